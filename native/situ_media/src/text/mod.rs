//! Text in pictures: any script, from font files, anti-aliased, clipped at the picture's edges.
//!
//! A [`Typeface`] is a row of fonts: a character is taken from the first that has it, and drawn as the first one's
//! box for missing characters when none has. [`layout`] places glyphs, [`glyphs`] draws them.

mod file;
mod glyphs;
mod layout;

use crate::error::{fail, Code, Result};
use crate::picture::Shape;
use skrifa::font::Font;
use std::panic::{catch_unwind, AssertUnwindSafe};
use std::path::Path;

/// More is no label on a picture.
const MAX_BYTES: usize = 64 * 1024;

/// Heights of a capital, pixels.
const SIZES: std::ops::RangeInclusive<f64> = 1.0..=2000.0;

/// Fonts that text is drawn with: each character by the first of them that has it.
pub struct Typeface {
    fonts: Vec<Font>,
}

/// Where and how text is drawn. Colours are channel values in memory order, 0 to the format's greatest.
pub struct Style {
    /// The top left corner of the first line's capitals, (x, y) in pixels.
    pub at: (f64, f64),
    /// Height of a capital, 1 to 2,000 pixels.
    pub size: f64,
    /// The text's colour.
    pub color: [f64; 4],
    /// The colour of the box behind it, if there shall be one.
    pub background: Option<[f64; 4]>,
}

impl Typeface {
    /// Opens TrueType or OpenType files, or takes them from memory where they did not change since. Refuses
    /// ([`Code::BadFont`]) none at all, and any that cannot be read or is no font.
    pub fn open<'p>(paths: impl IntoIterator<Item = &'p Path>) -> Result<Typeface> {
        let fonts: Vec<_> = paths.into_iter().map(file::open).collect::<Result<_>>()?;
        if fonts.is_empty() {
            return fail(Code::BadFont, "text needs a font");
        }
        Ok(Typeface { fonts })
    }

    /// Width and height of the text's box in pixels: the widest line's advance, and from the top of the first line's
    /// capitals to the last line's foot.
    pub fn measure(&self, text: &str, size: f64) -> Result<(f64, f64)> {
        let laid = self.lay(text, size)?;
        Ok((laid.width.into(), laid.height().into()))
    }

    /// Draws into a picture of `shape` without gaps.
    pub fn draw(&self, text: &str, style: &Style, shape: Shape, out: &mut [u8]) -> Result<()> {
        if out.len() != shape.bytes() {
            return fail(Code::Failed, "the buffer does not fit the picture");
        }
        let laid = self.lay(text, style.size)?;
        sound(|| glyphs::draw(&self.fonts, &laid, style, shape, out))
    }

    fn lay(&self, text: &str, size: f64) -> Result<layout::Layout> {
        if !SIZES.contains(&size) {
            return fail(
                Code::BadOption,
                format!("text is 1 to 2000 pixels high, not {size}"),
            );
        }
        if text.len() > MAX_BYTES {
            return fail(
                Code::TooLarge,
                format!("{} bytes of text, the most is {MAX_BYTES}", text.len()),
            );
        }
        sound(|| layout::lay(&self.fonts, text, size as f32))?
    }
}

/// The libraries promise an error or nothing for every font; should one break its promise, that is an error, too.
fn sound<T>(work: impl FnOnce() -> T) -> Result<T> {
    catch_unwind(AssertUnwindSafe(work)).or_else(|_| fail(Code::BadFont, "the font is damaged"))
}

#[cfg(test)]
mod tests;

//! Anti-aliased text in images, in any script, from font files, clipped at the edges of the image.
//!
//! A [`Typeface`] is a list of fonts. Each character is taken from the first font that contains it; if there is none,
//! it is drawn as the box for missing characters of the first font. [`layout`] positions the glyphs, and [`glyphs`]
//! draws them.
//!
//! OpenCV's fonts are ASCII only. FreeType and HarfBuzz would add two C libraries, and `ab_glyph` does not join
//! letters or support right-to-left text. `cosmic-text` searches the machine's fonts by family, so drawings would
//! differ between machines. Therefore this module uses `harfrust` and `skrifa`, and fonts are named by file.

mod font_cache;
mod glyphs;
mod layout;

use crate::error::{fail, Code, Result};
use crate::image::Shape;
use skrifa::font::Font;
use std::panic::{catch_unwind, AssertUnwindSafe};
use std::path::Path;

/// A longer text is not a label for an image.
const MAX_BYTES: usize = 64 * 1024;

/// The range of the height of a capital letter, in pixels.
const SIZES: std::ops::RangeInclusive<f64> = 1.0..=2000.0;

/// The fonts for drawing text; the first font that contains a character is used for it.
pub struct Typeface {
    fonts: Vec<Font>,
}

/// The position and appearance of text. Colors are channel values in memory order, from 0 to the format's maximum.
pub struct Style {
    /// The top left corner of the first line's capital letters, (x, y) in pixels.
    pub at: (f64, f64),
    /// The height of a capital letter, 1 to 2,000 pixels.
    pub size: f64,
    /// The color of the text.
    pub color: [f64; 4],
    /// The color of the box behind the text, if any.
    pub background: Option<[f64; 4]>,
}

impl Typeface {
    /// Opens TrueType or OpenType files. Unchanged files are taken from a cache. Returns [`Code::BadFont`] if there
    /// are no files, or if a file cannot be read or is not a font.
    pub fn open<'p>(paths: impl IntoIterator<Item = &'p Path>) -> Result<Typeface> {
        let fonts: Vec<_> = paths
            .into_iter()
            .map(font_cache::open_font)
            .collect::<Result<_>>()?;
        if fonts.is_empty() {
            return fail(Code::BadFont, "text needs at least one font file");
        }
        Ok(Typeface { fonts })
    }

    /// Returns the width and height of the text's box in pixels: the advance of the widest line, and the distance
    /// from the top of the first line's capitals to the bottom of the last line.
    pub fn measure(&self, text: &str, size: f64) -> Result<(f64, f64)> {
        let laid = self.layout_text(text, size)?;
        Ok((laid.width.into(), laid.height().into()))
    }

    /// Draws text into an image of `shape` with contiguous rows.
    pub fn draw(&self, text: &str, style: &Style, shape: Shape, out: &mut [u8]) -> Result<()> {
        if out.len() != shape.bytes() {
            return fail(
                Code::Failed,
                "the buffer does not match the size of the image",
            );
        }
        let laid = self.layout_text(text, style.size)?;
        catch_font_panic(|| glyphs::draw_text(&self.fonts, &laid, style, shape, out))
    }

    fn layout_text(&self, text: &str, size: f64) -> Result<layout::Layout> {
        if !SIZES.contains(&size) {
            return fail(
                Code::BadOption,
                format!("the height of text must be 1 to 2000 pixels, not {size}"),
            );
        }
        if text.len() > MAX_BYTES {
            return fail(
                Code::TooLarge,
                format!(
                    "{} bytes of text are more than the maximum of {MAX_BYTES}",
                    text.len()
                ),
            );
        }
        catch_font_panic(|| layout::layout_text(&self.fonts, text, size as f32))?
    }
}

/// Turns a panic of the font libraries into an error. They promise to handle every font, so this should never happen.
fn catch_font_panic<T>(work: impl FnOnce() -> T) -> Result<T> {
    catch_unwind(AssertUnwindSafe(work)).or_else(|_| fail(Code::BadFont, "the font is damaged"))
}

#[cfg(test)]
mod tests;

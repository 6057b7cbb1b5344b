//! Where each glyph goes: lines, writing direction, scripts, fonts, then HarfBuzz.

use crate::error::{fail, Code, Result};
use harfrust::{unicode, Buffer, Direction, Script, ShapeOptions, ShaperFont};
use skrifa::font::Font;
use skrifa::GlyphId;
use std::ops::Range;
use unicode_bidi::BidiInfo;

/// One glyph, its origin in pixels from the left end of the first line's baseline, y downwards.
pub struct Glyph {
    pub font: usize,
    pub id: GlyphId,
    pub x: f32,
    pub y: f32,
}

pub struct Layout {
    pub glyphs: Vec<Glyph>,
    /// Height of a capital.
    pub size: f32,
    /// Pixels of the em square's side.
    pub ppem: f32,
    pub width: f32,
    pub lines: usize,
    pub line_height: f32,
}

impl Layout {
    /// From the top of the first line's capitals to the foot of the last line: letters hang a third below the line.
    pub fn height(&self) -> f32 {
        (self.lines.saturating_sub(1)) as f32 * self.line_height + self.size * 1.35
    }
}

pub fn lay(fonts: &[Font], text: &str, size: f32) -> Result<Layout> {
    let ppem = size / capital(&fonts[0]);
    let mut laid = Layout {
        glyphs: Vec::new(),
        size,
        ppem,
        width: 0.0,
        lines: 0,
        line_height: leading(&fonts[0]) * ppem,
    };
    let text = text.replace('\t', "    ");
    for line in text.split('\n') {
        laid.lay_line(fonts, line.strip_suffix('\r').unwrap_or(line))?;
    }
    Ok(laid)
}

impl Layout {
    /// A line is left-aligned whatever its direction.
    fn lay_line(&mut self, fonts: &[Font], line: &str) -> Result<()> {
        let (mut x, y) = (0.0, self.lines as f32 * self.line_height);
        let bidi = BidiInfo::new(line, None);
        for paragraph in &bidi.paragraphs {
            let (levels, runs) = bidi.visual_runs(paragraph, paragraph.range.clone());
            for run in runs {
                let rtl = levels[run.start].is_rtl();
                let mut pieces = pieces(fonts, line, run);
                if rtl {
                    pieces.reverse();
                }
                for piece in pieces {
                    x = self.shape(fonts, &line[piece.range.clone()], &piece, rtl, (x, y))?;
                }
            }
        }
        self.width = self.width.max(x);
        self.lines += 1;
        Ok(())
    }

    /// Places the glyphs of a piece; answers where the next one starts.
    fn shape(
        &mut self,
        fonts: &[Font],
        text: &str,
        piece: &Piece,
        rtl: bool,
        (mut x, y): (f32, f32),
    ) -> Result<f32> {
        let font = &fonts[piece.font];
        let mut buffer = Buffer::new();
        buffer.push_str(text);
        buffer.set_direction(if rtl {
            Direction::RightToLeft
        } else {
            Direction::LeftToRight
        });
        buffer.set_script(piece.script);
        let shaped = harfrust::shape(&ShaperFont::new(font), &mut buffer, ShapeOptions::new());
        if shaped.is_err() || !buffer.allocation_successful() {
            return fail(Code::BadFont, "the font cannot set this text");
        }
        let scale = self.ppem / font.units_per_em() as f32;
        for (info, place) in buffer.glyph_infos().iter().zip(buffer.glyph_positions()) {
            self.glyphs.push(Glyph {
                font: piece.font,
                id: info.glyph_id.into(),
                x: x + place.x_offset as f32 * scale,
                y: y - place.y_offset as f32 * scale,
            });
            x += place.x_advance as f32 * scale;
        }
        Ok(x)
    }
}

/// A part of a line in one direction with one font and one script.
struct Piece {
    range: Range<usize>,
    font: usize,
    script: Option<Script>,
}

fn pieces(fonts: &[Font], line: &str, run: Range<usize>) -> Vec<Piece> {
    let mut pieces: Vec<Piece> = Vec::new();
    for (at, c) in line[run.clone()].char_indices() {
        let script = own_script(c);
        let range = run.start + at..run.start + at + c.len_utf8();
        if let Some(last) = pieces.last_mut() {
            let same_script = script.is_none() || last.script.is_none() || script == last.script;
            if same_script && font_for(fonts, c, Some(last.font)) == last.font {
                last.range.end = range.end;
                last.script = last.script.or(script);
                continue;
            }
        }
        let font = font_for(fonts, c, pieces.last().map(|last| last.font));
        pieces.push(Piece {
            range,
            font,
            script,
        });
    }
    pieces
}

/// `None` for characters of every script: digits, spaces, marks.
fn own_script(c: char) -> Option<Script> {
    let script = unicode::script(c.into());
    (![Script::COMMON, Script::INHERITED, Script::UNKNOWN].contains(&script)).then_some(script)
}

/// Marks stay with their letter, spaces where they are; the rest takes the first font that has it, or the first of all.
fn font_for(fonts: &[Font], c: char, last: Option<usize>) -> usize {
    let has = |font: &Font| font.charmap().map_unicode(c).is_some();
    match last {
        Some(last) if attached(c) => last,
        Some(last) if c.is_whitespace() && has(&fonts[last]) => last,
        _ => fonts.iter().position(has).unwrap_or(0),
    }
}

fn attached(c: char) -> bool {
    unicode::script(c.into()) == Script::INHERITED || c == '\u{200c}' || c == '\u{200d}'
}

/// Height of a capital, in ems.
fn capital(font: &Font) -> f32 {
    let em = f32::from(font.units_per_em());
    let stated = font
        .metrics()
        .cap_height
        .map(|height| height.to_f64() as f32);
    let drawn = || {
        let glyph = font.charmap().map_unicode('H')?;
        Some(font.glyph_metrics().extents(glyph)?.y_bearing)
    };
    // Fonts without capitals, or that state nonsense, get what is usual.
    let usual = |height: &f32| (0.3..=1.2).contains(&(height / em));
    stated
        .filter(usual)
        .or_else(|| drawn().filter(usual))
        .map_or(0.7, |height| height / em)
}

/// From line to line, in ems.
fn leading(font: &Font) -> f32 {
    let em = f64::from(font.units_per_em());
    let stated = font.metrics().h_line().map(|line| {
        (line.ascender.to_f64() - line.descender.to_f64() + line.line_gap.to_f64()) / em
    });
    stated
        .filter(|leading| (0.8..=3.0).contains(leading))
        .unwrap_or(1.2) as f32
}

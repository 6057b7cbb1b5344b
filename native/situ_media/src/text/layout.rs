//! Positions the glyphs: splits text into lines, writing directions, scripts and fonts, then shapes it with HarfBuzz.

use crate::error::{fail, Code, Result};
use harfrust::{unicode, Buffer, Direction, Script, ShapeOptions, ShaperFont};
use skrifa::font::Font;
use skrifa::GlyphId;
use std::ops::Range;
use unicode_bidi::BidiInfo;

/// A glyph, with its origin in pixels from the left end of the first line's baseline; y points downwards.
pub struct Glyph {
    pub font: usize,
    pub id: GlyphId,
    pub x: f32,
    pub y: f32,
}

pub struct Layout {
    pub glyphs: Vec<Glyph>,
    /// The height of a capital letter.
    pub size: f32,
    /// The side of the em square, in pixels.
    pub ppem: f32,
    pub width: f32,
    pub lines: usize,
    pub line_height: f32,
}

impl Layout {
    /// Returns the height from the top of the first line's capitals to the bottom of the last line. Descenders extend
    /// about a third below the baseline.
    pub fn height(&self) -> f32 {
        (self.lines.saturating_sub(1)) as f32 * self.line_height + self.size * 1.35
    }
}

pub fn layout_text(fonts: &[Font], text: &str, size: f32) -> Result<Layout> {
    let ppem = size / capital_height(&fonts[0]);
    let mut laid = Layout {
        glyphs: Vec::new(),
        size,
        ppem,
        width: 0.0,
        lines: 0,
        line_height: line_spacing(&fonts[0]) * ppem,
    };
    let text = text.replace('\t', "    ");
    for line in text.split('\n') {
        laid.layout_line(fonts, line.strip_suffix('\r').unwrap_or(line))?;
    }
    Ok(laid)
}

impl Layout {
    /// Lays out a line. Lines are left-aligned regardless of their direction.
    fn layout_line(&mut self, fonts: &[Font], line: &str) -> Result<()> {
        let (mut x, y) = (0.0, self.lines as f32 * self.line_height);
        let bidi = BidiInfo::new(line, None);
        for paragraph in &bidi.paragraphs {
            let (levels, runs) = bidi.visual_runs(paragraph, paragraph.range.clone());
            for run in runs {
                let rtl = levels[run.start].is_rtl();
                let mut segments = split_segments(fonts, line, run);
                if rtl {
                    segments.reverse();
                }
                for segment in segments {
                    x = self.shape_segment(
                        fonts,
                        &line[segment.range.clone()],
                        &segment,
                        rtl,
                        (x, y),
                    )?;
                }
            }
        }
        self.width = self.width.max(x);
        self.lines += 1;
        Ok(())
    }

    /// Appends the glyphs of a segment and returns the position of the next one.
    fn shape_segment(
        &mut self,
        fonts: &[Font],
        text: &str,
        segment: &Segment,
        rtl: bool,
        (mut x, y): (f32, f32),
    ) -> Result<f32> {
        let font = &fonts[segment.font];
        let mut buffer = Buffer::new();
        buffer.push_str(text);
        buffer.set_direction(if rtl {
            Direction::RightToLeft
        } else {
            Direction::LeftToRight
        });
        buffer.set_script(segment.script);
        let shaped = harfrust::shape(&ShaperFont::new(font), &mut buffer, ShapeOptions::new());
        if shaped.is_err() || !buffer.allocation_successful() {
            return fail(Code::BadFont, "the font cannot shape this text");
        }
        let scale = self.ppem / font.units_per_em() as f32;
        for (info, position) in buffer.glyph_infos().iter().zip(buffer.glyph_positions()) {
            self.glyphs.push(Glyph {
                font: segment.font,
                id: info.glyph_id.into(),
                x: x + position.x_offset as f32 * scale,
                y: y - position.y_offset as f32 * scale,
            });
            x += position.x_advance as f32 * scale;
        }
        Ok(x)
    }
}

/// A part of a line with one direction, one font and one script.
struct Segment {
    range: Range<usize>,
    font: usize,
    script: Option<Script>,
}

fn split_segments(fonts: &[Font], line: &str, run: Range<usize>) -> Vec<Segment> {
    let mut segments: Vec<Segment> = Vec::new();
    for (at, c) in line[run.clone()].char_indices() {
        let script = specific_script(c);
        let range = run.start + at..run.start + at + c.len_utf8();
        if let Some(last) = segments.last_mut() {
            let same_script = script.is_none() || last.script.is_none() || script == last.script;
            if same_script && find_font(fonts, c, Some(last.font)) == last.font {
                last.range.end = range.end;
                last.script = last.script.or(script);
                continue;
            }
        }
        let font = find_font(fonts, c, segments.last().map(|last| last.font));
        segments.push(Segment {
            range,
            font,
            script,
        });
    }
    segments
}

/// Returns the script of a character, or `None` for characters used in every script: digits, spaces, marks.
fn specific_script(c: char) -> Option<Script> {
    let script = unicode::script(c.into());
    (![Script::COMMON, Script::INHERITED, Script::UNKNOWN].contains(&script)).then_some(script)
}

/// Returns the font for a character. Marks use the font of their letter, and spaces the current font if possible.
/// Other characters use the first font that contains them, or else the first font.
fn find_font(fonts: &[Font], c: char, last: Option<usize>) -> usize {
    let has = |font: &Font| font.charmap().map_unicode(c).is_some();
    match last {
        Some(last) if is_attached(c) => last,
        Some(last) if c.is_whitespace() && has(&fonts[last]) => last,
        _ => fonts.iter().position(has).unwrap_or(0),
    }
}

fn is_attached(c: char) -> bool {
    unicode::script(c.into()) == Script::INHERITED || c == '\u{200c}' || c == '\u{200d}'
}

/// Returns the height of a capital letter, in ems.
fn capital_height(font: &Font) -> f32 {
    let em = f32::from(font.units_per_em());
    let stated = font
        .metrics()
        .cap_height
        .map(|height| height.to_f64() as f32);
    let drawn = || {
        let glyph = font.charmap().map_unicode('H')?;
        Some(font.glyph_metrics().extents(glyph)?.y_bearing)
    };
    // Fonts without capitals or with implausible metrics get a common default.
    let usual = |height: &f32| (0.3..=1.2).contains(&(height / em));
    stated
        .filter(usual)
        .or_else(|| drawn().filter(usual))
        .map_or(0.7, |height| height / em)
}

/// Returns the distance between two baselines, in ems.
fn line_spacing(font: &Font) -> f32 {
    let em = f64::from(font.units_per_em());
    let stated = font.metrics().h_line().map(|line| {
        (line.ascender.to_f64() - line.descender.to_f64() + line.line_gap.to_f64()) / em
    });
    stated
        .filter(|leading| (0.8..=3.0).contains(leading))
        .unwrap_or(1.2) as f32
}

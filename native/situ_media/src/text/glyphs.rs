//! Converts glyphs to outlines, and renders outlines.

use super::layout::Layout;
use super::Style;
use crate::blend::{blend_color, fill_rect, mix_channel, Rect};
use crate::image::Shape;
use skrifa::font::glyph::outline::PathSink;
use skrifa::font::Font;
use skrifa::{DrawMemory, GlyphId, ScalerFont};
use zeno::{Command, Mask, Point};

/// Glyphs that extend further from their origin, in pixels, are not drawn. No real font has one at the allowed sizes,
/// and the fixed-point numbers of the rasterizer overflow beyond twice this distance.
const MAX_GLYPH: f32 = 8000.0;

/// The margin of the background around the text, in pixels.
const MARGIN: i64 = 2;

/// The outline of a glyph, in pixels from `at`, and the pixels of the image that it may touch.
struct Outline {
    path: Vec<Command>,
    at: (i64, i64),
    area: Rect,
}

pub fn draw_text(fonts: &[Font], laid: &Layout, style: &Style, shape: Shape, out: &mut [u8]) {
    let image = Rect::of_image(shape);
    let scalers: Vec<ScalerFont> = fonts
        .iter()
        .map(|font| ScalerFont::unhinted(font.clone(), Some(laid.ppem)))
        .collect();
    let outlines: Vec<Outline> = laid
        .glyphs
        .iter()
        .filter_map(|glyph| {
            let x = SubpixelPosition::new(style.at.0, glyph.x);
            let y = SubpixelPosition::new(style.at.1, laid.size + glyph.y);
            glyph_outline(&scalers[glyph.font], glyph.id, x, y)
        })
        .collect();
    if let Some(color) = style.background {
        let background = outlines.iter().fold(text_rect(laid, style), |sum, o| {
            sum.union(o.area.expand_by(MARGIN))
        });
        fill_rect(out, shape, background.intersect(image), color);
    }
    let visible: Vec<&Outline> = outlines
        .iter()
        .filter(|o| !o.area.intersect(image).is_empty())
        .collect();
    let Some(area) = visible
        .iter()
        .map(|o| o.area.intersect(image))
        .reduce(Rect::union)
    else {
        return;
    };
    blend_color(
        out,
        shape,
        area,
        &render_coverage(&visible, area),
        style.color,
    );
}

/// Returns the measured box of the text, which may be larger than the drawn pixels.
fn text_rect(laid: &Layout, style: &Style) -> Rect {
    let (x, y) = (style.at.0 as f32, style.at.1 as f32);
    Rect {
        left: x.round() as i64,
        top: y.round() as i64,
        right: (x + laid.width).round() as i64,
        bottom: (y + laid.height()).round() as i64,
    }
    .expand_by(MARGIN)
}

/// An integer pixel and a fraction. The rendering of text therefore depends only on the fraction, not on the position
/// in the image.
#[derive(Clone, Copy)]
struct SubpixelPosition {
    pixel: i64,
    fraction: f32,
}

impl SubpixelPosition {
    fn new(at: f64, further: f32) -> SubpixelPosition {
        let within = (at - at.floor()) as f32 + further;
        SubpixelPosition {
            pixel: at.floor() as i64 + within.floor() as i64,
            fraction: within - within.floor(),
        }
    }
}

fn glyph_outline(
    scaler: &ScalerFont,
    glyph: GlyphId,
    x: SubpixelPosition,
    y: SubpixelPosition,
) -> Option<Outline> {
    let mut pen = Pen {
        origin: (x.fraction, y.fraction),
        path: Vec::new(),
        low: (f32::MAX, f32::MAX),
        high: (f32::MIN, f32::MIN),
        finite: true,
    };
    // Glyphs without an outline (a space, a bitmap) and damaged glyphs are skipped.
    scaler
        .outline(glyph)?
        .draw(DrawMemory::Scratch, &mut pen)
        .ok()?;
    let far = [pen.low.0, pen.low.1, pen.high.0, pen.high.1]
        .iter()
        .any(|v| v.abs() > MAX_GLYPH);
    if far || !pen.finite {
        return None;
    }
    Some(Outline {
        path: pen.path,
        at: (x.pixel, y.pixel),
        area: Rect {
            left: x.pixel + pen.low.0.floor() as i64,
            top: y.pixel + pen.low.1.floor() as i64,
            right: x.pixel + pen.high.0.ceil() as i64,
            bottom: y.pixel + pen.high.1.ceil() as i64,
        },
    })
}

/// Returns how much of each pixel of `area` the outlines cover, 0 to 255.
fn render_coverage(outlines: &[&Outline], area: Rect) -> Vec<u8> {
    let width = area.width();
    let mut sum = vec![0; width * area.height()];
    for outline in outlines {
        let part = outline.area.intersect(area);
        let (mask, _) = Mask::new(outline.path.as_slice())
            .size(part.width() as u32, part.height() as u32)
            .offset((
                (outline.at.0 - part.left) as f32,
                (outline.at.1 - part.top) as f32,
            ))
            .render();
        let rows = sum.chunks_exact_mut(width);
        let rows = rows.skip((part.top - area.top) as usize);
        let from = (part.left - area.left) as usize;
        for (row, ink) in rows.zip(mask.chunks_exact(part.width())) {
            for (sum, ink) in row[from..].iter_mut().zip(ink) {
                // Composites overlapping glyphs.
                *sum = 255 - mix_channel(255 - *sum as u32, 0, *ink as u32) as u8;
            }
        }
    }
    sum
}

struct Pen {
    origin: (f32, f32),
    path: Vec<Command>,
    low: (f32, f32),
    high: (f32, f32),
    finite: bool,
}

impl Pen {
    /// Converts a point from font coordinates (y upwards) to image coordinates (y downwards). Points are rounded to
    /// the grid of the rasterizer, so that whole pixels can be added without rounding.
    fn add_point(&mut self, x: f32, y: f32) -> Point {
        let grid = |v: f32| (v * 256.0).round() / 256.0;
        let (x, y) = (grid(self.origin.0 + x), grid(self.origin.1 - y));
        self.finite &= x.is_finite() && y.is_finite();
        self.low = (self.low.0.min(x), self.low.1.min(y));
        self.high = (self.high.0.max(x), self.high.1.max(y));
        Point::new(x, y)
    }
}

impl PathSink for Pen {
    fn move_to(&mut self, x: f32, y: f32) {
        let to = self.add_point(x, y);
        self.path.push(Command::MoveTo(to));
    }

    fn line_to(&mut self, x: f32, y: f32) {
        let to = self.add_point(x, y);
        self.path.push(Command::LineTo(to));
    }

    fn quad_to(&mut self, cx: f32, cy: f32, x: f32, y: f32) {
        let (control, to) = (self.add_point(cx, cy), self.add_point(x, y));
        self.path.push(Command::QuadTo(control, to));
    }

    fn curve_to(&mut self, cx0: f32, cy0: f32, cx1: f32, cy1: f32, x: f32, y: f32) {
        let (a, b, to) = (
            self.add_point(cx0, cy0),
            self.add_point(cx1, cy1),
            self.add_point(x, y),
        );
        self.path.push(Command::CurveTo(a, b, to));
    }

    fn close(&mut self) {
        self.path.push(Command::Close);
    }
}

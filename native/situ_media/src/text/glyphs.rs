//! Glyphs as outlines, outlines as ink.

use super::layout::Layout;
use super::Style;
use crate::ink::{blend, fill, mix, Area};
use crate::picture::Shape;
use skrifa::font::glyph::outline::PathSink;
use skrifa::font::Font;
use skrifa::{DrawMemory, GlyphId, ScalerFont};
use zeno::{Command, Mask, Point};

/// Glyphs that reach further from their origin, in pixels, are not drawn: no honest font has one at a size we allow,
/// and beyond twice this the rasteriser's fixed-point numbers overflow.
const MAX_GLYPH: f32 = 8000.0;

/// The background's rim around the text, pixels.
const RIM: i64 = 2;

/// A glyph's outline, in pixels from `at`, and the picture's pixels it may touch.
struct Outline {
    path: Vec<Command>,
    at: (i64, i64),
    area: Area,
}

pub fn draw(fonts: &[Font], laid: &Layout, style: &Style, shape: Shape, out: &mut [u8]) {
    let picture = Area::of(shape);
    let scalers: Vec<ScalerFont> = fonts
        .iter()
        .map(|font| ScalerFont::unhinted(font.clone(), Some(laid.ppem)))
        .collect();
    let outlines: Vec<Outline> = laid
        .glyphs
        .iter()
        .filter_map(|glyph| {
            let x = Place::new(style.at.0, glyph.x);
            let y = Place::new(style.at.1, laid.size + glyph.y);
            outline(&scalers[glyph.font], glyph.id, x, y)
        })
        .collect();
    if let Some(color) = style.background {
        let behind = outlines
            .iter()
            .fold(nominal(laid, style), |sum, o| sum.around(o.area.grown(RIM)));
        fill(out, shape, behind.common(picture), color);
    }
    let visible: Vec<&Outline> = outlines
        .iter()
        .filter(|o| !o.area.common(picture).is_empty())
        .collect();
    let Some(area) = visible
        .iter()
        .map(|o| o.area.common(picture))
        .reduce(Area::around)
    else {
        return;
    };
    blend(out, shape, area, &coverage(&visible, area), style.color);
}

/// The box of the text as measured, whether ink is in it or not.
fn nominal(laid: &Layout, style: &Style) -> Area {
    let (x, y) = (style.at.0 as f32, style.at.1 as f32);
    Area {
        left: x.round() as i64,
        top: y.round() as i64,
        right: (x + laid.width).round() as i64,
        bottom: (y + laid.height()).round() as i64,
    }
    .grown(RIM)
}

/// A whole pixel and a part of one: text looks the same wherever in a picture it lies.
#[derive(Clone, Copy)]
struct Place {
    pixel: i64,
    part: f32,
}

impl Place {
    fn new(at: f64, further: f32) -> Place {
        let within = (at - at.floor()) as f32 + further;
        Place {
            pixel: at.floor() as i64 + within.floor() as i64,
            part: within - within.floor(),
        }
    }
}

fn outline(scaler: &ScalerFont, glyph: GlyphId, x: Place, y: Place) -> Option<Outline> {
    let mut pen = Pen {
        origin: (x.part, y.part),
        path: Vec::new(),
        low: (f32::MAX, f32::MAX),
        high: (f32::MIN, f32::MIN),
        finite: true,
    };
    // A glyph without an outline (a space, a picture) and one that is damaged leave nothing.
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
        area: Area {
            left: x.pixel + pen.low.0.floor() as i64,
            top: y.pixel + pen.low.1.floor() as i64,
            right: x.pixel + pen.high.0.ceil() as i64,
            bottom: y.pixel + pen.high.1.ceil() as i64,
        },
    })
}

/// How much of each pixel of `area` the outlines cover, 0 to 255.
fn coverage(outlines: &[&Outline], area: Area) -> Vec<u8> {
    let width = area.width();
    let mut sum = vec![0; width * area.height()];
    for outline in outlines {
        let part = outline.area.common(area);
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
                // One glyph over the other.
                *sum = 255 - mix(255 - *sum as u32, 0, *ink as u32) as u8;
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
    /// Fonts count upwards, pictures downwards. On the rasteriser's grid, so that whole pixels can be added without
    /// rounding.
    fn point(&mut self, x: f32, y: f32) -> Point {
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
        let to = self.point(x, y);
        self.path.push(Command::MoveTo(to));
    }

    fn line_to(&mut self, x: f32, y: f32) {
        let to = self.point(x, y);
        self.path.push(Command::LineTo(to));
    }

    fn quad_to(&mut self, cx: f32, cy: f32, x: f32, y: f32) {
        let (control, to) = (self.point(cx, cy), self.point(x, y));
        self.path.push(Command::QuadTo(control, to));
    }

    fn curve_to(&mut self, cx0: f32, cy0: f32, cx1: f32, cy1: f32, x: f32, y: f32) {
        let (a, b, to) = (self.point(cx0, cy0), self.point(cx1, cy1), self.point(x, y));
        self.path.push(Command::CurveTo(a, b, to));
    }

    fn close(&mut self) {
        self.path.push(Command::Close);
    }
}

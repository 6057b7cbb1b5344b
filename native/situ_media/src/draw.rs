//! Lines, rectangles and circles, anti-aliased, clipped at the picture's edges.
//!
//! A pixel's place is its middle. A line covers its width to both sides of the way from middle to middle, end pixels
//! included, so straight ones of odd width have sharp edges. How much of a pixel is covered follows from how far its
//! middle is from the figure's edge.

use crate::error::{fail, Code, Result};
use crate::ink::{blend, fill, Area};
use crate::picture::Shape;

/// A figure in pixels; (0, 0) is the middle of the top left pixel. Numbers beyond [`REACH`] are refused.
#[derive(Clone, Copy, Debug)]
pub enum Figure {
    /// A straight line, its ends cut straight half a pixel beyond the end points.
    Line {
        /// One end, (x, y).
        from: (f64, f64),
        /// The other end.
        to: (f64, f64),
        /// Across, at least 1 (less counts as 1).
        width: f64,
    },
    /// Left, top, width, height; the outline of a width, or filled.
    Rectangle([f64; 4], Option<f64>),
    /// Middle and radius; the outline of a width, or filled.
    Circle((f64, f64), f64, Option<f64>),
}

/// No number of a figure is larger: beyond any picture, and pixels stay whole numbers.
pub const REACH: f64 = 1e6;

impl Figure {
    fn numbers(&self) -> [f64; 5] {
        match *self {
            Figure::Line { from, to, width } => [from.0, from.1, to.0, to.1, width],
            Figure::Rectangle([x, y, w, h], width) => [x, y, w, h, width.unwrap_or(0.0)],
            Figure::Circle((x, y), radius, width) => [x, y, radius, width.unwrap_or(0.0), 0.0],
        }
    }
}

/// Draws onto a picture of `shape` without gaps; colours are channel values in memory order.
pub fn draw(figure: &Figure, color: [f64; 4], shape: Shape, out: &mut [u8]) -> Result<()> {
    if out.len() != shape.bytes() {
        return fail(Code::Failed, "the buffer does not fit the picture");
    }
    // Not a number is not within reach either.
    let near = |number: f64| number.abs() <= REACH;
    if !figure.numbers().into_iter().all(near) {
        return fail(
            Code::BadOption,
            "shapes must lie within 1,000,000 pixels of the picture",
        );
    }
    match *figure {
        Figure::Line { from, to, width } => {
            let bar = Bar::new(from, to, width.max(1.0));
            let rows = (bar.middle.1 - bar.reach(), bar.middle.1 + bar.reach());
            let spans = |y| [bar.span(y), None];
            paint(rows, spans, |x, y| bar.cover(x, y), color, shape, out);
        }
        Figure::Rectangle(place, width) => rectangle(place, width, color, shape, out),
        Figure::Circle(middle, radius, width) => {
            let ring = Ring::new(middle, radius, width);
            let reach = ring.outer + 0.5;
            let rows = (middle.1 - reach, middle.1 + reach);
            let spans = |y| ring.spans(y);
            paint(rows, spans, |x, y| ring.cover(x, y), color, shape, out);
        }
    }
    Ok(())
}

type Span = Option<(f64, f64)>;

/// Row by row: the spans that may be covered, pixel by pixel how much.
fn paint(
    rows: (f64, f64),
    spans: impl Fn(f64) -> [Span; 2],
    cover: impl Fn(f64, f64) -> f64,
    color: [f64; 4],
    shape: Shape,
    out: &mut [u8],
) {
    let (top, bottom) = whole(rows, shape.height);
    for y in top..bottom {
        for span in spans(y as f64).into_iter().flatten() {
            let (left, right) = whole(span, shape.width);
            let covered: Vec<u8> = (left..right)
                .map(|x| (cover(x as f64, y as f64) * 255.0).round() as u8)
                .collect();
            if !covered.is_empty() {
                let area = Area {
                    left,
                    top: y,
                    right,
                    bottom: y + 1,
                };
                blend(out, shape, area, &covered, color);
            }
        }
    }
}

/// The pixels, first and one behind the last, between two places in a picture of `size` pixels.
fn whole((from, to): (f64, f64), size: usize) -> (i64, i64) {
    let size = size as f64;
    let from = from.floor().clamp(0.0, size);
    (from as i64, (to.ceil() + 1.0).clamp(from, size) as i64)
}

/// How much a pixel is covered whose middle lies this far inside of an edge.
fn inside(distance: f64) -> f64 {
    (distance + 0.5).clamp(0.0, 1.0)
}

/// A line as a bar: its middle, direction, half its length and half its width.
struct Bar {
    middle: (f64, f64),
    along: (f64, f64),
    length: f64,
    width: f64,
}

impl Bar {
    fn new(from: (f64, f64), to: (f64, f64), width: f64) -> Bar {
        let way = (to.0 - from.0, to.1 - from.1);
        let length = way.0.hypot(way.1);
        let along = if length > 0.0 {
            (way.0 / length, way.1 / length)
        } else {
            (1.0, 0.0)
        };
        Bar {
            middle: ((from.0 + to.0) / 2.0, (from.1 + to.1) / 2.0),
            along,
            length: length / 2.0 + 0.5,
            width: width / 2.0,
        }
    }

    /// How far up and down it reaches.
    fn reach(&self) -> f64 {
        (self.length + 0.5) * self.along.1.abs() + (self.width + 0.5) * self.along.0.abs()
    }

    /// Where a row meets it.
    fn span(&self, y: f64) -> Span {
        let dy = y - self.middle.1;
        let (ax, ay) = self.along;
        let ends = slab(ax, dy * ay, self.length + 0.5);
        let sides = slab(ay, -dy * ax, self.width + 0.5);
        let (from, to) = (ends.0.max(sides.0), ends.1.min(sides.1));
        (from <= to).then_some((self.middle.0 + from, self.middle.0 + to))
    }

    fn cover(&self, x: f64, y: f64) -> f64 {
        let (dx, dy) = (x - self.middle.0, y - self.middle.1);
        let (ax, ay) = self.along;
        let (along, across) = ((dx * ax + dy * ay).abs(), (dx * ay - dy * ax).abs());
        inside(self.length - along) * inside(self.width - across)
    }
}

/// For which x the value `slope * x + offset` is within `limit` of 0.
fn slab(slope: f64, offset: f64, limit: f64) -> (f64, f64) {
    if slope.abs() < 1e-9 {
        return if offset.abs() <= limit {
            (f64::NEG_INFINITY, f64::INFINITY)
        } else {
            (f64::INFINITY, f64::NEG_INFINITY)
        };
    }
    let (a, b) = ((-limit - offset) / slope, (limit - offset) / slope);
    (a.min(b), a.max(b))
}

/// A circle as what lies between two radii; a disc covers the pixels its outline would.
struct Ring {
    middle: (f64, f64),
    outer: f64,
    inner: Option<f64>,
}

impl Ring {
    fn new(middle: (f64, f64), radius: f64, width: Option<f64>) -> Ring {
        let half = width.map_or(0.5, |width| width.max(1.0) / 2.0);
        Ring {
            middle,
            outer: radius + half,
            inner: width.map(|_| radius - half).filter(|inner| *inner > 0.0),
        }
    }

    /// Where a row meets it: once, or left and right of the hole.
    fn spans(&self, y: f64) -> [Span; 2] {
        let dy = y - self.middle.1;
        let half = |radius: f64| (radius * radius - dy * dy).max(0.0).sqrt();
        let (x, outer) = (self.middle.0, half(self.outer + 0.5));
        match self.inner.map(|inner| half(inner - 0.5)) {
            Some(hole) if hole > 1.0 => [Some((x - outer, x - hole)), Some((x + hole, x + outer))],
            _ => [Some((x - outer, x + outer)), None],
        }
    }

    fn cover(&self, x: f64, y: f64) -> f64 {
        let distance = (x - self.middle.0).hypot(y - self.middle.1);
        let hole = self.inner.map_or(1.0, |inner| inside(distance - inner));
        inside(self.outer - distance) * hole
    }
}

/// Rectangles lie on whole pixels; an outline of even width has the odd pixel inside.
fn rectangle(
    [x, y, w, h]: [f64; 4],
    width: Option<f64>,
    color: [f64; 4],
    shape: Shape,
    out: &mut [u8],
) {
    let all = Area {
        left: x.round() as i64,
        top: y.round() as i64,
        right: (x + w).round() as i64,
        bottom: (y + h).round() as i64,
    };
    let Some(width) = width else {
        return fill(out, shape, all.common(Area::of(shape)), color);
    };
    let width = width.round().max(1.0) as i64;
    let outer = all.grown((width - 1) / 2);
    let inner = outer.grown(-width);
    let bands = if inner.is_empty() {
        vec![outer]
    } else {
        let Area {
            left,
            right,
            top,
            bottom,
        } = inner;
        vec![
            Area {
                bottom: top,
                ..outer
            },
            Area {
                top: bottom,
                ..outer
            },
            Area {
                right: left,
                ..inner_rows(outer, inner)
            },
            Area {
                left: right,
                ..inner_rows(outer, inner)
            },
        ]
    };
    for band in bands {
        fill(out, shape, band.common(Area::of(shape)), color);
    }
}

fn inner_rows(outer: Area, inner: Area) -> Area {
    Area {
        top: inner.top,
        bottom: inner.bottom,
        ..outer
    }
}

#[cfg(test)]
mod tests;

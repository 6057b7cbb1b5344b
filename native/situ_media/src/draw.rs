//! Anti-aliased lines, rectangles and circles, clipped at the edges of the image.
//!
//! The coordinates of a pixel are those of its center. A line covers half its width to both sides of the segment
//! between the two centers, including the end pixels, so straight lines of odd width have sharp edges. The coverage
//! of a pixel is computed from the distance between its center and the edge of the figure.
//!
//! OpenCV draws anti-aliased lines wider than requested (2 becomes 3 pixels, 5 becomes 7) and does not smooth 16-bit
//! images. Filling outlines with `zeno`, as for letters, overflows its fixed-point numbers at 8,000 pixels.

use crate::blend::{blend_color, fill_rect, Rect};
use crate::error::{fail, Code, Result};
use crate::image::Shape;

/// A figure in pixels; (0, 0) is the center of the top left pixel. Numbers beyond [`REACH`] are rejected.
#[derive(Clone, Copy, Debug)]
pub enum Figure {
    /// A straight line with square ends, half a pixel beyond the end points.
    Line {
        /// One end, (x, y).
        from: (f64, f64),
        /// The other end.
        to: (f64, f64),
        /// The thickness, at least 1 (smaller values count as 1).
        width: f64,
    },
    /// Left, top, width, height; with a line width for an outline, or filled.
    Rectangle([f64; 4], Option<f64>),
    /// Center and radius; with a line width for an outline, or filled.
    Circle((f64, f64), f64, Option<f64>),
}

/// The maximum absolute value of a number in a figure: it is beyond any image, and pixels stay exact integers.
pub const REACH: f64 = 1e6;

impl Figure {
    fn all_numbers(&self) -> [f64; 5] {
        match *self {
            Figure::Line { from, to, width } => [from.0, from.1, to.0, to.1, width],
            Figure::Rectangle([x, y, w, h], width) => [x, y, w, h, width.unwrap_or(0.0)],
            Figure::Circle((x, y), radius, width) => [x, y, radius, width.unwrap_or(0.0), 0.0],
        }
    }
}

/// Draws a figure on an image of `shape` with contiguous rows. Colors are channel values in memory order.
pub fn draw_figure(figure: &Figure, color: [f64; 4], shape: Shape, out: &mut [u8]) -> Result<()> {
    if out.len() != shape.bytes() {
        return fail(
            Code::Failed,
            "the buffer does not match the size of the image",
        );
    }
    // NaN fails this comparison, too.
    let is_near = |number: f64| number.abs() <= REACH;
    if !figure.all_numbers().into_iter().all(is_near) {
        return fail(
            Code::BadOption,
            "shapes must be within 1,000,000 pixels of the image",
        );
    }
    match *figure {
        Figure::Line { from, to, width } => {
            let bar = Bar::new(from, to, width.max(1.0));
            let rows = (
                bar.center.1 - bar.vertical_reach(),
                bar.center.1 + bar.vertical_reach(),
            );
            let spans = |y| [bar.row_span(y), None];
            paint_spans(rows, spans, |x, y| bar.coverage_at(x, y), color, shape, out);
        }
        Figure::Rectangle(rect, width) => draw_rectangle(rect, width, color, shape, out),
        Figure::Circle(center, radius, width) => {
            let ring = Ring::new(center, radius, width);
            let reach = ring.outer + 0.5;
            let rows = (center.1 - reach, center.1 + reach);
            let spans = |y| ring.row_spans(y);
            paint_spans(
                rows,
                spans,
                |x, y| ring.coverage_at(x, y),
                color,
                shape,
                out,
            );
        }
    }
    Ok(())
}

type Span = Option<(f64, f64)>;

/// Colors the pixels of the spans that may be covered, row by row.
fn paint_spans(
    rows: (f64, f64),
    spans: impl Fn(f64) -> [Span; 2],
    cover: impl Fn(f64, f64) -> f64,
    color: [f64; 4],
    shape: Shape,
    out: &mut [u8],
) {
    let (top, bottom) = pixel_range(rows, shape.height);
    for y in top..bottom {
        for span in spans(y as f64).into_iter().flatten() {
            let (left, right) = pixel_range(span, shape.width);
            let covered: Vec<u8> = (left..right)
                .map(|x| (cover(x as f64, y as f64) * 255.0).round() as u8)
                .collect();
            if !covered.is_empty() {
                let area = Rect {
                    left,
                    top: y,
                    right,
                    bottom: y + 1,
                };
                blend_color(out, shape, area, &covered, color);
            }
        }
    }
}

/// Returns the range of the pixels (first, last + 1) between two positions in an image of `size` pixels.
fn pixel_range((from, to): (f64, f64), size: usize) -> (i64, i64) {
    let size = size as f64;
    let from = from.floor().clamp(0.0, size);
    (from as i64, (to.ceil() + 1.0).clamp(from, size) as i64)
}

/// Returns the coverage of a pixel whose center is this far inside an edge.
fn edge_coverage(distance: f64) -> f64 {
    (distance + 0.5).clamp(0.0, 1.0)
}

/// A line as a rotated rectangle: its center, its direction, half its length and half its width.
struct Bar {
    center: (f64, f64),
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
            center: ((from.0 + to.0) / 2.0, (from.1 + to.1) / 2.0),
            along,
            length: length / 2.0 + 0.5,
            width: width / 2.0,
        }
    }

    /// Returns how far the bar extends above and below its center.
    fn vertical_reach(&self) -> f64 {
        (self.length + 0.5) * self.along.1.abs() + (self.width + 0.5) * self.along.0.abs()
    }

    /// Returns the part of a row that may be covered.
    fn row_span(&self, y: f64) -> Span {
        let dy = y - self.center.1;
        let (ax, ay) = self.along;
        let ends = interval_within(ax, dy * ay, self.length + 0.5);
        let sides = interval_within(ay, -dy * ax, self.width + 0.5);
        let (from, to) = (ends.0.max(sides.0), ends.1.min(sides.1));
        (from <= to).then_some((self.center.0 + from, self.center.0 + to))
    }

    fn coverage_at(&self, x: f64, y: f64) -> f64 {
        let (dx, dy) = (x - self.center.0, y - self.center.1);
        let (ax, ay) = self.along;
        let (along, across) = ((dx * ax + dy * ay).abs(), (dx * ay - dy * ax).abs());
        edge_coverage(self.length - along) * edge_coverage(self.width - across)
    }
}

/// Returns the interval of x in which `slope * x + offset` is within `limit` of 0.
fn interval_within(slope: f64, offset: f64, limit: f64) -> (f64, f64) {
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

/// A circle as the area between two radii. A disc covers the same pixels as its outline.
struct Ring {
    center: (f64, f64),
    outer: f64,
    inner: Option<f64>,
}

impl Ring {
    fn new(center: (f64, f64), radius: f64, width: Option<f64>) -> Ring {
        let half = width.map_or(0.5, |width| width.max(1.0) / 2.0);
        Ring {
            center,
            outer: radius + half,
            inner: width.map(|_| radius - half).filter(|inner| *inner > 0.0),
        }
    }

    /// Returns the parts of a row that may be covered: one, or one to each side of the hole.
    fn row_spans(&self, y: f64) -> [Span; 2] {
        let dy = y - self.center.1;
        let half = |radius: f64| (radius * radius - dy * dy).max(0.0).sqrt();
        let (x, outer) = (self.center.0, half(self.outer + 0.5));
        match self.inner.map(|inner| half(inner - 0.5)) {
            Some(hole) if hole > 1.0 => [Some((x - outer, x - hole)), Some((x + hole, x + outer))],
            _ => [Some((x - outer, x + outer)), None],
        }
    }

    fn coverage_at(&self, x: f64, y: f64) -> f64 {
        let distance = (x - self.center.0).hypot(y - self.center.1);
        let hole = self
            .inner
            .map_or(1.0, |inner| edge_coverage(distance - inner));
        edge_coverage(self.outer - distance) * hole
    }
}

/// Draws a rectangle on whole pixels. For an outline of even width, the extra pixel is inside.
fn draw_rectangle(
    [x, y, w, h]: [f64; 4],
    width: Option<f64>,
    color: [f64; 4],
    shape: Shape,
    out: &mut [u8],
) {
    let all = Rect {
        left: x.round() as i64,
        top: y.round() as i64,
        right: (x + w).round() as i64,
        bottom: (y + h).round() as i64,
    };
    let Some(width) = width else {
        return fill_rect(out, shape, all.intersect(Rect::of_image(shape)), color);
    };
    let width = width.round().max(1.0) as i64;
    let outer = all.expand_by((width - 1) / 2);
    let inner = outer.expand_by(-width);
    let bands = if inner.is_empty() {
        vec![outer]
    } else {
        let Rect {
            left,
            right,
            top,
            bottom,
        } = inner;
        vec![
            Rect {
                bottom: top,
                ..outer
            },
            Rect {
                top: bottom,
                ..outer
            },
            Rect {
                right: left,
                ..side_rows(outer, inner)
            },
            Rect {
                left: right,
                ..side_rows(outer, inner)
            },
        ]
    };
    for band in bands {
        fill_rect(out, shape, band.intersect(Rect::of_image(shape)), color);
    }
}

fn side_rows(outer: Rect, inner: Rect) -> Rect {
    Rect {
        top: inner.top,
        bottom: inner.bottom,
        ..outer
    }
}

#[cfg(test)]
mod tests;

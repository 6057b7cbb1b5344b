//! Every picture-to-picture operation as one value: its result's shape first, then the work.

use crate::convolve::Kernel;
use crate::depth::PseudoColor;
use crate::error::{fail, Code, Result};
use crate::geometry::Axis;
use crate::picture::{Format, Shape, View};
use crate::pixelwise::Threshold;
use crate::resize::Filter;
use crate::{color, convolve, depth, geometry, pixelwise, resize};

/// A picture in, a picture out. `shape` says what comes out (or why not), `run` does it.
#[derive(Clone, Debug)]
pub enum Op<'a> {
    /// Into another pixel format, see [`color::convert`].
    Convert(Format),
    /// Left, top, width and height of the part that is kept, in pixels; it lies inside the picture.
    Crop(i64, i64, i64, i64),
    /// Width and height of the result, in pixels.
    Resize(usize, usize, Filter),
    /// As `Resize`, proportions kept; the rest takes the pixel given, `format.bytes()` bytes in memory order.
    Letterbox(usize, usize, Filter, Vec<u8>),
    /// Mirrored.
    Flip(Axis),
    /// Turned clockwise by so many quarters of a turn.
    QuarterTurns(u32),
    /// Every channel but the fourth from 255 (65,535) downwards.
    Invert,
    /// Threshold, the greatest value and the rule, see [`pixelwise::threshold`].
    Threshold(u32, u32, Threshold),
    /// The channel at this place in memory, from 0, as grey of the same depth.
    ExtractChannel(usize),
    /// The absolute difference of each channel from a picture of the same shape.
    AbsoluteDifference(View<'a>),
    /// Of grey pictures with a small kernel, see [`convolve`].
    Convolve(Kernel),
    /// `:gray16` depth as colours, `:bgra32`.
    PseudoColorize(PseudoColor),
    /// A picture of the same format over this one, where the mask (`:gray8`, its size) is not 0; left and top may be
    /// negative or beyond the picture: what falls outside is cut off.
    Paste(View<'a>, Option<View<'a>>, i64, i64),
}

impl Op<'_> {
    /// The result's shape; refuses what the operation cannot work on.
    pub fn shape(&self, src: &View) -> Result<Shape> {
        let Shape {
            width,
            height,
            format,
        } = src.shape;
        match self {
            Op::Convert(to) => Shape::new(width, height, *to),
            Op::Crop(x, y, w, h) => src.part(*x, *y, *w, *h).map(|v| v.shape),
            Op::Resize(w, h, _) => Shape::new(*w, *h, format),
            Op::Letterbox(w, h, _, pixel) if pixel.len() == format.bytes() => {
                Shape::new(*w, *h, format)
            }
            Op::Letterbox(..) => fail(Code::BadOption, "the fill colour does not fit the format"),
            Op::QuarterTurns(n) if n % 2 == 1 => Shape::new(height, width, format),
            Op::ExtractChannel(c) if *c >= format.channels() => fail(
                Code::BadOption,
                format!("{} has no channel {c}", format.name()),
            ),
            Op::ExtractChannel(_) => Shape::new(width, height, gray_of(format)),
            Op::Convolve(kernel) => convolve::check(src, kernel).map(|()| src.shape),
            Op::PseudoColorize(_) if format != Format::Gray16 => fail(
                Code::BadFormat,
                format!("depth is :gray16, this is {}", format.name()),
            ),
            Op::PseudoColorize(_) => Shape::new(width, height, Format::Bgra32),
            _ => Ok(src.shape),
        }
    }

    /// Runs into `out`, which has exactly the bytes of `shape`.
    pub fn run(&self, src: &View, shape: Shape, out: &mut [u8]) -> Result<()> {
        match self {
            Op::Convert(format) => color::convert(src, *format, out),
            Op::Crop(x, y, w, h) => color::copy(&src.part(*x, *y, *w, *h)?, out),
            Op::Resize(_, _, filter) => resize::resize(src, shape, *filter, out)?,
            Op::Letterbox(_, _, filter, pixel) => {
                geometry::letterbox(src, shape, *filter, pixel, out)?
            }
            Op::Flip(axis) => geometry::flip(src, *axis, out),
            Op::QuarterTurns(n) => geometry::quarter_turns(src, *n, out),
            Op::Invert => pixelwise::invert(src, out),
            Op::Threshold(t, max, kind) => pixelwise::threshold(src, *t, *max, *kind, out),
            Op::ExtractChannel(c) => pixelwise::extract_channel(src, *c, out),
            Op::AbsoluteDifference(other) => pixelwise::absolute_difference(src, other, out)?,
            Op::Convolve(kernel) => convolve::convolve(src, kernel, out),
            Op::PseudoColorize(how) => depth::pseudo_colorize(src, *how, out),
            Op::Paste(part, mask, x, y) => {
                color::copy(src, out);
                geometry::paste(part, mask.as_ref(), *x, *y, shape, out)?
            }
        }
        Ok(())
    }
}

fn gray_of(format: Format) -> Format {
    if format.bytes_per_channel() == 2 {
        Format::Gray16
    } else {
        Format::Gray8
    }
}

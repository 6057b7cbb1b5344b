//! Every operation from image to image as a value that reports the shape of its result and then runs.

use crate::convolve::Kernel;
use crate::depth::PseudoColor;
use crate::error::{fail, Code, Result};
use crate::geometry::Axis;
use crate::image::{Format, Shape, View};
use crate::pixelwise::Threshold;
use crate::resize::Filter;
use crate::{color, convolve, depth, geometry, pixelwise, resize};

/// An operation from image to image. `result_shape` returns the shape of the result or an error, and `run` computes
/// it.
#[derive(Clone, Debug)]
pub enum Op<'a> {
    /// Converts to another pixel format, see [`color::convert`].
    Convert(Format),
    /// Left, top, width and height of the part to keep, in pixels. It must be inside the image.
    Crop(i64, i64, i64, i64),
    /// Width and height of the result, in pixels.
    Resize(usize, usize, Filter),
    /// Like `Resize`, but keeps the aspect ratio. The rest is filled with the given pixel, which has
    /// `format.pixel_bytes()` bytes in memory order.
    Letterbox(usize, usize, Filter, Vec<u8>),
    /// Mirrors the image.
    Flip(Axis),
    /// Rotates the image clockwise by this number of quarter turns.
    QuarterTurns(u32),
    /// Inverts every channel except the fourth.
    Invert,
    /// The threshold, the maximum value and the rule, see [`pixelwise::threshold`].
    Threshold(u32, u32, Threshold),
    /// Extracts the channel with this index in memory (from 0) as gray of the same depth.
    ExtractChannel(usize),
    /// Computes the absolute difference of each channel from an image of the same shape.
    AbsoluteDifference(View<'a>),
    /// Convolves a gray image with a small kernel, see [`convolve`].
    Convolve(Kernel),
    /// Colors a `:gray16` depth image; the result is `:bgra32`.
    PseudoColorize(PseudoColor),
    /// Pastes an image of the same format where the mask (`:gray8`, the same size) is not 0. Left and top may be
    /// negative or beyond the image; parts outside the image are clipped.
    Paste(View<'a>, Option<View<'a>>, i64, i64),
}

impl Op<'_> {
    /// Returns the shape of the result, or an error if the operation does not support the image.
    pub fn result_shape(&self, src: &View) -> Result<Shape> {
        let Shape {
            width,
            height,
            format,
        } = src.shape;
        match self {
            Op::Convert(to) => Shape::new(width, height, *to),
            Op::Crop(x, y, w, h) => src.crop(*x, *y, *w, *h).map(|v| v.shape),
            Op::Resize(w, h, _) => Shape::new(*w, *h, format),
            Op::Letterbox(w, h, _, pixel) if pixel.len() == format.pixel_bytes() => {
                Shape::new(*w, *h, format)
            }
            Op::Letterbox(..) => fail(
                Code::BadOption,
                "the fill color does not match the pixel format",
            ),
            Op::QuarterTurns(n) if n % 2 == 1 => Shape::new(height, width, format),
            Op::ExtractChannel(c) if *c >= format.channel_count() => fail(
                Code::BadOption,
                format!("{} has no channel {c}", format.name()),
            ),
            Op::ExtractChannel(_) => Shape::new(width, height, gray_format(format)),
            Op::Convolve(kernel) => convolve::check_kernel(src, kernel).map(|()| src.shape),
            Op::PseudoColorize(_) if format != Format::Gray16 => fail(
                Code::BadFormat,
                format!("depth images must be :gray16, not {}", format.name()),
            ),
            Op::PseudoColorize(_) => Shape::new(width, height, Format::Bgra32),
            _ => Ok(src.shape),
        }
    }

    /// Writes the result to `out`, which must have exactly the bytes of `shape`.
    pub fn run(&self, src: &View, shape: Shape, out: &mut [u8]) -> Result<()> {
        match self {
            Op::Convert(format) => color::convert(src, *format, out),
            Op::Crop(x, y, w, h) => color::copy_rows(&src.crop(*x, *y, *w, *h)?, out),
            Op::Resize(_, _, filter) => resize::resize_image(src, shape, *filter, out)?,
            Op::Letterbox(_, _, filter, pixel) => {
                geometry::letterbox(src, shape, *filter, pixel, out)?
            }
            Op::Flip(axis) => geometry::flip(src, *axis, out),
            Op::QuarterTurns(n) => geometry::rotate_quarter_turns(src, *n, out),
            Op::Invert => pixelwise::invert(src, out),
            Op::Threshold(t, max, kind) => pixelwise::threshold(src, *t, *max, *kind, out),
            Op::ExtractChannel(c) => pixelwise::extract_channel(src, *c, out),
            Op::AbsoluteDifference(other) => pixelwise::absolute_difference(src, other, out)?,
            Op::Convolve(kernel) => convolve::convolve(src, kernel, out),
            Op::PseudoColorize(how) => depth::pseudo_colorize(src, *how, out),
            Op::Paste(part, mask, x, y) => {
                color::copy_rows(src, out);
                geometry::paste(part, mask.as_ref(), *x, *y, shape, out)?
            }
        }
        Ok(())
    }
}

fn gray_format(format: Format) -> Format {
    if format.bytes_per_channel() == 2 {
        Format::Gray16
    } else {
        Format::Gray8
    }
}

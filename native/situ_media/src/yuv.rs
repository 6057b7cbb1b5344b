//! Converts frames of cameras and decoders with luma and subsampled chroma (BT.601, 16..235) to images.

use crate::error::{fail, Code, Result};
use crate::image::{Format, Shape};

/// The memory layout of luma (Y) and chroma (U, V) of a frame, 8 bits each, with contiguous rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// A luma plane, followed by the interleaved U and V of every 2 x 2 pixels.
    Nv12,
    /// A luma, a U and a V plane.
    I420,
    /// Y U Y V for every two pixels.
    Yuyv,
}

/// Returns the shape of the image if the number of bytes is exactly that of such a frame.
pub fn frame_shape(bytes: usize, layout: Layout, width: usize, height: usize) -> Result<Shape> {
    let shape = Shape::new(width, height, Format::Bgr24)?;
    let even = width.is_multiple_of(2) && (layout == Layout::Yuyv || height.is_multiple_of(2));
    let needed = match layout {
        Layout::Yuyv => width * height * 2,
        _ => width * height * 3 / 2,
    };
    if !even || bytes != needed {
        return fail(
            Code::BadImage,
            format!(
                "{bytes} bytes are not a {width}x{height} frame (the sides must be even, and {needed} bytes are needed)"
            ),
        );
    }
    Ok(shape)
}

#[inline(always)]
fn write_bgr(y: u8, u: u8, v: u8, out: &mut [u8]) {
    let (c, d, e) = (298 * (y as i32 - 16), u as i32 - 128, v as i32 - 128);
    out[0] = ((c + 516 * d + 128) >> 8).clamp(0, 255) as u8;
    out[1] = ((c - 100 * d - 208 * e + 128) >> 8).clamp(0, 255) as u8;
    out[2] = ((c + 409 * e + 128) >> 8).clamp(0, 255) as u8;
}

/// Converts a frame to :bgr24. `frame_shape` must have checked the sizes.
pub fn to_bgr(data: &[u8], layout: Layout, shape: Shape, out: &mut [u8]) {
    let (w, h) = (shape.width, shape.height);
    if layout == Layout::Yuyv {
        for (p, o) in data.chunks_exact(4).zip(out.chunks_exact_mut(6)) {
            write_bgr(p[0], p[1], p[3], &mut o[..3]);
            write_bgr(p[2], p[1], p[3], &mut o[3..]);
        }
        return;
    }
    let (luma, chroma) = data.split_at(w * h);
    for (y, (row, out)) in luma
        .chunks_exact(w)
        .zip(out.chunks_exact_mut(w * 3))
        .enumerate()
    {
        for (x, (l, o)) in row.iter().zip(out.chunks_exact_mut(3)).enumerate() {
            let (u, v) = match layout {
                Layout::Nv12 => {
                    let at = y / 2 * w + x / 2 * 2;
                    (chroma[at], chroma[at + 1])
                }
                _ => {
                    let at = y / 2 * (w / 2) + x / 2;
                    (chroma[at], chroma[w * h / 4 + at])
                }
            };
            write_bgr(*l, u, v, o);
        }
    }
}

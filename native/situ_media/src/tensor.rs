//! Converts images to input tensors for models.

use crate::error::{fail, Code, Result};
use crate::image::{Format, Shape, View};

/// How channel values are converted to the elements of a tensor.
#[derive(Clone, Copy, Debug)]
pub struct Layout {
    /// Channels first (NCHW) or last (NHWC).
    pub channels_first: bool,
    /// The factor of each value.
    pub scale: f32,
    /// The number added after scaling.
    pub offset: f32,
}

/// Returns the bytes of the f32 tensor. Alpha and unused channels are left out.
pub fn tensor_bytes(shape: Shape) -> Result<usize> {
    let channels = shape.format.channel_count().min(3);
    let n = shape.width * shape.height * channels * 4;
    if n > crate::image::MAX_BYTES {
        return fail(Code::TooLarge, "the tensor would need more than 1 GiB");
    }
    Ok(n)
}

/// Writes the image as f32 in native byte order; the red channel is first.
pub fn to_f32(src: &View, layout: Layout, out: &mut [u8]) {
    let format = src.shape.format;
    let order: &[usize] = match format {
        Format::Gray8 | Format::Gray16 => &[0],
        Format::Bgr24 | Format::Bgrx32 | Format::Bgra32 => &[2, 1, 0],
        _ => &[0, 1, 2],
    };
    let (size, depth) = (format.pixel_bytes(), format.bytes_per_channel());
    let plane = src.shape.width * src.shape.height;
    let mut i = 0;
    for row in src.rows() {
        for p in row.chunks_exact(size) {
            for (c, from) in order.iter().enumerate() {
                let raw = if depth == 2 {
                    u16::from_le_bytes([p[2 * from], p[2 * from + 1]]) as f32
                } else {
                    p[*from] as f32
                };
                let at = if layout.channels_first {
                    c * plane + i
                } else {
                    i * order.len() + c
                };
                let value = raw * layout.scale + layout.offset;
                out[at * 4..at * 4 + 4].copy_from_slice(&value.to_ne_bytes());
            }
            i += 1;
        }
    }
}

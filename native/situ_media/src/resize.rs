//! Resizing with the `fast_image_resize` crate (compiled in `situ_resize`).

use crate::area;
use crate::error::{Code, Error, Result};
use crate::image::{Format, Shape, View};
use situ_resize::{resize_pixels, FilterType, PixelLayout, ResizeAlg, ResizeOptions};

/// How the pixels of the source are weighted to compute a pixel of the result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Filter {
    /// The nearest pixel.
    Nearest,
    /// 2 x 2 pixels regardless of the scale, like INTER_LINEAR in OpenCV.
    Bilinear,
    /// 4 x 4 pixels (Catmull-Rom) regardless of the scale.
    Bicubic,
    /// The mean of the covered pixels, for shrinking.
    Area,
    /// Bilinear over all covered pixels: shrinks without jagged edges, like Pillow.
    Smooth,
    /// 6 x 6 pixels or all covered pixels; the sharpest and slowest filter.
    Lanczos,
}

fn resize_algorithm(filter: Filter) -> ResizeAlg {
    match filter {
        Filter::Nearest => ResizeAlg::Nearest,
        Filter::Bilinear => ResizeAlg::Interpolation(FilterType::Bilinear),
        Filter::Bicubic => ResizeAlg::Interpolation(FilterType::CatmullRom),
        Filter::Area | Filter::Smooth => ResizeAlg::Convolution(FilterType::Bilinear),
        Filter::Lanczos => ResizeAlg::Convolution(FilterType::Lanczos3),
    }
}

/// Resizes `src` to `shape` (of the same format) into `out`. Colors are weighted by the alpha channel, if there is
/// one.
pub fn resize_image(src: &View, shape: Shape, filter: Filter, out: &mut [u8]) -> Result<()> {
    if filter == Filter::Area {
        area::resize_by_area(src, shape, out);
        return Ok(());
    }
    let tight = src.packed_pixels();
    // 16-bit kernels require 2-byte alignment, which a sub-binary may not have.
    let aligned: Vec<u16>;
    let odd =
        src.shape.format.bytes_per_channel() == 2 && !(tight.as_ptr() as usize).is_multiple_of(2);
    let bytes: &[u8] = if odd {
        aligned = to_words(&tight);
        as_bytes(&aligned)
    } else {
        &tight
    };
    let options = ResizeOptions::new()
        .resize_alg(resize_algorithm(filter))
        .use_alpha(src.shape.format.has_alpha() && filter != Filter::Nearest);
    let from = (src.shape.width as u32, src.shape.height as u32);
    let to = (shape.width as u32, shape.height as u32);
    resize_pixels(
        pixel_layout(src.shape.format),
        (from, bytes),
        (to, out),
        &options,
    )
    .map_err(|what| Error {
        code: Code::Failed,
        what,
    })
}

fn pixel_layout(format: Format) -> PixelLayout {
    match format {
        Format::Gray8 => PixelLayout::U8,
        Format::Gray16 => PixelLayout::U16,
        Format::Bgr24 | Format::Rgb24 => PixelLayout::U8x3,
        Format::Bgrx32 | Format::Bgra32 | Format::Rgba32 => PixelLayout::U8x4,
        Format::Rgba64 => PixelLayout::U16x4,
    }
}

fn to_words(bytes: &[u8]) -> Vec<u16> {
    bytes
        .chunks_exact(2)
        .map(|b| u16::from_ne_bytes([b[0], b[1]]))
        .collect()
}

fn as_bytes(words: &[u16]) -> &[u8] {
    // SAFETY: every byte pattern is a valid u8 and u8 has no alignment to violate.
    #[allow(unsafe_code)]
    let (_, middle, _) = unsafe { words.align_to::<u8>() };
    middle
}

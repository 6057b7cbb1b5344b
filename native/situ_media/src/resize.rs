//! Resizing, by the `fast_image_resize` crate (compiled in `situ_resize`).

use crate::area;
use crate::error::{Code, Error, Result};
use crate::picture::{Format, Shape, View};
use situ_resize::{resize_pixels, FilterType, PixelLayout, ResizeAlg, ResizeOptions};

/// Which pixels of the source make one of the result, and by which weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Filter {
    /// The pixel at the same place.
    Nearest,
    /// Two by two pixels whatever the scale: what OpenCV calls INTER_LINEAR.
    Bilinear,
    /// Four by four pixels (Catmull-Rom), whatever the scale.
    Bicubic,
    /// The mean of the pixels covered: for shrinking.
    Area,
    /// Bilinear over all pixels covered: shrinks without jagged edges, as Pillow does.
    Smooth,
    /// Six by six pixels or all covered; sharpest and slowest.
    Lanczos,
}

fn algorithm(filter: Filter) -> ResizeAlg {
    match filter {
        Filter::Nearest => ResizeAlg::Nearest,
        Filter::Bilinear => ResizeAlg::Interpolation(FilterType::Bilinear),
        Filter::Bicubic => ResizeAlg::Interpolation(FilterType::CatmullRom),
        Filter::Area | Filter::Smooth => ResizeAlg::Convolution(FilterType::Bilinear),
        Filter::Lanczos => ResizeAlg::Convolution(FilterType::Lanczos3),
    }
}

/// Resizes `src` to `shape` (same format) into `out`. Colours are weighted by alpha where there is one.
pub fn resize(src: &View, shape: Shape, filter: Filter, out: &mut [u8]) -> Result<()> {
    if filter == Filter::Area {
        area::resize(src, shape, out);
        return Ok(());
    }
    let tight = src.tight();
    // 16-bit kernels ask for 2-byte alignment, which a part of a binary need not have.
    let aligned: Vec<u16>;
    let odd =
        src.shape.format.bytes_per_channel() == 2 && !(tight.as_ptr() as usize).is_multiple_of(2);
    let bytes: &[u8] = if odd {
        aligned = words(&tight);
        as_bytes(&aligned)
    } else {
        &tight
    };
    let options = ResizeOptions::new()
        .resize_alg(algorithm(filter))
        .use_alpha(src.shape.format.has_alpha() && filter != Filter::Nearest);
    let from = (src.shape.width as u32, src.shape.height as u32);
    let to = (shape.width as u32, shape.height as u32);
    resize_pixels(layout(src.shape.format), (from, bytes), (to, out), &options).map_err(|what| {
        Error {
            code: Code::Failed,
            what,
        }
    })
}

fn layout(format: Format) -> PixelLayout {
    match format {
        Format::Gray8 => PixelLayout::U8,
        Format::Gray16 => PixelLayout::U16,
        Format::Bgr24 | Format::Rgb24 => PixelLayout::U8x3,
        Format::Bgrx32 | Format::Bgra32 | Format::Rgba32 => PixelLayout::U8x4,
        Format::Rgba64 => PixelLayout::U16x4,
    }
}

fn words(bytes: &[u8]) -> Vec<u16> {
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

//! Resizing, by the `fast_image_resize` crate.

use crate::area;
use crate::error::{fail, Code, Error, Result};
use crate::picture::{Format, Shape, View};
use fast_image_resize::images::{TypedImage, TypedImageRef};
use fast_image_resize::pixels::{U16x4, U8x3, U8x4, U16, U8};
use fast_image_resize::{FilterType, PixelTrait, ResizeAlg, ResizeOptions, Resizer};

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
    let job = Job {
        from: src.shape,
        bytes,
        to: shape,
        options,
    };
    match src.shape.format {
        Format::Gray8 => job.run::<U8>(out),
        Format::Gray16 => job.run::<U16>(out),
        Format::Bgr24 | Format::Rgb24 => job.run::<U8x3>(out),
        Format::Bgrx32 | Format::Bgra32 | Format::Rgba32 => job.run::<U8x4>(out),
        Format::Rgba64 => job.run::<U16x4>(out),
    }
}

struct Job<'a> {
    from: Shape,
    bytes: &'a [u8],
    to: Shape,
    options: ResizeOptions,
}

impl Job<'_> {
    /// By type, for our kinds of pixels alone: the crate's own choice at run time compiles the kernels of all thirteen,
    /// which is minutes.
    fn run<P: PixelTrait>(&self, out: &mut [u8]) -> Result<()> {
        let source = TypedImageRef::<P>::from_buffer(
            self.from.width as u32,
            self.from.height as u32,
            self.bytes,
        );
        let target = TypedImage::<P>::from_buffer(self.to.width as u32, self.to.height as u32, out);
        let (Ok(source), Ok(mut target)) = (source, target) else {
            return fail(Code::Failed, "the resizer refused the buffers");
        };
        Resizer::new()
            .resize_typed(&source, &mut target, &self.options)
            .map_err(|e| Error {
                code: Code::Failed,
                what: format!("resizing failed: {e}"),
            })
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

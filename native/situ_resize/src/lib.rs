//! Resizes images with the `fast_image_resize` crate, for the pixel layouts of Situ.
//!
//! The kernels of that crate are generic, so they are compiled in the crate that calls them, which takes more than a
//! minute. This crate contains nothing else, so they are not recompiled when `situ_media` or its tests change.

#![deny(missing_docs)]

use fast_image_resize::images::{TypedImage, TypedImageRef};
use fast_image_resize::pixels::{U16x4, U8x3, U8x4, U16, U8};
use fast_image_resize::{PixelTrait, Resizer};

pub use fast_image_resize::{FilterType, ResizeAlg, ResizeOptions};

/// The layout of a pixel: the number of channels, and the width of each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelLayout {
    /// One channel of 8 bits.
    U8,
    /// Three channels of 8 bits.
    U8x3,
    /// Four channels of 8 bits. The last one is alpha if the options use it.
    U8x4,
    /// One channel of 16 bits.
    U16,
    /// Four channels of 16 bits. The last one is alpha if the options use it.
    U16x4,
}

/// The width and height of an image in pixels.
pub type Size = (u32, u32);

/// Resizes `source`, an image of size `from` without padding, into `target`, an image of size `to`. 16-bit layouts
/// need 2-byte alignment. Errors are messages for people.
pub fn resize_pixels(
    layout: PixelLayout,
    (from, source): (Size, &[u8]),
    (to, target): (Size, &mut [u8]),
    options: &ResizeOptions,
) -> Result<(), String> {
    match layout {
        PixelLayout::U8 => resize_typed::<U8>(from, source, to, target, options),
        PixelLayout::U8x3 => resize_typed::<U8x3>(from, source, to, target, options),
        PixelLayout::U8x4 => resize_typed::<U8x4>(from, source, to, target, options),
        PixelLayout::U16 => resize_typed::<U16>(from, source, to, target, options),
        PixelLayout::U16x4 => resize_typed::<U16x4>(from, source, to, target, options),
    }
}

// Dispatching by type compiles only our layouts; the run-time dispatch of the crate would compile the kernels of all
// thirteen.
fn resize_typed<P: PixelTrait>(
    from: Size,
    source: &[u8],
    to: Size,
    target: &mut [u8],
    options: &ResizeOptions,
) -> Result<(), String> {
    let source = TypedImageRef::<P>::from_buffer(from.0, from.1, source);
    let target = TypedImage::<P>::from_buffer(to.0, to.1, target);
    let (Ok(source), Ok(mut target)) = (source, target) else {
        return Err("the resizer rejected the buffers".to_string());
    };
    Resizer::new()
        .resize_typed(&source, &mut target, options)
        .map_err(|error| format!("resizing failed: {error}"))
}

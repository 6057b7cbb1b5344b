//! Image and audio kernels of situ_media on byte slices, without BEAM types.
//!
//! An image arrives as a checked [`image::View`], and an operation is an [`op::Op`]. The operation first reports the
//! shape of its result, the caller allocates the memory, and then the operation runs. Nothing is copied on the way to
//! and from the BEAM.

#![deny(missing_docs)]

mod area;
pub mod audio;
mod blend;
pub mod color;
pub mod compare;
pub mod convolve;
pub mod depth;
pub mod draw;
pub mod error;
pub mod geometry;
pub mod gray;
pub mod image;
pub mod jpeg;
pub mod op;
pub mod pixelwise;
pub mod png_file;
pub mod resize;
pub mod statistics;
pub mod tensor;
pub mod text;
pub mod yuv;

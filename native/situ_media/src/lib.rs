//! Pure Rust side of situ_media: pictures and sound as byte slices, no BEAM types.
//!
//! A picture comes in as a checked [`picture::View`], an operation is an [`op::Op`]: it gives the shape of its result
//! first, the caller provides the memory, then it runs. So nothing is copied on the way to and from the BEAM.

#![deny(missing_docs)]

mod area;
pub mod audio;
pub mod color;
pub mod compare;
pub mod convolve;
pub mod depth;
pub mod draw;
pub mod error;
pub mod geometry;
pub mod gray;
mod ink;
pub mod jpeg;
pub mod op;
pub mod picture;
pub mod pixelwise;
pub mod png_file;
pub mod resize;
pub mod statistics;
pub mod tensor;
pub mod text;
pub mod yuv;

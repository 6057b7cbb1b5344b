//! Kernels for 3D data: clouds and meshes from depth images, and operations on clouds.
//!
//! Points are three little-endian 32-bit floats in metres: x forward, y left, z up. This crate has no BEAM types.
#![deny(missing_docs)]

pub mod camera;
pub mod cloud;
pub mod depth;
pub mod error;
pub mod grid;
pub mod las;
pub mod normals;
pub mod plane;
pub mod records;
pub mod register;
pub mod room;

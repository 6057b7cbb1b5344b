//! ONNX models through ONNX Runtime, for `situ_infer`: no BEAM types.
//!
//! `runtime` opens the shared library, `tensor` moves bytes in and out, `model` is one loaded network.
#![deny(missing_docs)]

mod model;
mod patch;
mod runtime;
mod tensor;

pub use model::{Busy, Model, Options, Port, Provider};
pub use patch::{cut, patch_bytes, Patch, Picture, PixelLayout};
pub use runtime::{load, version};
pub use tensor::{ElementType, Tensor, TensorView};

/// Why something failed. The kind is for programs, the text for people.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Failure {
    /// The kind of failure, for programs.
    pub kind: Kind,
    /// A sentence that names the library, port or provider, for people.
    pub text: String,
}

/// The kinds of failure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// The shared library could not be opened or is too old.
    Library,
    /// The bytes are no model this runtime understands.
    Model,
    /// An input has the wrong name, type, shape or size.
    Input,
    /// The network failed while it ran.
    Run,
    /// The execution provider is not in this library.
    Provider,
}

impl Failure {
    pub(crate) fn new(kind: Kind, text: impl Into<String>) -> Self {
        Self {
            kind,
            text: text.into(),
        }
    }
}

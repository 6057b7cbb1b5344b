//! Runs ONNX models with ONNX Runtime, for `situ_infer`. This crate has no BEAM types.
//!
//! `runtime` loads the shared library, `tensor` converts bytes, and `model` is a loaded network.
#![deny(missing_docs)]

mod model;
mod patch;
mod runtime;
mod tensor;

pub use model::{Busy, Model, Options, Port, Provider};
pub use patch::{cut_patch, patch_bytes, Image, Patch, PixelLayout};
pub use runtime::{load_runtime, runtime_version};
pub use tensor::{ElementType, Tensor, TensorView};

/// An error: the kind is for programs, the text for people.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Failure {
    /// The kind of error, for programs.
    pub kind: Kind,
    /// The message, which contains the name of the library, port or provider, for people.
    pub text: String,
}

/// The kinds of errors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// The shared library could not be loaded or is too old.
    Library,
    /// The bytes are not a model that this runtime supports.
    Model,
    /// An input has the wrong name, type, shape or size.
    Input,
    /// The network failed during a run.
    Run,
    /// The library does not contain the execution provider.
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

//! The errors of this crate: a code for programs and a message for people.

/// The kinds of failure; the BEAM side turns each into an atom.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Code {
    /// An image has too few or too many bytes for its size, format and stride.
    BadImage,
    /// The operation does not support this pixel format, or two images have different formats.
    BadFormat,
    /// A width or height of 0.
    BadSize,
    /// A rectangle that is empty or extends beyond its image.
    BadRect,
    /// Any other argument that is out of range; the message contains the range.
    BadOption,
    /// The result would need more than [`crate::image::MAX_BYTES`].
    TooLarge,
    /// The bytes are not a JPEG, are damaged, or cost more to decode than the image size justifies.
    BadJpeg,
    /// The bytes are not a PNG, are damaged, or cost more to decode than the image size justifies.
    BadPng,
    /// The audio does not consist of complete frames, or its sample type or channel count is not supported.
    BadAudio,
    /// A font file cannot be read or is invalid, or the fonts cannot render the text.
    BadFont,
    /// The system has no memory left.
    OutOfMemory,
    /// A bug on the native side (such as a buffer of the wrong length), or an error of a library that fits no other
    /// kind.
    Failed,
}

/// Why an operation was rejected. Nothing was written in this case, unless the function documents otherwise.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Error {
    /// The kind, for programs.
    pub code: Code,
    /// The message, with the rejected numbers.
    pub what: String,
}

/// The result of every fallible function of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// Returns an error: `fail(Code::BadSize, format!(...))`.
pub fn fail<T>(code: Code, what: impl Into<String>) -> Result<T> {
    Err(Error {
        code,
        what: what.into(),
    })
}

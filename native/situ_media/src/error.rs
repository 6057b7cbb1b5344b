//! The errors of this crate: a code for programs and a sentence for people.

/// The kinds of failure; the BEAM side turns each into an atom.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Code {
    /// A picture's bytes are too few or too many for its size, format and stride.
    BadImage,
    /// The operation does not take this pixel format, or two pictures differ in theirs.
    BadFormat,
    /// A width or height of 0.
    BadSize,
    /// A rectangle that is empty or reaches out of its picture.
    BadRect,
    /// Any other argument out of its range; the sentence names the range.
    BadOption,
    /// The result would take more than [`crate::picture::MAX_BYTES`].
    TooLarge,
    /// Bytes that are no JPEG, a damaged one, or one that costs more than its size allows.
    BadJpeg,
    /// Bytes that are no PNG, a damaged one, or one that costs more than its size allows.
    BadPng,
    /// Sound whose bytes are not whole frames, or of a sample type or channel count that is not taken.
    BadAudio,
    /// A font file that cannot be read or is none, or a text that the fonts cannot draw.
    BadFont,
    /// The system gave no memory.
    OutOfMemory,
    /// A fault of the caller within the native side (a buffer of the wrong length), or a library's refusal that has no
    /// other kind.
    Failed,
}

/// Why an operation was refused. Nothing was written in that case, unless the function says so.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Error {
    /// The kind, for programs.
    pub code: Code,
    /// The sentence, with the numbers that were refused.
    pub what: String,
}

/// The result of every fallible function of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// Shorthand: `fail(Code::BadSize, format!(...))`.
pub fn fail<T>(code: Code, what: impl Into<String>) -> Result<T> {
    Err(Error {
        code,
        what: what.into(),
    })
}

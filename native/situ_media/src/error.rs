//! What goes wrong: a code for programs and a sentence for people.

/// The kinds of failure; the BEAM side turns each into an atom.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Code {
    BadImage,
    BadFormat,
    BadSize,
    BadRect,
    BadOption,
    TooLarge,
    BadJpeg,
    BadPng,
    BadAudio,
    BadFont,
    OutOfMemory,
    Failed,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Error {
    pub code: Code,
    pub what: String,
}

pub type Result<T> = std::result::Result<T, Error>;

/// Shorthand: `fail(Code::BadSize, format!(...))`.
pub fn fail<T>(code: Code, what: impl Into<String>) -> Result<T> {
    Err(Error {
        code,
        what: what.into(),
    })
}

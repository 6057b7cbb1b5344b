//! Errors of the kernels: a code for programs and a message for people.

/// The kinds of errors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Code {
    /// The bytes are not a cloud, or contain points that are not finite.
    BadCloud,
    /// A depth image whose size does not match its bytes.
    BadDepth,
    /// An impossible camera, or the ray table of a different camera.
    BadCamera,
    /// A number is out of range.
    BadOption,
    /// There are too few points, or all of them are on one line.
    Degenerate,
    /// The data does not fit in memory.
    TooLarge,
}

/// An error of a kernel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Error {
    /// The kind, for programs.
    pub code: Code,
    /// The message, for people.
    pub what: String,
}

impl std::fmt::Display for Error {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.what)
    }
}

impl std::error::Error for Error {}

/// The result of a kernel.
pub type Result<T> = std::result::Result<T, Error>;

/// Returns an error.
pub fn fail<T>(code: Code, what: impl Into<String>) -> Result<T> {
    Err(Error {
        code,
        what: what.into(),
    })
}

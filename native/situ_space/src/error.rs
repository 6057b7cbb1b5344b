//! Failures of the kernels, as a code for programs and a sentence for people.

/// The kinds of failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Code {
    /// Bytes that are no cloud, or no finite points.
    BadCloud,
    /// A depth image that does not add up.
    BadDepth,
    /// A camera that cannot be, or a table of another camera.
    BadCamera,
    /// A number out of its range.
    BadOption,
    /// Too few points, or all of them on one line.
    Degenerate,
    /// More than fits in memory.
    TooLarge,
}

/// One failure.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Error {
    /// For programs.
    pub code: Code,
    /// For people.
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

/// Shorthand for an error.
pub fn fail<T>(code: Code, what: impl Into<String>) -> Result<T> {
    Err(Error {
        code,
        what: what.into(),
    })
}

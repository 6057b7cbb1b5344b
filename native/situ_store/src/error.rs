//! What can go wrong, in terms a caller can act on.

use std::fmt;

pub type Result<T> = std::result::Result<T, Error>;

#[derive(Debug, Clone, PartialEq)]
pub enum Error {
    /// An operating system call failed: (what was tried, raw errno, message).
    Io(String, i32, String),
    /// Another writer holds the lock.
    Locked,
    /// There is no index file.
    NoStore,
    /// The magic is not ours.
    NotAStore,
    /// Written by a later version of the format.
    Newer(u32),
    /// Originating time does not increase: (stream, last, got).
    NotIncreasing(u32, i64, i64),
    /// A message is larger than a chunk can be.
    TooLarge(u64),
    /// The term holds something that means nothing outside the running system.
    NotStorable(&'static str),
    UnknownStream(u32),
    /// The store's folder was deleted under the writer.
    Deleted,
    Closed,
    /// Checksums or structure are wrong at (file, offset, why).
    Damaged(String, u64, String),
    /// An extent file is gone.
    MissingExtent(String),
    /// Simulated crash of the tests.
    Crash,
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{self:?}")
    }
}

impl std::error::Error for Error {}

impl Error {
    pub fn io(what: impl Into<String>, error: impl Into<std::io::Error>) -> Error {
        let error: std::io::Error = error.into();
        Error::Io(
            what.into(),
            error.raw_os_error().unwrap_or(0),
            error.to_string(),
        )
    }

    pub fn damaged(file: impl Into<String>, offset: u64, why: impl Into<String>) -> Error {
        Error::Damaged(file.into(), offset, why.into())
    }
}

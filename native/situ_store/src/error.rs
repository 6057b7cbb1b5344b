//! The errors of this crate, in terms that a caller can act on.

use std::fmt;

use crate::limits::{MAX_MESSAGE, VERSION};

/// The result of the functions of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// Why something could not be done.
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
    /// The writer has no such stream.
    UnknownStream(u32),
    /// The store's folder was deleted under the writer.
    Deleted,
    /// The writer is closed.
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
        match self {
            Error::Io(what, _, why) => write!(f, "could not {what}: {why}"),
            Error::Locked => f.write_str("another writer holds the store's lock"),
            Error::NoStore => f.write_str("there is no index.situ: no store, or one that lost it"),
            Error::NotAStore => f.write_str("the index does not begin like one of a store"),
            Error::Newer(version) => write!(
                f,
                "the store has format version {version}, and {VERSION} is the latest known here"
            ),
            Error::NotIncreasing(stream, last, got) => write!(
                f,
                "originating times of stream {stream} must increase: {got} came after {last}"
            ),
            Error::TooLarge(size) => write!(
                f,
                "a message has {size} bytes, and {MAX_MESSAGE} are the most it can have"
            ),
            Error::NotStorable(what) => {
                write!(f, "a message contains {what}, which cannot be stored")
            }
            Error::UnknownStream(stream) => write!(f, "the writer has no stream {stream}"),
            Error::Deleted => {
                f.write_str("the store's folder was deleted while it was being written")
            }
            Error::Closed => f.write_str("the writer is closed"),
            Error::Damaged(file, offset, why) => {
                write!(f, "{file} is damaged at byte {offset}: {why}")
            }
            Error::MissingExtent(file) => write!(f, "the file {file} is missing"),
            Error::Crash => f.write_str("a simulated crash"),
        }
    }
}

impl std::error::Error for Error {}

impl Error {
    /// An operating system call failed.
    pub fn io(what: impl Into<String>, error: impl Into<std::io::Error>) -> Error {
        let error: std::io::Error = error.into();
        Error::Io(
            what.into(),
            error.raw_os_error().unwrap_or(0),
            error.to_string(),
        )
    }

    /// A wrong place: the file, the byte, and what is wrong there.
    pub fn damaged(file: impl Into<String>, offset: u64, why: impl Into<String>) -> Error {
        Error::Damaged(file.into(), offset, why.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_sentences() {
        let damaged = Error::damaged("data-000000.situ", 64, "the chunk's checksum is wrong");
        assert_eq!(
            damaged.to_string(),
            "data-000000.situ is damaged at byte 64: the chunk's checksum is wrong"
        );
        let io = Error::Io("open lock".into(), 13, "Permission denied".into());
        assert_eq!(io.to_string(), "could not open lock: Permission denied");
    }
}

//! The errors of this crate.

use std::fmt;

use crate::limits::{MAX_MESSAGE, VERSION};

/// The result type of this crate's functions.
pub type Result<T> = std::result::Result<T, Error>;

/// The reason why an operation failed.
#[derive(Debug, Clone, PartialEq)]
pub enum Error {
    /// An operating system call failed: (operation, errno, message).
    Io(String, i32, String),
    /// Another writer holds the lock.
    Locked,
    /// There is no index file.
    NoStore,
    /// The index does not start with the magic bytes of a store.
    NotAStore,
    /// The store was written by a later version of the format.
    Newer(u32),
    /// The originating time does not increase: (stream, last, got).
    NotIncreasing(u32, i64, i64),
    /// A message of this size is too large to store.
    TooLarge(u64),
    /// The term contains a value that is meaningless outside the running system.
    NotStorable(&'static str),
    /// The writer has no stream with this number.
    UnknownStream(u32),
    /// The store's folder was deleted while it was being written.
    Deleted,
    /// The writer is closed.
    Closed,
    /// A checksum or structure is wrong: (file, offset, reason).
    Damaged(String, u64, String),
    /// An extent file is missing.
    MissingExtent(String),
    /// A mirror lacks bytes that this operation needs. They were noted (`residency`).
    Absent,
    /// A simulated crash in a test.
    Crash,
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Error::Io(what, _, why) => write!(f, "could not {what}: {why}"),
            Error::Locked => f.write_str("another writer holds the store's lock"),
            Error::NoStore => f.write_str("there is no index.situ: the folder is not a store, or its index was lost"),
            Error::NotAStore => f.write_str("index.situ does not start like the index of a store"),
            Error::Newer(version) => write!(
                f,
                "the store has format version {version}, but this program only knows versions up to {VERSION}"
            ),
            Error::NotIncreasing(stream, last, got) => write!(
                f,
                "originating times of stream {stream} must increase: {got} came after {last}"
            ),
            Error::TooLarge(size) => write!(
                f,
                "a message has {size} bytes, but at most {MAX_MESSAGE} are allowed"
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
            Error::Absent => f.write_str("the data are not on this machine yet"),
            Error::Crash => f.write_str("a simulated crash"),
        }
    }
}

impl std::error::Error for Error {}

impl Error {
    /// Builds the error of a failed operating system call.
    pub fn io(what: impl Into<String>, error: impl Into<std::io::Error>) -> Error {
        let error: std::io::Error = error.into();
        Error::Io(
            what.into(),
            error.raw_os_error().unwrap_or(0),
            error.to_string(),
        )
    }

    /// Builds the error for damage in a file at a byte offset.
    pub fn damaged(file: impl Into<String>, offset: u64, why: impl Into<String>) -> Error {
        Error::Damaged(file.into(), offset, why.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_errors_as_sentences() {
        let damaged = Error::damaged("data-000000.situ", 64, "the chunk's checksum is wrong");
        assert_eq!(
            damaged.to_string(),
            "data-000000.situ is damaged at byte 64: the chunk's checksum is wrong"
        );
        let io = Error::Io("open lock".into(), 13, "Permission denied".into());
        assert_eq!(io.to_string(), "could not open lock: Permission denied");
    }
}

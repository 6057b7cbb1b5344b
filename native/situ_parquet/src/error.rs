//! The errors that requests return.

use parquet::errors::ParquetError;
use std::io;

#[derive(Debug)]
pub enum Error {
    /// The file system refuses, with the reason as an atom of Erlang or a text.
    Io(io::Error),
    /// The file is not Parquet, damaged, or uses a feature that is not supported.
    Malformed(String),
}

pub type Result<T> = std::result::Result<T, Error>;

pub fn malformed<T>(why: impl Into<String>) -> Result<T> {
    Err(Error::Malformed(why.into()))
}

impl From<io::Error> for Error {
    fn from(error: io::Error) -> Self {
        // Without a number of the system, the error is about the content of the file.
        match error.raw_os_error() {
            Some(_) => Self::Io(error),
            None => Self::Malformed(error.to_string()),
        }
    }
}

impl From<ParquetError> for Error {
    fn from(error: ParquetError) -> Self {
        match error {
            ParquetError::External(error) => match error.downcast::<io::Error>() {
                Ok(error) => Self::from(*error),
                Err(error) => Self::Malformed(error.to_string()),
            },
            error => Self::Malformed(error.to_string()),
        }
    }
}

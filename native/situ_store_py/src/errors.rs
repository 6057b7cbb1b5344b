//! Converts errors of the store to Python's exceptions.

use pyo3::exceptions::{PyFileNotFoundError, PyOSError, PyValueError};
use pyo3::prelude::*;
use situ_store::Error;

/// Returns `situ.Damaged` with a message.
pub fn damaged(py: Python<'_>, message: String) -> PyErr {
    let class = py
        .import("situ.binary")
        .and_then(|module| module.getattr("Damaged"));
    match class.and_then(|class| class.call1((message.as_str(),))) {
        Ok(error) => PyErr::from_value(error),
        Err(error) => error,
    }
}

/// Returns the exception for an error of the store.
pub fn to_exception(py: Python<'_>, error: Error) -> PyErr {
    let text = error.to_string();
    match error {
        Error::NoStore | Error::MissingExtent(_) | Error::Deleted => {
            PyFileNotFoundError::new_err(text)
        }
        Error::NotIncreasing(..) | Error::TooLarge(_) | Error::Closed => {
            PyValueError::new_err(text)
        }
        Error::NotAStore | Error::Newer(_) | Error::Damaged(..) => damaged(py, text),
        _ => PyOSError::new_err(text),
    }
}

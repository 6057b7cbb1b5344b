//! Names of files, which are bytes.

use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::path::PathBuf;

use rustler::{Binary, Decoder, NifResult, Term};

/// A path as Erlang's file functions take it in a binary: as it is, whether it is UTF-8 or not.
pub struct FilePath(pub PathBuf);

impl<'a> Decoder<'a> for FilePath {
    fn decode(term: Term<'a>) -> NifResult<Self> {
        let bytes: Binary<'a> = term.decode()?;
        Ok(FilePath(PathBuf::from(OsStr::from_bytes(bytes.as_slice()))))
    }
}

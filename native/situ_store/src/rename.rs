//! Renames folders atomically, so that a killed program leaves either the old state or the new one.

use std::path::Path;

use rustix::fs::{renameat_with, RenameFlags, CWD};
use rustix::io::Errno;

use crate::error::{Error, Result};

/// The result of a rename.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// The name was changed.
    Done,
    /// The new name exists already.
    Exists,
    /// The file system cannot rename atomically.
    Unsupported,
}

/// Renames `from` to `to` unless `to` exists, even as an empty folder.
pub fn rename_new(from: &Path, to: &Path) -> Result<Outcome> {
    rename_with_flags(from, to, RenameFlags::NOREPLACE)
}

/// Exchanges two names.
pub fn exchange_names(one: &Path, other: &Path) -> Result<Outcome> {
    rename_with_flags(one, other, RenameFlags::EXCHANGE)
}

fn rename_with_flags(from: &Path, to: &Path, flags: RenameFlags) -> Result<Outcome> {
    match renameat_with(CWD, from, CWD, to, flags) {
        Ok(()) => Ok(Outcome::Done),
        Err(Errno::EXIST) => Ok(Outcome::Exists),
        Err(Errno::INVAL | Errno::NOSYS | Errno::OPNOTSUPP) => Ok(Outcome::Unsupported),
        Err(error) => Err(Error::io("rename the folder", error)),
    }
}

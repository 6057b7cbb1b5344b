//! Names of folders, changed in one step: a program that is killed leaves the one state or the other.

use std::path::Path;

use rustix::fs::{renameat_with, RenameFlags, CWD};
use rustix::io::Errno;

use crate::error::{Error, Result};

/// The result of a rename.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// It was made.
    Done,
    /// There is something of that name already.
    Exists,
    /// The file system cannot do it in one step.
    Unsupported,
}

/// Renames `from`, unless something is called `to`, be it an empty folder.
pub fn rename_new(from: &Path, to: &Path) -> Result<Outcome> {
    rename(from, to, RenameFlags::NOREPLACE)
}

/// Exchanges two names.
pub fn exchange(one: &Path, other: &Path) -> Result<Outcome> {
    rename(one, other, RenameFlags::EXCHANGE)
}

fn rename(from: &Path, to: &Path, flags: RenameFlags) -> Result<Outcome> {
    match renameat_with(CWD, from, CWD, to, flags) {
        Ok(()) => Ok(Outcome::Done),
        Err(Errno::EXIST) => Ok(Outcome::Exists),
        Err(Errno::INVAL | Errno::NOSYS | Errno::OPNOTSUPP) => Ok(Outcome::Unsupported),
        Err(error) => Err(Error::io("rename the folder", error)),
    }
}

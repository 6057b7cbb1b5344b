//! Locks between processes on files that are not stores. The holder writes into the file who it is, and the operating
//! system releases the lock when the process ends, however it ends.

use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Read, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use rustix::fs::{flock, FlockOperation, OFlags};
use rustix::io::Errno;

use crate::error::{Error, Result};

/// The most bytes that are read of a holder's description of itself.
const MOST: u64 = 4096;

/// A lock that this process holds, until it is dropped. Its file goes with it.
#[derive(Debug)]
pub struct FileLock {
    file: File,
    path: PathBuf,
}

/// The result of an attempt to lock.
#[derive(Debug)]
pub enum Attempt {
    /// The lock is the caller's.
    Taken(FileLock),
    /// Another holds it, and wrote these bytes about itself.
    Held(Vec<u8>),
}

/// Tries to lock `path`, a file for this purpose only. Other processes get `holder` when they try.
pub fn acquire(path: &Path, holder: &[u8]) -> Result<Attempt> {
    let failed = |e: std::io::Error| Error::io("lock", e);
    loop {
        let mut file = match open(path) {
            // Another user's file cannot be locked by this one, but may name its holder.
            Err(error) if error.kind() == ErrorKind::PermissionDenied => {
                return match File::open(path) {
                    Ok(file) if !try_lock(&file)? => Ok(Attempt::Held(read_holder(file))),
                    _ => Err(failed(error)),
                };
            }
            result => result.map_err(failed)?,
        };
        if !try_lock(&file)? {
            return Ok(Attempt::Held(read_holder(file)));
        }
        // The previous holder may have removed the file between opening and locking: then the lock is worthless.
        if !is_at(path, &file) {
            continue;
        }
        file.set_len(0).map_err(failed)?;
        file.write_all(holder).map_err(failed)?;
        let path = path.to_path_buf();
        return Ok(Attempt::Taken(FileLock { file, path }));
    }
}

fn open(path: &Path) -> std::io::Result<File> {
    let no_links = OFlags::NOFOLLOW.bits() as i32;
    let mut options = OpenOptions::new();
    options.read(true).write(true).create(true).truncate(false);
    options.custom_flags(no_links).open(path)
}

fn try_lock(file: &File) -> Result<bool> {
    match flock(file, FlockOperation::NonBlockingLockExclusive) {
        Ok(()) => Ok(true),
        Err(Errno::WOULDBLOCK) => Ok(false),
        Err(error) => Err(Error::io("lock", error)),
    }
}

fn read_holder(file: File) -> Vec<u8> {
    let mut bytes = Vec::new();
    // When it cannot be read, only the name is missing.
    let _ = file.take(MOST).read_to_end(&mut bytes);
    bytes
}

fn is_at(path: &Path, file: &File) -> bool {
    let same =
        |a: std::fs::Metadata, b: std::fs::Metadata| (a.dev(), a.ino()) == (b.dev(), b.ino());
    match (std::fs::symlink_metadata(path), file.metadata()) {
        (Ok(there), Ok(open)) => same(there, open),
        _ => false,
    }
}

impl Drop for FileLock {
    fn drop(&mut self) {
        // It is still locked, so no newer file of another holder is removed.
        if is_at(&self.path, &self.file) {
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::panic)]
mod tests {
    use super::*;

    #[test]
    fn only_one_holds_it_and_the_others_learn_who() {
        let path = std::env::temp_dir().join(format!("situ-file-lock-{}", std::process::id()));
        let Attempt::Taken(lock) = acquire(&path, b"Anna").unwrap() else {
            panic!("not taken");
        };
        match acquire(&path, b"Ben").unwrap() {
            Attempt::Held(told) => assert_eq!(told, b"Anna"),
            taken => panic!("{taken:?}"),
        }
        drop(lock);
        assert!(!path.exists());
        // A file that a killed process left locks nothing.
        std::fs::write(&path, "somebody long gone, with a longer name").unwrap();
        let Attempt::Taken(lock) = acquire(&path, b"Ben").unwrap() else {
            panic!("not taken");
        };
        assert_eq!(std::fs::read(&path).unwrap(), b"Ben");
        // A file that another program put in its place is not ours to remove.
        std::fs::remove_file(&path).unwrap();
        std::fs::write(&path, "another's").unwrap();
        drop(lock);
        assert!(path.exists());
        std::fs::remove_file(&path).unwrap();
    }
}

//! Locks between processes on files that do not belong to a store. The holder writes a description of itself into
//! the file, and the operating system releases the lock when the process ends for any reason.

use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Read, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use rustix::fs::{flock, FlockOperation, OFlags};
use rustix::io::Errno;

use crate::error::{Error, Result};

/// The maximum number of bytes read from a holder's description of itself.
const MAX_HOLDER_BYTES: u64 = 4096;

/// A lock held by this process until it is dropped. Dropping it deletes the file.
#[derive(Debug)]
pub struct FileLock {
    file: File,
    path: PathBuf,
}

/// The result of an attempt to acquire a lock.
#[derive(Debug)]
pub enum Attempt {
    /// The caller now holds the lock.
    Taken(FileLock),
    /// Another process holds the lock, described by these bytes.
    Held(Vec<u8>),
}

/// Tries to lock `path`, a file used only for this purpose. Other processes that try get `holder`.
pub fn acquire(path: &Path, holder: &[u8]) -> Result<Attempt> {
    let failed = |e: std::io::Error| Error::io("lock", e);
    loop {
        let mut file = match open_lock_file(path) {
            // Another user's file cannot be locked by this process, but it may name its holder.
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
        // The previous holder may have removed the file between opening and locking, which would make the lock
        // worthless.
        if !is_at(path, &file) {
            continue;
        }
        file.set_len(0).map_err(failed)?;
        file.write_all(holder).map_err(failed)?;
        let path = path.to_path_buf();
        return Ok(Attempt::Taken(FileLock { file, path }));
    }
}

fn open_lock_file(path: &Path) -> std::io::Result<File> {
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
    // If the file cannot be read, only the holder's name is missing.
    let _ = file.take(MAX_HOLDER_BYTES).read_to_end(&mut bytes);
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
        // The file is still locked, so this never removes a newer file of another holder.
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
    fn only_one_process_holds_the_lock_and_others_get_its_name() {
        let path = std::env::temp_dir().join(format!("situ-file-lock-{}", std::process::id()));
        let Attempt::Taken(lock) = acquire(&path, b"Anna").unwrap() else {
            panic!("not taken");
        };
        match acquire(&path, b"Ben").unwrap() {
            Attempt::Held(holder) => assert_eq!(holder, b"Anna"),
            other => panic!("{other:?}"),
        }
        drop(lock);
        assert!(!path.exists());
        // A file left by a killed process does not lock anything.
        std::fs::write(&path, "a process that ended, with a longer name").unwrap();
        let Attempt::Taken(lock) = acquire(&path, b"Ben").unwrap() else {
            panic!("not taken");
        };
        assert_eq!(std::fs::read(&path).unwrap(), b"Ben");
        // A file that another program created under the same name must not be removed.
        std::fs::remove_file(&path).unwrap();
        std::fs::write(&path, "another's").unwrap();
        drop(lock);
        assert!(path.exists());
        std::fs::remove_file(&path).unwrap();
    }
}

//! The exclusive lock of a store, which allows only one process to write.

use std::fs::{File, OpenOptions};
use std::path::Path;
use std::time::Duration;

use rustix::fs::{flock, FlockOperation};
use rustix::io::Errno;

use crate::error::{Error, Result};
use crate::extent::open_with;

/// Acquires the exclusive lock of the store in `dir`. A missing lock file is created with this mode.
pub fn lock_store(dir: &Path, mode: Option<u32>) -> Result<File> {
    let mut options = OpenOptions::new();
    options.read(true).write(true).create(true).truncate(false);
    let path = dir.join("lock");
    let file = open_with(&mut options, &path, mode).map_err(|e| Error::io("create lock", e))?;
    // A reader that checks whether the store is live holds the lock for a moment.
    for attempt in 0..5 {
        match flock(&file, FlockOperation::NonBlockingLockExclusive) {
            Ok(()) => return Ok(file),
            Err(Errno::WOULDBLOCK) if attempt < 4 => std::thread::sleep(Duration::from_millis(3)),
            Err(Errno::WOULDBLOCK) => break,
            Err(error) => return Err(Error::io("lock the store", error)),
        }
    }
    Err(Error::Locked)
}

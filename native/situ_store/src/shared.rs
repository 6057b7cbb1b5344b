//! Files in memory through which this process exchanges large values with another one that maps them too.
//!
//! The other process is not trusted: it may truncate the file, or write to it at any time. A lost page reads as zeros
//! (`guard`), and every access checks its place against the limit and the length of the file.

use std::fs::{File, OpenOptions};
use std::path::Path;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::Mutex;

use memmap2::MmapOptions;
use rustix::fs::{fallocate, FallocateFlags};

use crate::error::{Error, Result};
use crate::guard::{Map, MapMut};
use crate::reader::lock_mutex;

const WHAT: &str = "map the shared memory";

fn create_file(path: &Path) -> Result<File> {
    let mut options = OpenOptions::new();
    options.read(true).write(true).create_new(true);
    options.open(path).map_err(|error| Error::io(WHAT, error))
}

fn outside(at: u64, length: u64) -> Error {
    let why = format!("{length} bytes are outside of the shared memory");
    Error::damaged("shared memory", at, why)
}

/// A file that this process writes and the other one reads.
pub struct SharedWriter {
    file: File,
    map: Mutex<MapMut>,
    limit: u64,
    /// The bytes of the file that have memory.
    size: AtomicU64,
}

impl SharedWriter {
    /// Creates a file for at most `limit` bytes, without memory.
    #[allow(unsafe_code)]
    pub fn create(path: &Path, limit: u64) -> Result<SharedWriter> {
        let file = create_file(path)?;
        // SAFETY: the map is longer than the file, but only bytes that `reserve` has allocated are accessed. If the
        // other process truncates the file, the guard catches the signal. Nothing refers to the bytes: they are
        // copied into the map.
        let map = unsafe { MmapOptions::new().len(limit as usize).map_mut(&file) };
        let map = map.map_err(|error| Error::io(WHAT, error))?;
        Ok(SharedWriter {
            file,
            map: Mutex::new(MapMut::new(map)),
            limit,
            size: AtomicU64::new(0),
        })
    }

    /// Allocates memory for the first `size` bytes. Without it, writing to a full file system would lose the bytes.
    pub fn reserve(&self, size: u64) -> Result<()> {
        let before = self.size.load(Ordering::Acquire);
        if size > self.limit {
            return Err(outside(0, size));
        }
        if size > before {
            fallocate(&self.file, FallocateFlags::empty(), before, size - before)
                .map_err(|error| Error::io("allocate shared memory", error))?;
            self.size.store(size, Ordering::Release);
        }
        Ok(())
    }

    /// Copies `parts`, one after another, to the offset `at`.
    pub fn write(&self, at: u64, parts: &[&[u8]]) -> Result<()> {
        let length: u64 = parts.iter().map(|part| part.len() as u64).sum();
        let end = at.saturating_add(length);
        if end > self.size.load(Ordering::Acquire) {
            return Err(outside(at, length));
        }
        let mut map = lock_mutex(&self.map);
        let mut position = at as usize;
        for part in parts {
            map[position..position + part.len()].copy_from_slice(part);
            position += part.len();
        }
        if map.is_torn() {
            return Err(Error::damaged("shared memory", at, "it was truncated"));
        }
        Ok(())
    }
}

/// A file that the other process writes. Values are read in place, so their bytes are in use until they are dropped.
pub struct SharedReader {
    file: File,
    map: Map,
    limit: u64,
    used: AtomicUsize,
    released: Mutex<Vec<u32>>,
}

impl SharedReader {
    /// Creates an empty file, for at most `limit` bytes.
    #[allow(unsafe_code)]
    pub fn create(path: &Path, limit: u64) -> Result<SharedReader> {
        let file = create_file(path)?;
        // SAFETY: the map is longer than the file, but `check` compares each place with the length of the file. If the
        // other process truncates it later, the guard catches the signal. The other process can also change bytes
        // that are in use: they may then be wrong, like those of every file, but they stay readable.
        let map = unsafe { MmapOptions::new().len(limit as usize).map(&file) };
        let map = map.map_err(|error| Error::io(WHAT, error))?;
        Ok(SharedReader {
            file,
            map: Map::new(map),
            limit,
            used: AtomicUsize::new(0),
            released: Mutex::default(),
        })
    }

    /// Returns the bytes at a place, after checking that the file contains them.
    pub fn read(&self, at: u64, length: u64) -> Result<&[u8]> {
        let end = at.saturating_add(length);
        let size = self
            .file
            .metadata()
            .map_err(|error| Error::io(WHAT, error))?;
        if end > self.limit || end > size.len() || self.map.is_torn() {
            return Err(outside(at, length));
        }
        Ok(self.bytes(at, length))
    }

    /// Returns bytes that `read` has checked before.
    pub fn bytes(&self, at: u64, length: u64) -> &[u8] {
        let range = at as usize..at.saturating_add(length) as usize;
        self.map.get(range).unwrap_or(&[])
    }

    /// Counts the bytes of a value that refers to the map; returns false, without counting them, if more than half of
    /// the memory would then be in use.
    pub fn hold(&self, length: u64) -> bool {
        let before = self.used.fetch_add(length as usize, Ordering::AcqRel);
        let fits = (before as u64).saturating_add(length) <= self.limit / 2;
        if !fits {
            self.used.fetch_sub(length as usize, Ordering::AcqRel);
        }
        fits
    }

    /// Ends what `hold` has begun: the slot can be used again.
    pub fn release(&self, slot: u32, length: u64) {
        self.used.fetch_sub(length as usize, Ordering::AcqRel);
        lock_mutex(&self.released).push(slot);
    }

    /// Returns the slots that were released since the last call.
    pub fn take_released(&self) -> Vec<u32> {
        std::mem::take(&mut *lock_mutex(&self.released))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn folder(name: &str) -> std::path::PathBuf {
        let path = std::env::temp_dir().join(format!("situ-shared-{}-{name}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).unwrap();
        path
    }

    #[test]
    fn writes_only_reserved_memory() {
        let path = folder("write").join("in");
        let memory = SharedWriter::create(&path, 16_384).unwrap();
        assert!(memory.write(0, &[b"ab"]).is_err());
        memory.reserve(4_096).unwrap();
        memory.write(4_092, &[b"ab", b"cd"]).unwrap();
        assert!(memory.write(4_093, &[b"ab", b"cd"]).is_err());
        assert!(memory.write(u64::MAX, &[b"ab"]).is_err());
        assert!(memory.reserve(16_385).is_err());
        let bytes = std::fs::read(&path).unwrap();
        assert_eq!((bytes.len(), &bytes[4_092..]), (4_096, &b"abcd"[..]));
        // A file is created only once.
        assert!(SharedWriter::create(&path, 16_384).is_err());
    }

    #[test]
    fn reports_a_truncated_file_instead_of_ending_the_process() {
        let path = folder("truncated").join("in");
        let memory = SharedWriter::create(&path, 65_536).unwrap();
        memory.reserve(65_536).unwrap();
        memory.write(0, &[&[1; 65_536]]).unwrap();
        std::fs::File::create(&path).unwrap();
        assert!(memory.write(0, &[&[1; 65_536]]).is_err());
    }

    #[test]
    fn reads_only_what_the_file_has() {
        let path = folder("read").join("out");
        let memory = SharedReader::create(&path, 8_192).unwrap();
        assert!(memory.read(0, 1).is_err());
        std::fs::write(&path, vec![7; 10_000]).unwrap();
        assert_eq!(memory.read(8_190, 2).unwrap(), &[7, 7]);
        assert!(memory.read(8_190, 3).is_err());
        assert!(memory.read(u64::MAX, 3).is_err());
        // The bytes were checked, and lost later.
        std::fs::File::create(&path).unwrap();
        assert_eq!(memory.bytes(0, 3), &[0, 0, 0]);
        std::fs::write(&path, vec![7; 10_000]).unwrap();
        assert!(memory.read(0, 3).is_err());
    }

    #[test]
    fn counts_the_bytes_in_use() {
        let memory = SharedReader::create(&folder("used").join("out"), 8_192).unwrap();
        assert!(memory.hold(4_000));
        assert!(!memory.hold(97));
        assert!(memory.hold(96));
        memory.release(5, 4_000);
        memory.release(2, 96);
        assert_eq!(memory.take_released(), vec![5, 2]);
        assert!(memory.take_released().is_empty());
        assert!(memory.hold(4_096));
    }
}

//! Writes the index: appends entries to a memory map and publishes them with one atomic word.
//! See docs/adr/0030-the-store-index-is-the-commit-log.md.

use std::fs::{File, OpenOptions};
use std::path::Path;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::sync::Arc;

use memmap2::MmapOptions;
use rustix::fs::{fdatasync, ftruncate};
use rustix::thread::futex;

use crate::error::{Error, Result};
use crate::extent::{allocate_some, allocate_space, open_with, Fault};
use crate::format::*;
use crate::guard::MapMut;

/// The file name of the index in a store's folder.
pub const FILE: &str = "index.situ";
const FIRST_GROWTH: u64 = 64 * 1024;
const MAX_GROWTH: u64 = 16 * 1024 * 1024;
/// The reason in errors about a mapped file that has become shorter.
pub const FILE_WAS_CUT: &str = "the file was cut while it was open";

/// Returns the atomic word at offset `at` of a mapped index header.
#[allow(unsafe_code)]
pub fn atomic_word(map: &[u8], at: usize) -> &AtomicU64 {
    let bytes = &map[at..at + 8];
    // SAFETY: the slice is 8 bytes long and 8-aligned (maps begin at pages, `at` is a constant multiple of 8). The
    // memory is only ever accessed atomically, and every bit pattern is a valid u64.
    unsafe { &*(bytes.as_ptr().cast::<AtomicU64>()) }
}

/// Returns the low half of the commit word, which live readers wait on.
#[allow(unsafe_code)]
pub fn futex_word(map: &[u8]) -> &AtomicU32 {
    let bytes = &map[COMMITTED_AT..COMMITTED_AT + 4];
    // SAFETY: as in `atomic_word`; the low half of a little-endian u64 comes first.
    unsafe { &*(bytes.as_ptr().cast::<AtomicU32>()) }
}

#[allow(unsafe_code)]
fn map_mut(file: &File, from: u64, length: u64) -> Result<MapMut> {
    // SAFETY: the writer's lock makes the file ours, and its bytes are allocated. It is truncated only in `finish`,
    // after which nothing is written any more. If another program truncates it, the guard catches the signal.
    unsafe {
        MmapOptions::new()
            .offset(from)
            .len(length as usize)
            .map_mut(file)
    }
    .map(MapMut::new)
    .map_err(|e| Error::io("map index.situ", e))
}

/// The writer of `index.situ`.
#[derive(Debug)]
pub struct IndexWriter {
    /// The index file.
    pub file: File,
    header: MapMut,
    /// The mapped parts of the file: (offset of the first byte, map).
    segments: Vec<(u64, MapMut)>,
    size: u64,
    /// The number of committed entries.
    pub committed: u64,
    fault: Arc<Fault>,
}

impl IndexWriter {
    /// Creates the file with its header; the file must not exist yet.
    pub fn create(
        path: &Path,
        header: IndexHeader,
        mode: Option<u32>,
        fault: Arc<Fault>,
    ) -> Result<Self> {
        let mut options = OpenOptions::new();
        options.read(true).write(true).create_new(true);
        let file =
            open_with(&mut options, path, mode).map_err(|e| Error::io("create index.situ", e))?;
        fault.step()?;
        let size = INDEX_HEADER as u64;
        allocate_space(&file, 0, size).map_err(|e| Error::io("allocate index.situ", e))?;
        let mut map = map_mut(&file, 0, size)?;
        map[8..].copy_from_slice(&header.encode()[8..]);
        // The magic is written last, so that a reader never sees half a header.
        map[..8].copy_from_slice(INDEX_MAGIC);
        fault.step()?;
        let mut index = IndexWriter {
            file,
            header: map,
            segments: Vec::new(),
            size,
            committed: 0,
            fault,
        };
        index.add_segment()?;
        Ok(index)
    }

    fn add_segment(&mut self) -> Result<()> {
        let more = (self.size - INDEX_HEADER as u64).clamp(FIRST_GROWTH, MAX_GROWTH);
        self.fault.step()?;
        let more = allocate_some(&self.file, self.size, more, 4096)
            .map_err(|e| Error::io("allocate index.situ", e))?;
        self.fault.step()?;
        let map = map_mut(&self.file, self.size, more)?;
        // Only the last two segments can still be written; older ones are full.
        if self.segments.len() > 2 {
            self.segments.remove(0);
        }
        self.segments.push((self.size, map));
        self.size += more;
        Ok(())
    }

    /// Allocates space for `n` more entries, so that publishing them cannot fail.
    pub fn reserve(&mut self, n: usize) -> Result<()> {
        while INDEX_HEADER as u64 + (self.committed + n as u64) * ENTRY as u64 > self.size {
            self.add_segment()?;
        }
        Ok(())
    }

    /// Writes `entries` and publishes them.
    pub fn publish(&mut self, entries: &[Entry]) -> Result<()> {
        self.reserve(entries.len())?;
        let mut at = INDEX_HEADER as u64 + self.committed * ENTRY as u64;
        for entry in entries {
            self.fault.step()?;
            let Some((start, map)) = self
                .segments
                .iter_mut()
                .rev()
                .find(|(start, _)| *start <= at)
            else {
                return Err(Error::damaged(FILE, at, "no map for an entry"));
            };
            let local = (at - *start) as usize;
            map[local..local + ENTRY].copy_from_slice(&entry.encode());
            at += ENTRY as u64;
        }
        self.fault.step()?;
        if self.is_torn() {
            return Err(Error::damaged(FILE, 0, FILE_WAS_CUT));
        }
        self.committed += entries.len() as u64;
        atomic_word(&self.header, COMMITTED_AT).store(self.committed, Ordering::Release);
        let _ = futex::wake(
            futex_word(&self.header),
            futex::Flags::empty(),
            i32::MAX as u32,
        );
        if self.is_torn() {
            return Err(Error::damaged(FILE, 0, FILE_WAS_CUT));
        }
        self.fault.step()
    }

    fn is_torn(&self) -> bool {
        self.header.is_torn() || self.segments.iter().any(|(_, map)| map.is_torn())
    }

    /// Syncs the index to disk and records the number of entries that are safe there.
    pub fn sync(&mut self) -> Result<()> {
        fdatasync(&self.file).map_err(|e| Error::io("sync index.situ", e))?;
        atomic_word(&self.header, SYNCED_AT).store(self.committed, Ordering::Release);
        Ok(())
    }

    /// Truncates the unused rest of the file and marks the store closed.
    pub fn finish(&mut self) -> Result<()> {
        self.fault.step()?;
        let end = (INDEX_HEADER as u64 + self.committed * ENTRY as u64).next_multiple_of(4096);
        // The maps are dropped first, so that no page after the new end stays mapped.
        self.segments.clear();
        ftruncate(&self.file, end).map_err(|e| Error::io("trim index.situ", e))?;
        self.fault.step()?;
        self.header[STATE_AT] = 1;
        let _ = futex::wake(
            futex_word(&self.header),
            futex::Flags::empty(),
            i32::MAX as u32,
        );
        self.fault.step()
    }
}

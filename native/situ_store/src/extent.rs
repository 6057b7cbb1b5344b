//! Writes extents: allocated files of one lane that are filled from front to back.

use std::fs::{File, OpenOptions, Permissions};
use std::io::IoSlice;
use std::os::unix::fs::{OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::Arc;

use rustix::fs::{fallocate, fdatasync, ftruncate, FallocateFlags};
use rustix::io::{pwrite, pwritev, Errno};

use crate::error::{Error, Result};
use crate::format::*;

/// Simulated crashes for durability tests: the n-th step fails or kills the process.
#[derive(Debug, Default)]
pub struct Fault {
    left: AtomicI64,
    armed: bool,
    kill: bool,
}

impl Fault {
    /// Makes step number `steps` fail; with `kill` the process kills itself at that step.
    pub fn after(steps: i64, kill: bool) -> Arc<Self> {
        Arc::new(Fault {
            left: AtomicI64::new(steps),
            armed: true,
            kill,
        })
    }

    /// Counts a step and returns an error if it is the one that fails.
    #[inline]
    pub fn step(&self) -> Result<()> {
        if !self.armed || self.left.fetch_sub(1, Ordering::Relaxed) > 0 {
            return Ok(());
        }
        if self.kill {
            let _ = rustix::process::kill_process(
                rustix::process::getpid(),
                rustix::process::Signal::KILL,
            );
        }
        Err(Error::Crash)
    }
}

/// The default mode of a store's files: the owner can read and write them, and the group can read them.
pub const FILE_MODE: u32 = 0o640;

/// Opens a file of a store. A new file is created with its final mode, so it is never readable by more users than
/// intended. An explicit `mode` overrides the process's file mode mask.
pub fn open_with(
    options: &mut OpenOptions,
    path: &Path,
    mode: Option<u32>,
) -> std::io::Result<File> {
    let file = options.mode(mode.unwrap_or(FILE_MODE)).open(path)?;
    if let Some(mode) = mode {
        file.set_permissions(Permissions::from_mode(mode))?;
    }
    Ok(file)
}

/// Allocates bytes of a file on disk, so that writing them later cannot run out of space.
pub fn allocate_space(file: &File, from: u64, length: u64) -> std::result::Result<(), Errno> {
    match fallocate(file, FallocateFlags::empty(), from, length) {
        Err(Errno::OPNOTSUPP) | Err(Errno::NOSYS) => {
            // The file system does not support fallocate: write zeros, as posix_fallocate would.
            let zeros = [0; 64 * 1024];
            let mut at = from;
            while at < from + length {
                let n = zeros.len().min((from + length - at) as usize);
                at += pwrite(file, &zeros[..n], at)? as u64;
            }
            Ok(())
        }
        other => other,
    }
}

/// Allocates `length` bytes like `allocate_space`. On a nearly full disk it tries a quarter of that, then a quarter
/// again, down to `least`. Returns the allocated size.
pub fn allocate_some(
    file: &File,
    from: u64,
    length: u64,
    least: u64,
) -> std::result::Result<u64, Errno> {
    let mut length = length.max(least);
    loop {
        match allocate_space(file, from, length) {
            Ok(()) => return Ok(length),
            Err(Errno::NOSPC) if length > least => {
                // Release the space of the failed attempt before the next one.
                let _ = ftruncate(file, from);
                length = (length / 4).next_multiple_of(4096).max(least);
            }
            Err(error) => return Err(error),
        }
    }
}

/// Writes all of `bytes` to a file at offset `at`.
pub fn write_all(file: &File, mut bytes: &[u8], mut at: u64) -> std::result::Result<(), Errno> {
    while !bytes.is_empty() {
        match pwrite(file, bytes, at) {
            Ok(0) => return Err(Errno::IO),
            Ok(n) => {
                bytes = &bytes[n..];
                at += n as u64;
            }
            Err(Errno::INTR) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// Returns the file name of an extent.
pub fn file_name(lane: u8, number: u32) -> String {
    let lane = if lane == LANE_LARGE { "large" } else { "data" };
    format!("{lane}-{number:06}.situ")
}

/// Returns the file name of an extent in a mirror.
pub fn mirror_name(lane: u8, number: u32) -> String {
    file_name(lane, number).replace(".situ", ".mirror")
}

/// The writer of one lane: its current extent and its position in it.
#[derive(Debug)]
pub struct Lane {
    dir: PathBuf,
    id: [u8; 16],
    lane: u8,
    first_size: u64,
    max_size: u64,
    mode: Option<u32>,
    file: Option<File>,
    next: u32,
    position: u64,
    size: u64,
    /// The size of all previous extents, bytes.
    before: u64,
    dirty: bool,
    /// The folder has entries that are not on disk yet.
    created: bool,
    /// Extents that became full since the last sync.
    filled: Vec<File>,
    fault: Arc<Fault>,
}

impl Lane {
    /// Creates a lane without extents. The first chunk creates one of `first_size` bytes; later ones grow up to
    /// `max_size`.
    pub fn new(
        dir: &Path,
        id: [u8; 16],
        lane: u8,
        first_size: u64,
        max_size: u64,
        mode: Option<u32>,
        fault: Arc<Fault>,
    ) -> Self {
        Lane {
            dir: dir.to_path_buf(),
            id,
            lane,
            first_size,
            max_size,
            mode,
            file: None,
            next: 0,
            position: 0,
            size: 0,
            before: 0,
            dirty: false,
            created: true,
            filled: Vec::new(),
            fault,
        }
    }

    /// Returns the size of all extents in bytes; the current one counts only up to the end of its data.
    pub fn byte_size(&self) -> u64 {
        self.before + self.position
    }

    /// Reserves `length` bytes and returns (extent, offset). Opens a new extent if the current one is too full.
    pub fn reserve_space(&mut self, length: u64, align: u64) -> Result<(u32, u64)> {
        let offset = self.position.next_multiple_of(align);
        if self.file.is_none() || offset + length > self.size {
            self.open_next_extent(length)?;
        }
        let offset = self.position.next_multiple_of(align);
        Ok((self.next - 1, offset))
    }

    fn open_next_extent(&mut self, length: u64) -> Result<()> {
        let number = self.next;
        let file_name = file_name(self.lane, number);
        let path = self.dir.join(&file_name);
        let grown = self
            .first_size
            .saturating_mul(4u64.saturating_pow(number.min(16)));
        let size = grown
            .min(self.max_size)
            .max((length + 4096).next_multiple_of(4096));
        self.fault.step()?;
        // A file left under this number by a failed attempt was never committed, so it is overwritten.
        let mut options = OpenOptions::new();
        options.read(true).write(true).create(true).truncate(true);
        let file = open_with(&mut options, &path, self.mode)
            .map_err(|e| Error::io(format!("create {file_name}"), e))?;
        self.fault.step()?;
        let least = (length + 4096).next_multiple_of(4096);
        // The header comes first: whenever the writer dies, the file is either empty or a valid extent.
        let failed = |error: Errno| {
            let _ = std::fs::remove_file(&path);
            Error::io(format!("allocate {least} bytes for {file_name}"), error)
        };
        write_all(&file, &encode_extent_header(&self.id, self.lane, number), 0).map_err(failed)?;
        self.fault.step()?;
        let header = EXTENT_HEADER as u64;
        let size =
            header + allocate_some(&file, header, size - header, least - header).map_err(failed)?;
        self.fault.step()?;
        if let Some(full) = self.file.replace(file) {
            if self.dirty {
                self.filled.push(full);
            }
        }
        self.before += self.size;
        self.next += 1;
        self.position = EXTENT_HEADER as u64;
        self.size = size;
        self.dirty = true;
        self.created = true;
        Ok(())
    }

    /// Writes `slices` at the offset that `reserve_space` returned, and moves the position after them.
    pub fn write(&mut self, offset: u64, slices: &[&[u8]]) -> Result<()> {
        self.fault.step()?;
        let Some(file) = self.file.as_ref() else {
            return Err(Error::Closed);
        };
        let mut at = offset;
        let failed = |error: Errno| Error::io("write data", error);
        if let [one] = slices {
            write_all(file, one, at).map_err(failed)?;
            at += one.len() as u64;
        } else {
            for group in slices.chunks(512) {
                let vector: Vec<IoSlice<'_>> = group.iter().map(|s| IoSlice::new(s)).collect();
                let total: usize = group.iter().map(|s| s.len()).sum();
                let mut done = match pwritev(file, &vector, at) {
                    Ok(n) => n,
                    Err(Errno::INTR) => 0,
                    Err(error) => return Err(failed(error)),
                };
                if done < total {
                    // The kernel wrote only a part of the slices; write the rest one by one.
                    let mut slice_at = at;
                    for slice in group {
                        let skip = done.min(slice.len());
                        write_all(file, &slice[skip..], slice_at + skip as u64).map_err(failed)?;
                        done -= skip;
                        slice_at += slice.len() as u64;
                    }
                }
                at += total as u64;
            }
        }
        self.position = at.next_multiple_of(8);
        self.dirty = true;
        self.fault.step()
    }

    /// Erases the start of the chunk at this position, so that no scan mistakes it for a chunk.
    pub fn erase_chunk(&self, extent: u32, offset: u64) -> std::io::Result<()> {
        let path = self.dir.join(file_name(self.lane, extent));
        let file = OpenOptions::new().write(true).open(path)?;
        Ok(write_all(&file, &[0; 8], offset)?)
    }

    /// Syncs all chunks of the lane to disk.
    pub fn sync(&mut self) -> Result<()> {
        if self.created {
            let folder =
                File::open(&self.dir).map_err(|e| Error::io("open the store's folder", e))?;
            rustix::fs::fsync(&folder).map_err(|e| Error::io("sync the store's folder", e))?;
            self.created = false;
        }
        if let (true, Some(file)) = (self.dirty, self.file.as_ref()) {
            for full in self.filled.iter().chain([file]) {
                fdatasync(full).map_err(|e| Error::io("sync data", e))?;
            }
            self.filled.clear();
            self.dirty = false;
        }
        Ok(())
    }

    /// Truncates the unused rest of the last extent. Readers never access bytes after the committed ones, so a map
    /// of the old length is safe.
    pub fn trim(&mut self) -> Result<()> {
        self.fault.step()?;
        if let Some(file) = self.file.as_ref() {
            let end = self.position.next_multiple_of(4096).min(self.size);
            ftruncate(file, end).map_err(|e| Error::io("trim data", e))?;
        }
        self.fault.step()
    }

    /// Returns whether the folder still contains the index that is open as `index`, that is, whether the store has
    /// not been moved or replaced.
    pub fn folder_has_index(&self, index: &File) -> bool {
        let here = rustix::fs::stat(self.dir.join("index.situ"));
        match (here, rustix::fs::fstat(index)) {
            (Ok(a), Ok(b)) => a.st_ino == b.st_ino && a.st_dev == b.st_dev,
            _ => false,
        }
    }
}

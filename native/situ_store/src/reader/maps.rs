//! The maps of a store's extents, and how much of them stays in memory.

use std::collections::{HashMap, VecDeque};
use std::fs::File;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, RwLock};

use std::io::IoSliceMut;

use memmap2::{MmapOptions, UncheckedAdvice};
use rustix::io::{preadv2, Errno, ReadWriteFlags};

use crate::error::{Error, Result};
use crate::extent;
use crate::format::*;
use crate::guard::Map;

/// A reader keeps about this many bytes of maps resident; what it looked at longest ago goes first.
const MOST_RESIDENT: usize = 16 << 20;
const PAGE: usize = 4096;
/// The kernel maps the sixteen pages around each page that is read, so that is the unit to count and to release.
const AROUND: usize = 16 * PAGE;

#[allow(unsafe_code)]
pub(crate) fn map_file(file: &File, from: u64, length: u64, what: &str) -> Result<Map> {
    // SAFETY: mapped read-only and shared. The length was taken from the file; the format's writer never cuts a file
    // below what is committed, and only what is committed is looked at. If another program cuts it, the guard catches
    // the signal.
    unsafe {
        MmapOptions::new()
            .offset(from)
            .len(length as usize)
            .map(file)
    }
    .map(Map::new)
    .map_err(|e| Error::io(format!("map {what}"), e))
}

pub(crate) fn file_length(file: &File, what: &str) -> Result<u64> {
    file.metadata()
        .map(|m| m.len())
        .map_err(|e| Error::io(format!("size of {what}"), e))
}

/// The extents of one store, mapped when first wanted.
pub(super) struct Extents {
    dir: PathBuf,
    id: [u8; 16],
    maps: RwLock<HashMap<(u8, u32), Arc<Map>>>,
    window: Mutex<Window>,
    /// The file of large messages that was read last; one, so that long recordings do not take all the descriptors
    /// there are.
    file: Mutex<Option<(u32, Arc<File>)>>,
}

/// As many bytes hold the header of a large chunk and its table, of one message.
const HEAD: usize = 256;

impl Extents {
    pub fn new(dir: PathBuf, id: [u8; 16]) -> Self {
        Extents {
            dir,
            id,
            maps: RwLock::default(),
            window: Mutex::default(),
            file: Mutex::default(),
        }
    }

    /// Header and table of an uncompressed large chunk, read beside its map: there they would fault in sixteen pages
    /// to be let go of again. `None` when there is none in so many bytes, or (when it shall not `wait`) when they are
    /// not in memory.
    pub fn head(&self, entry: &Entry, map: &Map, wait: bool) -> Option<(ChunkHeader, Vec<u8>)> {
        let file = self.large(entry.extent)?;
        let space = (map.len() as u64).checked_sub(entry.offset)?;
        let mut bytes = [0; HEAD];
        let read = |bytes: &mut [u8], flags| {
            preadv2(&*file, &mut [IoSliceMut::new(bytes)], entry.offset, flags)
        };
        let n = if wait {
            read(&mut bytes, ReadWriteFlags::empty()).ok()?
        } else {
            match read(&mut bytes, ReadWriteFlags::NOWAIT) {
                // A file system that cannot say.
                Err(Errno::OPNOTSUPP) if resident(map, entry.offset as usize, HEAD) => {
                    read(&mut bytes, ReadWriteFlags::empty()).ok()?
                }
                other => other.ok()?,
            }
        };
        let header = ChunkHeader::decode_head(&bytes[..n], space).ok()?;
        let table = bytes.get(header.size()..header.size() + header.covered())?;
        (header.compression == Compression::None).then(|| (header, table.to_vec()))
    }

    fn large(&self, extent: u32) -> Option<Arc<File>> {
        let mut last = self.file.lock().unwrap_or_else(|p| p.into_inner());
        if let Some((number, file)) = &*last {
            if *number == extent {
                return Some(file.clone());
            }
        }
        let file = Arc::new(File::open(self.dir.join(extent::name(LANE_LARGE, extent))).ok()?);
        *last = Some((extent, file.clone()));
        Some(file)
    }

    /// The extent's map, if it was mapped before.
    pub fn mapped(&self, lane: u8, number: u32) -> Option<Arc<Map>> {
        let maps = self.maps.read().unwrap_or_else(|p| p.into_inner());
        maps.get(&(lane, number)).cloned()
    }

    pub fn get(&self, lane: u8, number: u32) -> Result<Arc<Map>> {
        if let Some(map) = self.mapped(lane, number) {
            return Ok(map);
        }
        let map = Arc::new(self.open(lane, number)?);
        let mut maps = self.maps.write().unwrap_or_else(|p| p.into_inner());
        Ok(maps.entry((lane, number)).or_insert(map).clone())
    }

    fn open(&self, lane: u8, number: u32) -> Result<Map> {
        let name = extent::name(lane, number);
        let file = File::open(self.dir.join(&name)).map_err(|e| match e.kind() {
            std::io::ErrorKind::NotFound => Error::MissingExtent(name.clone()),
            _ => Error::io(format!("open {name}"), e),
        })?;
        let length = file_length(&file, &name)?;
        if length < EXTENT_HEADER as u64 {
            return Err(Error::damaged(name, 0, "shorter than an extent's header"));
        }
        let map = map_file(&file, 0, length, &name)?;
        check_extent(&map, &self.id, lane, number).map_err(|why| Error::damaged(name, 0, why))?;
        Ok(map)
    }

    /// Notes that these bytes are about to be read, and releases the pages that were read longest ago.
    pub fn touch(&self, map: &Arc<Map>, start: usize, length: usize) {
        let old = {
            let mut window = self.window.lock().unwrap_or_else(|p| p.into_inner());
            window.add(map, start, start.saturating_add(length));
            window.overdue()
        };
        for range in old {
            release(&range.map, range.start, range.end);
        }
    }
}

struct Range {
    map: Arc<Map>,
    start: usize,
    end: usize,
}

/// Streams that are read in turn look at the same places again and again: so many of the last ranges are searched for
/// one.
const LATELY: usize = 8;

/// The ranges read lately, oldest first; neighbours are one range.
#[derive(Default)]
struct Window {
    ranges: VecDeque<Range>,
    bytes: usize,
}

impl Window {
    fn add(&mut self, map: &Arc<Map>, start: usize, end: usize) {
        let (start, end) = (start / AROUND * AROUND, end.next_multiple_of(AROUND));
        let mut lately = self.ranges.iter().rev().take(LATELY);
        if lately.any(|r| Arc::ptr_eq(&r.map, map) && r.start <= start && end <= r.end) {
            return;
        }
        match self.ranges.back_mut() {
            Some(last)
                if Arc::ptr_eq(&last.map, map) && start >= last.start && start <= last.end =>
            {
                self.bytes += end - last.end;
                last.end = end;
            }
            _ => {
                self.bytes += end - start;
                let map = map.clone();
                self.ranges.push_back(Range { map, start, end });
            }
        }
    }

    /// Half of the window at once, so that letting go costs few system calls.
    fn overdue(&mut self) -> Vec<Range> {
        let mut old = Vec::new();
        if self.bytes <= MOST_RESIDENT {
            return old;
        }
        while self.bytes > MOST_RESIDENT / 2 {
            let Some(first) = self.ranges.front_mut() else {
                break;
            };
            let excess = self.bytes - MOST_RESIDENT / 2;
            if first.end - first.start > excess {
                let cut = first.start + excess;
                let (map, start) = (first.map.clone(), first.start);
                first.start = cut;
                self.bytes -= excess;
                old.push(Range {
                    map,
                    start,
                    end: cut,
                });
            } else if let Some(first) = self.ranges.pop_front() {
                self.bytes -= first.end - first.start;
                old.push(first);
            }
        }
        old
    }
}

/// Gives the pages back to the page cache; the next read faults them in again.
#[allow(unsafe_code)]
pub(super) fn release(map: &Map, start: usize, end: usize) {
    let (from, to) = (start / PAGE * PAGE, end.min(map.len()));
    if to > from {
        // SAFETY: a read-only shared map of a file has no bytes of its own: the same ones come back from the file.
        let _ = unsafe {
            map.inner()
                .unchecked_advise_range(UncheckedAdvice::DontNeed, from, to - from)
        };
    }
}

/// Whether reading these bytes needs no disk. True of another user's file, too, of which the kernel does not tell.
#[allow(unsafe_code)]
pub(super) fn resident(map: &Map, start: usize, length: usize) -> bool {
    let mut pages = [0u8; 64];
    let from = start / PAGE * PAGE;
    let end = start.saturating_add(length).min(map.len());
    let n = end.saturating_sub(from).div_ceil(PAGE);
    if n == 0 || n > pages.len() {
        return false;
    }
    // SAFETY: the range lies in the map, `from` is a multiple of the page size (as the map's start is), and there is
    // a byte for each of its pages.
    let done = unsafe {
        libc::mincore(
            map.as_ptr().add(from) as *mut _,
            end - from,
            pages.as_mut_ptr(),
        )
    };
    done == 0 && pages[..n].iter().all(|page| page & 1 == 1)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn the_window_lets_go_of_the_oldest_half() {
        let map = |n| {
            let map = MmapOptions::new().len(n).map_anon().unwrap();
            Arc::new(Map::new(map.make_read_only().unwrap()))
        };
        let (a, b) = (map(32 << 20), map(32 << 20));
        let mut window = Window::default();
        // Neighbours become one range.
        for at in (0..12 << 20).step_by(1 << 20) {
            window.add(&a, at, at + (1 << 20) - 100);
        }
        // A range read twice counts once.
        window.add(&a, 5 << 20, (5 << 20) + 10);
        assert_eq!((window.ranges.len(), window.bytes), (1, 12 << 20));
        assert!(window.overdue().is_empty());
        // A byte counts as much as the kernel maps for it.
        window.add(&b, (4 << 20) + 70_000, (4 << 20) + 70_001);
        assert_eq!(window.bytes, (12 << 20) + AROUND);
        window.add(&b, 5 << 20, 10 << 20);
        let old = window.overdue();
        assert_eq!(old.len(), 1);
        assert!(Arc::ptr_eq(&old[0].map, &a));
        assert_eq!((old[0].start, old[0].end), (0, (9 << 20) + AROUND));
        assert_eq!(window.bytes, MOST_RESIDENT / 2);
        // Back to where it was: a range of its own.
        window.add(&b, 0, 1 << 20);
        assert_eq!(window.ranges.len(), 4);
        // More than all of it at once.
        window.add(&a, 0, 32 << 20);
        assert_eq!(window.overdue().len(), 5);
        assert_eq!(window.bytes, MOST_RESIDENT / 2);
    }
}

//! Maps a store's extents and limits how much of them stays resident.
//!
//! Without a limit, a replay of half a gigabyte of images held 600 MiB. Releasing pages (`MADV_DONTNEED`) loses
//! nothing, because the maps are read-only. Populating them in advance (`MADV_POPULATE_READ`) was slower than the
//! kernel's own read-around.

use std::collections::{HashMap, VecDeque};
use std::fs::File;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, RwLock};

use std::io::IoSliceMut;

use memmap2::{MmapOptions, UncheckedAdvice};
use rustix::io::{preadv2, Errno, ReadWriteFlags};

use super::residency::{self, AbsentRange, Marks};
use crate::error::{Error, Result};
use crate::extent;
use crate::format::*;
use crate::guard::Map;

/// A reader keeps about this many bytes of maps resident and releases the least recently read ones first.
const MOST_RESIDENT: usize = 16 << 20;
const PAGE: usize = 4096;
/// The kernel maps the sixteen pages around each page that is read, so this is the unit for counting and releasing.
/// With a count in bytes read, a studio that followed a live recording grew by 5 MB a minute.
const FAULT_AROUND: usize = 16 * PAGE;

#[allow(unsafe_code)]
pub(crate) fn map_file(file: &File, from: u64, length: u64, what: &str) -> Result<Map> {
    // SAFETY: the map is read-only and shared. The length is the file's length; the format's writer never truncates
    // a file below the committed bytes, and only those are accessed. If another program truncates it, the guard
    // catches the signal.
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

/// The extents of one store, mapped on first use.
pub(super) struct Extents {
    dir: PathBuf,
    id: [u8; 16],
    /// Whether the store is a mirror.
    pub mirror: bool,
    maps: RwLock<HashMap<(u8, u32), Arc<Map>>>,
    window: Mutex<Window>,
    /// The file of large messages that was read last. Only one is kept open, so that long recordings do not use up
    /// all file descriptors.
    file: Mutex<Option<(u32, Arc<File>)>>,
}

/// The maximum size of a large chunk's header and its table, which has one message.
const HEAD: usize = 256;

impl Extents {
    pub fn new(dir: PathBuf, id: [u8; 16]) -> Self {
        Extents {
            mirror: dir.join(residency::MIRROR).exists(),
            dir,
            id,
            maps: RwLock::default(),
            window: Mutex::default(),
            file: Mutex::default(),
        }
    }

    /// Reads header and table of an uncompressed large chunk from the file and not from its map, where they would
    /// fault in sixteen pages: an unchecked message of 64 KB takes 3 us instead of 11 to 15. Returns `None` if they
    /// need more bytes, or (unless `wait`) if they are not in memory.
    pub fn read_large_head(
        &self,
        entry: &Entry,
        map: &Map,
        wait: bool,
    ) -> Option<(ChunkHeader, Vec<u8>)> {
        let file = self.open_large_file(entry.extent)?;
        let space = (map.len() as u64).checked_sub(entry.offset)?;
        let mut bytes = [0; HEAD];
        let read = |bytes: &mut [u8], flags| {
            preadv2(&*file, &mut [IoSliceMut::new(bytes)], entry.offset, flags)
        };
        let n = if wait {
            read(&mut bytes, ReadWriteFlags::empty()).ok()?
        } else {
            match read(&mut bytes, ReadWriteFlags::NOWAIT) {
                // The file system does not support NOWAIT.
                Err(Errno::OPNOTSUPP) if is_resident(map, entry.offset as usize, HEAD) => {
                    read(&mut bytes, ReadWriteFlags::empty()).ok()?
                }
                other => other.ok()?,
            }
        };
        let header = ChunkHeader::decode_head(&bytes[..n], space).ok()?;
        let table =
            bytes.get(header.header_size()..header.header_size() + header.covered_size())?;
        (header.compression == Compression::None).then(|| (header, table.to_vec()))
    }

    fn open_large_file(&self, extent: u32) -> Option<Arc<File>> {
        let mut last = self.file.lock().unwrap_or_else(|p| p.into_inner());
        if let Some((number, file)) = &*last {
            if *number == extent {
                return Some(file.clone());
            }
        }
        let file = Arc::new(File::open(self.dir.join(extent::file_name(LANE_LARGE, extent))).ok()?);
        *last = Some((extent, file.clone()));
        Some(file)
    }

    /// Returns the extent's map if it was mapped before.
    pub fn cached_map(&self, lane: u8, number: u32) -> Option<Arc<Map>> {
        let maps = self.maps.read().unwrap_or_else(|p| p.into_inner());
        maps.get(&(lane, number)).cloned()
    }

    pub fn get(&self, lane: u8, number: u32) -> Result<Arc<Map>> {
        if let Some(map) = self.cached_map(lane, number) {
            return Ok(map);
        }
        let map = Arc::new(self.open_map(lane, number)?);
        let mut maps = self.maps.write().unwrap_or_else(|p| p.into_inner());
        Ok(maps.entry((lane, number)).or_insert(map).clone())
    }

    /// Returns whether a mirror has these bytes of an extent; notes them otherwise. The extent is mapped again for the
    /// next operation, because its file may have been replaced by an empty one.
    fn has_bytes(&self, (lane, extent): (u8, u32), map: &Map, offset: u64, length: u64) -> bool {
        let marks = Marks::find(map);
        if marks.is_some_and(|marks| marks.covers(map, offset, length)) {
            return true;
        }
        let mut maps = self.maps.write().unwrap_or_else(|p| p.into_inner());
        maps.remove(&(lane, extent));
        residency::note_absent(AbsentRange {
            lane,
            extent,
            offset,
            length,
        });
        false
    }

    /// Returns the extent's map if the first `length` bytes of an entry's chunk can be read now.
    pub fn get_chunk(&self, entry: &Entry, length: u64) -> Result<Arc<Map>> {
        let map = self.get(entry.lane, entry.extent)?;
        let extent = (entry.lane, entry.extent);
        if self.mirror && !self.has_bytes(extent, &map, entry.offset, length) {
            return Err(Error::Absent);
        }
        Ok(map)
    }

    /// Returns whether a mirror has an entry's chunk; notes its bytes otherwise.
    pub fn has_chunk(&self, entry: &Entry) -> bool {
        match self.get_chunk(entry, entry.length.into()) {
            // The header of the extent is missing, too.
            Err(Error::Absent) => {
                residency::note_absent(AbsentRange {
                    lane: entry.lane,
                    extent: entry.extent,
                    offset: entry.offset,
                    length: entry.length.into(),
                });
                false
            }
            _ => true,
        }
    }

    fn open_map(&self, lane: u8, number: u32) -> Result<Map> {
        let name = match self.mirror {
            true => extent::mirror_name(lane, number),
            false => extent::file_name(lane, number),
        };
        let file = File::open(self.dir.join(&name)).map_err(|e| match e.kind() {
            std::io::ErrorKind::NotFound => Error::MissingExtent(name.clone()),
            _ => Error::io(format!("open {name}"), e),
        })?;
        let length = file_length(&file, &name)?;
        if length < EXTENT_HEADER as u64 {
            return Err(Error::damaged(name, 0, "shorter than an extent's header"));
        }
        let map = map_file(&file, 0, length, &name)?;
        if self.mirror && !self.has_bytes((lane, number), &map, 0, EXTENT_HEADER as u64) {
            return Err(Error::Absent);
        }
        check_extent_header(&map, &self.id, lane, number)
            .map_err(|why| Error::damaged(name, 0, why))?;
        Ok(map)
    }

    /// Records that these bytes are about to be read, and releases the least recently read pages.
    pub fn touch(&self, map: &Arc<Map>, start: usize, length: usize) {
        let old = {
            let mut window = self.window.lock().unwrap_or_else(|p| p.into_inner());
            window.add(map, start, start.saturating_add(length));
            window.take_overdue()
        };
        for range in old {
            release_pages(&range.map, range.start, range.end);
        }
    }
}

struct Range {
    map: Arc<Map>,
    start: usize,
    end: usize,
}

/// The number of recent ranges in which a range is searched: streams that are read alternately access the same
/// ranges again and again.
const RECENT_RANGES: usize = 8;

/// The recently read ranges, oldest first. Adjacent ranges are merged.
#[derive(Default)]
struct Window {
    ranges: VecDeque<Range>,
    bytes: usize,
}

impl Window {
    fn add(&mut self, map: &Arc<Map>, start: usize, end: usize) {
        let (start, end) = (
            start / FAULT_AROUND * FAULT_AROUND,
            end.next_multiple_of(FAULT_AROUND),
        );
        let mut recent = self.ranges.iter().rev().take(RECENT_RANGES);
        if recent.any(|r| Arc::ptr_eq(&r.map, map) && r.start <= start && end <= r.end) {
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

    /// Takes ranges out of a full window until it is half empty, so that releasing them needs few system calls.
    fn take_overdue(&mut self) -> Vec<Range> {
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

/// Returns the pages to the page cache; the next read faults them in again.
#[allow(unsafe_code)]
pub(super) fn release_pages(map: &Map, start: usize, end: usize) {
    let (from, to) = (start / PAGE * PAGE, end.min(map.len()));
    if to > from {
        // SAFETY: a read-only shared map of a file has no data of its own; the same bytes are read from the file
        // again.
        let _ = unsafe {
            map.inner()
                .unchecked_advise_range(UncheckedAdvice::DontNeed, from, to - from)
        };
    }
}

/// Returns whether these bytes can be read without disk access. Also returns true for another user's file, for
/// which the kernel gives no information.
#[allow(unsafe_code)]
pub(super) fn is_resident(map: &Map, start: usize, length: usize) -> bool {
    let mut pages = [0u8; 64];
    let from = start / PAGE * PAGE;
    let end = start.saturating_add(length).min(map.len());
    let n = end.saturating_sub(from).div_ceil(PAGE);
    if n == 0 || n > pages.len() {
        return false;
    }
    // SAFETY: the range is within the map, `from` is a multiple of the page size (as is the map's start), and there
    // is a byte for each of its pages.
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
    fn a_full_window_releases_its_oldest_half() {
        let map = |n| {
            let map = MmapOptions::new().len(n).map_anon().unwrap();
            Arc::new(Map::new(map.make_read_only().unwrap()))
        };
        let (a, b) = (map(32 << 20), map(32 << 20));
        let mut window = Window::default();
        // Adjacent ranges are merged.
        for at in (0..12 << 20).step_by(1 << 20) {
            window.add(&a, at, at + (1 << 20) - 100);
        }
        // A range read twice counts once.
        window.add(&a, 5 << 20, (5 << 20) + 10);
        assert_eq!((window.ranges.len(), window.bytes), (1, 12 << 20));
        assert!(window.take_overdue().is_empty());
        // A byte counts as much as the kernel maps around it.
        window.add(&b, (4 << 20) + 70_000, (4 << 20) + 70_001);
        assert_eq!(window.bytes, (12 << 20) + FAULT_AROUND);
        window.add(&b, 5 << 20, 10 << 20);
        let old = window.take_overdue();
        assert_eq!(old.len(), 1);
        assert!(Arc::ptr_eq(&old[0].map, &a));
        assert_eq!((old[0].start, old[0].end), (0, (9 << 20) + FAULT_AROUND));
        assert_eq!(window.bytes, MOST_RESIDENT / 2);
        // Jumping back to an earlier position starts a new range.
        window.add(&b, 0, 1 << 20);
        assert_eq!(window.ranges.len(), 4);
        // A range can be larger than the whole window.
        window.add(&a, 0, 32 << 20);
        assert_eq!(window.take_overdue().len(), 5);
        assert_eq!(window.bytes, MOST_RESIDENT / 2);
    }
}

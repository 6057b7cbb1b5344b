//! Mirrors: copies of remote stores, whose bytes are fetched when they are needed. A mirror has the whole index, and
//! instead of each extent a sparse file with a mark for each block that was fetched. An operation that needs other
//! blocks notes their ranges and fails. The caller fetches them and repeats the operation.
//! See docs/adr/0194-recordings-in-object-storage-are-read-through-mirrors.md.

use std::cell::RefCell;
use std::sync::atomic::{fence, Ordering};

use super::Reader;
use crate::format::*;
use crate::guard::Map;

/// This file marks a folder as a mirror.
pub(super) const MIRROR: &str = "mirror.json";
/// The last bytes of a mirrored extent: magic, size of the extent (u64), size of a block (u64).
const TRAILER: usize = 24;
const MAGIC: &[u8; 8] = b"SITUMIR1";
const PAGE: u64 = 4096;
/// The limit of ranges that one operation notes.
const MOST_RANGES: usize = 100_000;

/// Bytes of an extent that a mirror lacks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AbsentRange {
    /// The extent's lane.
    pub lane: u8,
    /// The extent's number.
    pub extent: u32,
    /// The offset of the first byte.
    pub offset: u64,
    /// The number of bytes.
    pub length: u64,
}

thread_local! {
    static ABSENT: RefCell<Vec<AbsentRange>> = const { RefCell::new(Vec::new()) };
}

/// Returns the ranges noted by this thread since the last call.
pub fn take_absent() -> Vec<AbsentRange> {
    ABSENT.with(RefCell::take)
}

/// Returns whether this thread has noted a range since the last `take_absent`.
pub fn has_absent() -> bool {
    ABSENT.with_borrow(|ranges| !ranges.is_empty())
}

pub(super) fn note_absent(range: AbsentRange) {
    ABSENT.with_borrow_mut(|ranges| {
        if ranges.len() < MOST_RANGES {
            ranges.push(range);
        }
    });
}

/// The marks of a mirrored extent.
#[derive(Debug, Clone, Copy)]
pub(super) struct Marks {
    size: u64,
    block: u64,
    table: usize,
}

impl Marks {
    /// Finds the marks in a map of the file. They begin at the first page after the extent.
    pub fn find(map: &[u8]) -> Option<Marks> {
        let trailer = map.get(map.len().checked_sub(TRAILER)?..)?;
        let number = |at: usize| {
            Some(u64::from_le_bytes(
                trailer.get(at..at + 8)?.try_into().ok()?,
            ))
        };
        let (size, block) = (number(8)?, number(16)?);
        let table = size.checked_next_multiple_of(PAGE)?;
        let end = table.checked_add(
            size.checked_add(block)?
                .checked_sub(1)?
                .checked_div(block)?,
        )?;
        let fits = trailer.starts_with(MAGIC) && end + TRAILER as u64 == map.len() as u64;
        fits.then_some(Marks {
            size,
            block,
            table: usize::try_from(table).ok()?,
        })
    }

    /// Returns whether all blocks of a range were fetched. Bytes after the extent's end do not count.
    pub fn covers(&self, map: &Map, offset: u64, length: u64) -> bool {
        let end = offset.saturating_add(length).min(self.size);
        if offset >= end {
            return true;
        }
        let (first, last) = (offset / self.block, (end - 1) / self.block);
        let marks = map.get(self.table + first as usize..=self.table + last as usize);
        let covered = marks.is_some_and(|marks| marks.iter().all(|mark| *mark == 1));
        // Blocks are written before they are marked.
        fence(Ordering::Acquire);
        covered
    }
}

impl Reader {
    /// Returns whether the store is a mirror.
    pub fn is_mirror(&self) -> bool {
        self.extents.mirror
    }

    /// Notes which chunks a mirror lacks for reading a stream from `ordinal` on and no later than `to`, up to `most`
    /// messages or `bytes` bytes. Returns whether it lacks any.
    pub fn lacks_chunks(&self, stream: u32, ordinal: u64, to: i64, most: u64, bytes: u64) -> bool {
        if !self.is_mirror() {
            return false;
        }
        let (mut next, mut size) = (ordinal, 0u64);
        while next - ordinal < most && size < bytes {
            let Ok(Some(entry)) = self.entry_at(stream, next) else {
                break;
            };
            if entry.first > to {
                break;
            }
            self.extents.has_chunk(&entry);
            size += u64::from(entry.length);
            next = entry.ordinal + u64::from(entry.count);
        }
        has_absent()
    }

    /// Returns whether the chunk can be read without fetching; notes it otherwise.
    pub(super) fn has_chunk(&self, entry: &Entry) -> bool {
        !self.is_mirror() || self.extents.has_chunk(entry)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use memmap2::MmapOptions;

    fn mirror(size: u64, block: u64, marks: &[u8]) -> Map {
        let table = size.next_multiple_of(PAGE) as usize;
        let mut map = MmapOptions::new()
            .len(table + marks.len() + TRAILER)
            .map_anon()
            .unwrap();
        map[table..table + marks.len()].copy_from_slice(marks);
        let at = table + marks.len();
        map[at..at + 8].copy_from_slice(MAGIC);
        map[at + 8..at + 16].copy_from_slice(&size.to_le_bytes());
        map[at + 16..].copy_from_slice(&block.to_le_bytes());
        Map::new(map.make_read_only().unwrap())
    }

    #[test]
    fn marks_tell_which_blocks_were_fetched() {
        let map = mirror(10_000, 4_096, &[1, 0, 1]);
        let marks = Marks::find(&map).unwrap();
        assert!(marks.covers(&map, 0, 4_096));
        assert!(!marks.covers(&map, 0, 4_097));
        assert!(!marks.covers(&map, 5_000, 10));
        assert!(marks.covers(&map, 8_192, 1_808));
        // Nothing exists after the end.
        assert!(marks.covers(&map, 9_999, u64::MAX));
        assert!(marks.covers(&map, 20_000, 5));
    }

    #[test]
    fn a_file_without_a_sound_trailer_has_no_marks() {
        let map = mirror(10_000, 4_096, &[1, 0]);
        assert!(Marks::find(&map).is_none());
        assert!(Marks::find(&map[..10]).is_none());
        let map = mirror(10_000, 0, &[1]);
        assert!(Marks::find(&map).is_none());
    }

    #[test]
    fn each_thread_notes_its_own_ranges() {
        let range = AbsentRange {
            lane: 0,
            extent: 1,
            offset: 2,
            length: 3,
        };
        note_absent(range);
        assert!(std::thread::spawn(|| !has_absent()).join().unwrap());
        assert_eq!(take_absent(), [range]);
        assert!(!has_absent());
    }
}

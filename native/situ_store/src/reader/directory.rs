//! The directory of a store: the sound index entries by stream and level.

use std::collections::BTreeMap;
use std::fs::File;

use super::maps::{file_length, map_file, release_pages};
use super::Damage;
use crate::error::Result;
use crate::format::*;
use crate::guard::Map;
use crate::index;

/// The number of index bytes that may stay resident after loading. Entries that are read later return to memory one
/// page at a time.
const MOST_RESIDENT: u64 = 1 << 20;
const PAGE: u64 = 4096;

/// The chunks of one stream at one level, in time order. It contains only the numbers of their entries, which stay
/// in the mapped index: a store that records for days has millions of them.
#[derive(Debug, Default)]
pub(super) struct Directory {
    numbers: Vec<u32>,
    /// The position from which on the ordinals are too large because entries before it were lost, and the
    /// difference.
    shifts: Vec<(usize, u64)>,
    last: Option<i64>,
    count: u64,
    stored: u64,
}

/// A directory together with the index that its numbers refer to.
#[derive(Clone, Copy)]
pub(super) struct Entries<'a> {
    index: &'a Index,
    directory: &'a Directory,
}

impl<'a> Entries<'a> {
    pub fn len(&self) -> usize {
        self.directory.numbers.len()
    }

    /// Returns the number of messages in the chunks.
    pub fn message_count(&self) -> u64 {
        self.directory.count
    }

    /// Returns the size of the chunks and their entries in bytes.
    pub fn stored_bytes(&self) -> u64 {
        self.directory.stored
    }

    /// Returns the entry at a position, or `None` after the last entry or if the file was changed since it was
    /// checked.
    pub fn get(&self, position: usize) -> Option<Entry> {
        let number = *self.directory.numbers.get(position)?;
        let mut entry = self.index.raw_entry(u64::from(number))?;
        entry.ordinal = entry.ordinal.wrapping_sub(self.ordinal_shift(position));
        Some(entry)
    }

    fn ordinal_shift(&self, position: usize) -> u64 {
        let shifts = &self.directory.shifts;
        let n = shifts.partition_point(|(from, _)| *from <= position);
        n.checked_sub(1).map_or(0, |i| shifts[i].1)
    }

    pub fn first(&self) -> Option<Entry> {
        self.get(0)
    }

    pub fn last(&self) -> Option<Entry> {
        self.get(self.len().checked_sub(1)?)
    }

    pub fn iter_from(self, position: usize) -> impl Iterator<Item = Entry> + 'a {
        (position..self.len()).map_while(move |at| self.get(at))
    }

    /// Returns the position of the first entry that ends at or after `time`.
    pub fn position_at_time(&self, time: i64) -> usize {
        self.partition_point(|entry| entry.last < time)
    }

    pub fn position_at_ordinal(&self, ordinal: u64) -> usize {
        self.partition_point(|entry| entry.ordinal.saturating_add(entry.count.into()) <= ordinal)
    }

    fn partition_point(&self, before: impl Fn(&Entry) -> bool) -> usize {
        let (mut low, mut high) = (0, self.len());
        while low < high {
            let middle = low + (high - low) / 2;
            match self.get(middle) {
                Some(entry) if before(&entry) => low = middle + 1,
                _ => high = middle,
            }
        }
        low
    }
}

#[derive(Default)]
pub(super) struct Index {
    /// Maps of the index's entries: (offset of the first byte, map).
    segments: Vec<(u64, Map)>,
    mapped: u64,
    /// The end of the last map, if it ends within a page.
    tail: u64,
    pub loaded: u64,
    /// The number of entries read since the index's pages were released.
    looked_at: u64,
    /// Whether the index claims to have more entries than it has space for.
    short: bool,
    pub directories: BTreeMap<(u32, u8), Directory>,
    pub damage: Vec<Damage>,
}

impl Index {
    pub fn stream_entries(&self, stream: u32, level: u8) -> Option<Entries<'_>> {
        let directory = self.directories.get(&(stream, level))?;
        Some(Entries {
            index: self,
            directory,
        })
    }

    /// Returns whether another program has truncated the index since it was opened.
    pub fn is_torn(&self) -> bool {
        self.segments.iter().any(|(_, map)| map.is_torn())
    }

    pub fn raw_entry(&self, at: u64) -> Option<Entry> {
        let byte = INDEX_HEADER as u64 + at * ENTRY as u64;
        let segment = self
            .segments
            .partition_point(|(start, _)| *start <= byte)
            .checked_sub(1)?;
        let (start, map) = self.segments.get(segment)?;
        let local = (byte - start) as usize;
        Entry::decode(map.get(local..local + ENTRY)?)
    }

    /// Loads the entries up to `published` and returns the number of loaded entries.
    pub fn load_entries(&mut self, published: u64, file: &File) -> Result<u64> {
        self.mapped = self.mapped.max(INDEX_HEADER as u64);
        let wanted = (published.saturating_mul(ENTRY as u64)).saturating_add(INDEX_HEADER as u64);
        if wanted > self.mapped_end() {
            let length = file_length(file, index::FILE)?;
            // Only complete pages are mapped, so that the next segment can start where this one ends.
            let end = length / PAGE * PAGE;
            if end > self.mapped {
                self.map_segment(file, end)?;
                self.mapped = end;
            }
            // A truncated file has sound entries up to its last byte. If it grows later, the page is mapped again,
            // and the later map is used.
            if wanted > self.mapped && length > self.mapped_end() {
                self.map_segment(file, length)?;
                self.tail = length;
            }
        }
        let room = (self.mapped_end() - INDEX_HEADER as u64) / ENTRY as u64;
        if published > room && !self.short {
            self.short = true;
            self.note_damage(
                INDEX_HEADER as u64 + room * ENTRY as u64,
                "the index ends before its last entry",
            );
        }
        for at in self.loaded..published.min(room) {
            let byte = INDEX_HEADER as u64 + at * ENTRY as u64;
            let Some(entry) = self.raw_entry(at) else {
                self.note_damage(byte, "the entry's checksum is wrong");
                continue;
            };
            let Ok(number) = u32::try_from(at) else {
                self.note_damage(byte, "a store can have at most 4,294,967,296 chunks");
                break;
            };
            if entry.is_placeholder() {
                continue;
            }
            let directory = self
                .directories
                .entry((entry.stream, entry.level))
                .or_default();
            if directory.last.is_some_and(|last| entry.first <= last) {
                self.note_damage(byte, "the entry goes back in time");
                continue;
            }
            let shift = entry.ordinal.wrapping_sub(directory.count);
            if directory.shifts.last().map_or(0, |(_, shift)| *shift) != shift {
                directory.shifts.push((directory.numbers.len(), shift));
            }
            directory.count += entry.count as u64;
            directory.stored += entry.length as u64 + ENTRY as u64;
            directory.last = Some(entry.last);
            directory.numbers.push(number);
        }
        let loaded = published.min(room).max(self.loaded);
        self.looked_at += loaded - self.loaded;
        self.loaded = loaded;
        if self.looked_at * ENTRY as u64 >= MOST_RESIDENT {
            self.looked_at = 0;
            for (_, map) in &self.segments {
                release_pages(map, 0, map.len());
            }
        }
        Ok(self.loaded)
    }

    /// Returns the end of the mapped part of the file.
    fn mapped_end(&self) -> u64 {
        self.mapped.max(self.tail)
    }

    fn map_segment(&mut self, file: &File, end: u64) -> Result<()> {
        let map = map_file(file, self.mapped, end - self.mapped, index::FILE)?;
        self.segments.push((self.mapped, map));
        Ok(())
    }

    fn note_damage(&mut self, offset: u64, why: &str) {
        if self.damage.len() < 10_000 {
            self.damage.push(Damage {
                file: index::FILE.into(),
                offset,
                why: why.into(),
            });
        }
    }
}

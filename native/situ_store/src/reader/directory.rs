//! The directory of a store: the index's entries by stream and level, as far as they are sound.

use std::collections::BTreeMap;
use std::fs::File;

use memmap2::Mmap;

use super::maps::{file_length, map_file};
use super::Damage;
use crate::error::Result;
use crate::format::*;
use crate::index;

/// The chunks of one stream at one level, in time order.
#[derive(Debug, Default)]
pub struct Directory {
    pub entries: Vec<Entry>,
    pub count: u64,
    pub stored: u64,
}

impl Directory {
    /// The first entry that ends at or after `time`.
    pub fn at_time(&self, time: i64) -> usize {
        self.entries.partition_point(|entry| entry.last < time)
    }

    pub fn at_ordinal(&self, ordinal: u64) -> usize {
        self.entries
            .partition_point(|entry| entry.ordinal + entry.count as u64 <= ordinal)
    }
}

#[derive(Default)]
pub(super) struct Index {
    /// Maps of the index's entries: (first byte, map).
    segments: Vec<(u64, Mmap)>,
    mapped: u64,
    pub loaded: u64,
    /// The index says it has more entries than it has room for.
    short: bool,
    pub directories: BTreeMap<(u32, u8), Directory>,
    pub damage: Vec<Damage>,
}

impl Index {
    pub fn directory(&self, stream: u32, level: u8) -> Option<&Directory> {
        self.directories.get(&(stream, level))
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

    /// Takes in the entries up to `published`; how many are known now.
    pub fn load(&mut self, published: u64, file: &File) -> Result<u64> {
        self.mapped = self.mapped.max(INDEX_HEADER as u64);
        let wanted = (published.saturating_mul(ENTRY as u64)).saturating_add(INDEX_HEADER as u64);
        if wanted > self.mapped {
            let length = file_length(file, index::FILE)?;
            // Whole pages only, so that the next segment can begin where this one ends.
            let end = length / 4096 * 4096;
            if end > self.mapped {
                let map = map_file(file, self.mapped, end - self.mapped, index::FILE)?;
                self.segments.push((self.mapped, map));
                self.mapped = end;
            }
        }
        let room = (self.mapped - INDEX_HEADER as u64) / ENTRY as u64;
        if published > room && !self.short {
            self.short = true;
            self.note(
                INDEX_HEADER as u64 + room * ENTRY as u64,
                "the index ends before its last entry",
            );
        }
        for at in self.loaded..published.min(room) {
            let byte = INDEX_HEADER as u64 + at * ENTRY as u64;
            let Some(mut entry) = self.raw_entry(at) else {
                self.note(byte, "the entry's checksum is wrong");
                continue;
            };
            let directory = self
                .directories
                .entry((entry.stream, entry.level))
                .or_default();
            if directory
                .entries
                .last()
                .is_some_and(|last| entry.first <= last.last)
            {
                self.note(byte, "the entry goes back in time");
                continue;
            }
            entry.ordinal = directory.count;
            directory.count += entry.count as u64;
            directory.stored += entry.length as u64 + ENTRY as u64;
            directory.entries.push(entry);
        }
        self.loaded = published.min(room).max(self.loaded);
        Ok(self.loaded)
    }

    fn note(&mut self, offset: u64, why: &str) {
        if self.damage.len() < 10_000 {
            self.damage.push(Damage {
                file: index::FILE.into(),
                offset,
                why: why.into(),
            });
        }
    }
}

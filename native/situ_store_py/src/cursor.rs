//! Steps through the chunks of a stream in an interval.

use std::sync::Arc;

use situ_store::format::Entry;
use situ_store::{Reader, Result};

/// The chunks of a stream from `start` to `stop`.
pub struct ChunkCursor {
    pub store: Arc<Reader>,
    stream: u32,
    /// The first and the last time (ns) of the messages to read.
    pub range: (i64, i64),
    first: u64,
    next: u64,
    end: u64,
}

impl ChunkCursor {
    /// Begins at the first chunk that ends at or after `start` (ns).
    pub fn new(
        store: Arc<Reader>,
        stream: u32,
        start: Option<i64>,
        stop: Option<i64>,
    ) -> Result<Self> {
        let count = store.message_count(stream);
        let first = match start {
            Some(time) => {
                let entry = store.entry_from(stream, time)?;
                entry.map_or(count, |entry| entry.ordinal)
            }
            None => 0,
        };
        // The chunk that contains the last message may contain earlier ones, too.
        let end = match stop.and_then(|time| time.checked_add(1)) {
            Some(after) => {
                let entry = store.entry_from(stream, after)?;
                entry.map_or(count, |entry| entry.ordinal + u64::from(entry.count))
            }
            None => count,
        };
        Ok(ChunkCursor {
            store,
            stream,
            range: (start.unwrap_or(i64::MIN), stop.unwrap_or(i64::MAX)),
            first,
            next: first,
            end,
        })
    }

    /// Returns the next chunk, or `None` after the last one.
    pub fn next_entry(&mut self) -> Result<Option<Entry>> {
        if self.next >= self.end {
            return Ok(None);
        }
        let entry = self.store.entry_at(self.stream, self.next)?;
        match entry.filter(|entry| entry.first <= self.range.1) {
            Some(entry) => {
                self.next = entry.ordinal.saturating_add(u64::from(entry.count).max(1));
                Ok(Some(entry))
            }
            None => {
                self.next = self.end;
                Ok(None)
            }
        }
    }

    /// Returns the number of messages before the next chunk.
    pub fn position(&self) -> u64 {
        self.next
    }

    /// Returns the number of messages after those that were read, at most.
    pub fn remaining(&self) -> u64 {
        self.end.saturating_sub(self.next)
    }

    /// Returns the part that was read, from 0 to 1.
    pub fn progress(&self) -> f64 {
        if self.next >= self.end {
            return 1.0;
        }
        let all = self.end.saturating_sub(self.first).max(1);
        self.next.saturating_sub(self.first) as f64 / all as f64
    }
}

//! Returns a stream's statistics without reading its messages, and checks a whole store.

use super::{Damage, Reader};
use crate::error::{Error, Result};
use crate::format::*;

/// The statistics of a stream. Times are ns.
#[derive(Debug, Clone, PartialEq)]
pub struct Statistics {
    /// The number of messages.
    pub count: u64,
    /// Originating time of the first message.
    pub first: i64,
    /// Originating time of the last message.
    pub last: i64,
    /// Creation time of the first message.
    pub first_creation: i64,
    /// Creation time of the last message.
    pub last_creation: i64,
    /// The payload bytes of all messages.
    pub size_sum: u64,
    /// The sum of the latencies (creation - originating time) of all messages.
    pub latency_sum: f64,
    /// The size of its chunks in the files, bytes.
    pub stored: u64,
    /// The number of chunks.
    pub chunks: u64,
}

impl Reader {
    /// Returns the statistics of a stream from the index and its last chunk, or `None` if it has no messages.
    pub fn read_statistics(&self, stream: u32) -> Result<Option<Statistics>> {
        let (first, last, count, stored, chunks) = {
            let index = self.lock_index();
            let Some(entries) = index.stream_entries(stream, 0) else {
                return Ok(None);
            };
            let (Some(first), Some(last)) = (entries.first(), entries.last()) else {
                return Ok(None);
            };
            (
                first,
                last,
                entries.message_count(),
                entries.stored_bytes(),
                entries.len() as u64,
            )
        };
        let mut statistics = Statistics {
            count,
            first: first.first,
            last: last.last,
            first_creation: first.first_creation,
            last_creation: last.first_creation,
            size_sum: 0,
            latency_sum: 0.0,
            stored,
            chunks,
        };
        if last.lane == LANE_LARGE {
            // The chunk has one message, and its entry contains the creation time.
            if let Ok(header) = self.read_chunk_header(&last) {
                statistics.size_sum = header.size_sum;
                statistics.latency_sum = header.latency_sum;
            }
        } else if let Ok(chunk) = self.read_chunk(&last) {
            statistics.size_sum = chunk.header.size_sum;
            statistics.latency_sum = chunk.header.latency_sum;
            if let Some(Ok((envelope, _))) = chunk.messages().last() {
                statistics.last_creation = envelope.creation;
            }
        }
        Ok(Some(statistics))
    }

    /// Checks the entries `from..from + n` and the complete contents of their chunks. Returns the damage found and
    /// the total number of entries.
    pub fn verify_entries(&self, from: u64, n: u64) -> Result<(Vec<Damage>, u64)> {
        let total = self.refresh()?;
        let mut found = Vec::new();
        for at in from..total.min(from.saturating_add(n)) {
            let Some(entry) = self.lock_index().raw_entry(at) else {
                continue;
            };
            if entry.is_placeholder() {
                continue;
            }
            let checked = self.read_checked_chunk(&entry, true).and_then(|chunk| {
                let mut messages = chunk.messages();
                messages
                    .try_for_each(|m| m.map(|_| ()))
                    .map_err(|why| self.chunk_error(&entry, why))
            });
            match checked {
                Ok(()) | Err(Error::Absent) => {}
                Err(Error::Damaged(file, offset, why)) => found.push(Damage { file, offset, why }),
                Err(Error::MissingExtent(file)) => found.push(Damage {
                    file,
                    offset: entry.offset,
                    why: "the file is missing".into(),
                }),
                Err(error) => return Err(error),
            }
        }
        Ok((found, total))
    }
}

//! Walks over the records of a file's data section, and finds the next record after an invalid one.

use mcap::records::op;

use super::chunk_records::parse_chunk_fields;
use crate::file::{FileBytes, RecordHead};
use crate::Result;

/// The maximum number of positions tried in one file, because its bytes may be crafted so that each looks like a
/// record.
const MOST_TRIED: u32 = 4_000_000;
const WINDOW: u64 = 1 << 20;
/// The number of bytes needed to recognize a record by its first fields.
const HEAD: u64 = 64;

/// A position among the top-level records of a file.
pub struct Walk {
    /// The offset of the next record.
    pub at: u64,
    /// The end of the walk.
    pub until: u64,
    tried: u32,
}

impl Walk {
    pub fn new(at: u64, until: u64) -> Self {
        Walk {
            at,
            until,
            tried: 0,
        }
    }

    /// Reads the head of the record at the current position, or returns `None` at the end.
    pub fn next_record(&self, bytes: &FileBytes) -> Result<Option<RecordHead>> {
        if self.at >= self.until {
            return Ok(None);
        }
        bytes.record_head(self.at)
    }

    /// Skips an invalid record: to its end if its length is plausible, otherwise to the next bytes that look like a
    /// record. Returns the number of skipped bytes, or `None` if no more records are found.
    pub fn skip_damage(&mut self, bytes: &FileBytes, record: RecordHead) -> Result<Option<u64>> {
        let from = self.at;
        let next = if record.opcode != 0
            && record.end() <= self.until
            && self.is_record_boundary(bytes, record.end())
        {
            Some(record.end())
        } else if record.opcode == op::CHUNK {
            // The records in an uncompressed chunk look like top-level records, so only another chunk can end
            // it.
            self.find_record(bytes, from + 9, true)?
        } else {
            self.find_record(bytes, from + 1, false)?
        };
        self.at = next.unwrap_or(self.until);
        Ok(next.map(|next| next - from))
    }

    fn is_record_boundary(&mut self, bytes: &FileBytes, at: u64) -> bool {
        at == self.until || self.valid_record(bytes, at).is_some()
    }

    /// Returns the record at `at` if it looks valid.
    fn valid_record(&mut self, bytes: &FileBytes, at: u64) -> Option<RecordHead> {
        self.tried += 1;
        let record = bytes.record_head(at).ok().flatten()?;
        let length = HEAD
            .min(record.length)
            .min(bytes.size.saturating_sub(record.body));
        let head = bytes.read(record.body, length).ok()?;
        (record.end() <= self.until && is_plausible(record, &head)).then_some(record)
    }

    fn find_record(&mut self, bytes: &FileBytes, from: u64, chunks: bool) -> Result<Option<u64>> {
        let mut start = from;
        while start + 9 <= self.until {
            let window = bytes.read(start, WINDOW.min(self.until - start))?;
            // A record's head may extend over the boundary of two windows.
            let last = window.len().saturating_sub(8);
            for i in 0..last {
                let opcode = window[i];
                let wanted = if chunks {
                    opcode == op::CHUNK
                } else {
                    (op::HEADER..=op::DATA_END).contains(&opcode)
                };
                let at = start + i as u64;
                if !wanted || at + 9 + record_length(&window[i + 1..]) > self.until {
                    continue;
                }
                if self.tried > MOST_TRIED {
                    return Ok(None);
                }
                if self.starts_chain(bytes, at) {
                    return Ok(Some(at));
                }
            }
            start += last.max(1) as u64;
        }
        Ok(None)
    }

    /// Returns whether a record at `at` is credible. A chunk is sufficient; any other record needs two more after
    /// it, or the end.
    fn starts_chain(&mut self, bytes: &FileBytes, at: u64) -> bool {
        let mut at = at;
        for _ in 0..3 {
            if at == self.until {
                return true;
            }
            match self.valid_record(bytes, at) {
                Some(record) if matches!(record.opcode, op::CHUNK | op::FOOTER) => return true,
                Some(record) => at = record.end(),
                None => return false,
            }
        }
        true
    }
}

/// Returns a record's length, at most that of the largest possible file.
fn record_length(bytes: &[u8]) -> u64 {
    let eight = bytes.get(..8).and_then(|b| b.try_into().ok());
    eight.map_or(u64::MAX, u64::from_le_bytes).min(1 << 62)
}

/// Returns whether a record's first fields agree with its length.
fn is_plausible(record: RecordHead, head: &[u8]) -> bool {
    let word = |at: usize| -> u64 {
        let four = head.get(at..at + 4).and_then(|b| b.try_into().ok());
        four.map_or(u64::MAX, |b| u64::from(u32::from_le_bytes(b)))
    };
    let text = |at: usize, others: u64| word(at).saturating_add(others) <= record.length;
    match record.opcode {
        op::HEADER | op::METADATA => text(0, 8),
        op::FOOTER => record.length >= 20,
        op::SCHEMA => head.get(..2) != Some(&[0, 0]) && text(2, 14),
        op::CHANNEL => text(4, 16),
        op::MESSAGE => record.length >= 22,
        op::CHUNK => is_plausible_chunk(record, head),
        op::MESSAGE_INDEX => text(2, 6) && word(2) % 16 == 0,
        op::CHUNK_INDEX => record.length >= 64,
        op::ATTACHMENT => text(16, 36),
        op::ATTACHMENT_INDEX => record.length >= 48,
        op::STATISTICS => record.length >= 46,
        op::METADATA_INDEX => text(16, 20),
        op::SUMMARY_OFFSET => record.length >= 17,
        op::DATA_END => record.length >= 4,
        _ => false,
    }
}

fn is_plausible_chunk(record: RecordHead, head: &[u8]) -> bool {
    let Some((data, compression, _)) = parse_chunk_fields(head) else {
        return false;
    };
    let known = matches!(compression.as_str(), "" | "lz4" | "zstd");
    let size = head.get(data - 8..data).and_then(|b| b.try_into().ok());
    let size = size.map_or(u64::MAX, u64::from_le_bytes);
    known && size.saturating_add(data as u64) <= record.length
}

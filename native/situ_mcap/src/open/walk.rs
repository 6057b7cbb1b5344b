//! The records of a file's data section, one after the other, and where the next one is after one that makes no sense.

use mcap::records::op;

use super::unpacked::promise;
use crate::file::{Bytes, Place};
use crate::Result;

/// No more places are tried in one file: its bytes may be made so that each looks like a record.
const MOST_TRIED: u32 = 4_000_000;
const WINDOW: u64 = 1 << 20;
/// Enough to recognize a record by its first fields.
const HEAD: u64 = 64;

/// A position among the top-level records of a file.
pub struct Walk {
    /// Where the next record begins.
    pub at: u64,
    /// Where the walk ends.
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

    /// The record at the current position, or `None` at the end.
    pub fn place(&self, bytes: &Bytes) -> Result<Option<Place>> {
        if self.at >= self.until {
            return Ok(None);
        }
        bytes.place(self.at)
    }

    /// Passes over a record that makes no sense: to its end where its length is believable, else to the next bytes
    /// that look like a record. Returns how many bytes were passed over, or `None` where nothing more is found.
    pub fn pass(&mut self, bytes: &Bytes, place: Place) -> Result<Option<u64>> {
        let from = self.at;
        let next =
            if place.opcode != 0 && place.end() <= self.until && self.fits(bytes, place.end()) {
                Some(place.end())
            } else if place.opcode == op::CHUNK {
                // The records within a chunk that is not compressed look like top-level ones: only a chunk ends it.
                self.search(bytes, from + 9, true)?
            } else {
                self.search(bytes, from + 1, false)?
            };
        self.at = next.unwrap_or(self.until);
        Ok(next.map(|next| next - from))
    }

    fn fits(&mut self, bytes: &Bytes, at: u64) -> bool {
        at == self.until || self.record(bytes, at).is_some()
    }

    /// The record at `at` if it looks like one.
    fn record(&mut self, bytes: &Bytes, at: u64) -> Option<Place> {
        self.tried += 1;
        let place = bytes.place(at).ok().flatten()?;
        let length = HEAD
            .min(place.length)
            .min(bytes.size.saturating_sub(place.body));
        let head = bytes.read(place.body, length).ok()?;
        (place.end() <= self.until && sound(place, &head)).then_some(place)
    }

    fn search(&mut self, bytes: &Bytes, from: u64, chunks: bool) -> Result<Option<u64>> {
        let mut start = from;
        while start + 9 <= self.until {
            let window = bytes.read(start, WINDOW.min(self.until - start))?;
            // A record's head may lie across the border of two windows.
            let last = window.len().saturating_sub(8);
            for i in 0..last {
                let opcode = window[i];
                let wanted = if chunks {
                    opcode == op::CHUNK
                } else {
                    (op::HEADER..=op::DATA_END).contains(&opcode)
                };
                let at = start + i as u64;
                if !wanted || at + 9 + length(&window[i + 1..]) > self.until {
                    continue;
                }
                if self.tried > MOST_TRIED {
                    return Ok(None);
                }
                if self.chain(bytes, at) {
                    return Ok(Some(at));
                }
            }
            start += last.max(1) as u64;
        }
        Ok(None)
    }

    /// A chunk proves itself; any other record needs two more after it, or the end.
    fn chain(&mut self, bytes: &Bytes, at: u64) -> bool {
        let mut at = at;
        for _ in 0..3 {
            if at == self.until {
                return true;
            }
            match self.record(bytes, at) {
                Some(place) if matches!(place.opcode, op::CHUNK | op::FOOTER) => return true,
                Some(place) => at = place.end(),
                None => return false,
            }
        }
        true
    }
}

/// A record's length, at most the length of the largest file.
fn length(bytes: &[u8]) -> u64 {
    let eight = bytes.get(..8).and_then(|b| b.try_into().ok());
    eight.map_or(u64::MAX, u64::from_le_bytes).min(1 << 62)
}

/// Whether a record's first fields agree with its length.
fn sound(place: Place, head: &[u8]) -> bool {
    let word = |at: usize| -> u64 {
        let four = head.get(at..at + 4).and_then(|b| b.try_into().ok());
        four.map_or(u64::MAX, |b| u64::from(u32::from_le_bytes(b)))
    };
    let text = |at: usize, others: u64| word(at).saturating_add(others) <= place.length;
    match place.opcode {
        op::HEADER | op::METADATA => text(0, 8),
        op::FOOTER => place.length >= 20,
        op::SCHEMA => head.get(..2) != Some(&[0, 0]) && text(2, 14),
        op::CHANNEL => text(4, 16),
        op::MESSAGE => place.length >= 22,
        op::CHUNK => chunk(place, head),
        op::MESSAGE_INDEX => text(2, 6) && word(2) % 16 == 0,
        op::CHUNK_INDEX => place.length >= 64,
        op::ATTACHMENT => text(16, 36),
        op::ATTACHMENT_INDEX => place.length >= 48,
        op::STATISTICS => place.length >= 46,
        op::METADATA_INDEX => text(16, 20),
        op::SUMMARY_OFFSET => place.length >= 17,
        op::DATA_END => place.length >= 4,
        _ => false,
    }
}

fn chunk(place: Place, head: &[u8]) -> bool {
    let Some((data, compression, _)) = promise(head) else {
        return false;
    };
    let known = matches!(compression.as_str(), "" | "lz4" | "zstd");
    let size = head.get(data - 8..data).and_then(|b| b.try_into().ok());
    let size = size.map_or(u64::MAX, u64::from_le_bytes);
    known && size.saturating_add(data as u64) <= place.length
}

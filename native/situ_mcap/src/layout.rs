//! Describes the structure of a file: its chunks, and the size of each channel's messages.

use std::collections::BTreeMap;

use mcap::records::{op, Record};

use crate::chunk::Records;
use crate::file::parse_record;
use crate::{Reader, Result};

/// A chunk: messages that are compressed together.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Chunk {
    /// Its offset in the file, bytes.
    pub offset: u64,
    /// The size of its record, bytes.
    pub length: u64,
    /// Its compression; empty if it is not compressed.
    pub compression: String,
    /// The size of its compressed data, bytes.
    pub packed: u64,
    /// The size of its unpacked data, bytes.
    pub unpacked: u64,
    /// The time of its first message, ns.
    pub start: u64,
    /// The time of its last message, ns.
    pub end: u64,
}

impl Reader {
    /// Returns the chunks in file order.
    pub fn chunks(&self) -> Vec<Chunk> {
        let chunks = self.contents.chunks.iter().map(|c| Chunk {
            offset: c.offset,
            length: c.length,
            compression: c.compression.clone(),
            packed: c.packed,
            unpacked: c.unpacked,
            start: c.start,
            end: c.end,
        });
        chunks.collect()
    }

    /// Returns the size of the messages' data of every channel in a chunk, or `None` after the last chunk.
    pub fn channel_sizes(&self, number: u32) -> Result<Option<BTreeMap<u16, u64>>> {
        if number as usize >= self.contents.chunks.len() {
            return Ok(None);
        }
        let records = self.unpacked_chunk(number)?;
        let mut sizes = BTreeMap::new();
        for (opcode, at, body) in Records::new(&records) {
            if opcode == op::MESSAGE {
                if let Record::Message { header, data } = parse_record(opcode, body, at)? {
                    *sizes.entry(header.channel_id).or_insert(0) += data.len() as u64;
                }
            }
        }
        Ok(Some(sizes))
    }
}

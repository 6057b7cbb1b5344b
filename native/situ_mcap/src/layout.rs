//! How a file is built: its chunks, and how many bytes each channel takes.

use std::collections::BTreeMap;

use mcap::records::{op, Record};

use crate::chunk::Records;
use crate::file::parse;
use crate::{Reader, Result};

/// A chunk: some seconds of messages, compressed together.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Chunk {
    /// Where it lies.
    pub offset: u64,
    /// Its record's bytes.
    pub length: u64,
    /// How it is compressed; empty: not at all.
    pub compression: String,
    /// The bytes of its data, compressed.
    pub packed: u64,
    /// And not.
    pub unpacked: u64,
    /// The time of its first message, ns.
    pub start: u64,
    /// The time of its last message, ns.
    pub end: u64,
}

impl Reader {
    /// Its chunks, in the order of the file.
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

    /// The bytes of the messages' data of every channel in a chunk: of the `number`th, `None` behind the last.
    pub fn sizes(&self, number: u32) -> Result<Option<BTreeMap<u16, u64>>> {
        if number as usize >= self.contents.chunks.len() {
            return Ok(None);
        }
        let records = self.chunk(number)?;
        let mut sizes = BTreeMap::new();
        for (opcode, at, body) in Records::new(&records) {
            if opcode == op::MESSAGE {
                if let Record::Message { header, data } = parse(opcode, body, at)? {
                    *sizes.entry(header.channel_id).or_insert(0) += data.len() as u64;
                }
            }
        }
        Ok(Some(sizes))
    }
}

//! Reads the messages of a chunk.

use super::{Envelope, Value};
use crate::format::*;
use crate::varint::Cursor;

/// An iterator over the messages of a chunk, in order. It ends with an error when the body contradicts itself.
pub struct Messages<'a> {
    body: &'a [u8],
    encoding: Encoding,
    table: Cursor<'a>,
    payload_at: usize,
    previous: Envelope,
    latency: i64,
    left: u32,
    end: i64,
    started: bool,
}

impl<'a> Messages<'a> {
    /// Iterates over the messages of a chunk with this header and raw body.
    pub fn new(header: &ChunkHeader, body: &'a [u8]) -> Self {
        let table_end = (header.table_length as usize).min(body.len());
        Self::with_table(header, body, &body[..table_end])
    }

    /// Iterates like `new`, but takes the table from a separate buffer and does not read it from the body.
    pub fn with_table(header: &ChunkHeader, body: &'a [u8], table: &'a [u8]) -> Self {
        let table_end = table.len();
        Messages {
            body,
            encoding: header.encoding,
            table: Cursor::new(table),
            payload_at: table_end,
            previous: Envelope {
                sequence: header.first_sequence.wrapping_sub(1),
                time: header.first,
                creation: header.first_creation,
            },
            latency: header.first_creation.wrapping_sub(header.first),
            left: if header.encoding.is_pyramid() {
                0
            } else {
                header.count
            },
            end: header.last,
            started: false,
        }
    }

    fn read_message(&mut self) -> Option<(Envelope, Value)> {
        let step = self.table.next_signed()?;
        let delta = self.table.next_varint()?;
        let latency_delta = self.table.next_signed()?;
        if self.started == (delta == 0) {
            return None;
        }
        self.started = true;
        let time = self.previous.time.checked_add_unsigned(delta)?;
        if time > self.end {
            return None;
        }
        self.latency = self.latency.wrapping_add(latency_delta);
        let envelope = Envelope {
            sequence: self
                .previous
                .sequence
                .wrapping_add(step as u64)
                .wrapping_add(1),
            time,
            creation: time.wrapping_add(self.latency),
        };
        let at = self.payload_at;
        let value = match self.encoding {
            Encoding::Int => {
                let mut cursor = Cursor::new(self.body);
                cursor.at = at;
                let value = cursor.next_signed()?;
                self.payload_at = cursor.at;
                Value::Int(value)
            }
            Encoding::Float => {
                self.payload_at = at + 8;
                Value::Float(f64_at(self.body.get(at..at + 8)?, 0))
            }
            Encoding::Bool => {
                self.payload_at = at + 1;
                Value::Bool(*self.body.get(at).filter(|byte| **byte < 3)?)
            }
            Encoding::Bytes | Encoding::Term | Encoding::Codec => {
                let length = usize::try_from(self.table.next_varint()?).ok()?;
                let end = at
                    .checked_add(length)
                    .filter(|end| *end <= self.body.len())?;
                self.payload_at = end;
                Value::Bytes { start: at, length }
            }
            Encoding::Bins | Encoding::Tracks => return None,
        };
        self.previous = envelope;
        Some((envelope, value))
    }
}

impl Iterator for Messages<'_> {
    type Item = std::result::Result<(Envelope, Value), &'static str>;

    #[inline]
    fn next(&mut self) -> Option<Self::Item> {
        if self.left == 0 {
            return None;
        }
        self.left -= 1;
        match self.read_message() {
            Some(item) => Some(Ok(item)),
            None => {
                self.left = 0;
                Some(Err("the chunk's table contradicts its body"))
            }
        }
    }
}

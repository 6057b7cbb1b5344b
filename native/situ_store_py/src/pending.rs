//! The messages of one stream that wait for the next commit.

use situ_store::chunk::{Envelope, Input};
use situ_store::format::{LARGE_MESSAGE, MAX_CHUNK_MESSAGES};
use situ_store::{Encoding, Error, Result, Writer};

/// The payload bytes after which waiting messages are committed.
const BATCH_BYTES: usize = 64 << 10;

/// A message: its times (ns), and its number or the length of its bytes.
struct Row {
    time: i64,
    creation: i64,
    value: u64,
}

/// The waiting messages of one stream, all of one encoding.
pub struct Pending {
    stream: u32,
    kind: (Encoding, u16),
    rows: Vec<Row>,
    bytes: Vec<u8>,
    last: Option<i64>,
}

impl Pending {
    pub fn new(stream: u32) -> Self {
        Pending {
            stream,
            kind: (Encoding::Int, 0),
            rows: Vec::new(),
            bytes: Vec::new(),
            last: None,
        }
    }

    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// Returns whether the waiting messages have to be committed before a message of this kind and size is added.
    pub fn is_full_for(&self, kind: (Encoding, u16), size: usize) -> bool {
        let is_other = self.kind != kind || size >= LARGE_MESSAGE;
        let is_full =
            self.rows.len() >= MAX_CHUNK_MESSAGES as usize || self.bytes.len() >= BATCH_BYTES;
        !self.rows.is_empty() && (is_other || is_full)
    }

    /// Checks that a message is later than the last one, and makes its time the last one.
    pub fn advance(&mut self, time: i64) -> Result<()> {
        match self.last {
            Some(last) if time <= last => Err(Error::NotIncreasing(self.stream, last, time)),
            _ => {
                self.last = Some(time);
                Ok(())
            }
        }
    }

    /// Adds a message.
    pub fn push(&mut self, kind: (Encoding, u16), time: i64, creation: i64, input: Input<'_>) {
        self.kind = kind;
        let value = match input {
            Input::Int(value) => value as u64,
            Input::Float(value) => value.to_bits(),
            Input::Bool(value) => value.into(),
            Input::Bytes(bytes) => {
                self.bytes.extend_from_slice(bytes);
                bytes.len() as u64
            }
            Input::Parts(parts) => {
                parts
                    .iter()
                    .for_each(|part| self.bytes.extend_from_slice(part));
                input.byte_size() as u64
            }
        };
        self.rows.push(Row {
            time,
            creation,
            value,
        });
    }

    /// Adds the messages to the writer's current commit. They keep waiting until `clear`.
    pub fn push_to(&self, writer: &mut Writer) -> Result<()> {
        let (mut at, (encoding, codec)) = (0, self.kind);
        let (_, count) = writer.stream_position(self.stream).unwrap_or_default();
        for (sequence, row) in (count + 1..).zip(&self.rows) {
            let input = match encoding {
                Encoding::Int => Input::Int(row.value as i64),
                Encoding::Float => Input::Float(f64::from_bits(row.value)),
                Encoding::Bool => Input::Bool(row.value as u8),
                _ => {
                    let start = at;
                    at += row.value as usize;
                    Input::Bytes(self.bytes.get(start..at).unwrap_or_default())
                }
            };
            let envelope = Envelope {
                sequence,
                time: row.time,
                creation: row.creation,
            };
            writer.push(self.stream, envelope, encoding, codec, input)?;
        }
        Ok(())
    }

    /// Drops the messages after their commit.
    pub fn clear(&mut self) {
        self.rows.clear();
        self.bytes.clear();
    }
}

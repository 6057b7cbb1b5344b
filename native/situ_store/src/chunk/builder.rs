//! Builds chunks.

use super::{Envelope, Input};
use crate::format::*;
use crate::varint;

/// Collects messages of one stream and one encoding into the table and payload of a chunk.
#[derive(Debug)]
pub struct Builder {
    /// The table built so far.
    pub table: Vec<u8>,
    /// The payloads collected so far.
    pub payload: Vec<u8>,
    /// The stream's number.
    pub stream: u32,
    /// The encoding of all its messages.
    pub encoding: Encoding,
    /// The codec's number for [`Encoding::Codec`], else 0.
    pub codec: u16,
    /// The number of messages in the chunk.
    pub count: u32,
    /// The envelope of the first message.
    pub first: Envelope,
    /// The envelope of the last message.
    pub last: Envelope,
}

const EMPTY_ENVELOPE: Envelope = Envelope {
    sequence: 0,
    time: 0,
    creation: 0,
};

impl Default for Builder {
    fn default() -> Self {
        Builder {
            table: Vec::with_capacity(8 * 1024),
            payload: Vec::with_capacity(MAX_CHUNK_PAYLOAD + LARGE_MESSAGE),
            stream: 0,
            encoding: Encoding::Bytes,
            codec: 0,
            count: 0,
            first: EMPTY_ENVELOPE,
            last: EMPTY_ENVELOPE,
        }
    }
}

impl Builder {
    /// Clears the builder and starts a new chunk.
    pub fn start(&mut self, stream: u32, encoding: Encoding, codec: u16) {
        self.table.clear();
        self.payload.clear();
        self.stream = stream;
        self.encoding = encoding;
        self.codec = codec;
        self.count = 0;
    }

    /// Returns whether a message of `size` bytes still fits into this chunk.
    pub fn accepts(&self, stream: u32, encoding: Encoding, codec: u16, size: usize) -> bool {
        self.stream == stream
            && self.encoding == encoding
            && self.codec == codec
            && self.count < MAX_CHUNK_MESSAGES
            && self.payload.len() + size <= MAX_CHUNK_PAYLOAD
    }

    /// Adds the table row of a message whose payload is stored elsewhere.
    pub fn push_envelope(&mut self, envelope: Envelope, size: usize) {
        let latency = envelope.creation.wrapping_sub(envelope.time);
        let (previous, previous_latency) = if self.count == 0 {
            self.first = envelope;
            (
                Envelope {
                    sequence: envelope.sequence.wrapping_sub(1),
                    ..envelope
                },
                latency,
            )
        } else {
            (self.last, self.last.creation.wrapping_sub(self.last.time))
        };
        let step = envelope
            .sequence
            .wrapping_sub(previous.sequence)
            .wrapping_sub(1) as i64;
        varint::put_signed(&mut self.table, step);
        varint::put(
            &mut self.table,
            envelope.time.wrapping_sub(previous.time) as u64,
        );
        varint::put_signed(&mut self.table, latency.wrapping_sub(previous_latency));
        if self.encoding.has_lengths() {
            varint::put(&mut self.table, size as u64);
        }
        self.last = envelope;
        self.count += 1;
    }

    /// Adds a message: its table row and its payload.
    pub fn push(&mut self, envelope: Envelope, input: Input<'_>) {
        let before = self.payload.len();
        match input {
            Input::Int(value) => varint::put_signed(&mut self.payload, value),
            Input::Float(value) => self
                .payload
                .extend_from_slice(&value.to_bits().to_le_bytes()),
            Input::Bool(value) => self.payload.push(value),
            Input::Bytes(bytes) => self.payload.extend_from_slice(bytes),
            Input::Parts(parts) => parts
                .iter()
                .for_each(|part| self.payload.extend_from_slice(part)),
        }
        let size = self.payload.len() - before;
        self.push_envelope(envelope, size);
    }
}

//! Building and reading chunks: one or more messages of one stream, checked as one.

use crate::error::{Error, Result};
use crate::format::*;
use crate::varint::{self, Cursor};

/// A message's payload as it is handed in.
#[derive(Debug, Clone, Copy)]
pub enum Input<'a> {
    Int(i64),
    Float(f64),
    /// 0 false, 1 true, 2 nil.
    Bool(u8),
    Bytes(&'a [u8]),
    Parts(&'a [&'a [u8]]),
}

impl Input<'_> {
    pub fn byte_size(&self) -> usize {
        match self {
            Input::Int(value) => (64 - varint::zigzag(*value).leading_zeros() as usize)
                .div_ceil(7)
                .max(1),
            Input::Float(_) => 8,
            Input::Bool(_) => 1,
            Input::Bytes(bytes) => bytes.len(),
            Input::Parts(parts) => parts.iter().map(|part| part.len()).sum(),
        }
    }

    /// The number drawn for it, where there is one.
    pub fn number(&self) -> Option<f64> {
        match self {
            Input::Int(value) => Some(*value as f64),
            Input::Float(value) => Some(*value),
            Input::Bool(value) if *value < 2 => Some(*value as f64),
            _ => None,
        }
    }
}

/// The number that an external term is, if it is one (numbers and truths among other terms of a stream).
pub fn term_number(bytes: &[u8]) -> Option<f64> {
    match *bytes {
        // Atoms as older and as newer systems write them.
        [131, 100, 0, 4, b't', b'r', b'u', b'e'] | [131, 119, 4, b't', b'r', b'u', b'e'] => {
            Some(1.0)
        }
        [131, 100, 0, 5, b'f', b'a', b'l', b's', b'e']
        | [131, 119, 5, b'f', b'a', b'l', b's', b'e'] => Some(0.0),
        [131, 97, n] => Some(n as f64),
        [131, 98, a, b, c, d] => Some(i32::from_be_bytes([a, b, c, d]) as f64),
        [131, 70, a, b, c, d, e, f, g, h] => Some(f64::from_be_bytes([a, b, c, d, e, f, g, h])),
        [131, 110, n @ 1..=8, sign, ref digits @ ..] if digits.len() == n as usize => {
            let size = digits
                .iter()
                .rev()
                .fold(0.0, |sum, digit| sum * 256.0 + *digit as f64);
            Some(if sign == 0 { size } else { -size })
        }
        _ => None,
    }
}

/// What of a message is not payload.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Envelope {
    pub sequence: u64,
    pub time: i64,
    pub creation: i64,
}

/// Collects messages of one stream and one encoding into the table and payload of a chunk.
#[derive(Debug)]
pub struct Builder {
    pub table: Vec<u8>,
    pub payload: Vec<u8>,
    pub stream: u32,
    pub encoding: Encoding,
    pub codec: u16,
    pub count: u32,
    pub first: Envelope,
    pub last: Envelope,
}

const NOWHERE: Envelope = Envelope {
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
            first: NOWHERE,
            last: NOWHERE,
        }
    }
}

impl Builder {
    pub fn start(&mut self, stream: u32, encoding: Encoding, codec: u16) {
        self.table.clear();
        self.payload.clear();
        self.stream = stream;
        self.encoding = encoding;
        self.codec = codec;
        self.count = 0;
    }

    /// Whether a message of `size` bytes still goes into this chunk.
    pub fn accepts(&self, stream: u32, encoding: Encoding, codec: u16, size: usize) -> bool {
        self.stream == stream
            && self.encoding == encoding
            && self.codec == codec
            && self.count < MAX_CHUNK_MESSAGES
            && self.payload.len() + size <= MAX_CHUNK_PAYLOAD
    }

    /// The table's line for a message; the payload goes elsewhere.
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

/// The compressed body, or `None` when compressing gains nothing.
pub fn compress(compression: Compression, table: &[u8], payload: &[u8]) -> Result<Option<Vec<u8>>> {
    if compression == Compression::None || table.len() + payload.len() < 64 {
        return Ok(None);
    }
    let mut raw = Vec::with_capacity(table.len() + payload.len());
    raw.extend_from_slice(table);
    raw.extend_from_slice(payload);
    let packed = match compression {
        Compression::None => return Ok(None),
        Compression::Lz4 => lz4_flex::block::compress(&raw),
        Compression::Zstd => zstd::bulk::compress(&raw, 3).map_err(|e| Error::io("compress", e))?,
    };
    Ok((packed.len() < raw.len()).then_some(packed))
}

/// The raw body of a chunk: a view into the map, or what decompression gave.
#[derive(Debug)]
pub enum Body<'a> {
    Mapped(&'a [u8]),
    Unpacked(Vec<u8>),
}

impl Body<'_> {
    pub fn bytes(&self) -> &[u8] {
        match self {
            Body::Mapped(bytes) => bytes,
            Body::Unpacked(bytes) => bytes,
        }
    }
}

/// Checks the stored body of the chunk that `bytes` begin with (unless `trust_body`) and unpacks it, to at most
/// `most` bytes.
pub fn open<'a>(
    header: &ChunkHeader,
    bytes: &'a [u8],
    trust_body: bool,
    most: usize,
) -> std::result::Result<Body<'a>, &'static str> {
    let stored = bytes
        .get(header.size()..header.length as usize)
        .ok_or("the chunk does not end in its extent")?;
    if !trust_body && crc32c::crc32c(&stored[header.covered()..]) != header.body_crc {
        return Err("the chunk's checksum is wrong");
    }
    let raw_length = header.raw_length as usize;
    if header.compression != Compression::None && raw_length > most {
        return Err("the chunk unpacks to more bytes than are allowed");
    }
    match header.compression {
        Compression::None => Ok(Body::Mapped(stored)),
        Compression::Lz4 => {
            // An LZ4 block cannot grow more than 255-fold.
            if raw_length > stored.len().saturating_mul(255).saturating_add(64) {
                return Err("the chunk says it unpacks to more than it can");
            }
            let raw = lz4_flex::block::decompress(stored, raw_length)
                .map_err(|_| "the chunk does not unpack")?;
            if raw.len() == raw_length {
                Ok(Body::Unpacked(raw))
            } else {
                Err("the chunk unpacks to another length")
            }
        }
        Compression::Zstd => {
            let raw = zstd::bulk::decompress(stored, raw_length)
                .map_err(|_| "the chunk does not unpack")?;
            if raw.len() == raw_length {
                Ok(Body::Unpacked(raw))
            } else {
                Err("the chunk unpacks to another length")
            }
        }
    }
}

/// A message's payload as it is read: where it lies in the raw body, or the value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Value {
    Int(i64),
    Float(f64),
    Bool(u8),
    Bytes { start: usize, length: usize },
}

impl Value {
    pub fn number(&self) -> Option<f64> {
        match self {
            Value::Int(value) => Some(*value as f64),
            Value::Float(value) => Some(*value),
            Value::Bool(value) if *value < 2 => Some(*value as f64),
            _ => None,
        }
    }
}

/// The messages of a chunk, in order. Ends early (and says so by `whole`) when the body contradicts itself.
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
    pub fn new(header: &ChunkHeader, body: &'a [u8]) -> Self {
        let table_end = (header.table_length as usize).min(body.len());
        Self::with_table(header, body, &body[..table_end])
    }

    /// As `new`, with the table that the body begins with from elsewhere: the body is not looked at for it.
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

    fn read(&mut self) -> Option<(Envelope, Value)> {
        let step = self.table.signed()?;
        let delta = self.table.varint()?;
        let latency_delta = self.table.signed()?;
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
                let value = cursor.signed()?;
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
                let length = usize::try_from(self.table.varint()?).ok()?;
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
        match self.read() {
            Some(item) => Some(Ok(item)),
            None => {
                self.left = 0;
                Some(Err("the chunk's table contradicts its body"))
            }
        }
    }
}

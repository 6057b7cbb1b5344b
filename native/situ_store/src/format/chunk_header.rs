//! The header of a chunk: its stream, its contents, and its checksums.

use super::{
    f64_at, i64_at, put_bytes, u32_at, u64_at, Compression, Encoding, CHUNK_HEADER, CHUNK_HEADER_1,
    CHUNK_MAGIC, CHUNK_MAGIC_1, MAX_CHUNK_PAYLOAD, MAX_MESSAGE, TRACKS,
};

/// The header of a chunk. `priv/schema/store.md` describes its layout.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChunkHeader {
    /// The size of the header and the stored body, bytes.
    pub length: u32,
    /// The stream's number.
    pub stream: u32,
    /// 0 for messages; higher levels contain bins, see [`Entry::level`](super::Entry::level).
    pub level: u8,
    /// The encoding of the payloads.
    pub encoding: Encoding,
    /// The compression of the body.
    pub compression: Compression,
    /// The number of messages or bins in the chunk.
    pub count: u32,
    /// The ordinal of the first message or bin at the time of writing; a later repair may have changed it.
    pub ordinal: u64,
    /// Originating time of the first message (start of the first bin), ns.
    pub first: i64,
    /// Originating time of the last message (start of the last bin), ns.
    pub last: i64,
    /// Sequence id of the first message.
    pub first_sequence: u64,
    /// Creation time of the first message, ns.
    pub first_creation: i64,
    /// The payload bytes of the stream up to and including this chunk.
    pub size_sum: u64,
    /// The sum of the stream's latencies (creation - originating time, ns) up to and including this chunk.
    pub latency_sum: f64,
    /// The size of the body before compression, bytes.
    pub raw_length: u32,
    /// The size of the table at the start of the raw body, bytes.
    pub table_length: u32,
    /// The codec's number for [`Encoding::Codec`], else 0.
    pub codec: u16,
    /// CRC-32C of the stored body, except for the part that the header's checksum covers.
    pub body_crc: u32,
    /// The number of the chunk's entry in the index; `None` in version 1.
    pub number: Option<u64>,
    /// The number of entries that were committed when the chunk was written; the writer had acknowledged their
    /// chunks.
    pub committed: u64,
}

impl ChunkHeader {
    /// Returns the size of the header in bytes.
    pub fn header_size(&self) -> usize {
        if self.number.is_some() {
            CHUNK_HEADER
        } else {
            CHUNK_HEADER_1
        }
    }

    /// Encodes the header. Its checksum also covers `table`.
    pub fn encode(&self, table: &[u8]) -> [u8; CHUNK_HEADER] {
        let mut bytes = [0; CHUNK_HEADER];
        put_bytes(&mut bytes, 0, &CHUNK_MAGIC.to_le_bytes());
        put_bytes(&mut bytes, 8, &self.length.to_le_bytes());
        put_bytes(&mut bytes, 12, &self.stream.to_le_bytes());
        bytes[16] = self.level;
        bytes[17] = self.encoding as u8;
        bytes[18] = self.compression as u8;
        put_bytes(&mut bytes, 20, &self.count.to_le_bytes());
        put_bytes(&mut bytes, 24, &self.ordinal.to_le_bytes());
        put_bytes(&mut bytes, 32, &self.first.to_le_bytes());
        put_bytes(&mut bytes, 40, &self.last.to_le_bytes());
        put_bytes(&mut bytes, 48, &self.first_sequence.to_le_bytes());
        put_bytes(&mut bytes, 56, &self.first_creation.to_le_bytes());
        put_bytes(&mut bytes, 64, &self.size_sum.to_le_bytes());
        put_bytes(&mut bytes, 72, &self.latency_sum.to_bits().to_le_bytes());
        put_bytes(&mut bytes, 80, &self.raw_length.to_le_bytes());
        put_bytes(&mut bytes, 84, &self.table_length.to_le_bytes());
        put_bytes(&mut bytes, 88, &self.codec.to_le_bytes());
        put_bytes(&mut bytes, 92, &self.body_crc.to_le_bytes());
        put_bytes(
            &mut bytes,
            96,
            &self.number.unwrap_or(u64::MAX).to_le_bytes(),
        );
        put_bytes(&mut bytes, 104, &self.committed.to_le_bytes());
        let crc = crc32c::crc32c_append(crc32c::crc32c(&bytes[8..]), table);
        put_bytes(&mut bytes, 4, &crc.to_le_bytes());
        bytes
    }

    /// Parses and checks the header of the chunk at the start of `bytes`, which may continue after the chunk.
    pub fn decode(bytes: &[u8]) -> std::result::Result<Self, &'static str> {
        Self::decode_head(bytes, bytes.len() as u64)
    }

    /// Parses and checks the header like `decode`, from a prefix of the chunk that contains the header and the
    /// table it covers. `space` is the number of bytes to the end of the extent.
    pub fn decode_head(bytes: &[u8], space: u64) -> std::result::Result<Self, &'static str> {
        let size = match bytes.get(..4).map(|magic| u32_at(magic, 0)) {
            Some(CHUNK_MAGIC) => CHUNK_HEADER,
            Some(CHUNK_MAGIC_1) => CHUNK_HEADER_1,
            _ => return Err("no chunk begins here"),
        };
        if bytes.len() < size {
            return Err("no chunk begins here");
        }
        let second = size == CHUNK_HEADER;
        let header = ChunkHeader {
            length: u32_at(bytes, 8),
            stream: u32_at(bytes, 12),
            level: bytes[16],
            encoding: Encoding::from_u8(bytes[17]).ok_or("unknown encoding")?,
            compression: Compression::from_u8(bytes[18]).ok_or("unknown compression")?,
            count: u32_at(bytes, 20),
            ordinal: u64_at(bytes, 24),
            first: i64_at(bytes, 32),
            last: i64_at(bytes, 40),
            first_sequence: u64_at(bytes, 48),
            first_creation: i64_at(bytes, 56),
            size_sum: u64_at(bytes, 64),
            latency_sum: f64_at(bytes, 72),
            raw_length: u32_at(bytes, 80),
            table_length: u32_at(bytes, 84),
            codec: u32_at(bytes, 88) as u16,
            body_crc: u32_at(bytes, 92),
            number: second.then(|| u64_at(bytes, 96)),
            committed: if second { u64_at(bytes, 104) } else { 0 },
        };
        let length = header.length as usize;
        if length < size || length as u64 > space {
            return Err("the chunk does not end in its extent");
        }
        let stored = length - size;
        let covered = if header.compression == Compression::None {
            header.table_length as usize
        } else {
            0
        };
        if covered > stored
            || header.table_length > header.raw_length
            || (header.compression == Compression::None && stored != header.raw_length as usize)
            || header.raw_length as usize > MAX_MESSAGE + MAX_CHUNK_PAYLOAD
        {
            return Err("the chunk's lengths contradict each other");
        }
        let kind = match header.level {
            0 => !header.encoding.is_pyramid(),
            level if level > TRACKS => header.encoding == Encoding::Tracks,
            _ => header.encoding == Encoding::Bins,
        };
        if !kind {
            return Err("messages are at level 0, bins above it");
        }
        let covered = bytes
            .get(8..size + covered)
            .ok_or("the chunk's table was not read")?;
        if crc32c::crc32c(covered) != u32_at(bytes, 4) {
            return Err("the chunk header's checksum is wrong");
        }
        Ok(header)
    }

    /// Returns the number of bytes of the stored body that the header's checksum covers.
    pub fn covered_size(&self) -> usize {
        if self.compression == Compression::None {
            self.table_length as usize
        } else {
            0
        }
    }
}

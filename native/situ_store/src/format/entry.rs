//! The index entry of a chunk.

use super::{i64_at, put_bytes, u32_at, u64_at, CHUNK_HEADER_1, ENTRY, PLACEHOLDER, TRACKS};

/// An index entry: the location of a chunk and a summary of its messages.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Entry {
    /// The stream's number.
    pub stream: u32,
    /// 0 for messages; 1 to 62 for bins of 2^level ns of the signal; 65 to 126 for bins of 2^(level - 64) ns of the
    /// tracks; [`PLACEHOLDER`] if the entry is a placeholder.
    pub level: u8,
    /// [`LANE_DATA`](super::LANE_DATA) or [`LANE_LARGE`](super::LANE_LARGE).
    pub lane: u8,
    /// The number of the extent within its lane.
    pub extent: u32,
    /// The offset of the chunk in its extent file, bytes.
    pub offset: u64,
    /// The size of the chunk, bytes.
    pub length: u32,
    /// The number of messages or bins in the chunk.
    pub count: u32,
    /// The ordinal of the first message or bin, counted per stream and level.
    pub ordinal: u64,
    /// Originating time of the first message (start of the first bin), ns.
    pub first: i64,
    /// Originating time of the last message (start of the last bin), ns.
    pub last: i64,
    /// Creation time of the first message, ns.
    pub first_creation: i64,
}

impl Entry {
    /// Encodes the entry with its checksum.
    pub fn encode(&self) -> [u8; ENTRY] {
        let mut bytes = [0; ENTRY];
        put_bytes(&mut bytes, 4, &self.stream.to_le_bytes());
        bytes[8] = self.level;
        bytes[9] = self.lane;
        put_bytes(&mut bytes, 12, &self.extent.to_le_bytes());
        put_bytes(&mut bytes, 16, &self.offset.to_le_bytes());
        put_bytes(&mut bytes, 24, &self.length.to_le_bytes());
        put_bytes(&mut bytes, 28, &self.count.to_le_bytes());
        put_bytes(&mut bytes, 32, &self.ordinal.to_le_bytes());
        put_bytes(&mut bytes, 40, &self.first.to_le_bytes());
        put_bytes(&mut bytes, 48, &self.last.to_le_bytes());
        put_bytes(&mut bytes, 56, &self.first_creation.to_le_bytes());
        let crc = crc32c::crc32c(&bytes[4..]);
        put_bytes(&mut bytes, 0, &crc.to_le_bytes());
        bytes
    }
    /// Parses the entry at the start of `bytes`. Returns `None` if its checksum is wrong or its fields are
    /// impossible.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        if bytes.len() < ENTRY || crc32c::crc32c(&bytes[4..ENTRY]) != u32_at(bytes, 0) {
            return None;
        }
        let entry = Entry {
            stream: u32_at(bytes, 4),
            level: bytes[8],
            lane: bytes[9],
            extent: u32_at(bytes, 12),
            offset: u64_at(bytes, 16),
            length: u32_at(bytes, 24),
            count: u32_at(bytes, 28),
            ordinal: u64_at(bytes, 32),
            first: i64_at(bytes, 40),
            last: i64_at(bytes, 48),
            first_creation: i64_at(bytes, 56),
        };
        let level = entry.level < 63 || (TRACKS + 1..TRACKS + 63).contains(&entry.level);
        let sane = entry.count > 0
            && entry.first <= entry.last
            && entry.lane <= 1
            && level
            && entry.length as usize >= CHUNK_HEADER_1;
        (sane || entry.is_placeholder()).then_some(entry)
    }

    /// Builds an entry that keeps the number of a lost chunk.
    pub fn placeholder() -> Self {
        Entry {
            stream: 0,
            level: PLACEHOLDER,
            lane: 0,
            extent: 0,
            offset: 0,
            length: 0,
            count: 0,
            ordinal: 0,
            first: 0,
            last: 0,
            first_creation: 0,
        }
    }

    /// Returns whether the entry only keeps the number of a lost chunk.
    pub fn is_placeholder(&self) -> bool {
        self.level == PLACEHOLDER
    }
}

//! The fixed structures of the format, as bytes. See `priv/schema/store.md`.

use crate::error::{Error, Result};
pub use crate::limits::{MAX_MESSAGE, VERSION};

pub const INDEX_MAGIC: &[u8; 8] = b"SITUIDX1";
pub const EXTENT_MAGIC: &[u8; 8] = b"SITUDAT1";
/// What a chunk begins with: `CHK2`, in stores of version 1 `CHNK`.
pub const CHUNK_MAGIC: u32 = 0x324b_4843;
pub const CHUNK_MAGIC_1: u32 = 0x4b4e_4843;
pub const INDEX_HEADER: usize = 4096;
pub const ENTRY: usize = 64;
pub const EXTENT_HEADER: usize = 64;
pub const CHUNK_HEADER: usize = 112;
pub const CHUNK_HEADER_1: usize = 96;
/// The level of an index entry that names nothing any more: a place kept so that the numbers of the others stay.
pub const HOLE: u8 = 255;
/// Levels of what is counted and told of a stream's messages stand this much above those of its signal.
pub const TRACKS: u8 = 64;
pub const BIN: usize = 40;
pub const COMMITTED_AT: usize = 64;
pub const SYNCED_AT: usize = 72;
pub const STATE_AT: usize = 80;
pub const MAX_CHUNK_MESSAGES: u32 = 1024;
pub const MAX_CHUNK_PAYLOAD: usize = 64 * 1024;
pub const LARGE_MESSAGE: usize = 32 * 1024;
/// A chunk of the data lane does not unpack to more: its payload, one message that was too many, and its table.
pub const MAX_SMALL_BODY: usize =
    MAX_CHUNK_PAYLOAD + LARGE_MESSAGE + 40 * MAX_CHUNK_MESSAGES as usize;
/// Larger messages are stored plain, and a reader unpacks no larger ones unless it was asked to.
pub const MAX_UNPACKED: usize = 64 << 20;
pub const LANE_DATA: u8 = 0;
pub const LANE_LARGE: u8 = 1;
pub const CATALOG: u32 = 0;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Encoding {
    Bins = 0,
    Int = 1,
    Float = 2,
    Bytes = 3,
    Term = 4,
    Codec = 5,
    Bool = 6,
    /// Counts, states and numbers by key of the messages in bins, at levels above `TRACKS`.
    Tracks = 7,
}

impl Encoding {
    pub fn from_u8(value: u8) -> Option<Self> {
        Some(match value {
            0 => Self::Bins,
            1 => Self::Int,
            2 => Self::Float,
            3 => Self::Bytes,
            4 => Self::Term,
            5 => Self::Codec,
            6 => Self::Bool,
            7 => Self::Tracks,
            _ => return None,
        })
    }

    /// Bins instead of messages.
    pub fn is_pyramid(self) -> bool {
        matches!(self, Self::Bins | Self::Tracks)
    }

    pub fn has_lengths(self) -> bool {
        matches!(self, Self::Bytes | Self::Term | Self::Codec)
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Compression {
    None = 0,
    Lz4 = 1,
    Zstd = 2,
}

impl Compression {
    pub fn from_u8(value: u8) -> Option<Self> {
        Some(match value {
            0 => Self::None,
            1 => Self::Lz4,
            2 => Self::Zstd,
            _ => return None,
        })
    }
}

pub fn u32_at(bytes: &[u8], at: usize) -> u32 {
    let mut raw = [0; 4];
    raw.copy_from_slice(&bytes[at..at + 4]);
    u32::from_le_bytes(raw)
}

pub fn u64_at(bytes: &[u8], at: usize) -> u64 {
    let mut raw = [0; 8];
    raw.copy_from_slice(&bytes[at..at + 8]);
    u64::from_le_bytes(raw)
}

pub fn i64_at(bytes: &[u8], at: usize) -> i64 {
    u64_at(bytes, at) as i64
}

pub fn f64_at(bytes: &[u8], at: usize) -> f64 {
    f64::from_bits(u64_at(bytes, at))
}

fn set(bytes: &mut [u8], at: usize, value: &[u8]) {
    bytes[at..at + value.len()].copy_from_slice(value);
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IndexHeader {
    pub id: [u8; 16],
    pub created: i64,
    pub version: u32,
}

impl IndexHeader {
    pub fn encode(&self) -> [u8; INDEX_HEADER] {
        let mut bytes = [0; INDEX_HEADER];
        set(&mut bytes, 0, INDEX_MAGIC);
        set(&mut bytes, 8, &self.version.to_le_bytes());
        set(&mut bytes, 16, &self.id);
        set(&mut bytes, 32, &self.created.to_le_bytes());
        let crc = crc32c::crc32c(&bytes[16..64]);
        set(&mut bytes, 12, &crc.to_le_bytes());
        bytes
    }

    pub fn decode(bytes: &[u8]) -> Result<Self> {
        if bytes.len() < INDEX_HEADER || &bytes[..8] != INDEX_MAGIC {
            return Err(Error::NotAStore);
        }
        let version = u32_at(bytes, 8);
        if version > VERSION {
            return Err(Error::Newer(version));
        }
        if version == 0 || crc32c::crc32c(&bytes[16..64]) != u32_at(bytes, 12) {
            return Err(Error::damaged(
                "index.situ",
                12,
                "the header's checksum is wrong",
            ));
        }
        let mut id = [0; 16];
        id.copy_from_slice(&bytes[16..32]);
        Ok(IndexHeader {
            id,
            created: i64_at(bytes, 32),
            version,
        })
    }
}

pub fn extent_header(id: &[u8; 16], lane: u8, number: u32) -> [u8; EXTENT_HEADER] {
    let mut bytes = [0; EXTENT_HEADER];
    set(&mut bytes, 0, EXTENT_MAGIC);
    set(&mut bytes, 8, &VERSION.to_le_bytes());
    set(&mut bytes, 16, id);
    set(&mut bytes, 32, &(lane as u32).to_le_bytes());
    set(&mut bytes, 36, &number.to_le_bytes());
    let crc = crc32c::crc32c(&bytes[16..64]);
    set(&mut bytes, 12, &crc.to_le_bytes());
    bytes
}

/// Whether `bytes` open extent `number` of `lane` in store `id`.
pub fn check_extent(
    bytes: &[u8],
    id: &[u8; 16],
    lane: u8,
    number: u32,
) -> std::result::Result<(), &'static str> {
    if bytes.len() < EXTENT_HEADER || &bytes[..8] != EXTENT_MAGIC {
        return Err("not an extent of a store");
    }
    if crc32c::crc32c(&bytes[16..64]) != u32_at(bytes, 12) {
        return Err("the extent header's checksum is wrong");
    }
    if &bytes[16..32] != id {
        return Err("the extent belongs to another store");
    }
    if u32_at(bytes, 32) != lane as u32 || u32_at(bytes, 36) != number {
        return Err("the extent stands in another's place");
    }
    Ok(())
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Entry {
    pub stream: u32,
    pub level: u8,
    pub lane: u8,
    pub extent: u32,
    pub offset: u64,
    pub length: u32,
    pub count: u32,
    pub ordinal: u64,
    pub first: i64,
    pub last: i64,
    pub first_creation: i64,
}

impl Entry {
    pub fn encode(&self) -> [u8; ENTRY] {
        let mut bytes = [0; ENTRY];
        set(&mut bytes, 4, &self.stream.to_le_bytes());
        bytes[8] = self.level;
        bytes[9] = self.lane;
        set(&mut bytes, 12, &self.extent.to_le_bytes());
        set(&mut bytes, 16, &self.offset.to_le_bytes());
        set(&mut bytes, 24, &self.length.to_le_bytes());
        set(&mut bytes, 28, &self.count.to_le_bytes());
        set(&mut bytes, 32, &self.ordinal.to_le_bytes());
        set(&mut bytes, 40, &self.first.to_le_bytes());
        set(&mut bytes, 48, &self.last.to_le_bytes());
        set(&mut bytes, 56, &self.first_creation.to_le_bytes());
        let crc = crc32c::crc32c(&bytes[4..]);
        set(&mut bytes, 0, &crc.to_le_bytes());
        bytes
    }

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
        (sane || entry.is_hole()).then_some(entry)
    }

    /// An entry that keeps the place of a chunk that is gone.
    pub fn hole() -> Self {
        Entry {
            stream: 0,
            level: HOLE,
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

    pub fn is_hole(&self) -> bool {
        self.level == HOLE
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChunkHeader {
    pub length: u32,
    pub stream: u32,
    pub level: u8,
    pub encoding: Encoding,
    pub compression: Compression,
    pub count: u32,
    pub ordinal: u64,
    pub first: i64,
    pub last: i64,
    pub first_sequence: u64,
    pub first_creation: i64,
    pub size_sum: u64,
    pub latency_sum: f64,
    pub raw_length: u32,
    pub table_length: u32,
    pub codec: u16,
    pub body_crc: u32,
    /// The number of the chunk's entry in the index, where the chunk tells (version 2).
    pub number: Option<u64>,
    /// How many entries were committed when it was written: whatever they name was acknowledged.
    pub committed: u64,
}

impl ChunkHeader {
    /// How many bytes the header takes.
    pub fn size(&self) -> usize {
        if self.number.is_some() {
            CHUNK_HEADER
        } else {
            CHUNK_HEADER_1
        }
    }

    /// The header's bytes; `table` is what the header's checksum covers besides them.
    pub fn encode(&self, table: &[u8]) -> [u8; CHUNK_HEADER] {
        let mut bytes = [0; CHUNK_HEADER];
        set(&mut bytes, 0, &CHUNK_MAGIC.to_le_bytes());
        set(&mut bytes, 8, &self.length.to_le_bytes());
        set(&mut bytes, 12, &self.stream.to_le_bytes());
        bytes[16] = self.level;
        bytes[17] = self.encoding as u8;
        bytes[18] = self.compression as u8;
        set(&mut bytes, 20, &self.count.to_le_bytes());
        set(&mut bytes, 24, &self.ordinal.to_le_bytes());
        set(&mut bytes, 32, &self.first.to_le_bytes());
        set(&mut bytes, 40, &self.last.to_le_bytes());
        set(&mut bytes, 48, &self.first_sequence.to_le_bytes());
        set(&mut bytes, 56, &self.first_creation.to_le_bytes());
        set(&mut bytes, 64, &self.size_sum.to_le_bytes());
        set(&mut bytes, 72, &self.latency_sum.to_bits().to_le_bytes());
        set(&mut bytes, 80, &self.raw_length.to_le_bytes());
        set(&mut bytes, 84, &self.table_length.to_le_bytes());
        set(&mut bytes, 88, &self.codec.to_le_bytes());
        set(&mut bytes, 92, &self.body_crc.to_le_bytes());
        set(
            &mut bytes,
            96,
            &self.number.unwrap_or(u64::MAX).to_le_bytes(),
        );
        set(&mut bytes, 104, &self.committed.to_le_bytes());
        let crc = crc32c::crc32c_append(crc32c::crc32c(&bytes[8..]), table);
        set(&mut bytes, 4, &crc.to_le_bytes());
        bytes
    }

    /// Parses and checks the header of the chunk that `bytes` begin with (the bytes may go on behind the chunk).
    pub fn decode(bytes: &[u8]) -> std::result::Result<Self, &'static str> {
        Self::decode_head(bytes, bytes.len() as u64)
    }

    /// As `decode`, from the chunk's first bytes: the header and what its checksum covers; `space` is how far the
    /// extent goes on.
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
            .ok_or("the chunk's table is not at hand")?;
        if crc32c::crc32c(covered) != u32_at(bytes, 4) {
            return Err("the chunk header's checksum is wrong");
        }
        Ok(header)
    }

    /// How many bytes of the stored body the header's checksum covers.
    pub fn covered(&self) -> usize {
        if self.compression == Compression::None {
            self.table_length as usize
        } else {
            0
        }
    }
}

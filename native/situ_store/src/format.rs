//! The fixed structures of the format, as bytes. See `priv/schema/store.md`.

mod chunk_header;
mod entry;

use crate::error::{Error, Result};
pub use crate::limits::{MAX_MESSAGE, VERSION};
pub use chunk_header::ChunkHeader;
pub use entry::Entry;

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

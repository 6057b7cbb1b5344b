//! The fixed structures of the format, as bytes. See `priv/schema/store.md`.

mod chunk_header;
mod entry;

use crate::error::{Error, Result};
pub use crate::limits::{MAX_MESSAGE, VERSION};
pub use chunk_header::ChunkHeader;
pub use entry::Entry;

/// The first 8 bytes of `index.situ`.
pub const INDEX_MAGIC: &[u8; 8] = b"SITUIDX1";
/// The first 8 bytes of an extent.
pub const EXTENT_MAGIC: &[u8; 8] = b"SITUDAT1";
/// The first 4 bytes of a chunk, `CHK2`.
pub const CHUNK_MAGIC: u32 = 0x324b_4843;
/// The first 4 bytes of a chunk in a store of version 1, `CHNK`.
pub const CHUNK_MAGIC_1: u32 = 0x4b4e_4843;
/// Bytes of the index header.
pub const INDEX_HEADER: usize = 4096;
/// Bytes of an index entry.
pub const ENTRY: usize = 64;
/// Bytes of an extent header.
pub const EXTENT_HEADER: usize = 64;
/// Bytes of a chunk header, version 2.
pub const CHUNK_HEADER: usize = 112;
/// Bytes of a chunk header, version 1.
pub const CHUNK_HEADER_1: usize = 96;
/// The level of an index entry that names no chunk any more; it stays so that the others keep their numbers.
pub const HOLE: u8 = 255;
/// The levels of a stream's tracks are so much above those of its signal.
pub const TRACKS: u8 = 64;
/// Bytes of a pyramid bin.
pub const BIN: usize = 40;
/// Where the index header holds the number of committed entries (u64, atomic).
pub const COMMITTED_AT: usize = 64;
/// Where the index header holds the number of entries known to be on the disk (u64, atomic).
pub const SYNCED_AT: usize = 72;
/// Where the index header holds the state: 0 open, 1 closed.
pub const STATE_AT: usize = 80;
/// The most messages of a chunk.
pub const MAX_CHUNK_MESSAGES: u32 = 1024;
/// The most payload bytes of a chunk of several messages.
pub const MAX_CHUNK_PAYLOAD: usize = 64 * 1024;
/// Messages of at least so many bytes are chunks of their own in the large lane.
pub const LARGE_MESSAGE: usize = 32 * 1024;
/// A chunk of the data lane does not unpack to more: its payload, one message that was too many, and its table.
pub const MAX_SMALL_BODY: usize =
    MAX_CHUNK_PAYLOAD + LARGE_MESSAGE + 40 * MAX_CHUNK_MESSAGES as usize;
/// Larger messages are stored plain, and a reader unpacks no larger ones unless it was asked to.
pub const MAX_UNPACKED: usize = 64 << 20;
/// The lane of chunks of small messages.
pub const LANE_DATA: u8 = 0;
/// The lane of large messages, one per chunk.
pub const LANE_LARGE: u8 = 1;
/// The number of the catalog's stream.
pub const CATALOG: u32 = 0;

/// The kinds of payload; a chunk has one of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Encoding {
    /// Bins of a signal (`pyramid::Bin`), 40 bytes each.
    Bins = 0,
    /// Integers of 64 bits, as zigzag varints.
    Int = 1,
    /// Floats of 64 bits, little-endian.
    Float = 2,
    /// Binaries, as they are.
    Bytes = 3,
    /// Terms in Erlang's external term format.
    Term = 4,
    /// Bytes of a codec; the catalog names the codec.
    Codec = 5,
    /// Booleans: 0 false, 1 true, 2 nil.
    Bool = 6,
    /// Counts, states and numbers by key of the messages in bins, at levels above `TRACKS`.
    Tracks = 7,
}

impl Encoding {
    /// The encoding with this number, if there is one.
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

    /// Whether the table of a chunk holds the lengths of its payloads.
    pub fn has_lengths(self) -> bool {
        matches!(self, Self::Bytes | Self::Term | Self::Codec)
    }
}

/// The compression of a chunk's body.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Compression {
    /// Stored plain.
    None = 0,
    /// An LZ4 block without its length.
    Lz4 = 1,
    /// A zstd frame.
    Zstd = 2,
}

impl Compression {
    /// The compression with this number, if there is one.
    pub fn from_u8(value: u8) -> Option<Self> {
        Some(match value {
            0 => Self::None,
            1 => Self::Lz4,
            2 => Self::Zstd,
            _ => return None,
        })
    }
}

/// The little-endian u32 at `at`; panics if `bytes` end before it.
pub fn u32_at(bytes: &[u8], at: usize) -> u32 {
    let mut raw = [0; 4];
    raw.copy_from_slice(&bytes[at..at + 4]);
    u32::from_le_bytes(raw)
}

/// The little-endian u64 at `at`; panics if `bytes` end before it.
pub fn u64_at(bytes: &[u8], at: usize) -> u64 {
    let mut raw = [0; 8];
    raw.copy_from_slice(&bytes[at..at + 8]);
    u64::from_le_bytes(raw)
}

/// The little-endian i64 at `at`; panics if `bytes` end before it.
pub fn i64_at(bytes: &[u8], at: usize) -> i64 {
    u64_at(bytes, at) as i64
}

/// The little-endian f64 at `at`; panics if `bytes` end before it.
pub fn f64_at(bytes: &[u8], at: usize) -> f64 {
    f64::from_bits(u64_at(bytes, at))
}

fn set(bytes: &mut [u8], at: usize, value: &[u8]) {
    bytes[at..at + value.len()].copy_from_slice(value);
}

/// The constant part of the header of `index.situ`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IndexHeader {
    /// The store's random id.
    pub id: [u8; 16],
    /// When the store was created, ns since 1970.
    pub created: i64,
    /// The format's version, 1 or 2.
    pub version: u32,
}

impl IndexHeader {
    /// The header's bytes, with `committed`, `synced` and state 0.
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

    /// Parses and checks the header that `bytes` begin with.
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

/// The header of extent `number` of `lane` in store `id`.
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

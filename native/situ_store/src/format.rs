//! Encodes the fixed structures of the format. See `priv/schema/store.md`.

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
/// The size of the index header, bytes.
pub const INDEX_HEADER: usize = 4096;
/// The size of an index entry, bytes.
pub const ENTRY: usize = 64;
/// The size of an extent header, bytes.
pub const EXTENT_HEADER: usize = 64;
/// The size of a version 2 chunk header, bytes.
pub const CHUNK_HEADER: usize = 112;
/// The size of a version 1 chunk header, bytes.
pub const CHUNK_HEADER_1: usize = 96;
/// The level of an index entry that no longer refers to a chunk. The entry stays so that the others keep their
/// numbers.
pub const PLACEHOLDER: u8 = 255;
/// The difference between the levels of a stream's tracks and those of its signal.
pub const TRACKS: u8 = 64;
/// The size of a pyramid bin, bytes.
pub const BIN: usize = 40;
/// The offset in the index header of the number of committed entries (u64, atomic).
pub const COMMITTED_AT: usize = 64;
/// The offset in the index header of the number of entries known to be on disk (u64, atomic).
pub const SYNCED_AT: usize = 72;
/// The offset in the index header of the state: 0 open, 1 closed.
pub const STATE_AT: usize = 80;
/// The maximum number of messages in a chunk.
pub const MAX_CHUNK_MESSAGES: u32 = 1024;
/// The maximum payload of a chunk with several messages, bytes.
pub const MAX_CHUNK_PAYLOAD: usize = 64 * 1024;
/// Messages of at least this many bytes get their own chunk in the large lane.
pub const LARGE_MESSAGE: usize = 32 * 1024;
/// The maximum unpacked size of a chunk in the data lane: its payload, one message over the limit, and its table.
pub const MAX_SMALL_BODY: usize =
    MAX_CHUNK_PAYLOAD + LARGE_MESSAGE + 40 * MAX_CHUNK_MESSAGES as usize;
/// Larger messages are stored uncompressed, and a reader unpacks larger ones only on request.
pub const MAX_UNPACKED: usize = 64 << 20;
/// The lane of chunks of small messages.
pub const LANE_DATA: u8 = 0;
/// The lane of large messages, with one message per chunk.
pub const LANE_LARGE: u8 = 1;
/// The number of the catalog's stream.
pub const CATALOG: u32 = 0;

/// The kinds of payload. A chunk contains one kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Encoding {
    /// Bins of a signal (`pyramid::Bin`), 40 bytes each.
    Bins = 0,
    /// Integers of 64 bits, as zigzag varints.
    Int = 1,
    /// Floats of 64 bits, little-endian.
    Float = 2,
    /// Binaries, stored unchanged.
    Bytes = 3,
    /// Terms in Erlang's external term format.
    Term = 4,
    /// Bytes of a codec; the catalog names the codec.
    Codec = 5,
    /// Booleans: 0 false, 1 true, 2 nil.
    Bool = 6,
    /// Counts, states and numbers by key of the messages in each bin, at levels above `TRACKS`.
    Tracks = 7,
}

impl Encoding {
    /// Returns the encoding with this number, or `None`.
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

    /// Returns whether chunks of this encoding contain bins instead of messages.
    pub fn is_pyramid(self) -> bool {
        matches!(self, Self::Bins | Self::Tracks)
    }

    /// Returns whether the table of a chunk contains the lengths of its payloads.
    pub fn has_lengths(self) -> bool {
        matches!(self, Self::Bytes | Self::Term | Self::Codec)
    }
}

/// The compression of a chunk's body.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Compression {
    /// Stored uncompressed.
    None = 0,
    /// An LZ4 block without a length prefix.
    Lz4 = 1,
    /// A zstd frame.
    Zstd = 2,
}

impl Compression {
    /// Returns the compression with this number, or `None`.
    pub fn from_u8(value: u8) -> Option<Self> {
        Some(match value {
            0 => Self::None,
            1 => Self::Lz4,
            2 => Self::Zstd,
            _ => return None,
        })
    }
}

/// Reads the little-endian u32 at `at`. Panics if `bytes` are too short.
pub fn u32_at(bytes: &[u8], at: usize) -> u32 {
    let mut raw = [0; 4];
    raw.copy_from_slice(&bytes[at..at + 4]);
    u32::from_le_bytes(raw)
}

/// Reads the little-endian u64 at `at`. Panics if `bytes` are too short.
pub fn u64_at(bytes: &[u8], at: usize) -> u64 {
    let mut raw = [0; 8];
    raw.copy_from_slice(&bytes[at..at + 8]);
    u64::from_le_bytes(raw)
}

/// Reads the little-endian i64 at `at`. Panics if `bytes` are too short.
pub fn i64_at(bytes: &[u8], at: usize) -> i64 {
    u64_at(bytes, at) as i64
}

/// Reads the little-endian f64 at `at`. Panics if `bytes` are too short.
pub fn f64_at(bytes: &[u8], at: usize) -> f64 {
    f64::from_bits(u64_at(bytes, at))
}

fn put_bytes(bytes: &mut [u8], at: usize, value: &[u8]) {
    bytes[at..at + value.len()].copy_from_slice(value);
}

/// The constant part of the header of `index.situ`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IndexHeader {
    /// The store's random id.
    pub id: [u8; 16],
    /// The creation time of the store, ns since 1970.
    pub created: i64,
    /// The format's version, 1 or 2.
    pub version: u32,
}

impl IndexHeader {
    /// Encodes the header, with `committed`, `synced` and state set to 0.
    pub fn encode(&self) -> [u8; INDEX_HEADER] {
        let mut bytes = [0; INDEX_HEADER];
        put_bytes(&mut bytes, 0, INDEX_MAGIC);
        put_bytes(&mut bytes, 8, &self.version.to_le_bytes());
        put_bytes(&mut bytes, 16, &self.id);
        put_bytes(&mut bytes, 32, &self.created.to_le_bytes());
        let crc = crc32c::crc32c(&bytes[16..64]);
        put_bytes(&mut bytes, 12, &crc.to_le_bytes());
        bytes
    }

    /// Parses and checks the header at the start of `bytes`.
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

/// Encodes the header of extent `number` of `lane` in store `id`.
pub fn encode_extent_header(id: &[u8; 16], lane: u8, number: u32) -> [u8; EXTENT_HEADER] {
    let mut bytes = [0; EXTENT_HEADER];
    put_bytes(&mut bytes, 0, EXTENT_MAGIC);
    put_bytes(&mut bytes, 8, &VERSION.to_le_bytes());
    put_bytes(&mut bytes, 16, id);
    put_bytes(&mut bytes, 32, &(lane as u32).to_le_bytes());
    put_bytes(&mut bytes, 36, &number.to_le_bytes());
    let crc = crc32c::crc32c(&bytes[16..64]);
    put_bytes(&mut bytes, 12, &crc.to_le_bytes());
    bytes
}

/// Checks that `bytes` start with the header of extent `number` of `lane` in store `id`.
pub fn check_extent_header(
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
        return Err("the extent's header names another lane or number");
    }
    Ok(())
}

//! Packs, checks and unpacks the stored body of a chunk.

use crate::error::{Error, Result};
use crate::format::*;

/// Returns the compressed body, or `None` if compression does not make it smaller.
pub fn compress_body(
    compression: Compression,
    table: &[u8],
    payload: &[u8],
) -> Result<Option<Vec<u8>>> {
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

/// The raw body of a chunk: a view into the map, or unpacked bytes.
#[derive(Debug)]
pub enum Body<'a> {
    /// A view into the map.
    Mapped(&'a [u8]),
    /// Bytes that were decompressed.
    Unpacked(Vec<u8>),
}

impl Body<'_> {
    /// Returns the bytes of the body.
    pub fn as_bytes(&self) -> &[u8] {
        match self {
            Body::Mapped(bytes) => bytes,
            Body::Unpacked(bytes) => bytes,
        }
    }
}

/// Checks the stored body of the chunk at the start of `bytes` (unless `trust_body`) and unpacks it to at most
/// `most` bytes.
pub fn open_body<'a>(
    header: &ChunkHeader,
    bytes: &'a [u8],
    trust_body: bool,
    most: usize,
) -> std::result::Result<Body<'a>, &'static str> {
    let stored = bytes
        .get(header.header_size()..header.length as usize)
        .ok_or("the chunk does not end in its extent")?;
    if !trust_body && crc32c::crc32c(&stored[header.covered_size()..]) != header.body_crc {
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
                return Err("the chunk's unpacked length is impossible");
            }
            let raw = lz4_flex::block::decompress(stored, raw_length)
                .map_err(|_| "the chunk does not unpack")?;
            if raw.len() == raw_length {
                Ok(Body::Unpacked(raw))
            } else {
                Err("the chunk unpacks to a different length")
            }
        }
        Compression::Zstd => {
            let raw = zstd::bulk::decompress(stored, raw_length)
                .map_err(|_| "the chunk does not unpack")?;
            if raw.len() == raw_length {
                Ok(Body::Unpacked(raw))
            } else {
                Err("the chunk unpacks to a different length")
            }
        }
    }
}

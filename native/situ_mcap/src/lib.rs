//! MCAP files (<https://mcap.dev/spec>) read at random and written: the records are the `mcap` crate's; what is on
//! top is an index of each channel's messages, so that they can be asked for by number and by time, and the recovery
//! of files without an index or cut short. Files are read by `pread`, never mapped: one that shrinks meanwhile is an
//! error and no signal.

#![deny(missing_docs)]

mod chunk;
mod copy;
mod file;
mod layout;
mod open;
mod reader;
mod span;
mod track;
mod writer;

pub use copy::{Copied, Copy, Order, Selection};
pub use layout::Chunk;
pub use reader::{Channel, Found, Info, Message, Query, Reader, Schema};
pub use track::Times;
pub use writer::{ChannelSpec, Compression, Options, Writer};

/// The errors of this crate; their texts are for people.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Error {
    /// The operating system refused: what was tried, its error number and its words.
    Io(String, i32, String),
    /// The file does not begin like MCAP.
    NotMcap,
    /// The bytes at an offset make no sense.
    Damaged(u64, String),
    /// The writer was closed before.
    Closed,
}

/// The result of the functions of this crate.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    pub(crate) fn io(what: &str, error: &std::io::Error) -> Self {
        Error::Io(
            what.to_string(),
            error.raw_os_error().unwrap_or(0),
            error.to_string(),
        )
    }

    pub(crate) fn mcap(what: &str, error: mcap::McapError) -> Self {
        match error {
            mcap::McapError::Io(error) => Error::io(what, &error),
            other => Error::Damaged(0, other.to_string()),
        }
    }
}

/// Bytes compressed to a frame of LZ4 that ROS 1 reads, too: blocks that stand alone, a checksum of the whole, no size.
pub fn pack_lz4(bytes: &[u8]) -> std::io::Result<Vec<u8>> {
    use lz4_flex::frame::{BlockMode, BlockSize, FrameEncoder, FrameInfo};
    use std::io::Write;
    let info = FrameInfo::new()
        .block_mode(BlockMode::Independent)
        .block_size(BlockSize::Max4MB)
        .content_checksum(true);
    let mut encoder = FrameEncoder::with_frame_info(info, Vec::with_capacity(bytes.len() / 2));
    encoder.write_all(bytes)?;
    encoder.finish().map_err(std::io::Error::from)
}

/// Bytes that were compressed by `"lz4"`, `"zstd"` or not (`""`), at most `size` of them; or why they cannot be
/// unpacked.
pub fn unpack(compression: &str, bytes: &[u8], size: u64) -> std::result::Result<Vec<u8>, String> {
    if compression == "lz4_block" {
        return unpack_block(bytes, size);
    }
    match chunk::partly(compression, bytes, size) {
        (bytes, None) => Ok(bytes),
        (_, Some(why)) => Err(why),
    }
}

/// A bare block of LZ4, of exactly so many bytes. One byte packs 255 at the most.
fn unpack_block(bytes: &[u8], size: u64) -> std::result::Result<Vec<u8>, String> {
    if size > bytes.len() as u64 * 255 {
        return Err(format!("{} bytes do not unpack to {size}", bytes.len()));
    }
    lz4_flex::block::decompress(bytes, size as usize).map_err(|why| why.to_string())
}

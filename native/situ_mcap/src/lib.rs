//! Reads and writes MCAP files (<https://mcap.dev/spec>). The `mcap` crate parses the records; this crate adds an
//! index of each channel's messages, so that they can be read by number and by time, and recovers files that are
//! truncated or have no index. Files are read by `pread` and never mapped, so a file that shrinks while it is read
//! causes an error and not a signal.

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

pub use copy::{Copy, CopyReport, Order, Selection};
pub use layout::Chunk;
pub use reader::{AttachmentInfo, Channel, Info, Message, Query, Reader, Schema};
pub use track::Times;
pub use writer::{ChannelSpec, Compression, Options, Writer};

/// The errors of this crate. Their texts are shown to users.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Error {
    /// An operating system call failed: (operation, errno, message).
    Io(String, i32, String),
    /// The file does not start with the magic bytes of MCAP.
    NotMcap,
    /// The bytes at an offset are invalid.
    Damaged(u64, String),
    /// The writer is closed.
    Closed,
}

/// The result type of this crate's functions.
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

/// Compresses bytes to an LZ4 frame that ROS 1 can read, too: independent blocks, a content checksum, and no size.
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

/// Unpacks at most `size` bytes that were compressed by `"lz4"`, `"zstd"` or not at all (`""`). Returns the reason
/// if that fails.
pub fn unpack(compression: &str, bytes: &[u8], size: u64) -> std::result::Result<Vec<u8>, String> {
    if compression == "lz4_block" {
        return unpack_block(bytes, size);
    }
    match chunk::unpack_prefix(compression, bytes, size) {
        (bytes, None) => Ok(bytes),
        (_, Some(why)) => Err(why),
    }
}

/// Unpacks a raw LZ4 block to exactly `size` bytes. A byte can unpack to at most 255.
fn unpack_block(bytes: &[u8], size: u64) -> std::result::Result<Vec<u8>, String> {
    if size > bytes.len() as u64 * 255 {
        return Err(format!("{} bytes cannot unpack to {size}", bytes.len()));
    }
    lz4_flex::block::decompress(bytes, size as usize).map_err(|why| why.to_string())
}

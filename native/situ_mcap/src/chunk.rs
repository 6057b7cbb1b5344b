//! Unpacks chunks, which contain many records compressed together.

use std::io::Read;

use mcap::records::ChunkHeader;

use crate::{Error, Result};

/// The maximum unpacked size of a chunk.
const MOST_UNPACKED: u64 = 1 << 30;

/// Unpacks the records of a complete chunk.
pub fn unpack_chunk(header: &ChunkHeader, data: &[u8], at: u64) -> Result<Vec<u8>> {
    let size = header.uncompressed_size;
    if size > MOST_UNPACKED {
        let why = format!("a chunk claims to have {size} bytes");
        return Err(Error::Damaged(at, why));
    }
    let (bytes, fault) = unpack_prefix(&header.compression, data, size);
    if let Some(why) = fault {
        return Err(Error::Damaged(at, why));
    }
    if bytes.len() as u64 != size {
        let why = format!("a chunk of {} bytes claims to have {size}", bytes.len());
        return Err(Error::Damaged(at, why));
    }
    if header.uncompressed_crc != 0 && crc32fast::hash(&bytes) != header.uncompressed_crc {
        return Err(Error::Damaged(
            at,
            "a chunk's checksum is wrong".to_string(),
        ));
    }
    Ok(bytes)
}

/// Unpacks as much as possible, at most `size` bytes. Returns the bytes, and the reason if they are incomplete.
pub fn unpack_prefix(compression: &str, data: &[u8], size: u64) -> (Vec<u8>, Option<String>) {
    match compression {
        "" => {
            let n = data.len().min(size as usize);
            (data[..n].to_vec(), None)
        }
        "zstd" => match zstd::stream::read::Decoder::with_buffer(data) {
            Ok(decoder) => read_up_to(decoder, size),
            Err(error) => (Vec::new(), Some(error.to_string())),
        },
        "lz4" => read_up_to(lz4_flex::frame::FrameDecoder::new(data), size),
        other => (
            Vec::new(),
            Some(format!("the compression {other:?} is not supported")),
        ),
    }
}

fn read_up_to(mut from: impl Read, size: u64) -> (Vec<u8>, Option<String>) {
    let mut bytes = Vec::with_capacity(size.min(16 << 20) as usize);
    let mut buffer = vec![0; 64 << 10];
    loop {
        match from.read(&mut buffer) {
            Ok(0) => return (bytes, None),
            Ok(n) => {
                bytes.extend_from_slice(&buffer[..n]);
                if bytes.len() as u64 > size {
                    return (
                        bytes,
                        Some("a chunk unpacks to more than it claims".to_string()),
                    );
                }
            }
            Err(error) => return (bytes, Some(error.to_string())),
        }
    }
}

/// The records in unpacked bytes: operation code, offset of the record, body. Ends at the first incomplete record.
pub struct Records<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Records<'a> {
    pub fn new(bytes: &'a [u8]) -> Self {
        Records { bytes, at: 0 }
    }

    /// Returns the record at `at`.
    pub fn record_at(bytes: &'a [u8], at: u64) -> Option<(u8, &'a [u8])> {
        let mut records = Records {
            bytes,
            at: usize::try_from(at).ok()?,
        };
        records.next().map(|(op, _, body)| (op, body))
    }
}

impl<'a> Iterator for Records<'a> {
    type Item = (u8, u64, &'a [u8]);

    fn next(&mut self) -> Option<Self::Item> {
        let head = self.bytes.get(self.at..self.at.checked_add(9)?)?;
        let mut length = [0; 8];
        length.copy_from_slice(&head[1..]);
        let from = self.at + 9;
        let until = from.checked_add(usize::try_from(u64::from_le_bytes(length)).ok()?)?;
        let body = self.bytes.get(from..until)?;
        let item = (head[0], self.at as u64, body);
        self.at = until;
        Some(item)
    }
}

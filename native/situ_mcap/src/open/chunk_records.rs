//! Unpacks the records of a chunk.

use mcap::records::{op, Record};

use super::ChunkInfo;
use crate::chunk;
use crate::file::{parse_record, FileBytes, RecordHead};
use crate::{Error, Result};

/// Returns a chunk's records and whether the file ends within the chunk. In that case it returns the records that
/// can be unpacked.
pub fn unpack_records(bytes: &FileBytes, record: RecordHead, at: u64) -> Result<(Vec<u8>, bool)> {
    if record.end() <= bytes.size {
        let body = bytes.record_body(record)?;
        let Record::Chunk { header, data } = parse_record(op::CHUNK, &body, at)? else {
            return Err(Error::Damaged(at, "no chunk is there".to_string()));
        };
        return Ok((chunk::unpack_chunk(&header, &data, at)?, false));
    }
    let mut body = bytes.read(record.body, bytes.size - record.body)?;
    let available = body.len();
    // The crate expects as many bytes as the header claims, so the header is parsed here.
    let Some(fields) = parse_chunk_fields(&body) else {
        return Err(Error::Damaged(
            at,
            "the file is cut short within a chunk's header".to_string(),
        ));
    };
    let data = body.split_off(fields.0.min(available));
    let (records, _) = chunk::unpack_prefix(&fields.1, &data, fields.2.min(1 << 30));
    Ok((records, true))
}

/// Returns the offset of a chunk's data, their compression, and their unpacked size.
pub(super) fn parse_chunk_fields(body: &[u8]) -> Option<(usize, String, u64)> {
    let size = u64::from_le_bytes(body.get(16..24)?.try_into().ok()?);
    let name = u32::from_le_bytes(body.get(28..32)?.try_into().ok()?) as usize;
    let text = body.get(32..32usize.checked_add(name)?)?;
    let data = 32 + name + 8;
    (body.len() >= data).then(|| (data, String::from_utf8_lossy(text).into_owned(), size))
}

/// Reads a chunk's header as far as the file contains it.
pub fn read_chunk_info(bytes: &FileBytes, record: RecordHead, at: u64) -> Result<ChunkInfo> {
    // The name of a compression has a few letters.
    let head = bytes.read(record.body, 64.min(bytes.size - record.body))?;
    let number = |from: usize| {
        let eight = head.get(from..from + 8).and_then(|b| b.try_into().ok());
        eight.map_or(0, u64::from_le_bytes)
    };
    let Some((data, compression, unpacked)) = parse_chunk_fields(&head) else {
        return Ok(ChunkInfo {
            offset: at,
            ..ChunkInfo::default()
        });
    };
    let end = record.end().min(bytes.size);
    Ok(ChunkInfo {
        offset: at,
        start: number(0),
        end: number(8),
        length: end - at,
        packed: (end - record.body).saturating_sub(data as u64),
        unpacked,
        compression,
        ..ChunkInfo::default()
    })
}

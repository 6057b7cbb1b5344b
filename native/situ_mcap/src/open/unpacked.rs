//! The records of a chunk, unpacked.

use mcap::records::{op, Record};

use super::ChunkPlace;
use crate::chunk;
use crate::file::{parse, Bytes, Place};
use crate::{Error, Result};

/// A chunk's records: all of them, or what can be unpacked of one that the file ends in.
pub fn unpacked(bytes: &Bytes, place: Place, at: u64) -> Result<(Vec<u8>, bool)> {
    if place.end() <= bytes.size {
        let body = bytes.body(place)?;
        let Record::Chunk { header, data } = parse(op::CHUNK, &body, at)? else {
            return Err(Error::Damaged(at, "no chunk is there".to_string()));
        };
        return Ok((chunk::unpack(&header, &data, at)?, false));
    }
    let mut body = bytes.read(place.body, bytes.size - place.body)?;
    let there = body.len();
    // The crate wants as many bytes as the header promises: those that are lost are left out again.
    let Some(promised) = promise(&body) else {
        return Err(Error::Damaged(
            at,
            "the file is cut short within a chunk's header".to_string(),
        ));
    };
    let data = body.split_off(promised.0.min(there));
    let (records, _) = chunk::partly(&promised.1, &data, promised.2.min(1 << 30));
    Ok((records, true))
}

/// Where a chunk's data begin, how they are compressed and what they unpack to.
pub(super) fn promise(body: &[u8]) -> Option<(usize, String, u64)> {
    let size = u64::from_le_bytes(body.get(16..24)?.try_into().ok()?);
    let name = u32::from_le_bytes(body.get(28..32)?.try_into().ok()?) as usize;
    let text = body.get(32..32usize.checked_add(name)?)?;
    let data = 32 + name + 8;
    (body.len() >= data).then(|| (data, String::from_utf8_lossy(text).into_owned(), size))
}

/// A chunk's own header, as far as the file has it.
pub fn header(bytes: &Bytes, place: Place, at: u64) -> Result<ChunkPlace> {
    // A compression's name has a few letters.
    let head = bytes.read(place.body, 64.min(bytes.size - place.body))?;
    let number = |from: usize| {
        let eight = head.get(from..from + 8).and_then(|b| b.try_into().ok());
        eight.map_or(0, u64::from_le_bytes)
    };
    let Some((data, compression, unpacked)) = promise(&head) else {
        return Ok(ChunkPlace {
            offset: at,
            ..ChunkPlace::default()
        });
    };
    let end = place.end().min(bytes.size);
    Ok(ChunkPlace {
        offset: at,
        start: number(0),
        end: number(8),
        length: end - at,
        packed: (end - place.body).saturating_sub(data as u64),
        unpacked,
        compression,
        ..ChunkPlace::default()
    })
}

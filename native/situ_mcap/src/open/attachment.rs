//! Reads attachments by the fields before their data, which may be larger than any memory.

use mcap::records::AttachmentHeader;

use crate::file::{Bytes, Place};
use crate::{Error, Found, Result};

/// A name and a media type that take more are refused.
const MOST_HEAD: u64 = 1 << 20;
const FIRST: u64 = 4096;
const PIECE: u64 = 1 << 20;

/// An attachment, and where its data are.
pub struct Attached {
    pub header: AttachmentHeader,
    /// Where the data begin.
    pub data: u64,
    /// Their bytes.
    pub size: u64,
    body: u64,
    crc: u32,
}

impl Attached {
    /// Reads the fields of the attachment at `at`.
    pub fn read(bytes: &Bytes, place: Place, at: u64) -> Result<Self> {
        let fault = |why: &str| Error::Damaged(at, why.to_string());
        if place.end() > bytes.size {
            return Err(fault("the file is cut short within an attachment"));
        }
        let first = bytes.read(place.body, FIRST.min(place.length))?;
        let head = match fields(&first) {
            Some(_) => first,
            None => bytes.read(place.body, MOST_HEAD.min(place.length))?,
        };
        let (header, data, size) =
            fields(&head).ok_or_else(|| fault("an attachment's name is no text or too long"))?;
        let behind = data.checked_add(size).and_then(|n| n.checked_add(4));
        if behind.is_none_or(|n| n > place.length) {
            return Err(fault("an attachment is shorter than it says"));
        }
        let crc = bytes.read(place.body + data + size, 4)?;
        Ok(Attached {
            header,
            data: place.body + data,
            size,
            body: place.body,
            crc: u32::from_le_bytes([crc[0], crc[1], crc[2], crc[3]]),
        })
    }

    /// As it is listed.
    pub fn found(&self, at: u64) -> Found {
        Found {
            name: self.header.name.clone(),
            media_type: self.header.media_type.clone(),
            log_time: self.header.log_time,
            offset: at,
            size: self.size,
        }
    }

    /// Compares the checksum, where there is one.
    pub fn verify(&self, bytes: &Bytes, at: u64) -> Result<()> {
        if self.crc == 0 {
            return Ok(());
        }
        let mut hasher = crc32fast::Hasher::new();
        each_piece(bytes, self.body, self.data + self.size, |piece| {
            hasher.update(piece);
            Ok(())
        })?;
        if hasher.finalize() == self.crc {
            return Ok(());
        }
        let why = format!(
            "the checksum of the attachment {:?} is wrong",
            self.header.name
        );
        Err(Error::Damaged(at, why))
    }

    /// Hands its data over, in pieces.
    pub fn each_piece(&self, bytes: &Bytes, fun: impl FnMut(&[u8]) -> Result<()>) -> Result<()> {
        each_piece(bytes, self.data, self.data + self.size, fun)
    }
}

fn each_piece(
    bytes: &Bytes,
    from: u64,
    until: u64,
    mut fun: impl FnMut(&[u8]) -> Result<()>,
) -> Result<()> {
    let mut at = from;
    while at < until {
        let piece = bytes.read(at, PIECE.min(until - at))?;
        fun(&piece)?;
        at += piece.len() as u64;
    }
    Ok(())
}

/// The header, and where the data begin in the body and how long they are.
fn fields(head: &[u8]) -> Option<(AttachmentHeader, u64, u64)> {
    let eight = |at: usize| -> Option<u64> {
        let bytes = head.get(at..at.checked_add(8)?)?;
        Some(u64::from_le_bytes(bytes.try_into().ok()?))
    };
    let text = |at: usize| -> Option<(String, usize)> {
        let bytes = head.get(at..at.checked_add(4)?)?;
        let from = at + 4;
        let until = from.checked_add(u32::from_le_bytes(bytes.try_into().ok()?) as usize)?;
        let text = String::from_utf8(head.get(from..until)?.to_vec()).ok()?;
        Some((text, until))
    };
    let (log_time, create_time) = (eight(0)?, eight(8)?);
    let (name, at) = text(16)?;
    let (media_type, at) = text(at)?;
    let header = AttachmentHeader {
        log_time,
        create_time,
        name,
        media_type,
    };
    Some((header, at as u64 + 8, eight(at)?))
}

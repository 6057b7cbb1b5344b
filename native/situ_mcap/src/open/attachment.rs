//! Reads the fields of attachments before their data, which may be larger than the memory.

use mcap::records::AttachmentHeader;

use crate::file::{FileBytes, RecordHead};
use crate::{AttachmentInfo, Error, Result};

/// The maximum size of the fields before the data.
const MOST_HEAD: u64 = 1 << 20;
const FIRST: u64 = 4096;
const BLOCK: u64 = 1 << 20;

/// An attachment and the position of its data.
pub struct StoredAttachment {
    pub header: AttachmentHeader,
    /// The offset of the data.
    pub data: u64,
    /// The size of the data, bytes.
    pub size: u64,
    body: u64,
    crc: u32,
}

impl StoredAttachment {
    /// Reads the fields of the attachment at `at`.
    pub fn read(bytes: &FileBytes, record: RecordHead, at: u64) -> Result<Self> {
        let fault = |why: &str| Error::Damaged(at, why.to_string());
        if record.end() > bytes.size {
            return Err(fault("the file is cut short within an attachment"));
        }
        let first = bytes.read(record.body, FIRST.min(record.length))?;
        let head = match parse_fields(&first) {
            Some(_) => first,
            None => bytes.read(record.body, MOST_HEAD.min(record.length))?,
        };
        let (header, data, size) = parse_fields(&head)
            .ok_or_else(|| fault("an attachment's name is too long or not UTF-8"))?;
        let behind = data.checked_add(size).and_then(|n| n.checked_add(4));
        if behind.is_none_or(|n| n > record.length) {
            return Err(fault("an attachment is shorter than it claims"));
        }
        let crc = bytes.read(record.body + data + size, 4)?;
        Ok(StoredAttachment {
            header,
            data: record.body + data,
            size,
            body: record.body,
            crc: u32::from_le_bytes([crc[0], crc[1], crc[2], crc[3]]),
        })
    }

    /// Returns the attachment's description for lists.
    pub fn info(&self, at: u64) -> AttachmentInfo {
        AttachmentInfo {
            name: self.header.name.clone(),
            media_type: self.header.media_type.clone(),
            log_time: self.header.log_time,
            offset: at,
            size: self.size,
        }
    }

    /// Verifies the checksum if there is one.
    pub fn verify_checksum(&self, bytes: &FileBytes, at: u64) -> Result<()> {
        if self.crc == 0 {
            return Ok(());
        }
        let mut hasher = crc32fast::Hasher::new();
        visit_blocks(bytes, self.body, self.data + self.size, |block| {
            hasher.update(block);
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

    /// Calls `fun` with its data, block by block.
    pub fn visit_data(
        &self,
        bytes: &FileBytes,
        fun: impl FnMut(&[u8]) -> Result<()>,
    ) -> Result<()> {
        visit_blocks(bytes, self.data, self.data + self.size, fun)
    }
}

fn visit_blocks(
    bytes: &FileBytes,
    from: u64,
    until: u64,
    mut fun: impl FnMut(&[u8]) -> Result<()>,
) -> Result<()> {
    let mut at = from;
    while at < until {
        let block = bytes.read(at, BLOCK.min(until - at))?;
        fun(&block)?;
        at += block.len() as u64;
    }
    Ok(())
}

/// Parses the header, the offset of the data in the body, and their size.
fn parse_fields(head: &[u8]) -> Option<(AttachmentHeader, u64, u64)> {
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

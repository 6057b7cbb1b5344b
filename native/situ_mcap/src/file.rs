//! Reads the bytes of a file, and its records by their offsets.

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::Path;

use crate::{Error, Result};

/// The maximum size of a record. Only chunks and attachments come near it.
pub const MOST_RECORD: u64 = 1 << 30;

pub struct FileBytes {
    file: File,
    pub size: u64,
}

/// A record's operation code, the offset of its body, and the length it claims to have.
#[derive(Debug, Clone, Copy)]
pub struct RecordHead {
    pub opcode: u8,
    pub body: u64,
    pub length: u64,
}

impl RecordHead {
    pub fn end(&self) -> u64 {
        self.body.saturating_add(self.length)
    }
}

impl FileBytes {
    pub fn open(path: &Path) -> Result<Self> {
        let file = File::open(path).map_err(|e| Error::io("open", &e))?;
        let size = file.metadata().map_err(|e| Error::io("look at", &e))?.len();
        Ok(FileBytes { file, size })
    }

    /// Reads `length` bytes from `at` on. Allocates no more than the file has.
    pub fn read(&self, at: u64, length: u64) -> Result<Vec<u8>> {
        if at.checked_add(length).is_none_or(|end| end > self.size) || length > MOST_RECORD {
            let why = format!(
                "a record needs {length} bytes there, but the file has {}",
                self.size
            );
            return Err(Error::Damaged(at, why));
        }
        let mut bytes = vec![0; length as usize];
        match self.file.read_exact_at(&mut bytes, at) {
            Ok(()) => Ok(bytes),
            Err(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => Err(Error::Damaged(
                at,
                "the file has become shorter".to_string(),
            )),
            Err(e) => Err(Error::io("read", &e)),
        }
    }

    /// Reads the head of the record at `at`, or `None` at the end of the file.
    pub fn record_head(&self, at: u64) -> Result<Option<RecordHead>> {
        if at + 9 > self.size {
            return Ok(None);
        }
        let head = self.read(at, 9)?;
        let mut length = [0; 8];
        length.copy_from_slice(&head[1..]);
        Ok(Some(RecordHead {
            opcode: head[0],
            body: at + 9,
            length: u64::from_le_bytes(length),
        }))
    }

    /// Reads a record's body, which must be within the file.
    pub fn record_body(&self, record: RecordHead) -> Result<Vec<u8>> {
        self.read(record.body, record.length)
    }
}

/// Parses a record. Rejects records that would make the `mcap` crate panic.
pub fn parse_record(opcode: u8, body: &[u8], at: u64) -> Result<mcap::records::Record<'_>> {
    if opcode == mcap::records::op::ATTACHMENT && body.len() < 40 {
        return Err(Error::Damaged(at, "an attachment is too short".to_string()));
    }
    mcap::parse_record(opcode, body).map_err(|e| Error::Damaged(at, e.to_string()))
}

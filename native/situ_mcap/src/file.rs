//! The bytes of a file, and its records by where they lie.

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::Path;

use crate::{Error, Result};

/// No record but a chunk or an attachment is anywhere near that long.
pub const MOST_RECORD: u64 = 1 << 30;

pub struct Bytes {
    file: File,
    pub size: u64,
}

/// A record's operation code, where its body begins and how long that says to be.
#[derive(Debug, Clone, Copy)]
pub struct Place {
    pub opcode: u8,
    pub body: u64,
    pub length: u64,
}

impl Place {
    pub fn end(&self) -> u64 {
        self.body.saturating_add(self.length)
    }
}

impl Bytes {
    pub fn open(path: &Path) -> Result<Self> {
        let file = File::open(path).map_err(|e| Error::io("open", &e))?;
        let size = file.metadata().map_err(|e| Error::io("look at", &e))?.len();
        Ok(Bytes { file, size })
    }

    /// `length` bytes from `at` on; no more is allocated than there are.
    pub fn read(&self, at: u64, length: u64) -> Result<Vec<u8>> {
        if at.checked_add(length).is_none_or(|end| end > self.size) || length > MOST_RECORD {
            let why = format!(
                "{length} bytes are wanted there, the file has {}",
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

    /// The record that begins at `at`, or `None` where the file has no more.
    pub fn place(&self, at: u64) -> Result<Option<Place>> {
        if at + 9 > self.size {
            return Ok(None);
        }
        let head = self.read(at, 9)?;
        let mut length = [0; 8];
        length.copy_from_slice(&head[1..]);
        Ok(Some(Place {
            opcode: head[0],
            body: at + 9,
            length: u64::from_le_bytes(length),
        }))
    }

    /// A record's body; it must lie in the file.
    pub fn body(&self, place: Place) -> Result<Vec<u8>> {
        self.read(place.body, place.length)
    }
}

/// A record parsed; what the crate would trip over is refused before.
pub fn parse(opcode: u8, body: &[u8], at: u64) -> Result<mcap::records::Record<'_>> {
    if opcode == mcap::records::op::ATTACHMENT && body.len() < 40 {
        return Err(Error::Damaged(
            at,
            "an attachment that is too short".to_string(),
        ));
    }
    mcap::parse_record(opcode, body).map_err(|e| Error::Damaged(at, e.to_string()))
}

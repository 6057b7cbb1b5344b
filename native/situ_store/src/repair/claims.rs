//! The index as it lies there: every entry that its checksum vouches for, at its number.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use crate::error::{Error, Result};
use crate::format::*;
use crate::index;
use crate::reader::Damage;

pub(super) struct Claims {
    /// `None` when there is no index or its header is damaged.
    pub header: Option<IndexHeader>,
    /// How many entries the header says are committed.
    pub published: u64,
    /// For how many there is room in the file.
    pub room: u64,
    pub entries: Vec<Option<Entry>>,
    /// The index ends before its last entry.
    pub short: bool,
    pub closed: bool,
    pub damage: Vec<Damage>,
}

impl Claims {
    pub fn read(dir: &Path) -> Result<Claims> {
        let mut claims = Claims {
            header: None,
            published: 0,
            room: 0,
            entries: Vec::new(),
            short: false,
            closed: false,
            damage: Vec::new(),
        };
        let failed = |e: std::io::Error| Error::io("read index.situ", e);
        let mut file = match File::open(dir.join(index::FILE)) {
            Ok(file) => file,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
                claims.note(0, "there is no index");
                return Ok(claims);
            }
            Err(e) => return Err(failed(e)),
        };
        let length = file.metadata().map_err(failed)?.len();
        let mut head = vec![0; INDEX_HEADER];
        if length < INDEX_HEADER as u64 {
            claims.note(0, "the index is shorter than its header");
            return Ok(claims);
        }
        file.read_exact(&mut head).map_err(failed)?;
        claims.room = (length - INDEX_HEADER as u64) / ENTRY as u64;
        claims.published = u64_at(&head, COMMITTED_AT);
        claims.closed = head[STATE_AT] == 1;
        match IndexHeader::decode(&head) {
            Ok(header) => claims.header = Some(header),
            Err(Error::Newer(version)) => return Err(Error::Newer(version)),
            Err(_) => claims.note(0, "the index's header is damaged"),
        }
        // Without a header no reader could open the store: only the chunks show how many entries were committed.
        let n = if claims.header.is_some() {
            claims.short = claims.published > claims.room;
            claims.published.min(claims.room)
        } else {
            0
        };
        if claims.short {
            let end = INDEX_HEADER as u64 + claims.room * ENTRY as u64;
            claims.note(end, "the index ends before its last entry");
        }
        claims.load(&mut file, n).map_err(failed)?;
        Ok(claims)
    }

    fn load(&mut self, file: &mut File, n: u64) -> std::io::Result<()> {
        let mut bytes = vec![0; 1024 * ENTRY];
        let mut left = n as usize;
        while left > 0 {
            let some = left.min(1024);
            let bytes = &mut bytes[..some * ENTRY];
            file.read_exact(bytes)?;
            for entry in bytes.chunks_exact(ENTRY) {
                let entry = Entry::decode(entry);
                if entry.is_none() {
                    let at = INDEX_HEADER + self.entries.len() * ENTRY;
                    self.note(at as u64, "the entry's checksum is wrong");
                }
                self.entries.push(entry);
            }
            left -= some;
        }
        Ok(())
    }

    /// Whether every committed chunk has its entry.
    pub fn whole(&self) -> bool {
        self.header.is_some() && !self.short && self.entries.iter().all(Option::is_some)
    }

    fn note(&mut self, offset: u64, why: &str) {
        self.damage.push(Damage {
            file: index::FILE.into(),
            offset,
            why: why.into(),
        });
    }
}

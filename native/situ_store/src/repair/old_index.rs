//! Reads the existing index: every entry with a valid checksum, at its number.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use crate::error::{Error, Result};
use crate::format::*;
use crate::index;
use crate::reader::Damage;

pub(super) struct OldIndex {
    /// `None` if there is no index or its header is damaged.
    pub header: Option<IndexHeader>,
    /// The number of committed entries according to the header.
    pub published: u64,
    /// The number of entries that fit into the file.
    pub room: u64,
    pub entries: Vec<Option<Entry>>,
    /// Whether the index ends before its last entry.
    pub short: bool,
    pub closed: bool,
    pub damage: Vec<Damage>,
}

impl OldIndex {
    pub fn read(dir: &Path) -> Result<OldIndex> {
        let mut index = OldIndex {
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
                index.note_damage(0, "there is no index");
                return Ok(index);
            }
            Err(e) => return Err(failed(e)),
        };
        let length = file.metadata().map_err(failed)?.len();
        let mut head = vec![0; INDEX_HEADER];
        if length < INDEX_HEADER as u64 {
            index.note_damage(0, "the index is shorter than its header");
            return Ok(index);
        }
        file.read_exact(&mut head).map_err(failed)?;
        index.room = (length - INDEX_HEADER as u64) / ENTRY as u64;
        index.published = u64_at(&head, COMMITTED_AT);
        index.closed = head[STATE_AT] == 1;
        match IndexHeader::decode(&head) {
            Ok(header) => index.header = Some(header),
            Err(Error::Newer(version)) => return Err(Error::Newer(version)),
            Err(_) => index.note_damage(0, "the index's header is damaged"),
        }
        // Without a header no reader can open the store, and only the chunks show how many entries were committed.
        let n = if index.header.is_some() {
            index.short = index.published > index.room;
            index.published.min(index.room)
        } else {
            0
        };
        if index.short {
            let end = INDEX_HEADER as u64 + index.room * ENTRY as u64;
            index.note_damage(end, "the index ends before its last entry");
        }
        index.load_entries(&mut file, n).map_err(failed)?;
        Ok(index)
    }

    fn load_entries(&mut self, file: &mut File, n: u64) -> std::io::Result<()> {
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
                    self.note_damage(at as u64, "the entry's checksum is wrong");
                }
                self.entries.push(entry);
            }
            left -= some;
        }
        Ok(())
    }

    /// Returns whether every committed chunk has its entry.
    pub fn is_complete(&self) -> bool {
        self.header.is_some() && !self.short && self.entries.iter().all(Option::is_some)
    }

    fn note_damage(&mut self, offset: u64, why: &str) {
        self.damage.push(Damage {
            file: index::FILE.into(),
            offset,
            why: why.into(),
        });
    }
}

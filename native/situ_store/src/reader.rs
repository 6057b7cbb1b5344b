//! The reader: directories from the index, chunks from mapped extents. Trusts nothing it has not checked.

mod directory;
mod maps;
mod statistics;
mod summary;

use std::collections::HashMap;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, RwLock, RwLockReadGuard};

use memmap2::Mmap;
use rustix::fs::{flock, FlockOperation};

use crate::chunk::{self, Body, Messages};
use crate::error::{Error, Result};
use crate::extent;
use crate::format::*;
use crate::index::{self, word};

use directory::Index;
use maps::Extents;
use summary::Computed;

pub(crate) use maps::{file_length, map_file};
pub use statistics::Statistics;

#[derive(Debug, Clone, PartialEq)]
pub struct Damage {
    pub file: String,
    pub offset: u64,
    pub why: String,
}

pub struct Reader {
    dir: PathBuf,
    pub header: IndexHeader,
    file: File,
    head: Mmap,
    index: RwLock<Index>,
    extents: Extents,
    /// Pyramids computed for want of stored ones: (level, bins, messages seen).
    computed: Mutex<HashMap<u32, Computed>>,
    /// Check payloads of large chunks too.
    pub verify_large: bool,
}

/// A checked chunk: its header, its raw body, and the map it lies in.
pub struct Chunk {
    pub header: ChunkHeader,
    pub map: Arc<Mmap>,
    start: usize,
    unpacked: Option<Vec<u8>>,
}

impl Chunk {
    pub fn body(&self) -> &[u8] {
        match &self.unpacked {
            Some(bytes) => bytes,
            None => &self.map[self.start + CHUNK_HEADER..self.start + self.header.length as usize],
        }
    }

    /// Where the body lies in the map, when it lies there (it was not compressed).
    pub fn mapped_at(&self) -> Option<usize> {
        self.unpacked.is_none().then_some(self.start + CHUNK_HEADER)
    }

    pub fn take_unpacked(&mut self) -> Option<Vec<u8>> {
        self.unpacked.take()
    }

    /// The number drawn for a message, where there is one.
    pub fn number(&self, value: &chunk::Value) -> Option<f64> {
        match *value {
            chunk::Value::Bytes { start, length } if self.header.encoding == Encoding::Term => {
                chunk::term_number(self.body().get(start..start + length)?)
            }
            _ => value.number(),
        }
    }

    pub fn messages(&self) -> Messages<'_> {
        Messages::new(&self.header, self.body())
    }
}

fn is_plain(chunk: &[u8]) -> bool {
    ChunkHeader::decode(chunk).is_ok_and(|header| header.compression == Compression::None)
}

impl Reader {
    pub fn open(dir: &Path) -> Result<Reader> {
        let file = File::open(dir.join(index::FILE)).map_err(|e| match e.kind() {
            std::io::ErrorKind::NotFound => Error::NoStore,
            _ => Error::io("open index.situ", e),
        })?;
        if file_length(&file, index::FILE)? < INDEX_HEADER as u64 {
            return Err(Error::NotAStore);
        }
        let head = map_file(&file, 0, INDEX_HEADER as u64, index::FILE)?;
        let header = IndexHeader::decode(&head)?;
        let reader = Reader {
            dir: dir.to_path_buf(),
            header,
            file,
            head,
            index: RwLock::default(),
            extents: Extents::new(dir.to_path_buf(), header.id),
            computed: Mutex::new(HashMap::new()),
            verify_large: true,
        };
        reader.refresh()?;
        Ok(reader)
    }

    pub fn dir(&self) -> &Path {
        &self.dir
    }

    pub fn is_closed(&self) -> bool {
        self.head[STATE_AT] == 1
    }

    /// Whether a writer holds the store now.
    pub fn is_live(&self) -> bool {
        if self.is_closed() {
            return false;
        }
        match File::open(self.dir.join("lock")) {
            Err(_) => false,
            Ok(file) => match flock(&file, FlockOperation::NonBlockingLockShared) {
                Ok(()) => {
                    let _ = flock(&file, FlockOperation::Unlock);
                    false
                }
                Err(_) => true,
            },
        }
    }

    /// How many entries the writer has published.
    pub fn published(&self) -> u64 {
        word(&self.head, COMMITTED_AT).load(Ordering::Acquire)
    }

    pub fn synced(&self) -> u64 {
        word(&self.head, SYNCED_AT).load(Ordering::Acquire)
    }

    pub(crate) fn head(&self) -> &Mmap {
        &self.head
    }

    fn lock_index(&self) -> RwLockReadGuard<'_, Index> {
        self.index
            .read()
            .unwrap_or_else(|poisoned| poisoned.into_inner())
    }

    /// Takes in what was published since; the number of entries now known.
    pub fn refresh(&self) -> Result<u64> {
        let published = self.published();
        let loaded = self.lock_index().loaded;
        if loaded >= published {
            return Ok(loaded);
        }
        let mut index = self
            .index
            .write()
            .unwrap_or_else(|poisoned| poisoned.into_inner());
        index.load(published, &self.file)
    }

    /// What was found wrong so far.
    pub fn damage(&self) -> Vec<Damage> {
        self.lock_index().damage.clone()
    }

    pub fn entries_loaded(&self) -> u64 {
        self.lock_index().loaded
    }

    /// The numbers of the streams that have messages.
    pub fn streams(&self) -> Vec<u32> {
        self.lock_index()
            .directories
            .keys()
            .filter(|(_, level)| *level == 0)
            .map(|(stream, _)| *stream)
            .collect()
    }

    pub fn count(&self, stream: u32) -> u64 {
        self.lock_index()
            .entries(stream, 0)
            .map_or(0, |entries| entries.count())
    }

    /// The chunk an entry names, checked.
    pub fn chunk(&self, entry: &Entry) -> Result<Chunk> {
        self.chunk_checked(entry, self.verify_large || entry.lane == LANE_DATA)
    }

    pub fn chunk_checked(&self, entry: &Entry, body_too: bool) -> Result<Chunk> {
        let map = self.extents.get(entry.lane, entry.extent)?;
        let broken =
            |why: &str| Error::damaged(extent::name(entry.lane, entry.extent), entry.offset, why);
        let start = usize::try_from(entry.offset)
            .ok()
            .filter(|at| *at <= map.len());
        let start = start.ok_or_else(|| broken("the extent ends before the chunk"))?;
        let header = ChunkHeader::decode(&map[start..]).map_err(broken)?;
        let same = header.stream == entry.stream
            && header.level == entry.level
            && header.count == entry.count
            && header.length == entry.length
            && header.first == entry.first
            && header.last == entry.last;
        if !same {
            return Err(broken("the chunk is not the one the index names"));
        }
        self.extents.touch(&map, start, header.length as usize);
        let unpacked = match chunk::open(&header, &map[start..], !body_too).map_err(broken)? {
            Body::Mapped(_) => None,
            Body::Unpacked(bytes) => Some(bytes),
        };
        Ok(Chunk {
            header,
            map,
            start,
            unpacked,
        })
    }

    /// Whether the chunk can be read (and, where it is to be, checked) without waiting for a disk, and in little time.
    pub fn is_quick(&self, entry: &Entry) -> bool {
        let length = match (entry.lane, self.verify_large) {
            (LANE_DATA, _) => entry.length as usize,
            (_, false) => CHUNK_HEADER,
            (_, true) => return false,
        };
        let Ok(start) = usize::try_from(entry.offset) else {
            return false;
        };
        self.extents
            .mapped(entry.lane, entry.extent)
            .is_some_and(|map| {
                maps::resident(&map, start, length)
                    && (entry.lane == LANE_DATA || is_plain(&map[start..]))
            })
    }

    /// The entry holding message `ordinal` of a stream, if it has so many.
    pub fn entry_at(&self, stream: u32, ordinal: u64) -> Option<Entry> {
        let index = self.lock_index();
        let entries = index.entries(stream, 0)?;
        entries.get(entries.at_ordinal(ordinal))
    }

    /// The ordinal of the first message at or after `time` (the stream's count when there is none).
    pub fn ordinal_from(&self, stream: u32, time: i64) -> Result<u64> {
        let (entry, count) = {
            let index = self.lock_index();
            let Some(entries) = index.entries(stream, 0) else {
                return Ok(0);
            };
            (entries.get(entries.at_time(time)), entries.count())
        };
        let Some(entry) = entry else { return Ok(count) };
        if entry.first >= time {
            return Ok(entry.ordinal);
        }
        let chunk = self.chunk_checked(&entry, entry.lane == LANE_DATA)?;
        let mut ordinal = entry.ordinal;
        for message in chunk.messages() {
            let (envelope, _) = message.map_err(|why| self.broken(&entry, why))?;
            if envelope.time >= time {
                break;
            }
            ordinal += 1;
        }
        Ok(ordinal)
    }

    pub fn broken(&self, entry: &Entry, why: &str) -> Error {
        Error::damaged(extent::name(entry.lane, entry.extent), entry.offset, why)
    }

    /// All entries, as far as they are sound.
    pub fn all_entries(&self) -> Vec<Entry> {
        let index = self.lock_index();
        (0..index.loaded)
            .filter_map(|at| index.raw_entry(at))
            .collect()
    }
}

//! The reader: directories from the index, chunks from mapped extents. Trusts nothing it has not checked.

mod directory;
mod maps;
mod statistics;
mod summary;
mod tracks;

use std::collections::HashMap;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, RwLock, RwLockReadGuard};

use rustix::fs::{flock, FlockOperation};

use crate::chunk::{self, Body, Messages};
use crate::error::{Error, Result};
use crate::extent;
use crate::format::*;
use crate::guard::Map;
use crate::index::{self, word, CUT};

use directory::Index;
use maps::Extents;
use summary::Computed;

pub(crate) use maps::{file_length, map_file};
pub use statistics::Statistics;
pub use tracks::{lock, Known, Line, Told};

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
    head: Map,
    index: RwLock<Index>,
    extents: Extents,
    /// Pyramids computed for want of stored ones: (level, bins, messages seen).
    computed: Mutex<HashMap<u32, Computed>>,
    /// What is remembered of the tracks of streams.
    known: tracks::KnownStreams,
    /// Check payloads of large chunks too.
    pub verify_large: bool,
    /// The most bytes that a message may unpack to.
    pub max_unpacked: usize,
}

/// A checked chunk: its header, its raw body, and the map it lies in.
pub struct Chunk {
    pub header: ChunkHeader,
    pub map: Arc<Map>,
    start: usize,
    held: Held,
}

/// What of a chunk is held beside its map.
enum Held {
    Nothing,
    /// Its table, so that the map need not be looked at for it.
    Table(Vec<u8>),
    /// What it unpacked to.
    Body(Arc<Vec<u8>>),
}

impl Chunk {
    pub fn body(&self) -> &[u8] {
        match &self.held {
            Held::Body(bytes) => bytes,
            _ => {
                &self.map[self.start + self.header.size()..self.start + self.header.length as usize]
            }
        }
    }

    /// Where the body lies in the map, when it lies there (it was not compressed).
    pub fn mapped_at(&self) -> Option<usize> {
        (!matches!(self.held, Held::Body(_))).then(|| self.start + self.header.size())
    }

    /// What it unpacked to, where it was compressed.
    pub fn unpacked(&self) -> Option<Arc<Vec<u8>>> {
        match &self.held {
            Held::Body(bytes) => Some(bytes.clone()),
            _ => None,
        }
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
        match &self.held {
            Held::Table(table) => Messages::with_table(&self.header, self.body(), table),
            _ => Messages::new(&self.header, self.body()),
        }
    }
}

pub(crate) fn names(entry: &Entry, header: &ChunkHeader) -> bool {
    header.stream == entry.stream
        && header.level == entry.level
        && header.count == entry.count
        && header.length == entry.length
        && header.first == entry.first
        && header.last == entry.last
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
            known: Mutex::default(),
            verify_large: true,
            max_unpacked: MAX_UNPACKED,
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

    /// How many entries were published that are not taken in yet.
    pub fn behind(&self) -> u64 {
        self.published().saturating_sub(self.entries_loaded())
    }

    /// The header of the chunk an entry names; its body is not looked at.
    pub fn chunk_header(&self, entry: &Entry) -> Result<ChunkHeader> {
        let map = self.extents.get(entry.lane, entry.extent)?;
        let at = usize::try_from(entry.offset).ok();
        let bytes = at.and_then(|at| map.get(at..));
        let header = bytes
            .ok_or("the extent ends before the chunk")
            .and_then(ChunkHeader::decode)
            .map_err(|why| self.broken(entry, why))?;
        Ok(header)
    }

    /// How many entries the writer has published.
    pub fn published(&self) -> u64 {
        word(&self.head, COMMITTED_AT).load(Ordering::Acquire)
    }

    pub fn synced(&self) -> u64 {
        word(&self.head, SYNCED_AT).load(Ordering::Acquire)
    }

    pub(crate) fn head(&self) -> &Map {
        &self.head
    }

    fn lock_index(&self) -> RwLockReadGuard<'_, Index> {
        self.index
            .read()
            .unwrap_or_else(|poisoned| poisoned.into_inner())
    }

    /// An error when the index was cut by somebody since it was opened: what it answered then means nothing.
    pub fn whole(&self) -> Result<()> {
        if self.head.torn() || self.lock_index().torn() {
            return Err(Error::damaged(index::FILE, 0, CUT));
        }
        Ok(())
    }

    /// Takes in what was published since; the number of entries now known.
    pub fn refresh(&self) -> Result<u64> {
        self.whole()?;
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
        if entry.lane == LANE_LARGE && !body_too {
            if let Some(chunk) = self.headed(entry, &map, true) {
                return Ok(chunk);
            }
        }
        let broken = |why: &str| {
            let why = if map.torn() { CUT } else { why };
            Error::damaged(extent::name(entry.lane, entry.extent), entry.offset, why)
        };
        let start = usize::try_from(entry.offset)
            .ok()
            .filter(|at| *at <= map.len());
        let start = start.ok_or_else(|| broken("the extent ends before the chunk"))?;
        let header = ChunkHeader::decode(&map[start..]).map_err(broken)?;
        if !names(entry, &header) {
            return Err(broken("the chunk is not the one the index names"));
        }
        self.extents.touch(&map, start, header.length as usize);
        let most = match entry.lane {
            LANE_DATA => MAX_SMALL_BODY,
            _ => self.max_unpacked,
        };
        let held = match chunk::open(&header, &map[start..], !body_too, most).map_err(broken)? {
            Body::Mapped(_) => Held::Nothing,
            Body::Unpacked(bytes) => Held::Body(Arc::new(bytes)),
        };
        Ok(Chunk {
            header,
            map,
            start,
            held,
        })
    }

    /// A large chunk whose payload nobody checks: its map is not looked at.
    fn headed(&self, entry: &Entry, map: &Arc<Map>, wait: bool) -> Option<Chunk> {
        let (header, table) = self.extents.head(entry, map, wait)?;
        let start = usize::try_from(entry.offset).ok()?;
        let end = start.checked_add(header.length as usize)?;
        if !names(entry, &header) || end > map.len() {
            return None;
        }
        self.extents.touch(map, start, end - start);
        Some(Chunk {
            header,
            map: map.clone(),
            start,
            held: Held::Table(table),
        })
    }

    /// The chunk, when it can be read (and, where it is to be, checked) without waiting for a disk, and in little time.
    pub fn quick_chunk(&self, entry: &Entry) -> Option<Result<Chunk>> {
        let map = self.extents.mapped(entry.lane, entry.extent)?;
        if entry.lane == LANE_LARGE {
            // A term of that size takes long to make.
            let chunk = match self.verify_large {
                true => None,
                false => self.headed(entry, &map, false),
            };
            return chunk
                .filter(|chunk| chunk.header.encoding != Encoding::Term)
                .map(Ok);
        }
        let start = usize::try_from(entry.offset).ok()?;
        maps::resident(&map, start, entry.length as usize).then(|| self.chunk(entry))
    }

    /// The entry holding message `ordinal` of a stream, if it has so many.
    pub fn entry_at(&self, stream: u32, ordinal: u64) -> Result<Option<Entry>> {
        let entry = {
            let index = self.lock_index();
            let entries = index.entries(stream, 0);
            entries.and_then(|entries| entries.get(entries.at_ordinal(ordinal)))
        };
        self.whole()?;
        Ok(entry)
    }

    /// The ordinal of the first message at or after `time` (the stream's count when there is none).
    pub fn ordinal_from(&self, stream: u32, time: i64) -> Result<u64> {
        Ok(self.find(stream, time, false)?.unwrap_or_default())
    }

    /// As `ordinal_from`; `None` when that has to wait for a disk.
    pub fn ordinal_quick(&self, stream: u32, time: i64) -> Result<Option<u64>> {
        self.find(stream, time, true)
    }

    fn find(&self, stream: u32, time: i64, quick: bool) -> Result<Option<u64>> {
        let (entry, count) = {
            let index = self.lock_index();
            let Some(entries) = index.entries(stream, 0) else {
                return Ok(Some(0));
            };
            (entries.get(entries.at_time(time)), entries.count())
        };
        self.whole()?;
        let Some(entry) = entry else {
            return Ok(Some(count));
        };
        // A large chunk holds one message.
        if entry.first >= time || entry.lane == LANE_LARGE {
            return Ok(Some(entry.ordinal));
        }
        let chunk = if quick {
            match self.quick_chunk(&entry) {
                Some(chunk) => chunk?,
                None => return Ok(None),
            }
        } else {
            self.chunk(&entry)?
        };
        let mut ordinal = entry.ordinal;
        for message in chunk.messages() {
            let (envelope, _) = message.map_err(|why| self.broken(&entry, why))?;
            if envelope.time >= time {
                break;
            }
            ordinal += 1;
        }
        Ok(Some(ordinal))
    }

    pub fn broken(&self, entry: &Entry, why: &str) -> Error {
        Error::damaged(extent::name(entry.lane, entry.extent), entry.offset, why)
    }

    /// All entries, as far as they are sound.
    pub fn all_entries(&self) -> Vec<Entry> {
        let index = self.lock_index();
        (0..index.loaded)
            .filter_map(|at| index.raw_entry(at))
            .filter(|entry| !entry.is_hole())
            .collect()
    }
}

//! The reader: directories from the index, chunks from mapped extents. Trusts nothing it has not checked.

mod changes;
mod chunk;
mod directory;
mod gaps;
mod levels;
mod maps;
mod statistics;
mod summary;
mod tracks;

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::sync::{Mutex, MutexGuard, RwLock, RwLockReadGuard};

use rustix::fs::{flock, FlockOperation};

use crate::error::{Error, Result};
use crate::format::*;
use crate::guard::Map;
use crate::index::{self, word, CUT};

use directory::Index;
use maps::Extents;

pub(crate) use chunk::names;
pub use chunk::Chunk;
pub(crate) use maps::{file_length, map_file};
pub use statistics::Statistics;
pub use tracks::{Known, Line, Told};

/// The lock, whatever became of a thread that held it.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex
        .lock()
        .unwrap_or_else(|poisoned| poisoned.into_inner())
}

/// A damaged place in a store.
#[derive(Debug, Clone, PartialEq)]
pub struct Damage {
    /// The file's name in the store's folder.
    pub file: String,
    /// Where in the file, bytes from its beginning.
    pub offset: u64,
    /// The damage in words.
    pub why: String,
}

/// An open store: its index in memory, its extents mapped when they are needed. Threads may share it.
pub struct Reader {
    dir: PathBuf,
    /// The header of the index.
    pub header: IndexHeader,
    file: File,
    head: Map,
    index: RwLock<Index>,
    extents: Extents,
    /// Pyramids of signals, made in memory where the store has none.
    made: summary::Made,
    /// Names and bins of the streams' tracks, kept between calls.
    known: tracks::KnownStreams,
    /// Check payloads of large chunks too.
    pub verify_large: bool,
    /// The most bytes that a message may unpack to.
    pub max_unpacked: usize,
}

impl Reader {
    /// Opens the store in folder `dir`, also while it is being written.
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
            made: Mutex::default(),
            known: Mutex::default(),
            verify_large: true,
            max_unpacked: MAX_UNPACKED,
        };
        reader.refresh()?;
        Ok(reader)
    }

    /// The store's folder.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// Whether a writer or a repair has closed the store.
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

    /// How many entries the writer has published.
    pub fn published(&self) -> u64 {
        word(&self.head, COMMITTED_AT).load(Ordering::Acquire)
    }

    /// How many entries the writer knows to be on the disk.
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

    /// An error if another program has cut the index since it was opened: then its answers are void.
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

    /// The damage found so far.
    pub fn damage(&self) -> Vec<Damage> {
        self.lock_index().damage.clone()
    }

    /// How many entries of the index are taken in.
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

    /// How many messages a stream has.
    pub fn count(&self, stream: u32) -> u64 {
        self.lock_index()
            .entries(stream, 0)
            .map_or(0, |entries| entries.count())
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

    /// All sound entries.
    pub fn all_entries(&self) -> Vec<Entry> {
        let index = self.lock_index();
        (0..index.loaded)
            .filter_map(|at| index.raw_entry(at))
            .filter(|entry| !entry.is_hole())
            .collect()
    }
}

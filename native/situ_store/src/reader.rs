//! The reader: builds directories from the index and reads chunks from mapped extents. It checks everything before
//! using it.

mod changes;
mod chunk;
mod directory;
mod gaps;
mod levels;
mod maps;
mod residency;
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
use crate::index::{self, atomic_word, FILE_WAS_CUT};

use directory::Index;
use maps::Extents;

pub(crate) use chunk::matches_header;
pub use chunk::Chunk;
pub(crate) use maps::{file_length, map_file};
pub use residency::{has_absent, take_absent, AbsentRange};
pub use statistics::Statistics;
pub use tracks::{Line, TrackCache, TrackData};

/// Locks a mutex, even if another thread panicked while holding it.
pub fn lock_mutex<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex
        .lock()
        .unwrap_or_else(|poisoned| poisoned.into_inner())
}

/// Damage at one position of a store.
#[derive(Debug, Clone, PartialEq)]
pub struct Damage {
    /// The file's name in the store's folder.
    pub file: String,
    /// The offset in the file, bytes.
    pub offset: u64,
    /// A description of the damage.
    pub why: String,
}

/// An open store: its index in memory, and its extents, which are mapped on first use. Threads may share it.
pub struct Reader {
    dir: PathBuf,
    /// The header of the index.
    pub header: IndexHeader,
    file: File,
    head: Map,
    index: RwLock<Index>,
    extents: Extents,
    /// Pyramids of signals, computed in memory for streams without stored ones.
    memory_pyramids: summary::MemoryPyramids,
    /// Names and bins of the streams' tracks, cached between calls.
    track_caches: tracks::TrackCaches,
    /// Whether the payloads of large chunks are checked, too.
    pub verify_large: bool,
    /// The maximum unpacked size of a message, bytes.
    pub max_unpacked: usize,
}

impl Reader {
    /// Opens the store in folder `dir`. The store may be growing.
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
            memory_pyramids: Mutex::default(),
            track_caches: Mutex::default(),
            verify_large: true,
            max_unpacked: MAX_UNPACKED,
        };
        reader.refresh()?;
        Ok(reader)
    }

    /// Returns the store's folder.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// Returns whether a writer or a repair has closed the store.
    pub fn is_closed(&self) -> bool {
        self.head[STATE_AT] == 1
    }

    /// Returns whether a writer has the store open now.
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

    /// Returns the number of published entries that the reader has not loaded yet.
    pub fn pending_entries(&self) -> u64 {
        self.published_entries()
            .saturating_sub(self.entries_loaded())
    }

    /// Returns the number of entries that the writer has published.
    pub fn published_entries(&self) -> u64 {
        atomic_word(&self.head, COMMITTED_AT).load(Ordering::Acquire)
    }

    /// Returns the number of entries that the writer has synced to disk.
    pub fn synced_entries(&self) -> u64 {
        atomic_word(&self.head, SYNCED_AT).load(Ordering::Acquire)
    }

    pub(crate) fn header_map(&self) -> &Map {
        &self.head
    }

    fn lock_index(&self) -> RwLockReadGuard<'_, Index> {
        self.index
            .read()
            .unwrap_or_else(|poisoned| poisoned.into_inner())
    }

    /// Returns an error if another program has truncated the index since it was opened, which makes all results
    /// invalid.
    pub fn check_intact(&self) -> Result<()> {
        if self.head.is_torn() || self.lock_index().is_torn() {
            return Err(Error::damaged(index::FILE, 0, FILE_WAS_CUT));
        }
        Ok(())
    }

    /// Loads newly published entries and returns the total number of loaded entries.
    pub fn refresh(&self) -> Result<u64> {
        self.check_intact()?;
        let published = self.published_entries();
        let loaded = self.lock_index().loaded;
        if loaded >= published {
            return Ok(loaded);
        }
        let mut index = self
            .index
            .write()
            .unwrap_or_else(|poisoned| poisoned.into_inner());
        index.load_entries(published, &self.file)
    }

    /// Returns the damage found so far.
    pub fn damage(&self) -> Vec<Damage> {
        self.lock_index().damage.clone()
    }

    /// Returns the number of loaded index entries.
    pub fn entries_loaded(&self) -> u64 {
        self.lock_index().loaded
    }

    /// Returns the numbers of the streams that have messages.
    pub fn stream_numbers(&self) -> Vec<u32> {
        self.lock_index()
            .directories
            .keys()
            .filter(|(_, level)| *level == 0)
            .map(|(stream, _)| *stream)
            .collect()
    }

    /// Returns the number of messages in a stream.
    pub fn message_count(&self, stream: u32) -> u64 {
        self.lock_index()
            .stream_entries(stream, 0)
            .map_or(0, |entries| entries.message_count())
    }

    /// Returns the entry of the chunk that contains message `ordinal` of a stream, or `None` after the last
    /// message.
    pub fn entry_at(&self, stream: u32, ordinal: u64) -> Result<Option<Entry>> {
        let entry = {
            let index = self.lock_index();
            let entries = index.stream_entries(stream, 0);
            entries.and_then(|entries| entries.get(entries.position_at_ordinal(ordinal)))
        };
        self.check_intact()?;
        Ok(entry)
    }

    /// Returns the entry of the first chunk that ends at or after `time`, or `None` if there is none.
    pub fn entry_from(&self, stream: u32, time: i64) -> Result<Option<Entry>> {
        let entry = {
            let index = self.lock_index();
            let entries = index.stream_entries(stream, 0);
            entries.and_then(|entries| entries.get(entries.position_at_time(time)))
        };
        self.check_intact()?;
        Ok(entry)
    }

    /// Returns the ordinal of the first message at or after `time`, or the message count if there is none.
    pub fn ordinal_from(&self, stream: u32, time: i64) -> Result<u64> {
        Ok(self.find_ordinal(stream, time, false)?.unwrap_or_default())
    }

    /// Returns the same ordinal as `ordinal_from`, or `None` if finding it might have to wait for the disk.
    pub fn quick_ordinal(&self, stream: u32, time: i64) -> Result<Option<u64>> {
        self.find_ordinal(stream, time, true)
    }

    fn find_ordinal(&self, stream: u32, time: i64, quick: bool) -> Result<Option<u64>> {
        let (entry, count) = {
            let index = self.lock_index();
            let Some(entries) = index.stream_entries(stream, 0) else {
                return Ok(Some(0));
            };
            (
                entries.get(entries.position_at_time(time)),
                entries.message_count(),
            )
        };
        self.check_intact()?;
        let Some(entry) = entry else {
            return Ok(Some(count));
        };
        // A large chunk contains a single message.
        if entry.first >= time || entry.lane == LANE_LARGE {
            return Ok(Some(entry.ordinal));
        }
        let chunk = if quick {
            match self.quick_chunk(&entry) {
                Some(chunk) => chunk?,
                None => return Ok(None),
            }
        } else {
            self.read_chunk(&entry)?
        };
        let mut ordinal = entry.ordinal;
        for message in chunk.messages() {
            let (envelope, _) = message.map_err(|why| self.chunk_error(&entry, why))?;
            if envelope.time >= time {
                break;
            }
            ordinal += 1;
        }
        Ok(Some(ordinal))
    }

    /// Returns all sound entries.
    pub fn all_entries(&self) -> Vec<Entry> {
        let index = self.lock_index();
        (0..index.loaded)
            .filter_map(|at| index.raw_entry(at))
            .filter(|entry| !entry.is_placeholder())
            .collect()
    }
}

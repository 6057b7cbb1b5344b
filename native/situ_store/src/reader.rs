//! The reader: directories from the index, chunks from mapped extents. Trusts nothing it has not checked.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, RwLock, RwLockReadGuard};

use memmap2::{Mmap, MmapOptions};
use rustix::fs::{flock, FlockOperation};

use crate::chunk::{self, Body, Messages};
use crate::error::{Error, Result};
use crate::extent;
use crate::format::*;
use crate::index::{self, word};
use crate::pyramid::{self, Bin, Folder};

#[derive(Debug, Clone, PartialEq)]
pub struct Damage {
    pub file: String,
    pub offset: u64,
    pub why: String,
}

/// The chunks of one stream at one level, in time order.
#[derive(Debug, Default)]
pub struct Directory {
    pub entries: Vec<Entry>,
    pub count: u64,
    pub stored: u64,
}

impl Directory {
    /// The first entry that ends at or after `time`.
    fn at_time(&self, time: i64) -> usize {
        self.entries.partition_point(|entry| entry.last < time)
    }

    fn at_ordinal(&self, ordinal: u64) -> usize {
        self.entries
            .partition_point(|entry| entry.ordinal + entry.count as u64 <= ordinal)
    }
}

struct Inner {
    /// Maps of the index's entries: (first byte, map).
    segments: Vec<(u64, Mmap)>,
    mapped: u64,
    loaded: u64,
    /// The index says it has more entries than it has room for.
    short: bool,
    directories: BTreeMap<(u32, u8), Directory>,
    damage: Vec<Damage>,
}

type Extents = HashMap<(u8, u32), Arc<Mmap>>;

pub struct Reader {
    dir: PathBuf,
    pub header: IndexHeader,
    file: File,
    head: Mmap,
    inner: RwLock<Inner>,
    extents: RwLock<Extents>,
    /// Pyramids computed for want of stored ones: (level, bins, messages seen).
    computed: Mutex<HashMap<u32, Computed>>,
    /// Check payloads of large chunks too.
    pub verify_large: bool,
}

#[derive(Default)]
struct Computed {
    builder: pyramid::Builder,
    levels: BTreeMap<u8, Vec<Bin>>,
    seen: u64,
}

#[derive(Debug, Clone, PartialEq)]
pub struct Statistics {
    pub count: u64,
    pub first: i64,
    pub last: i64,
    pub first_creation: i64,
    pub last_creation: i64,
    pub size_sum: u64,
    pub latency_sum: f64,
    pub stored: u64,
    pub chunks: u64,
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

#[allow(unsafe_code)]
pub(crate) fn map_file(file: &File, from: u64, length: u64, what: &str) -> Result<Mmap> {
    // SAFETY: mapped read-only and shared. The length was taken from the file; the format's writer never cuts a file
    // below what is committed, and only what is committed is looked at.
    unsafe {
        MmapOptions::new()
            .offset(from)
            .len(length as usize)
            .map(file)
    }
    .map_err(|e| Error::io(format!("map {what}"), e))
}

pub(crate) fn file_length(file: &File, what: &str) -> Result<u64> {
    file.metadata()
        .map(|m| m.len())
        .map_err(|e| Error::io(format!("size of {what}"), e))
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
            inner: RwLock::new(Inner {
                segments: Vec::new(),
                mapped: INDEX_HEADER as u64,
                loaded: 0,
                short: false,
                directories: BTreeMap::new(),
                damage: Vec::new(),
            }),
            extents: RwLock::new(HashMap::new()),
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

    fn lock_inner(&self) -> RwLockReadGuard<'_, Inner> {
        self.inner
            .read()
            .unwrap_or_else(|poisoned| poisoned.into_inner())
    }

    /// Takes in what was published since; the number of entries now known.
    pub fn refresh(&self) -> Result<u64> {
        let published = self.published();
        let loaded = self.lock_inner().loaded;
        if loaded >= published {
            return Ok(loaded);
        }
        let mut inner = self
            .inner
            .write()
            .unwrap_or_else(|poisoned| poisoned.into_inner());
        inner.load(published, &self.file)
    }

    /// What was found wrong so far.
    pub fn damage(&self) -> Vec<Damage> {
        self.lock_inner().damage.clone()
    }

    pub fn entries_loaded(&self) -> u64 {
        self.lock_inner().loaded
    }

    /// The numbers of the streams that have messages.
    pub fn streams(&self) -> Vec<u32> {
        self.lock_inner()
            .directories
            .keys()
            .filter(|(_, level)| *level == 0)
            .map(|(stream, _)| *stream)
            .collect()
    }

    pub fn count(&self, stream: u32) -> u64 {
        self.lock_inner()
            .directories
            .get(&(stream, 0))
            .map_or(0, |d| d.count)
    }

    fn extent(&self, lane: u8, number: u32) -> Result<Arc<Mmap>> {
        if let Some(map) = self
            .extents
            .read()
            .unwrap_or_else(|p| p.into_inner())
            .get(&(lane, number))
        {
            return Ok(map.clone());
        }
        let name = extent::name(lane, number);
        let file = File::open(self.dir.join(&name)).map_err(|e| match e.kind() {
            std::io::ErrorKind::NotFound => Error::MissingExtent(name.clone()),
            _ => Error::io(format!("open {name}"), e),
        })?;
        let length = file_length(&file, &name)?;
        if length < EXTENT_HEADER as u64 {
            return Err(Error::damaged(name, 0, "shorter than an extent's header"));
        }
        let map = map_file(&file, 0, length, &name)?;
        check_extent(&map, &self.header.id, lane, number)
            .map_err(|why| Error::damaged(name, 0, why))?;
        let map = Arc::new(map);
        self.extents
            .write()
            .unwrap_or_else(|p| p.into_inner())
            .insert((lane, number), map.clone());
        Ok(map)
    }

    /// The chunk an entry names, checked.
    pub fn chunk(&self, entry: &Entry) -> Result<Chunk> {
        self.chunk_checked(entry, self.verify_large || entry.lane == LANE_DATA)
    }

    pub fn chunk_checked(&self, entry: &Entry, body_too: bool) -> Result<Chunk> {
        let map = self.extent(entry.lane, entry.extent)?;
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

    /// The entry holding message `ordinal` of a stream, if it has so many.
    pub fn entry_at(&self, stream: u32, ordinal: u64) -> Option<Entry> {
        let inner = self.lock_inner();
        let directory = inner.directories.get(&(stream, 0))?;
        directory
            .entries
            .get(directory.at_ordinal(ordinal))
            .copied()
    }

    /// The ordinal of the first message at or after `time` (the stream's count when there is none).
    pub fn ordinal_from(&self, stream: u32, time: i64) -> Result<u64> {
        let (entry, count) = {
            let inner = self.lock_inner();
            let Some(directory) = inner.directories.get(&(stream, 0)) else {
                return Ok(0);
            };
            (
                directory.entries.get(directory.at_time(time)).copied(),
                directory.count,
            )
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

    pub fn statistics(&self, stream: u32) -> Result<Option<Statistics>> {
        let (first, last, count, stored, chunks) = {
            let inner = self.lock_inner();
            let Some(directory) = inner.directories.get(&(stream, 0)) else {
                return Ok(None);
            };
            let (Some(first), Some(last)) = (directory.entries.first(), directory.entries.last())
            else {
                return Ok(None);
            };
            (
                *first,
                *last,
                directory.count,
                directory.stored,
                directory.entries.len() as u64,
            )
        };
        let mut statistics = Statistics {
            count,
            first: first.first,
            last: last.last,
            first_creation: first.first_creation,
            last_creation: last.first_creation,
            size_sum: 0,
            latency_sum: 0.0,
            stored,
            chunks,
        };
        if let Ok(chunk) = self.chunk_checked(&last, last.lane == LANE_DATA) {
            statistics.size_sum = chunk.header.size_sum;
            statistics.latency_sum = chunk.header.latency_sum;
            if let Some(Ok((envelope, _))) = chunk.messages().last() {
                statistics.last_creation = envelope.creation;
            }
        }
        Ok(Some(statistics))
    }

    /// Stretches of at least `least` ns between chunks of a stream: `(from, to)`.
    pub fn gaps(&self, stream: u32, least: i64) -> Vec<(i64, i64)> {
        let inner = self.lock_inner();
        let Some(directory) = inner.directories.get(&(stream, 0)) else {
            return Vec::new();
        };
        let pairs = directory.entries.windows(2);
        pairs
            .filter(|w| w[1].first.saturating_sub(w[0].last) >= least)
            .map(|w| (w[0].last, w[1].first))
            .collect()
    }

    /// Checks the entries `from..from + n` and their chunks wholly; the damage found, and how many entries there are.
    pub fn verify(&self, from: u64, n: u64) -> Result<(Vec<Damage>, u64)> {
        let total = self.refresh()?;
        let mut found = Vec::new();
        for at in from..total.min(from.saturating_add(n)) {
            let Some(entry) = self.lock_inner().raw_entry(at) else {
                continue;
            };
            let checked = self.chunk_checked(&entry, true).and_then(|chunk| {
                let mut messages = chunk.messages();
                messages
                    .try_for_each(|m| m.map(|_| ()))
                    .map_err(|why| self.broken(&entry, why))
            });
            match checked {
                Ok(()) => {}
                Err(Error::Damaged(file, offset, why)) => found.push(Damage { file, offset, why }),
                Err(Error::MissingExtent(file)) => found.push(Damage {
                    file,
                    offset: entry.offset,
                    why: "the file is missing".into(),
                }),
                Err(error) => return Err(error),
            }
        }
        Ok((found, total))
    }

    /// All entries, as far as they are sound.
    pub fn all_entries(&self) -> Vec<Entry> {
        let inner = self.lock_inner();
        (0..inner.loaded)
            .filter_map(|at| inner.raw_entry(at))
            .collect()
    }

    fn entries_between(&self, stream: u32, level: u8, from: i64, to: i64) -> Vec<Entry> {
        let inner = self.lock_inner();
        let Some(directory) = inner.directories.get(&(stream, level)) else {
            return Vec::new();
        };
        let start = directory.at_time(from);
        directory.entries[start..]
            .iter()
            .take_while(|entry| entry.first <= to)
            .copied()
            .collect()
    }

    /// Bins of width 2^k over `from..=to`: stored ones where there are, the rest folded from finer levels and the messages.
    pub fn summary(&self, stream: u32, from: i64, to: i64, k: u8) -> Result<Vec<Bin>> {
        let k = k.min(62);
        let from = pyramid::floor(from, k);
        let to = pyramid::floor(to, k).saturating_add((1i64 << k) - 1);
        let mut folder = Folder::new(k);
        let levels: Vec<u8> = {
            let inner = self.lock_inner();
            let range = inner.directories.range((stream, 0)..=(stream, k));
            range
                .filter(|((_, level), _)| *level > 0)
                .map(|((_, level), _)| *level)
                .rev()
                .collect()
        };
        let mut at = from;
        for level in levels {
            at = self.fold_level(stream, level, at, to, &mut folder)?;
            if at > to {
                return Ok(folder.bins);
            }
        }
        self.fold_messages(stream, at, to, k, &mut folder)?;
        Ok(folder.bins)
    }

    /// Adds the stored bins of a level from `from` on; the time behind the last of them.
    fn fold_level(
        &self,
        stream: u32,
        level: u8,
        from: i64,
        to: i64,
        folder: &mut Folder,
    ) -> Result<i64> {
        let width = 1i64 << level;
        let mut at = from;
        for entry in self.entries_between(stream, level, from, to) {
            // A damaged pyramid is no damage to the recording: finer levels and the messages tell what it lacks.
            let Ok(chunk) = self.chunk(&entry) else {
                return Ok(at);
            };
            for bin in chunk.body().chunks_exact(BIN).filter_map(Bin::decode) {
                if bin.start < at {
                    continue;
                }
                if bin.start > to {
                    return Ok(i64::MAX);
                }
                folder.add(bin);
                at = bin.start.saturating_add(width);
            }
        }
        // Past the last stored bin of the level nothing is known; before it all is.
        let covered = {
            let inner = self.lock_inner();
            let last = inner
                .directories
                .get(&(stream, level))
                .and_then(|d| d.entries.last())
                .map(|e| e.last);
            last.map_or(i64::MIN, |last| last.saturating_add(width))
        };
        Ok(at.max(covered.min(to.saturating_add(1))))
    }

    fn fold_messages(
        &self,
        stream: u32,
        from: i64,
        to: i64,
        k: u8,
        folder: &mut Folder,
    ) -> Result<()> {
        let entries = self.entries_between(stream, 0, from, to);
        let messages: u64 = entries.iter().map(|e| e.count as u64).sum();
        if messages > 400_000 {
            return self.fold_computed(stream, from, to, k, folder);
        }
        for entry in &entries {
            let Ok(chunk) = self.chunk(entry) else {
                continue;
            };
            for message in chunk.messages() {
                let Ok((envelope, value)) = message else {
                    break;
                };
                if envelope.time > to {
                    break;
                }
                if envelope.time >= from {
                    if let Some(number) = chunk.number(&value) {
                        folder.add(Bin::sample(envelope.time, number));
                    }
                }
            }
        }
        Ok(())
    }

    /// A store without (enough of) a pyramid: computes one in memory, once, and follows a growing store.
    fn fold_computed(
        &self,
        stream: u32,
        from: i64,
        to: i64,
        k: u8,
        folder: &mut Folder,
    ) -> Result<()> {
        let mut all = self.computed.lock().unwrap_or_else(|p| p.into_inner());
        let computed = all.entry(stream).or_default();
        self.catch_up(stream, computed);
        let level = computed
            .levels
            .range(..=k)
            .next_back()
            .map(|(level, _)| *level);
        let mut at = from;
        if let Some(bins) = level.and_then(|level| computed.levels.get(&level)) {
            let width = 1i64 << level.unwrap_or(0);
            let start = bins.partition_point(|bin| bin.start < from);
            for bin in bins[start..].iter().take_while(|bin| bin.start <= to) {
                folder.add(*bin);
                at = bin.start.saturating_add(width);
            }
            let last = bins
                .last()
                .map_or(from, |bin| bin.start.saturating_add(width));
            at = at.max(last.min(to.saturating_add(1)));
        }
        if at > to {
            return Ok(());
        }
        for entry in self.entries_between(stream, 0, at, to) {
            let Ok(chunk) = self.chunk(&entry) else {
                continue;
            };
            for (envelope, value) in chunk.messages().flatten() {
                if envelope.time >= at && envelope.time <= to {
                    if let Some(number) = chunk.number(&value) {
                        folder.add(Bin::sample(envelope.time, number));
                    }
                }
            }
        }
        Ok(())
    }

    fn catch_up(&self, stream: u32, computed: &mut Computed) {
        let count = self.count(stream);
        while computed.seen < count {
            let Some(entry) = self.entry_at(stream, computed.seen) else {
                break;
            };
            if let Ok(chunk) = self.chunk(&entry) {
                for (envelope, value) in chunk.messages().flatten() {
                    if let Some(number) = chunk.number(&value) {
                        computed.builder.add(Bin::sample(envelope.time, number));
                    }
                }
            }
            computed.seen = entry.ordinal + entry.count as u64;
        }
        for (level, bins) in computed.builder.take_ready(1) {
            computed.levels.entry(level).or_default().extend(bins);
        }
    }
}

impl Inner {
    fn raw_entry(&self, at: u64) -> Option<Entry> {
        let byte = INDEX_HEADER as u64 + at * ENTRY as u64;
        let segment = self
            .segments
            .partition_point(|(start, _)| *start <= byte)
            .checked_sub(1)?;
        let (start, map) = self.segments.get(segment)?;
        let local = (byte - start) as usize;
        Entry::decode(map.get(local..local + ENTRY)?)
    }

    fn load(&mut self, published: u64, file: &File) -> Result<u64> {
        let wanted = (published.saturating_mul(ENTRY as u64)).saturating_add(INDEX_HEADER as u64);
        if wanted > self.mapped {
            let length = file_length(file, index::FILE)?;
            // Whole pages only, so that the next segment can begin where this one ends.
            let end = length / 4096 * 4096;
            if end > self.mapped {
                let map = map_file(file, self.mapped, end - self.mapped, index::FILE)?;
                self.segments.push((self.mapped, map));
                self.mapped = end;
            }
        }
        let room = (self.mapped - INDEX_HEADER as u64) / ENTRY as u64;
        if published > room && !self.short {
            self.short = true;
            self.note(
                INDEX_HEADER as u64 + room * ENTRY as u64,
                "the index ends before its last entry",
            );
        }
        for at in self.loaded..published.min(room) {
            let byte = INDEX_HEADER as u64 + at * ENTRY as u64;
            let Some(mut entry) = self.raw_entry(at) else {
                self.note(byte, "the entry's checksum is wrong");
                continue;
            };
            let directory = self
                .directories
                .entry((entry.stream, entry.level))
                .or_default();
            if directory
                .entries
                .last()
                .is_some_and(|last| entry.first <= last.last)
            {
                self.note(byte, "the entry goes back in time");
                continue;
            }
            entry.ordinal = directory.count;
            directory.count += entry.count as u64;
            directory.stored += entry.length as u64 + ENTRY as u64;
            directory.entries.push(entry);
        }
        self.loaded = published.min(room).max(self.loaded);
        Ok(self.loaded)
    }

    fn note(&mut self, offset: u64, why: &str) {
        if self.damage.len() < 10_000 {
            self.damage.push(Damage {
                file: index::FILE.into(),
                offset,
                why: why.into(),
            });
        }
    }
}

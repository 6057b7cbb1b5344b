//! The writer: packs streams into chunks and chunks into extents, and publishes them with one atomic word.
//! See docs/adr/0031-stores-are-written-with-pwrite-and-read-through-maps.md.

mod chunks;
mod closing;
mod columns;
mod drafts;
mod lock;
mod pyramids;
mod stream;

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use crate::chunk::{term_number, Builder, Envelope, Input};
use crate::error::{Error, Result};
use crate::extent::{Fault, Lane};
use crate::format::*;
use crate::index::{self, IndexWriter};
use crate::pyramid::{Bin, FLUSH};

pub use columns::{Column, ColumnValues};
pub use drafts::{Addition, Draft, Drafts, Size, DRAFT_MESSAGE};
pub use lock::lock_store;
use stream::Stream;

/// When committed messages are synced to disk.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Durability {
    /// The operating system decides. This survives the end of the process, but not a power failure.
    None,
    /// At least this often (when something is committed or `sync` is called).
    Interval(Duration),
    /// At every commit, which waits for the disk.
    Each,
}

/// The options of a new store.
#[derive(Debug, Clone)]
pub struct Options {
    /// The size of the first extent of each lane, bytes.
    pub first_extent: u64,
    /// The maximum size of an extent, unless a single chunk needs more, bytes.
    pub max_extent: u64,
    /// When committed messages are synced to disk.
    pub durability: Durability,
    /// The mode of the files, regardless of the process's file mode mask. Without it, `FILE_MODE` restricted by
    /// that mask.
    pub mode: Option<u32>,
    /// Simulated crashes for tests; none by default.
    pub fault: Arc<Fault>,
}

impl Default for Options {
    fn default() -> Self {
        Options {
            first_extent: 4 << 20,
            max_extent: 256 << 20,
            durability: Durability::None,
            mode: None,
            fault: Arc::default(),
        }
    }
}

/// Writes a store. Only one writer at a time can hold the lock of its folder.
#[derive(Debug)]
pub struct Writer {
    dir: PathBuf,
    _lock: File,
    lanes: [Lane; 2],
    index: IndexWriter,
    streams: Vec<Stream>,
    touched: Vec<u32>,
    /// Streams with enough bins for a chunk.
    ready: Vec<usize>,
    entries: Vec<Entry>,
    builder: Builder,
    durability: Durability,
    synced: Instant,
    checked: Instant,
    closed: bool,
    fault: Arc<Fault>,
}

/// Returns the system's time, ns since 1970.
pub fn system_time() -> i64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0, |d| d.as_nanos() as i64)
}

fn random_id() -> Result<[u8; 16]> {
    use std::io::Read;
    let mut id = [0; 16];
    File::open("/dev/urandom")
        .and_then(|mut file| file.read_exact(&mut id))
        .map_err(|e| Error::io("read /dev/urandom", e))?;
    Ok(id)
}

impl Writer {
    /// Creates a store in `dir`, an existing folder without a store.
    pub fn create(dir: &Path, options: Options) -> Result<Writer> {
        let lock = lock_store(dir, options.mode)?;
        let id = random_id()?;
        let header = IndexHeader {
            id,
            created: system_time(),
            version: VERSION,
        };
        let fault = options.fault.clone();
        let lane = |lane, size| {
            Lane::new(
                dir,
                id,
                lane,
                size,
                options.max_extent,
                options.mode,
                options.fault.clone(),
            )
        };
        Ok(Writer {
            dir: dir.to_path_buf(),
            _lock: lock,
            lanes: [
                lane(LANE_DATA, options.first_extent),
                lane(
                    LANE_LARGE,
                    options
                        .first_extent
                        .saturating_mul(4)
                        .min(options.max_extent),
                ),
            ],
            index: IndexWriter::create(
                &dir.join(index::FILE),
                header,
                options.mode,
                fault.clone(),
            )?,
            streams: vec![Stream::new(Compression::None, false)],
            touched: Vec::new(),
            ready: Vec::new(),
            entries: Vec::new(),
            builder: Builder::default(),
            durability: options.durability,
            synced: Instant::now(),
            checked: Instant::now(),
            closed: false,
            fault,
        })
    }

    /// Returns the store's folder.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// Adds a stream and returns its number. Nothing is written: the caller adds its catalog record.
    pub fn add_stream(&mut self, compression: Compression, large: bool) -> u32 {
        self.streams.push(Stream::new(compression, large));
        (self.streams.len() - 1) as u32
    }

    /// Returns the size of the written data in bytes, not counting space that is allocated for later data.
    pub fn byte_size(&self) -> u64 {
        let index = INDEX_HEADER as u64 + self.index.committed * ENTRY as u64;
        self.lanes.iter().map(Lane::byte_size).sum::<u64>() + index
    }

    /// Returns the number of committed index entries.
    pub fn committed_entries(&self) -> u64 {
        self.index.committed
    }

    /// Returns the last originating time of a stream and its number of messages.
    pub fn stream_position(&self, stream: u32) -> Option<(Option<i64>, u64)> {
        let stream = self.streams.get(stream as usize)?;
        Some((stream.position.last_time, stream.position.ordinal))
    }

    /// Adds a message to the current commit. After an error, call `rollback`.
    pub fn push(
        &mut self,
        stream: u32,
        envelope: Envelope,
        encoding: Encoding,
        codec: u16,
        input: Input<'_>,
    ) -> Result<()> {
        if self.closed {
            return Err(Error::Closed);
        }
        self.push_message(stream, envelope, encoding, codec, input)
    }

    fn push_message(
        &mut self,
        stream: u32,
        envelope: Envelope,
        encoding: Encoding,
        codec: u16,
        input: Input<'_>,
    ) -> Result<()> {
        let state = self
            .streams
            .get_mut(stream as usize)
            .ok_or(Error::UnknownStream(stream))?;
        if state.saved.is_none() {
            state.saved = Some(state.position);
            self.touched.push(stream);
        }
        if let Some(last) = state.position.last_time {
            if envelope.time <= last {
                return Err(Error::NotIncreasing(stream, last, envelope.time));
            }
        }
        let size = input.byte_size();
        if size > MAX_MESSAGE {
            return Err(Error::TooLarge(size as u64));
        }
        let alone = state.large || size >= LARGE_MESSAGE;
        if self.builder.count > 0 && (alone || !self.builder.accepts(stream, encoding, codec, size))
        {
            self.flush_chunk()?;
        }
        if self.builder.count == 0 {
            self.builder.start(stream, encoding, codec);
        }
        let number = match input {
            Input::Bytes(bytes) if encoding == Encoding::Term => term_number(bytes),
            _ => input.numeric_value(),
        };
        let state = &mut self.streams[stream as usize];
        if let Some(number) = number {
            let sample = Bin::from_sample(envelope.time, number);
            state.pending_points.push(sample);
        }
        if stream != CATALOG {
            state.note_message(envelope.time, encoding, &input);
        }
        if alone {
            self.write_large(envelope, size, input)?;
        } else {
            self.builder.push(envelope, input);
        }
        let position = &mut self.streams[stream as usize].position;
        position.last_time = Some(envelope.time);
        if alone {
            position.ordinal += 1;
        }
        position.size_sum += size as u64;
        position.latency_sum += envelope.creation as f64 - envelope.time as f64;
        Ok(())
    }

    /// Adds a point of the stream's signal to the pyramid, for payloads that are not numbers themselves.
    pub fn push_point(&mut self, stream: u32, point: Bin) -> Result<()> {
        let state = self
            .streams
            .get_mut(stream as usize)
            .ok_or(Error::UnknownStream(stream))?;
        state.pending_points.push(point);
        Ok(())
    }

    /// Publishes everything pushed since the last commit: all of it, or none (on an error, after `rollback`).
    pub fn commit(&mut self) -> Result<u64> {
        self.flush_chunk()?;
        if self.entries.is_empty() {
            return Ok(self.index.committed);
        }
        self.check_folder()?;
        self.index.reserve(self.entries.len())?;
        if self.durability == Durability::Each {
            self.sync_lanes()?;
        }
        self.index.publish(&self.entries)?;
        self.entries.clear();
        self.settle_streams();
        self.after_commit()?;
        Ok(self.index.committed)
    }

    fn settle_streams(&mut self) {
        self.ready.clear();
        for number in std::mem::take(&mut self.touched) {
            let stream = &mut self.streams[number as usize];
            stream.saved = None;
            stream.settle_values();
            if stream.pyramid.has_ready(FLUSH) || stream.track_bins.has_ready(FLUSH) {
                self.ready.push(number as usize);
            }
        }
    }

    fn after_commit(&mut self) -> Result<()> {
        self.write_ready_pyramids()?;
        match self.durability {
            Durability::Each => self.index.sync(),
            Durability::Interval(every) if self.synced.elapsed() >= every => self.sync(),
            _ => Ok(()),
        }
    }

    /// Drops the messages pushed since the last commit and erases their chunks, so that no scan finds them.
    pub fn rollback(&mut self) {
        self.builder.count = 0;
        for entry in std::mem::take(&mut self.entries) {
            // A chunk that stays on a failing disk has the number of a later chunk, which takes precedence.
            let _ = self.lanes[entry.lane as usize].erase_chunk(entry.extent, entry.offset);
        }
        for number in std::mem::take(&mut self.touched) {
            let stream = &mut self.streams[number as usize];
            if let Some(saved) = stream.saved.take() {
                stream.position = saved;
            }
            stream.drop_values();
        }
    }

    fn check_folder(&mut self) -> Result<()> {
        if self.checked.elapsed() > Duration::from_millis(500) {
            self.checked = Instant::now();
            if !self.lanes[0].folder_has_index(&self.index.file) {
                return Err(Error::Deleted);
            }
        }
        Ok(())
    }

    fn sync_lanes(&mut self) -> Result<()> {
        self.lanes.iter_mut().try_for_each(Lane::sync)
    }

    /// Syncs everything committed to disk.
    pub fn sync(&mut self) -> Result<()> {
        self.sync_lanes()?;
        self.index.sync()?;
        self.synced = Instant::now();
        Ok(())
    }
}

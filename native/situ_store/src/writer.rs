//! The writer: streams into chunks, chunks into extents, one publishing word for all of it.

use std::fs::{File, OpenOptions};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use rustix::fs::{flock, FlockOperation};
use rustix::io::Errno;

use crate::chunk::{compress, term_number, Builder, Envelope, Input};
use crate::error::{Error, Result};
use crate::extent::{Fault, Lane};
use crate::format::*;
use crate::index::{self, IndexWriter};
use crate::pyramid::{self, Bin};

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Durability {
    /// The operating system writes when it likes: survives a kill of the process, not a power cut.
    None,
    /// To the disk at least this often (when something is committed or `sync` is called).
    Interval(Duration),
    /// Every commit waits for the disk.
    Each,
}

#[derive(Debug, Clone)]
pub struct Options {
    pub first_extent: u64,
    pub max_extent: u64,
    pub durability: Durability,
    pub fault: Arc<Fault>,
}

impl Default for Options {
    fn default() -> Self {
        Options {
            first_extent: 4 << 20,
            max_extent: 256 << 20,
            durability: Durability::None,
            fault: Arc::default(),
        }
    }
}

/// What must be put back when a commit fails.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Position {
    ordinal: u64,
    last_time: Option<i64>,
    size_sum: u64,
    latency_sum: f64,
}

#[derive(Debug)]
struct Stream {
    compression: Compression,
    large: bool,
    position: Position,
    saved: Option<Position>,
    pyramid: pyramid::Builder,
    /// Ordinals per pyramid level.
    bins: [u64; 64],
    last_bin: [i64; 64],
    points: Vec<Bin>,
}

impl Stream {
    fn new(compression: Compression, large: bool) -> Self {
        Stream {
            compression,
            large,
            position: Position {
                ordinal: 0,
                last_time: None,
                size_sum: 0,
                latency_sum: 0.0,
            },
            saved: None,
            pyramid: pyramid::Builder::default(),
            bins: [0; 64],
            last_bin: [i64::MIN; 64],
            points: Vec::new(),
        }
    }
}

#[derive(Debug)]
pub struct Writer {
    dir: PathBuf,
    _lock: File,
    lanes: [Lane; 2],
    index: IndexWriter,
    streams: Vec<Stream>,
    touched: Vec<u32>,
    entries: Vec<Entry>,
    builder: Builder,
    durability: Durability,
    synced: Instant,
    checked: Instant,
    closed: bool,
    fault: Arc<Fault>,
}

/// Takes the exclusive lock of the store in `dir`.
pub fn lock(dir: &Path) -> Result<File> {
    let file = OpenOptions::new()
        .read(true)
        .write(true)
        .create(true)
        .truncate(false)
        .open(dir.join("lock"))
        .map_err(|e| Error::io("create lock", e))?;
    // A reader that asks whether the store is live holds the lock for a moment.
    for attempt in 0..5 {
        match flock(&file, FlockOperation::NonBlockingLockExclusive) {
            Ok(()) => return Ok(file),
            Err(Errno::WOULDBLOCK) if attempt < 4 => std::thread::sleep(Duration::from_millis(3)),
            Err(Errno::WOULDBLOCK) => break,
            Err(error) => return Err(Error::io("lock the store", error)),
        }
    }
    Err(Error::Locked)
}

pub fn now() -> i64 {
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
    /// A new store in `dir`, which exists and holds none.
    pub fn create(dir: &Path, options: Options) -> Result<Writer> {
        let lock = lock(dir)?;
        let id = random_id()?;
        let header = IndexHeader { id, created: now() };
        let fault = options.fault.clone();
        let lane = |lane, size| {
            Lane::new(
                dir,
                id,
                lane,
                size,
                options.max_extent,
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
            index: IndexWriter::create(&dir.join(index::FILE), header, fault.clone())?,
            streams: vec![Stream::new(Compression::None, false)],
            touched: Vec::new(),
            entries: Vec::new(),
            builder: Builder::default(),
            durability: options.durability,
            synced: Instant::now(),
            checked: Instant::now(),
            closed: false,
            fault,
        })
    }

    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// A new stream's number. Nothing is written: its catalog record is the caller's.
    pub fn add_stream(&mut self, compression: Compression, large: bool) -> u32 {
        self.streams.push(Stream::new(compression, large));
        (self.streams.len() - 1) as u32
    }

    pub fn committed(&self) -> u64 {
        self.index.committed
    }

    /// The last originating time of a stream, and how many messages it has.
    pub fn position(&self, stream: u32) -> Option<(Option<i64>, u64)> {
        let stream = self.streams.get(stream as usize)?;
        Some((stream.position.last_time, stream.position.ordinal))
    }

    /// Adds a message to the commit under way. After an error: `rollback`.
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
            _ => input.number(),
        };
        if let Some(number) = number {
            self.streams[stream as usize]
                .points
                .push(Bin::sample(envelope.time, number));
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

    /// A point of the stream's signal (of a payload that is not a number itself), for the pyramid.
    pub fn push_point(&mut self, stream: u32, point: Bin) -> Result<()> {
        let state = self
            .streams
            .get_mut(stream as usize)
            .ok_or(Error::UnknownStream(stream))?;
        state.points.push(point);
        Ok(())
    }

    fn header(
        &self,
        stored: usize,
        raw: usize,
        compression: Compression,
        body_crc: u32,
    ) -> ChunkHeader {
        let builder = &self.builder;
        let position = self.streams[builder.stream as usize].position;
        ChunkHeader {
            length: (CHUNK_HEADER + stored) as u32,
            stream: builder.stream,
            level: 0,
            encoding: builder.encoding,
            compression,
            count: builder.count,
            ordinal: position.ordinal,
            first: builder.first.time,
            last: builder.last.time,
            first_sequence: builder.first.sequence,
            first_creation: builder.first.creation,
            size_sum: position.size_sum,
            latency_sum: position.latency_sum,
            raw_length: raw as u32,
            table_length: builder.table.len() as u32,
            codec: builder.codec,
            body_crc,
        }
    }

    fn flush_chunk(&mut self) -> Result<()> {
        if self.builder.count == 0 {
            return Ok(());
        }
        let compression = self.streams[self.builder.stream as usize].compression;
        let packed = compress(compression, &self.builder.table, &self.builder.payload)?;
        let raw = self.builder.table.len() + self.builder.payload.len();
        let entry = match &packed {
            Some(body) => {
                let header = self.header(body.len(), raw, compression, crc32c::crc32c(body));
                let bytes = header.encode(&[]);
                self.place(LANE_DATA, 8, &header, &[&bytes, body])?
            }
            None => {
                let crc = crc32c::crc32c(&self.builder.payload);
                let header = self.header(raw, raw, Compression::None, crc);
                let bytes = header.encode(&self.builder.table);
                let (table, payload) = (
                    std::mem::take(&mut self.builder.table),
                    std::mem::take(&mut self.builder.payload),
                );
                let placed = self.place(LANE_DATA, 8, &header, &[&bytes, &table, &payload]);
                self.builder.table = table;
                self.builder.payload = payload;
                placed?
            }
        };
        self.entries.push(entry);
        self.streams[self.builder.stream as usize].position.ordinal += self.builder.count as u64;
        self.builder.count = 0;
        Ok(())
    }

    /// A message in a chunk of its own, straight from the caller's memory.
    fn write_large(&mut self, envelope: Envelope, size: usize, input: Input<'_>) -> Result<()> {
        let compression = self.streams[self.builder.stream as usize].compression;
        let position = &mut self.streams[self.builder.stream as usize].position;
        // The header carries sums with this message in them; `push` adds them for good once it is written.
        let before = *position;
        position.size_sum += size as u64;
        position.latency_sum += envelope.creation as f64 - envelope.time as f64;
        let placed = self.place_large(envelope, size, input, compression);
        self.streams[self.builder.stream as usize].position = before;
        self.builder.count = 0;
        self.entries.push(placed?);
        Ok(())
    }

    fn place_large(
        &mut self,
        envelope: Envelope,
        size: usize,
        input: Input<'_>,
        compression: Compression,
    ) -> Result<Entry> {
        let small;
        let parts: &[&[u8]] = match input {
            Input::Bytes(bytes) => {
                small = [bytes];
                &small
            }
            Input::Parts(parts) => parts,
            other => {
                self.builder.push(envelope, other);
                let payload = std::mem::take(&mut self.builder.payload);
                let placed = self.place_parts(&[&payload], size, compression);
                self.builder.payload = payload;
                return placed;
            }
        };
        self.builder.push_envelope(envelope, size);
        self.place_parts(parts, size, compression)
    }

    fn place_parts(
        &mut self,
        parts: &[&[u8]],
        size: usize,
        compression: Compression,
    ) -> Result<Entry> {
        // The payload starts at a multiple of 64: copies of unaligned neighbours run at a tenth of the speed.
        let padded = (CHUNK_HEADER + self.builder.table.len()).next_multiple_of(64) - CHUNK_HEADER;
        self.builder.table.resize(padded, 0);
        if compression != Compression::None {
            let whole = parts.concat();
            if let Some(body) = compress(compression, &self.builder.table, &whole)? {
                let raw = self.builder.table.len() + size;
                let header = self.header(body.len(), raw, compression, crc32c::crc32c(&body));
                return self.place(LANE_LARGE, 64, &header, &[&header.encode(&[]), &body]);
            }
        }
        let crc = parts
            .iter()
            .fold(0, |crc, part| crc32c::crc32c_append(crc, part));
        let raw = self.builder.table.len() + size;
        let header = self.header(raw, raw, Compression::None, crc);
        let bytes = header.encode(&self.builder.table);
        let table = std::mem::take(&mut self.builder.table);
        let mut slices: Vec<&[u8]> = Vec::with_capacity(parts.len() + 2);
        slices.extend([&bytes[..], &table[..]]);
        slices.extend_from_slice(parts);
        let placed = self.place(LANE_LARGE, 64, &header, &slices);
        self.builder.table = table;
        placed
    }

    fn place(
        &mut self,
        lane: u8,
        align: u64,
        header: &ChunkHeader,
        slices: &[&[u8]],
    ) -> Result<Entry> {
        let (extent, offset) = self.lanes[lane as usize].reserve(header.length as u64, align)?;
        self.lanes[lane as usize].write(offset, slices)?;
        Ok(Entry {
            stream: header.stream,
            level: header.level,
            lane,
            extent,
            offset,
            length: header.length,
            count: header.count,
            ordinal: header.ordinal,
            first: header.first,
            last: header.last,
            first_creation: header.first_creation,
        })
    }

    /// Publishes everything pushed since the last commit: all of it, or (on an error, after `rollback`) none.
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
        self.settle();
        self.after_commit()?;
        Ok(self.index.committed)
    }

    fn settle(&mut self) {
        for number in std::mem::take(&mut self.touched) {
            let stream = &mut self.streams[number as usize];
            stream.saved = None;
            for point in stream.points.drain(..) {
                stream.pyramid.add(point);
            }
        }
    }

    fn after_commit(&mut self) -> Result<()> {
        let ready =
            (0..self.streams.len()).any(|at| self.streams[at].pyramid.has_ready(pyramid::FLUSH));
        if ready {
            // A full disk is told by the next message; the bins wait.
            match self.write_pyramids(pyramid::FLUSH) {
                Err(Error::Crash) => return Err(Error::Crash),
                _ => self.entries.clear(),
            }
        }
        match self.durability {
            Durability::Each => self.index.sync(),
            Durability::Interval(every) if self.synced.elapsed() >= every => self.sync(),
            _ => Ok(()),
        }
    }

    /// Forgets what was pushed since the last commit. Its bytes in the extents mean nothing.
    pub fn rollback(&mut self) {
        self.builder.count = 0;
        self.entries.clear();
        for number in std::mem::take(&mut self.touched) {
            let stream = &mut self.streams[number as usize];
            if let Some(saved) = stream.saved.take() {
                stream.position = saved;
            }
            stream.points.clear();
        }
    }

    fn write_pyramids(&mut self, least: usize) -> Result<()> {
        for number in 0..self.streams.len() {
            let mut failed = Ok(());
            for (k, bins) in self.streams[number].pyramid.take_ready(least) {
                if failed.is_ok() {
                    failed = self.write_bins(number, k, &bins);
                }
                if failed.is_err() {
                    self.streams[number].pyramid.put_back(k, bins);
                }
            }
            failed?;
        }
        Ok(())
    }

    fn write_bins(&mut self, number: usize, k: u8, bins: &[Bin]) -> Result<()> {
        for bins in bins.chunks(MAX_CHUNK_MESSAGES as usize) {
            let (Some(first), Some(last)) = (bins.first(), bins.last()) else {
                continue;
            };
            let stream = &self.streams[number];
            if first.start <= stream.last_bin[k as usize] {
                // Points of a codec that went back in time: their bins are left out, the messages are there.
                continue;
            }
            let mut body = Vec::with_capacity(bins.len() * BIN);
            bins.iter().for_each(|bin| bin.encode(&mut body));
            let header = ChunkHeader {
                length: (CHUNK_HEADER + body.len()) as u32,
                stream: number as u32,
                level: k,
                encoding: Encoding::Bins,
                compression: Compression::None,
                count: bins.len() as u32,
                ordinal: stream.bins[k as usize],
                first: first.start,
                last: last.start,
                first_sequence: 0,
                first_creation: 0,
                size_sum: 0,
                latency_sum: 0.0,
                raw_length: body.len() as u32,
                table_length: 0,
                codec: 0,
                body_crc: crc32c::crc32c(&body),
            };
            let entry = self.place(LANE_DATA, 8, &header, &[&header.encode(&[]), &body])?;
            self.index.publish(&[entry])?;
            let stream = &mut self.streams[number];
            stream.bins[k as usize] += bins.len() as u64;
            stream.last_bin[k as usize] = last.start;
        }
        Ok(())
    }

    fn check_folder(&mut self) -> Result<()> {
        if self.checked.elapsed() > Duration::from_millis(500) {
            self.checked = Instant::now();
            if !self.lanes[0].folder_lives(&self.index.file) {
                return Err(Error::Deleted);
            }
        }
        Ok(())
    }

    fn sync_lanes(&mut self) -> Result<()> {
        self.lanes.iter_mut().try_for_each(Lane::sync)
    }

    /// Everything committed to the disk.
    pub fn sync(&mut self) -> Result<()> {
        self.sync_lanes()?;
        self.index.sync()?;
        self.synced = Instant::now();
        Ok(())
    }

    /// Writes the rest of the pyramids, cuts the files, marks the store closed. Committed messages are safe whatever it answers.
    pub fn close(&mut self) -> Result<()> {
        if self.closed {
            return Ok(());
        }
        self.rollback();
        self.closed = true;
        let finished = self.finish();
        // Whatever happened: nobody else may be kept out.
        let _ = flock(&self._lock, FlockOperation::Unlock);
        finished
    }

    fn finish(&mut self) -> Result<()> {
        self.fault.step()?;
        if !self.lanes[0].folder_lives(&self.index.file) {
            return Err(Error::Deleted);
        }
        self.streams
            .iter_mut()
            .for_each(|stream| stream.pyramid.finish());
        let pyramids = self.write_pyramids(1);
        self.lanes.iter_mut().try_for_each(Lane::trim)?;
        if self.durability != Durability::None {
            self.sync()?;
        }
        self.index.finish()?;
        match pyramids {
            // Without room for the pyramids the store is whole all the same: they are computed when wanted.
            Err(Error::Crash) => Err(Error::Crash),
            _ => Ok(()),
        }
    }
}

//! Collects small messages of many streams in memory, so that one commit writes all of them.
//!
//! No disk access holds the lock of a draft. A scheduler of the BEAM can therefore add messages to it while another
//! thread commits.

use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use super::Writer;
use crate::chunk::{Envelope, Input};
use crate::error::{Error, Result};
use crate::format::Encoding;
use crate::reader::lock_mutex;

/// The maximum size of a message in a draft, because a draft copies its messages.
pub const DRAFT_MESSAGE: usize = 1024;

/// The number of index entries after which a commit of many drafts is published and the next one begins.
const COMMIT_ENTRIES: usize = 256;

/// The maximum number of empty batches that are kept for reuse.
const SPARE_BATCHES: usize = 16;

/// The drafts of a store that have messages, and empty batches.
#[derive(Debug, Default)]
pub struct Drafts {
    waiting: Mutex<Vec<Arc<Draft>>>,
    spare: Mutex<Vec<Batch>>,
}

/// The messages of one stream that wait for a commit.
#[derive(Debug)]
pub struct Draft {
    drafts: Arc<Drafts>,
    stream: u32,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    batch: Batch,
    /// The encoding of all messages, set by the first one.
    encoding: Option<Encoding>,
    /// The originating time of the last message.
    last_time: Option<i64>,
    /// The time at which the first waiting message was added.
    since: Option<Instant>,
    /// Whether a thread is committing messages of the draft.
    in_commit: bool,
    /// Whether the draft is in the list of waiting drafts.
    listed: bool,
}

/// Messages of one encoding.
#[derive(Debug)]
struct Batch {
    encoding: Encoding,
    rows: Vec<Row>,
    bytes: Vec<u8>,
}

/// A message: its envelope, and its number or the length of its bytes.
#[derive(Debug, Clone, Copy)]
struct Row {
    envelope: Envelope,
    value: u64,
}

impl Default for Batch {
    fn default() -> Self {
        Batch {
            encoding: Encoding::Int,
            rows: Vec::new(),
            bytes: Vec::new(),
        }
    }
}

impl Batch {
    #[inline]
    fn push(&mut self, envelope: Envelope, input: Input<'_>) -> Option<()> {
        let value = match (self.encoding, input) {
            (Encoding::Int, Input::Int(value)) => value as u64,
            (Encoding::Float, Input::Float(value)) => value.to_bits(),
            (Encoding::Bool, Input::Bool(value)) => value.into(),
            (Encoding::Bytes, Input::Bytes(bytes)) if bytes.len() <= DRAFT_MESSAGE => {
                self.bytes.extend_from_slice(bytes);
                bytes.len() as u64
            }
            _ => return None,
        };
        self.rows.push(Row { envelope, value });
        Some(())
    }

    fn truncate(&mut self, rows: usize, bytes: usize) {
        self.rows.truncate(rows);
        self.bytes.truncate(bytes);
    }

    fn size(&self) -> Size {
        Size {
            messages: self.rows.len(),
            bytes: self.bytes.len() + 8 * self.rows.len(),
        }
    }

    /// Adds the messages to the writer's current commit.
    fn push_to(&self, writer: &mut Writer, stream: u32) -> Result<()> {
        let mut at = 0;
        for row in &self.rows {
            let input = match self.encoding {
                Encoding::Float => Input::Float(f64::from_bits(row.value)),
                Encoding::Bool => Input::Bool(row.value as u8),
                Encoding::Bytes => {
                    let start = at;
                    at += row.value as usize;
                    Input::Bytes(&self.bytes[start..at])
                }
                _ => Input::Int(row.value as i64),
            };
            writer.push(stream, row.envelope, self.encoding, 0, input)?;
        }
        Ok(())
    }
}

/// What waits in a draft.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Size {
    /// The number of messages.
    pub messages: usize,
    /// The size of their payloads in bytes; a number counts as 8.
    pub bytes: usize,
}

/// Messages that are being added to a draft, either all or none.
pub struct Addition<'a> {
    batch: &'a mut Batch,
    last_time: &'a mut Option<i64>,
}

impl Addition<'_> {
    /// Adds a message. Returns `None` if it does not fit: its time does not increase, it is large, or it has another
    /// encoding than the messages before it.
    #[inline]
    pub fn push(&mut self, envelope: Envelope, input: Input<'_>) -> Option<()> {
        if self.last_time.is_some_and(|last| envelope.time <= last) {
            return None;
        }
        *self.last_time = Some(envelope.time);
        self.batch.push(envelope, input)
    }
}

impl Drafts {
    /// Creates the draft of a stream.
    pub fn add_draft(self: &Arc<Self>, stream: u32) -> Arc<Draft> {
        Arc::new(Draft {
            drafts: self.clone(),
            stream,
            state: Mutex::default(),
        })
    }

    fn take_spare(&self) -> Batch {
        lock_mutex(&self.spare).pop().unwrap_or_default()
    }

    fn put_spare(&self, mut batch: Batch) {
        batch.truncate(0, 0);
        let mut spare = lock_mutex(&self.spare);
        if spare.len() < SPARE_BATCHES {
            spare.push(batch);
        }
    }

    /// Commits the messages of all drafts. After an error, the messages that were not committed keep waiting.
    ///
    /// The messages of a draft that the writer refuses also keep waiting, without an error for the others.
    pub fn commit_all(&self, writer: &mut Writer) -> Result<()> {
        let waiting = std::mem::take(&mut *lock_mutex(&self.waiting));
        let mut taken = Vec::new();
        let mut result = Ok(());
        for draft in waiting {
            draft.lock().listed = false;
            match result {
                Ok(()) => result = draft.push_to(writer, &mut taken),
                Err(_) => draft.note_waiting(&mut draft.lock()),
            }
        }
        let result = result.and_then(|()| finish_commit(writer, &mut taken));
        if result.is_err() {
            undo_commit(writer, taken);
        }
        result
    }
}

/// Batches of the current commit.
type Taken = Vec<(Arc<Draft>, Batch)>;

fn finish_commit(writer: &mut Writer, taken: &mut Taken) -> Result<()> {
    writer.commit()?;
    taken
        .drain(..)
        .for_each(|(draft, batch)| draft.settle_batch(batch));
    Ok(())
}

fn undo_commit(writer: &mut Writer, taken: Taken) {
    writer.rollback();
    taken
        .into_iter()
        .for_each(|(draft, batch)| draft.put_back(batch));
}

impl Draft {
    fn lock(&self) -> MutexGuard<'_, State> {
        lock_mutex(&self.state)
    }

    /// Adds the messages that `add` pushes, and returns the size of the draft. If `add` returns `None`, adds none of
    /// them and returns `None`.
    pub fn add_messages(
        self: &Arc<Self>,
        encoding: Encoding,
        add: impl FnOnce(&mut Addition<'_>) -> Option<()>,
    ) -> Option<Size> {
        let mut guard = self.lock();
        let state = &mut *guard;
        let (rows, bytes, last) = (
            state.batch.rows.len(),
            state.batch.bytes.len(),
            state.last_time,
        );
        if *state.encoding.get_or_insert(encoding) != encoding {
            return None;
        }
        state.batch.encoding = encoding;
        let added = add(&mut Addition {
            batch: &mut state.batch,
            last_time: &mut state.last_time,
        });
        if added.is_none() {
            state.batch.truncate(rows, bytes);
            state.last_time = last;
            return None;
        }
        self.note_waiting(state);
        Some(state.batch.size())
    }

    fn note_waiting(self: &Arc<Self>, state: &mut State) {
        if state.batch.rows.is_empty() {
            return;
        }
        if state.since.is_none() {
            state.since = Some(Instant::now());
        }
        if !state.listed {
            state.listed = true;
            lock_mutex(&self.drafts.waiting).push(self.clone());
        }
    }

    /// Returns how long the oldest message has waited, or `None` if all messages are committed.
    pub fn waiting_time(&self) -> Option<Duration> {
        let state = self.lock();
        match state.since {
            // If this commit fails, its messages wait again.
            None if state.in_commit => Some(Duration::ZERO),
            since => since.map(|since| since.elapsed()),
        }
    }

    /// Commits the messages of this draft. After an error they keep waiting.
    pub fn commit(self: &Arc<Self>, writer: &mut Writer) -> Result<()> {
        let mut taken = Vec::new();
        let result = self
            .check_position(writer)
            .and_then(|()| self.push_to(writer, &mut taken))
            .and_then(|()| finish_commit(writer, &mut taken));
        if result.is_err() {
            undo_commit(writer, taken);
        }
        result
    }

    /// Returns an error if the writer would refuse the messages because of what the stream already contains.
    fn check_position(&self, writer: &Writer) -> Result<()> {
        let Some(first) = self.lock().batch.rows.first().copied() else {
            return Ok(());
        };
        match writer.stream_position(self.stream) {
            None => Err(Error::UnknownStream(self.stream)),
            Some((Some(last), _)) if first.envelope.time <= last => {
                Err(Error::NotIncreasing(self.stream, last, first.envelope.time))
            }
            Some(_) => Ok(()),
        }
    }

    /// Moves the messages to the writer's current commit, unless it would refuse them.
    fn push_to(self: &Arc<Self>, writer: &mut Writer, taken: &mut Taken) -> Result<()> {
        if self.check_position(writer).is_err() {
            return Ok(());
        }
        let Some(batch) = self.take_batch() else {
            return Ok(());
        };
        taken.push((self.clone(), batch));
        if let Some((_, batch)) = taken.last() {
            batch.push_to(writer, self.stream)?;
        }
        if writer.entries.len() >= COMMIT_ENTRIES {
            finish_commit(writer, taken)?;
        }
        Ok(())
    }

    fn take_batch(&self) -> Option<Batch> {
        let mut state = self.lock();
        if state.batch.rows.is_empty() {
            return None;
        }
        state.since = None;
        state.in_commit = true;
        Some(std::mem::replace(
            &mut state.batch,
            self.drafts.take_spare(),
        ))
    }

    fn settle_batch(&self, batch: Batch) {
        self.lock().in_commit = false;
        self.drafts.put_spare(batch);
    }

    /// Puts back messages that could not be committed, before those that were added in the meantime.
    fn put_back(self: &Arc<Self>, mut batch: Batch) {
        let mut guard = self.lock();
        let state = &mut *guard;
        state.in_commit = false;
        batch.rows.append(&mut state.batch.rows);
        batch.bytes.append(&mut state.batch.bytes);
        state.batch = batch;
        self.note_waiting(state);
    }
}

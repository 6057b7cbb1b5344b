//! Reads a file: its description, and the messages of any channel by number.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard};

use mcap::records::{op, MessageHeader, MessageIndexEntry, Record};

use crate::chunk::Records;
use crate::file::{parse_record, FileBytes};
use crate::open::{read_contents, read_contents_without_index, unpack_records, Contents};
use crate::track::{Entry, Track, LOOSE};
use crate::{Error, Result, Times};

/// A channel.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Channel {
    /// Its number in the file.
    pub id: u16,
    /// Its name.
    pub topic: String,
    /// The encoding of its messages.
    pub encoding: String,
    /// The number of its schema, 0 for none.
    pub schema: u16,
    /// The writer's metadata.
    pub metadata: BTreeMap<String, String>,
}

impl From<mcap::records::Channel> for Channel {
    fn from(record: mcap::records::Channel) -> Self {
        Channel {
            id: record.id,
            topic: record.topic,
            encoding: record.message_encoding,
            schema: record.schema_id,
            metadata: record.metadata,
        }
    }
}

/// The type of a channel's messages.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Schema {
    /// The type's name.
    pub name: String,
    /// The language of `data`, such as `ros1msg` or `jsonschema`.
    pub encoding: String,
    /// The definition.
    pub data: Vec<u8>,
}

/// An attachment.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AttachmentInfo {
    /// Its name.
    pub name: String,
    /// Its media type.
    pub media_type: String,
    /// The time when it was recorded, ns.
    pub log_time: u64,
    /// Its offset in the file, bytes.
    pub offset: u64,
    /// Its size, bytes.
    pub size: u64,
}

/// A description of a file.
#[derive(Debug, Clone)]
pub struct Info {
    /// Its profile, such as `ros1`.
    pub profile: String,
    /// The library that wrote it.
    pub library: String,
    /// Its channels with their message counts.
    pub channels: Vec<(Channel, u64)>,
    /// Its schemas, by number.
    pub schemas: BTreeMap<u16, Schema>,
    /// Its attachments.
    pub attachments: Vec<AttachmentInfo>,
    /// Its metadata records.
    pub metadata: Vec<(String, BTreeMap<String, String>)>,
    /// The damage found, in sentences.
    pub damage: Vec<String>,
    /// Whether its writer finished it.
    pub finished: bool,
}

/// A message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Message {
    /// The time that orders it in its channel, ns.
    pub time: u64,
    /// The time when it was recorded, ns.
    pub log_time: u64,
    /// The time when it was sent, ns.
    pub publish_time: u64,
    /// The sequence number from the writer.
    pub sequence: u32,
    /// Its bytes; empty if only the envelope was requested.
    pub data: Vec<u8>,
}

/// Selects messages.
#[derive(Debug, Clone, Copy)]
pub struct Query {
    /// Their channel.
    pub channel: u16,
    /// The times that order them.
    pub times: Times,
    /// The number of the first message.
    pub from: u64,
    /// The last time, ns.
    pub to: i128,
    /// The maximum number of messages.
    pub most: usize,
    /// The approximate maximum of data, bytes.
    pub bytes: usize,
    /// Whether to leave out their data.
    pub envelopes: bool,
    /// Whether to skip messages that cannot be read; otherwise they are errors.
    pub skip_damage: bool,
}

/// The maximum size of cached unpacked chunks, bytes. Streams that are read together share them.
const MAX_CACHED_BYTES: usize = 64 << 20;

/// An open file. Threads may share it.
pub struct Reader {
    pub(crate) bytes: FileBytes,
    pub(crate) contents: Contents,
    tracks: Mutex<HashMap<(u16, Times), Arc<Track>>>,
    chunk_cache: Mutex<Vec<(u32, Arc<Vec<u8>>)>>,
}

impl std::hash::Hash for Times {
    fn hash<H: std::hash::Hasher>(&self, state: &mut H) {
        (*self as u8).hash(state);
    }
}

/// Skips the other messages of a chunk that cannot be unpacked.
fn skip_damaged_chunk(track: &Track, at: usize) -> usize {
    let chunk = track.entries[at].chunk;
    let others = track.entries[at + 1..].iter();
    let same = others
        .take_while(|e| chunk != LOOSE && e.chunk == chunk)
        .count();
    at + 1 + same
}

fn lock_mutex<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex
        .lock()
        .unwrap_or_else(|poisoned| poisoned.into_inner())
}

impl Reader {
    /// Opens a file by its summary, or by scanning all records.
    pub fn open(path: &Path) -> Result<Self> {
        let bytes = FileBytes::open(path)?;
        let contents = read_contents(&bytes)?;
        Ok(Reader::new(bytes, contents))
    }

    /// Opens a file by scanning all records, because its index is wrong for the reason `why`.
    pub fn open_without_index(path: &Path, why: &str) -> Result<Self> {
        let bytes = FileBytes::open(path)?;
        let contents = read_contents_without_index(&bytes, why)?;
        Ok(Reader::new(bytes, contents))
    }

    fn new(bytes: FileBytes, contents: Contents) -> Self {
        Reader {
            bytes,
            contents,
            tracks: Mutex::default(),
            chunk_cache: Mutex::default(),
        }
    }

    /// Returns a description of the file.
    pub fn info(&self) -> Info {
        let contents = &self.contents;
        let count = |id: &u16| contents.counts.get(id).copied().unwrap_or(0);
        Info {
            profile: contents.profile.clone(),
            library: contents.library.clone(),
            channels: contents
                .channels
                .values()
                .map(|c| (c.clone(), count(&c.id)))
                .collect(),
            schemas: contents.schemas.clone(),
            attachments: contents.attachments.clone(),
            metadata: contents.metadata.clone(),
            damage: contents.damage.clone(),
            finished: contents.finished,
        }
    }

    pub(crate) fn message_index(&self, channel: u16, at: u64) -> Result<Vec<MessageIndexEntry>> {
        let head = self.bytes.record_head(at)?;
        let head =
            head.ok_or_else(|| Error::Damaged(at, "no message index is there".to_string()))?;
        let body = self.bytes.record_body(head)?;
        match parse_record(head.opcode, &body, at)? {
            Record::MessageIndex(index) if index.channel_id == channel => Ok(index.records),
            _ => {
                let why = "no message index of the channel is there".to_string();
                Err(Error::Damaged(at, why))
            }
        }
    }

    /// Returns the number of the first message at or after `time`.
    pub fn seek(&self, channel: u16, times: Times, time: i128) -> Result<u64> {
        Ok(self.channel_track(channel, times)?.seek(time) as u64)
    }

    /// Returns the messages that the query selects, at least one if there is one, and the next number.
    pub fn read(&self, query: &Query) -> Result<(Vec<Message>, u64)> {
        let track = self.channel_track(query.channel, query.times)?;
        let mut at = usize::try_from(query.from).unwrap_or(usize::MAX);
        let mut found = Vec::new();
        let mut size = 0;
        while let Some(entry) = track.entries.get(at) {
            let enough = found.len() >= query.most || size >= query.bytes;
            if i128::from(entry.time) > query.to || enough {
                break;
            }
            match self.read_message(entry, query.envelopes) {
                Ok(message) => {
                    size += message.data.len();
                    found.push(message);
                    at += 1;
                }
                Err(Error::Damaged(..)) if query.skip_damage => at = skip_damaged_chunk(&track, at),
                Err(other) => return Err(other),
            }
        }
        Ok((found, at as u64))
    }

    fn read_message(&self, entry: &Entry, envelopes: bool) -> Result<Message> {
        self.with_message(entry, |header, data| Message {
            time: entry.time,
            log_time: header.log_time,
            publish_time: header.publish_time,
            sequence: header.sequence,
            data: if envelopes { Vec::new() } else { data.to_vec() },
        })
    }

    pub(crate) fn with_message<T>(
        &self,
        entry: &Entry,
        fun: impl FnOnce(&MessageHeader, &[u8]) -> T,
    ) -> Result<T> {
        let whole;
        let (opcode, body) = if entry.chunk == LOOSE {
            let head = self.bytes.record_head(entry.offset)?;
            let head =
                head.ok_or_else(|| Error::Damaged(entry.offset, "no record is there".to_string()))?;
            whole = Arc::new(self.bytes.record_body(head)?);
            (head.opcode, whole.as_slice())
        } else {
            whole = self.unpacked_chunk(entry.chunk)?;
            let record = Records::record_at(&whole, entry.offset);
            record.ok_or_else(|| {
                Error::Damaged(
                    entry.offset,
                    "the index points at no record of its chunk".to_string(),
                )
            })?
        };
        match parse_record(opcode, body, entry.offset)? {
            Record::Message { header, data } => Ok(fun(&header, &data)),
            _ => Err(Error::Damaged(
                entry.offset,
                "the index points at no message".to_string(),
            )),
        }
    }

    pub(crate) fn unpacked_chunk(&self, number: u32) -> Result<Arc<Vec<u8>>> {
        if let Some((_, bytes)) = lock_mutex(&self.chunk_cache)
            .iter()
            .find(|(n, _)| *n == number)
        {
            return Ok(bytes.clone());
        }
        let chunk = self.contents.chunks.get(number as usize);
        let chunk = chunk.ok_or_else(|| Error::Damaged(0, "no such chunk".to_string()))?;
        let head = self.bytes.record_head(chunk.offset)?;
        let head =
            head.ok_or_else(|| Error::Damaged(chunk.offset, "no chunk is there".to_string()))?;
        if head.opcode != op::CHUNK {
            return Err(Error::Damaged(
                chunk.offset,
                "no chunk is there".to_string(),
            ));
        }
        let (records, _) = unpack_records(&self.bytes, head, chunk.offset)?;
        let records = Arc::new(records);
        let mut chunk_cache = lock_mutex(&self.chunk_cache);
        let mut size = records.len() + chunk_cache.iter().map(|(_, b)| b.len()).sum::<usize>();
        while size > MAX_CACHED_BYTES && !chunk_cache.is_empty() {
            size -= chunk_cache.remove(0).1.len();
        }
        chunk_cache.push((number, records.clone()));
        Ok(records)
    }

    /// Returns the index of a channel, which is built on first use.
    pub(crate) fn channel_track(&self, channel: u16, times: Times) -> Result<Arc<Track>> {
        if let Some(track) = lock_mutex(&self.tracks).get(&(channel, times)) {
            return Ok(track.clone());
        }
        let mut entries = self.channel_entries(channel)?;
        if times.is_in_messages() {
            // A message that cannot be read keeps its time from the index. Only reading it is an error.
            let mut damaged = None;
            for entry in &mut entries {
                if entry.chunk != LOOSE && damaged == Some(entry.chunk) {
                    continue;
                }
                match self.with_message(entry, |header, data| times.message_time(header, data)) {
                    Ok(time) => entry.time = time,
                    Err(Error::Damaged(..)) => damaged = Some(entry.chunk),
                    Err(other) => return Err(other),
                }
            }
        }
        let track = Arc::new(Track::new(entries));
        lock_mutex(&self.tracks).insert((channel, times), track.clone());
        Ok(track)
    }

    /// Returns the positions of a channel's messages with their unmodified log times.
    pub(crate) fn channel_entries(&self, channel: u16) -> Result<Vec<Entry>> {
        match &self.contents.entries {
            Some(entries) => Ok(entries.get(&channel).cloned().unwrap_or_default()),
            None => self.indexed_entries(channel),
        }
    }

    /// Finds the messages by the message indexes after the chunks.
    fn indexed_entries(&self, channel: u16) -> Result<Vec<Entry>> {
        let mut entries = Vec::new();
        for (number, chunk) in self.contents.chunks.iter().enumerate() {
            let Some(&at) = chunk.indexes.get(&channel) else {
                continue;
            };
            let chunk = number as u32;
            entries.extend(self.message_index(channel, at)?.iter().map(|r| Entry {
                time: r.log_time,
                chunk,
                offset: r.offset,
            }));
        }
        Ok(entries)
    }

    /// Reads an attachment's bytes.
    pub fn read_attachment(&self, offset: u64) -> Result<Vec<u8>> {
        let head = self.bytes.record_head(offset)?;
        let head = head.filter(|p| p.opcode == op::ATTACHMENT);
        let head =
            head.ok_or_else(|| Error::Damaged(offset, "no attachment is there".to_string()))?;
        match parse_record(op::ATTACHMENT, &self.bytes.record_body(head)?, offset)? {
            Record::Attachment { data, .. } => Ok(data.into_owned()),
            _ => Err(Error::Damaged(offset, "no attachment is there".to_string())),
        }
    }
}

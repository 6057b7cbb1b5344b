//! A file being read: what is in it, and any channel's messages by number.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard};

use mcap::records::{op, MessageHeader, MessageIndexEntry, Record};

use crate::chunk::Records;
use crate::file::{parse, Bytes};
use crate::open::{contents, contents_without_index, unpacked, Contents};
use crate::track::{Entry, Track, LOOSE};
use crate::{Error, Result, Times};

/// One channel.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Channel {
    /// Its number in the file.
    pub id: u16,
    /// Its name.
    pub topic: String,
    /// How its messages are written.
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
pub struct Found {
    /// Its name.
    pub name: String,
    /// Its media type.
    pub media_type: String,
    /// When it was recorded, ns.
    pub log_time: u64,
    /// Where it lies.
    pub offset: u64,
    /// Its bytes.
    pub size: u64,
}

/// A description of a file.
#[derive(Debug, Clone)]
pub struct Info {
    /// Its profile, such as `ros1`.
    pub profile: String,
    /// Who wrote it.
    pub library: String,
    /// Its channels, with the number of messages of each.
    pub channels: Vec<(Channel, u64)>,
    /// Its schemas by their numbers.
    pub schemas: BTreeMap<u16, Schema>,
    /// Its attachments.
    pub attachments: Vec<Found>,
    /// Its metadata records.
    pub metadata: Vec<(String, BTreeMap<String, String>)>,
    /// The damage found, in sentences.
    pub damage: Vec<String>,
    /// Whether its writer came to the end.
    pub finished: bool,
}

/// One message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Message {
    /// Its place in the order of the channel, ns.
    pub time: u64,
    /// When it was recorded, ns.
    pub log_time: u64,
    /// When it was sent, ns.
    pub publish_time: u64,
    /// The writer's count.
    pub sequence: u32,
    /// Its bytes; empty when only the envelope was wanted.
    pub data: Vec<u8>,
}

/// Which messages are wanted.
#[derive(Debug, Clone, Copy)]
pub struct Query {
    /// Of which channel.
    pub channel: u16,
    /// In which order.
    pub times: Times,
    /// The number of the first.
    pub from: u64,
    /// The last time, ns.
    pub to: i128,
    /// No more than so many.
    pub most: usize,
    /// About so many bytes of data.
    pub bytes: usize,
    /// Without their data.
    pub envelopes: bool,
    /// Without those that cannot be read; else that is an error.
    pub skip_damage: bool,
}

/// Bytes of unpacked chunks that are kept: streams that are read side by side share them.
const KEPT: usize = 64 << 20;

/// An open file. Any thread may read.
pub struct Reader {
    pub(crate) bytes: Bytes,
    pub(crate) contents: Contents,
    tracks: Mutex<HashMap<(u16, Times), Arc<Track>>>,
    kept: Mutex<Vec<(u32, Arc<Vec<u8>>)>>,
}

impl std::hash::Hash for Times {
    fn hash<H: std::hash::Hasher>(&self, state: &mut H) {
        (*self as u8).hash(state);
    }
}

/// Passes over the other messages of a chunk that cannot be unpacked.
fn after_damage(track: &Track, at: usize) -> usize {
    let chunk = track.entries[at].chunk;
    let others = track.entries[at + 1..].iter();
    let same = others
        .take_while(|e| chunk != LOOSE && e.chunk == chunk)
        .count();
    at + 1 + same
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex
        .lock()
        .unwrap_or_else(|poisoned| poisoned.into_inner())
}

impl Reader {
    /// Opens a file: by its summary, or by passing over it.
    pub fn open(path: &Path) -> Result<Self> {
        let bytes = Bytes::open(path)?;
        let contents = contents(&bytes)?;
        Ok(Reader::new(bytes, contents))
    }

    /// Opens a file by passing over it, since its index is wrong: `why`.
    pub fn open_without_index(path: &Path, why: &str) -> Result<Self> {
        let bytes = Bytes::open(path)?;
        let contents = contents_without_index(&bytes, why)?;
        Ok(Reader::new(bytes, contents))
    }

    fn new(bytes: Bytes, contents: Contents) -> Self {
        Reader {
            bytes,
            contents,
            tracks: Mutex::default(),
            kept: Mutex::default(),
        }
    }

    /// A description of the file.
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

    pub(crate) fn index(&self, channel: u16, at: u64) -> Result<Vec<MessageIndexEntry>> {
        let place = self.bytes.place(at)?;
        let place =
            place.ok_or_else(|| Error::Damaged(at, "no message index is there".to_string()))?;
        let body = self.bytes.body(place)?;
        match parse(place.opcode, &body, at)? {
            Record::MessageIndex(index) if index.channel_id == channel => Ok(index.records),
            _ => {
                let why = "no message index of the channel is there".to_string();
                Err(Error::Damaged(at, why))
            }
        }
    }

    /// The number of the first message at or after `time`.
    pub fn seek(&self, channel: u16, times: Times, time: i128) -> Result<u64> {
        Ok(self.track(channel, times)?.seek(time) as u64)
    }

    /// Returns messages of a channel as the query says, at least one where there is one, and the next number.
    pub fn read(&self, query: &Query) -> Result<(Vec<Message>, u64)> {
        let track = self.track(query.channel, query.times)?;
        let mut at = usize::try_from(query.from).unwrap_or(usize::MAX);
        let mut found = Vec::new();
        let mut size = 0;
        while let Some(entry) = track.entries.get(at) {
            let enough = found.len() >= query.most || size >= query.bytes;
            if i128::from(entry.time) > query.to || enough {
                break;
            }
            match self.message(entry, query.envelopes) {
                Ok(message) => {
                    size += message.data.len();
                    found.push(message);
                    at += 1;
                }
                Err(Error::Damaged(..)) if query.skip_damage => at = after_damage(&track, at),
                Err(other) => return Err(other),
            }
        }
        Ok((found, at as u64))
    }

    fn message(&self, entry: &Entry, envelopes: bool) -> Result<Message> {
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
            let place = self.bytes.place(entry.offset)?;
            let place = place
                .ok_or_else(|| Error::Damaged(entry.offset, "no record is there".to_string()))?;
            whole = Arc::new(self.bytes.body(place)?);
            (place.opcode, whole.as_slice())
        } else {
            whole = self.chunk(entry.chunk)?;
            let record = Records::at(&whole, entry.offset);
            record.ok_or_else(|| {
                Error::Damaged(
                    entry.offset,
                    "the index points at no record of its chunk".to_string(),
                )
            })?
        };
        match parse(opcode, body, entry.offset)? {
            Record::Message { header, data } => Ok(fun(&header, &data)),
            _ => Err(Error::Damaged(
                entry.offset,
                "the index points at no message".to_string(),
            )),
        }
    }

    pub(crate) fn chunk(&self, number: u32) -> Result<Arc<Vec<u8>>> {
        if let Some((_, bytes)) = locked(&self.kept).iter().find(|(n, _)| *n == number) {
            return Ok(bytes.clone());
        }
        let chunk = self.contents.chunks.get(number as usize);
        let chunk = chunk.ok_or_else(|| Error::Damaged(0, "no such chunk".to_string()))?;
        let place = self.bytes.place(chunk.offset)?;
        let place =
            place.ok_or_else(|| Error::Damaged(chunk.offset, "no chunk is there".to_string()))?;
        if place.opcode != op::CHUNK {
            return Err(Error::Damaged(
                chunk.offset,
                "no chunk is there".to_string(),
            ));
        }
        let (records, _) = unpacked(&self.bytes, place, chunk.offset)?;
        let records = Arc::new(records);
        let mut kept = locked(&self.kept);
        let mut size = records.len() + kept.iter().map(|(_, b)| b.len()).sum::<usize>();
        while size > KEPT && !kept.is_empty() {
            size -= kept.remove(0).1.len();
        }
        kept.push((number, records.clone()));
        Ok(records)
    }

    /// The index of a channel, made when it is first asked for.
    pub(crate) fn track(&self, channel: u16, times: Times) -> Result<Arc<Track>> {
        if let Some(track) = locked(&self.tracks).get(&(channel, times)) {
            return Ok(track.clone());
        }
        let mut entries = self.entries(channel)?;
        if times.in_messages() {
            // A message that cannot be read keeps the time of the index. Only reading it is an error.
            let mut damaged = None;
            for entry in &mut entries {
                if entry.chunk != LOOSE && damaged == Some(entry.chunk) {
                    continue;
                }
                match self.with_message(entry, |header, data| times.of(header, data)) {
                    Ok(time) => entry.time = time,
                    Err(Error::Damaged(..)) => damaged = Some(entry.chunk),
                    Err(other) => return Err(other),
                }
            }
        }
        let track = Arc::new(Track::new(entries));
        locked(&self.tracks).insert((channel, times), track.clone());
        Ok(track)
    }

    /// The places of a channel's messages, by their log times as they are.
    pub(crate) fn entries(&self, channel: u16) -> Result<Vec<Entry>> {
        match &self.contents.entries {
            Some(entries) => Ok(entries.get(&channel).cloned().unwrap_or_default()),
            None => self.indexed(channel),
        }
    }

    /// By the message indexes behind the chunks.
    fn indexed(&self, channel: u16) -> Result<Vec<Entry>> {
        let mut entries = Vec::new();
        for (number, chunk) in self.contents.chunks.iter().enumerate() {
            let Some(&at) = chunk.indexes.get(&channel) else {
                continue;
            };
            let chunk = number as u32;
            entries.extend(self.index(channel, at)?.iter().map(|r| Entry {
                time: r.log_time,
                chunk,
                offset: r.offset,
            }));
        }
        Ok(entries)
    }

    /// An attachment's bytes.
    pub fn attachment(&self, offset: u64) -> Result<Vec<u8>> {
        let place = self.bytes.place(offset)?;
        let place = place.filter(|p| p.opcode == op::ATTACHMENT);
        let place =
            place.ok_or_else(|| Error::Damaged(offset, "no attachment is there".to_string()))?;
        match parse(op::ATTACHMENT, &self.bytes.body(place)?, offset)? {
            Record::Attachment { data, .. } => Ok(data.into_owned()),
            _ => Err(Error::Damaged(offset, "no attachment is there".to_string())),
        }
    }
}

//! Opens files: by the summary at the file's end if it is complete, otherwise by scanning all records.

mod attachment;
mod chunk_records;
mod gaps;
mod scan;
mod walk;

use std::collections::BTreeMap;

use mcap::records::{op, ChunkIndex, Record, Statistics};

use crate::chunk::Records;
use crate::file::{parse_record, FileBytes};
use crate::track::Entry;
use crate::{AttachmentInfo, Channel, Error, Result, Schema};

pub use attachment::StoredAttachment;
pub use chunk_records::{read_chunk_info, unpack_records};
pub use scan::describe_damage;
use scan::scan_records;
pub use walk::Walk;

pub const MAGIC: &[u8] = &[0x89, b'M', b'C', b'A', b'P', 0x30, b'\r', b'\n'];
const FOOTER: u64 = 9 + 20 + 8;

/// A chunk and the message indexes after it.
#[derive(Debug, Clone, Default)]
pub struct ChunkInfo {
    pub offset: u64,
    pub indexes: BTreeMap<u16, u64>,
    pub start: u64,
    pub end: u64,
    /// The size of its record, of its compressed data, and of its unpacked data, bytes.
    pub length: u64,
    pub packed: u64,
    pub unpacked: u64,
    pub compression: String,
}

/// The contents of a file.
#[derive(Debug, Default)]
pub struct Contents {
    pub profile: String,
    pub library: String,
    pub channels: BTreeMap<u16, Channel>,
    pub schemas: BTreeMap<u16, Schema>,
    pub chunks: Vec<ChunkInfo>,
    pub counts: BTreeMap<u16, u64>,
    pub attachments: Vec<AttachmentInfo>,
    pub metadata: Vec<(String, BTreeMap<String, String>)>,
    /// Messages found while scanning the file. With an index they are looked up later.
    pub entries: Option<BTreeMap<u16, Vec<Entry>>>,
    pub damage: Vec<String>,
    pub finished: bool,
}

/// The maximum number of sentences about damage.
const MOST_SENTENCES: usize = 1000;

/// Adds a sentence about damage to a list, up to a limit.
pub fn push_sentence(sentences: &mut Vec<String>, sentence: String) {
    if sentences.len() < MOST_SENTENCES {
        sentences.push(sentence);
    }
}

impl Contents {
    fn note_damage(&mut self, sentence: String) {
        push_sentence(&mut self.damage, sentence);
    }
}

pub fn read_contents(bytes: &FileBytes) -> Result<Contents> {
    if bytes.size < 8 || bytes.read(0, 8)? != MAGIC {
        return Err(Error::NotMcap);
    }
    match read_summary(bytes) {
        Ok(Some(contents)) => Ok(contents),
        Ok(None) => scan_records(bytes),
        Err(Error::Damaged(at, why)) => {
            read_contents_without_index(bytes, &format!("at byte {at}: {why}"))
        }
        Err(other) => Err(other),
    }
}

pub fn read_contents_without_index(bytes: &FileBytes, why: &str) -> Result<Contents> {
    if bytes.size < 8 || bytes.read(0, 8)? != MAGIC {
        return Err(Error::NotMcap);
    }
    let mut contents = scan_records(bytes)?;
    contents.note_damage(format!("the index cannot be read {why}"));
    Ok(contents)
}

/// Returns `None` if there is no summary, or if it does not describe every message.
fn read_summary(bytes: &FileBytes) -> Result<Option<Contents>> {
    if bytes.size < 8 + FOOTER {
        return Ok(None);
    }
    let tail = bytes.read(bytes.size - FOOTER, FOOTER)?;
    if &tail[29..] != MAGIC || tail[0] != op::FOOTER {
        return Ok(None);
    }
    let Record::Footer(footer) = parse_record(op::FOOTER, &tail[9..29], bytes.size - FOOTER)?
    else {
        return Ok(None);
    };
    if footer.summary_start == 0 || footer.summary_start > bytes.size - FOOTER {
        return Ok(None);
    }
    let length = bytes.size - FOOTER - footer.summary_start;
    let section = bytes.read(footer.summary_start, length)?;
    let mut contents = Contents {
        finished: true,
        ..Contents::default()
    };
    if let Some(record) = bytes.record_head(8)? {
        add_record(
            &mut contents,
            record.opcode,
            &bytes.record_body(record)?,
            record.body,
        )?;
    }
    let mut statistics = None;
    let mut read = 0;
    let mut indexed = Vec::new();
    for (opcode, at, body) in Records::new(&section) {
        let at = footer.summary_start + at;
        read = at + 9 + body.len() as u64;
        match parse_record(opcode, body, at)? {
            Record::Statistics(found) => {
                contents.counts = found.channel_message_counts.clone();
                statistics = Some(found);
            }
            Record::ChunkIndex(index) => {
                let length = index
                    .chunk_length
                    .saturating_add(index.message_index_length);
                indexed.push((index.chunk_start_offset, length));
                contents.chunks.push(chunk_info(index));
            }
            Record::AttachmentIndex(index) => {
                indexed.push((index.offset, index.length));
                contents.attachments.push(AttachmentInfo {
                    name: index.name,
                    media_type: index.media_type,
                    log_time: index.log_time,
                    offset: index.offset,
                    size: index.data_size,
                });
            }
            Record::MetadataIndex(index) => {
                indexed.push((index.offset, index.length));
                add_metadata(bytes, &mut contents, index.offset)?;
            }
            _ => add_record(&mut contents, opcode, body, at)?,
        }
    }
    if read != bytes.size - FOOTER {
        return Err(Error::Damaged(
            read,
            "the summary ends within a record".to_string(),
        ));
    }
    contents.chunks.sort_by_key(|c| c.offset);
    let whole = statistics.is_some_and(|statistics| is_complete(&contents, &statistics))
        && gaps::read_gaps(bytes, &mut contents, indexed, footer.summary_start)?;
    Ok(whole.then_some(contents))
}

fn chunk_info(index: ChunkIndex) -> ChunkInfo {
    ChunkInfo {
        offset: index.chunk_start_offset,
        indexes: index.message_index_offsets,
        start: index.message_start_time,
        end: index.message_end_time,
        length: index.chunk_length,
        packed: index.compressed_size,
        unpacked: index.uncompressed_size,
        compression: index.compression,
    }
}

/// Returns whether the summary contains the position of every message.
fn is_complete(contents: &Contents, statistics: &Statistics) -> bool {
    let messages: u64 = contents.counts.values().sum();
    let chunks = statistics.chunk_count as usize;
    let indexed = contents
        .chunks
        .iter()
        .all(|c| !c.indexes.is_empty() || c.start == 0 && c.end == 0);
    let known = contents
        .counts
        .keys()
        .all(|id| contents.channels.contains_key(id));
    let defined = |schema: u16| schema == 0 || contents.schemas.contains_key(&schema);
    let defined = contents.channels.values().all(|c| defined(c.schema));
    let counted = messages == 0 || chunks > 0 && chunks == contents.chunks.len() && indexed;
    statistics.message_count == messages && known && defined && counted
}

fn add_metadata(bytes: &FileBytes, contents: &mut Contents, offset: u64) -> Result<()> {
    if let Some(record) = bytes.record_head(offset)? {
        if record.opcode == op::METADATA {
            add_record(
                contents,
                op::METADATA,
                &bytes.record_body(record)?,
                record.body,
            )?;
        }
    }
    Ok(())
}

/// Adds a record that may be anywhere in a file: header, schema, channel or metadata.
fn add_record(contents: &mut Contents, opcode: u8, body: &[u8], at: u64) -> Result<()> {
    if !matches!(opcode, op::HEADER | op::SCHEMA | op::CHANNEL | op::METADATA) {
        return Ok(());
    }
    match parse_record(opcode, body, at)? {
        Record::Header(header) => {
            contents.profile = header.profile;
            contents.library = header.library;
        }
        Record::Schema { header, data } => {
            let schema = Schema {
                name: header.name,
                encoding: header.encoding,
                data: data.into_owned(),
            };
            contents.schemas.entry(header.id).or_insert(schema);
        }
        Record::Channel(channel) => {
            let channel = Channel::from(channel);
            contents.channels.entry(channel.id).or_insert(channel);
        }
        Record::Metadata(metadata) => contents.metadata.push((metadata.name, metadata.metadata)),
        _ => {}
    }
    Ok(())
}

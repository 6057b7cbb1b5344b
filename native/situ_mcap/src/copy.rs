//! Copies a file's records to another file unchanged. Nothing is decoded, so messages of unknown types are copied,
//! too.

mod definitions;
mod sorted;
mod streamed;

use std::collections::{BTreeMap, BTreeSet};

use mcap::records::{MessageHeader, Record};
use mcap::write::PrivateRecordOptions;

use crate::file::parse_record;
use crate::open::{push_sentence, StoredAttachment};
use crate::{Channel, Compression, Error, Reader, Result, Schema, Writer};

use definitions::Definitions;

/// The order of the messages in the new file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// The order of the original.
    File,
    /// By log times; messages with equal times keep the order of the original.
    LogTime,
}

/// Selects the messages to copy.
#[derive(Debug, Clone)]
pub struct Selection {
    /// The channels to copy; `None` for all.
    pub channels: Option<BTreeSet<u16>>,
    /// The first log time, ns.
    pub from: i128,
    /// The last log time, ns.
    pub to: i128,
    /// Their order.
    pub order: Order,
    /// The names of metadata records that are replaced by others.
    pub replaced: BTreeSet<String>,
    /// Whether damaged parts are left out; otherwise they are errors.
    pub skip_damage: bool,
}

impl Selection {
    fn includes_message(&self, header: &MessageHeader) -> bool {
        let time = i128::from(header.log_time);
        self.includes_channel(header.channel_id) && time >= self.from && time <= self.to
    }

    fn includes_channel(&self, id: u16) -> bool {
        self.channels
            .as_ref()
            .is_none_or(|wanted| wanted.contains(&id))
    }
}

/// The amount copied so far.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct CopyReport {
    /// The number of messages.
    pub messages: u64,
    /// The number of attachments.
    pub attachments: u64,
    /// The number of metadata records.
    pub metadata: u64,
    /// Sentences about the parts that could not be copied.
    pub left_out: Vec<String>,
}

impl CopyReport {
    fn note_left_out(&mut self, sentence: String) {
        push_sentence(&mut self.left_out, sentence);
    }
}

enum Plan {
    Streamed(streamed::Streamed),
    Sorted(sorted::Sorted),
}

/// A copy in progress.
pub struct Copy {
    selection: Selection,
    plan: Plan,
    report: CopyReport,
    definitions: Definitions,
    unknown: BTreeMap<u16, u64>,
}

impl Copy {
    /// Begins a copy by writing schemas and channels under their original numbers.
    pub fn begin(reader: &Reader, writer: &mut Writer, selection: Selection) -> Result<Self> {
        let contents = &reader.contents;
        let channels = contents.channels.values();
        let channels: Vec<_> = channels
            .filter(|c| selection.includes_channel(c.id))
            .collect();
        let mut report = CopyReport::default();
        let mut definitions = Definitions::default();
        for (&id, schema) in &contents.schemas {
            if selection.channels.is_none() || channels.iter().any(|c| c.schema == id) {
                definitions.write_schema(writer, id, schema)?;
            }
        }
        for channel in channels {
            if let Err(Error::Damaged(at, why)) = definitions.write_channel(writer, channel) {
                if !selection.skip_damage {
                    return Err(Error::Damaged(at, why));
                }
                report.note_left_out(why);
                let schema = 0;
                definitions.write_channel(
                    writer,
                    &Channel {
                        schema,
                        ..channel.clone()
                    },
                )?;
            }
        }
        let plan = match selection.order {
            Order::File => Plan::Streamed(streamed::Streamed::new(reader)),
            Order::LogTime => Plan::Sorted(sorted::Sorted::new(reader, &selection)?),
        };
        Ok(Copy {
            selection,
            plan,
            report,
            definitions,
            unknown: BTreeMap::new(),
        })
    }

    /// Copies a few more megabytes. Returns whether the copy is complete.
    pub fn step(&mut self, reader: &Reader, writer: &mut Writer) -> Result<bool> {
        let mut plan = std::mem::replace(&mut self.plan, Plan::Sorted(sorted::Sorted::default()));
        let result = match &mut plan {
            Plan::Streamed(streamed) => streamed.step(self, reader, writer),
            Plan::Sorted(sorted) => sorted.step(self, reader, writer),
        };
        self.plan = plan;
        let done = result?;
        if done {
            for (channel, n) in std::mem::take(&mut self.unknown) {
                self.report.note_left_out(format!(
                    "{n} messages are of channel {channel}, which the file does not describe"
                ));
            }
        }
        Ok(done)
    }

    /// Returns the amount copied so far.
    pub fn report(&self) -> &CopyReport {
        &self.report
    }

    fn copy_message(
        &mut self,
        writer: &mut Writer,
        header: &MessageHeader,
        data: &[u8],
        at: u64,
    ) -> Result<()> {
        if !self.selection.includes_message(header) {
            return Ok(());
        }
        if !self.definitions.channels.contains(&header.channel_id) {
            let id = header.channel_id;
            let why = format!("a message of channel {id}, which the file does not describe");
            *self.unknown.entry(id).or_default() += 1;
            return if self.selection.skip_damage {
                Ok(())
            } else {
                Err(Error::Damaged(at, why))
            };
        }
        self.report.messages += 1;
        writer
            .inner()?
            .write_to_known_channel(header, data)
            .map_err(|e| Error::mcap("write", e))
    }

    fn copy_attachment(&mut self, reader: &Reader, writer: &mut Writer, at: u64) -> Result<()> {
        let record = reader.bytes.record_head(at)?;
        let record = record.ok_or_else(|| Error::Damaged(at, "no attachment is there".into()))?;
        let attachment = StoredAttachment::read(&reader.bytes, record, at)?;
        attachment.verify_checksum(&reader.bytes, at)?;
        let inner = writer.inner()?;
        let failed = |e| Error::mcap("write", e);
        inner
            .start_attachment(attachment.size, attachment.header.clone())
            .map_err(failed)?;
        attachment.visit_data(&reader.bytes, |block| {
            inner.put_attachment_bytes(block).map_err(failed)
        })?;
        inner.finish_attachment().map_err(failed)?;
        self.report.attachments += 1;
        Ok(())
    }

    fn copy_metadata(
        &mut self,
        writer: &mut Writer,
        name: String,
        metadata: BTreeMap<String, String>,
    ) -> Result<()> {
        if self.selection.replaced.contains(&name) {
            return Ok(());
        }
        self.report.metadata += 1;
        writer.write_metadata(&name, metadata)
    }

    /// Copies a record from inside or outside of a chunk.
    fn copy_record(
        &mut self,
        writer: &mut Writer,
        (opcode, body, at): (u8, &[u8], u64),
        chunked: bool,
    ) -> Result<()> {
        match parse_record(opcode, body, at)? {
            Record::Message { header, data } => self.copy_message(writer, &header, &data, at),
            // With selected channels, all wanted ones are written already. Without, a summary may have left some
            // out.
            Record::Schema { .. } | Record::Channel(_) if self.selection.channels.is_some() => {
                Ok(())
            }
            Record::Schema { header, data } => {
                let (name, encoding, data) = (header.name, header.encoding, data.into_owned());
                let schema = Schema {
                    name,
                    encoding,
                    data,
                };
                self.definitions.write_schema(writer, header.id, &schema)
            }
            Record::Channel(channel) => self.definitions.write_channel(writer, &channel.into()),
            Record::Metadata(metadata) => {
                self.copy_metadata(writer, metadata.name, metadata.metadata)
            }
            Record::Unknown { opcode, data } if opcode >= 0x80 => {
                let options = match chunked {
                    true => PrivateRecordOptions::IncludeInChunks.into(),
                    false => Default::default(),
                };
                let inner = writer.inner()?;
                inner
                    .write_private_record(opcode, &data, options)
                    .map_err(|e| Error::mcap("write", e))
            }
            Record::Unknown { opcode, .. } => {
                let what = format!("a record of unknown kind {opcode} at byte {at}");
                self.report.note_left_out(what);
                Ok(())
            }
            _ => Ok(()),
        }
    }
}

impl Reader {
    /// Returns the compression of the file's chunks, and whether there are any.
    pub fn chunk_style(&self) -> (Compression, bool) {
        let chunk = self.contents.chunks.first();
        let compression = match chunk.map(|c| c.compression.as_str()) {
            Some("lz4") => Compression::Lz4,
            Some("zstd") => Compression::Zstd,
            _ => Compression::None,
        };
        (compression, chunk.is_some())
    }
}

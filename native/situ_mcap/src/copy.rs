//! Copies a file's records to another file as they are. Nothing is decoded, so that messages which nobody here can
//! interpret are copied with the others.

mod described;
mod sorted;
mod streamed;

use std::collections::{BTreeMap, BTreeSet};

use mcap::records::{MessageHeader, Record};
use mcap::write::PrivateRecordOptions;

use crate::file::parse;
use crate::open::{push_sentence, Attached};
use crate::{Channel, Compression, Error, Reader, Result, Schema, Writer};

use described::Described;

/// The order of the messages in the new file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// As in the original.
    File,
    /// By their log times; those of one time as in the original.
    LogTime,
}

/// Which messages are copied.
#[derive(Debug, Clone)]
pub struct Selection {
    /// Those of these channels; `None` for all.
    pub channels: Option<BTreeSet<u16>>,
    /// The first log time, ns.
    pub from: i128,
    /// The last log time, ns.
    pub to: i128,
    /// Their order.
    pub order: Order,
    /// The names of records of metadata that others replace.
    pub replaced: BTreeSet<String>,
    /// Whether damaged parts are left out; else they are errors.
    pub skip_damage: bool,
}

impl Selection {
    fn wants(&self, header: &MessageHeader) -> bool {
        let time = i128::from(header.log_time);
        self.wants_channel(header.channel_id) && time >= self.from && time <= self.to
    }

    fn wants_channel(&self, id: u16) -> bool {
        self.channels
            .as_ref()
            .is_none_or(|wanted| wanted.contains(&id))
    }
}

/// The parts copied so far.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Copied {
    /// Messages.
    pub messages: u64,
    /// Attachments.
    pub attachments: u64,
    /// Records of metadata.
    pub metadata: u64,
    /// The parts that could not be copied, in sentences.
    pub left_out: Vec<String>,
}

impl Copied {
    fn note_left_out(&mut self, sentence: String) {
        push_sentence(&mut self.left_out, sentence);
    }
}

enum Plan {
    Streamed(streamed::Streamed),
    Sorted(sorted::Sorted),
}

/// A copy that is running.
pub struct Copy {
    selection: Selection,
    plan: Plan,
    copied: Copied,
    described: Described,
    unknown: BTreeMap<u16, u64>,
}

impl Copy {
    /// Begins a copy: writes schemas and channels, under the numbers that they have.
    pub fn begin(reader: &Reader, writer: &mut Writer, selection: Selection) -> Result<Self> {
        let contents = &reader.contents;
        let channels = contents.channels.values();
        let channels: Vec<_> = channels.filter(|c| selection.wants_channel(c.id)).collect();
        let mut copied = Copied::default();
        let mut described = Described::default();
        for (&id, schema) in &contents.schemas {
            if selection.channels.is_none() || channels.iter().any(|c| c.schema == id) {
                described.schema(writer, id, schema)?;
            }
        }
        for channel in channels {
            if let Err(Error::Damaged(at, why)) = described.channel(writer, channel) {
                if !selection.skip_damage {
                    return Err(Error::Damaged(at, why));
                }
                copied.note_left_out(why);
                let schema = 0;
                described.channel(
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
            copied,
            described,
            unknown: BTreeMap::new(),
        })
    }

    /// Copies some megabytes more, and returns whether that was all.
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
                self.copied.note_left_out(format!(
                    "{n} messages are of channel {channel}, which the file does not describe"
                ));
            }
        }
        Ok(done)
    }

    /// Returns the parts copied so far.
    pub fn copied(&self) -> &Copied {
        &self.copied
    }

    fn message(
        &mut self,
        writer: &mut Writer,
        header: &MessageHeader,
        data: &[u8],
        at: u64,
    ) -> Result<()> {
        if !self.selection.wants(header) {
            return Ok(());
        }
        if !self.described.channels.contains(&header.channel_id) {
            let id = header.channel_id;
            let why = format!("a message of channel {id}, which the file does not describe");
            *self.unknown.entry(id).or_default() += 1;
            return if self.selection.skip_damage {
                Ok(())
            } else {
                Err(Error::Damaged(at, why))
            };
        }
        self.copied.messages += 1;
        writer
            .inner()?
            .write_to_known_channel(header, data)
            .map_err(|e| Error::mcap("write", e))
    }

    fn attachment(&mut self, reader: &Reader, writer: &mut Writer, at: u64) -> Result<()> {
        let place = reader.bytes.place(at)?;
        let place = place.ok_or_else(|| Error::Damaged(at, "no attachment is there".into()))?;
        let attached = Attached::read(&reader.bytes, place, at)?;
        attached.verify(&reader.bytes, at)?;
        let inner = writer.inner()?;
        let failed = |e| Error::mcap("write", e);
        inner
            .start_attachment(attached.size, attached.header.clone())
            .map_err(failed)?;
        attached.each_piece(&reader.bytes, |piece| {
            inner.put_attachment_bytes(piece).map_err(failed)
        })?;
        inner.finish_attachment().map_err(failed)?;
        self.copied.attachments += 1;
        Ok(())
    }

    fn metadata(
        &mut self,
        writer: &mut Writer,
        name: String,
        metadata: BTreeMap<String, String>,
    ) -> Result<()> {
        if self.selection.replaced.contains(&name) {
            return Ok(());
        }
        self.copied.metadata += 1;
        writer.metadata(&name, metadata)
    }

    /// A record of a chunk, or one outside of chunks.
    fn record(
        &mut self,
        writer: &mut Writer,
        (opcode, body, at): (u8, &[u8], u64),
        chunked: bool,
    ) -> Result<()> {
        match parse(opcode, body, at)? {
            Record::Message { header, data } => self.message(writer, &header, &data, at),
            // Those that a summary leaves out; the others are there already.
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
                self.described.schema(writer, header.id, &schema)
            }
            Record::Channel(channel) => self.described.channel(writer, &channel.into()),
            Record::Metadata(metadata) => self.metadata(writer, metadata.name, metadata.metadata),
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
                let what =
                    format!("a record of kind {opcode} at byte {at}, which MCAP does not know");
                self.copied.note_left_out(what);
                Ok(())
            }
            _ => Ok(()),
        }
    }
}

impl Reader {
    /// How its own chunks are made: the compression, and whether there are any.
    pub fn style(&self) -> (Compression, bool) {
        let chunk = self.contents.chunks.first();
        let compression = match chunk.map(|c| c.compression.as_str()) {
            Some("lz4") => Compression::Lz4,
            Some("zstd") => Compression::Zstd,
            _ => Compression::None,
        };
        (compression, chunk.is_some())
    }
}

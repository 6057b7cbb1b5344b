//! Copies in the order of log times. The positions of all messages are in memory, 24 bytes each.

use super::{Copy, Selection};
use crate::track::Entry;
use crate::{Error, Reader, Result, Writer};

/// The number of messages in a step.
const STEP: usize = 10_000;

#[derive(Default)]
pub struct Sorted {
    messages: Vec<Entry>,
    done: usize,
}

impl Sorted {
    pub fn new(reader: &Reader, selection: &Selection) -> Result<Self> {
        let mut messages = Vec::new();
        for &id in reader.contents.channels.keys() {
            if selection.includes_channel(id) {
                messages.extend(reader.channel_entries(id)?);
            }
        }
        messages.sort_by_key(|entry| (entry.time, entry.chunk, entry.offset));
        Ok(Sorted { messages, done: 0 })
    }

    pub fn step(&mut self, copy: &mut Copy, reader: &Reader, writer: &mut Writer) -> Result<bool> {
        let until = self.messages.len().min(self.done + STEP);
        while self.done < until {
            let entry = self.messages[self.done];
            self.done += 1;
            let result = reader.with_message(&entry, |header, data| {
                copy.copy_message(writer, header, data, entry.offset)
            });
            match result {
                Ok(written) => written?,
                Err(Error::Damaged(_, why)) if copy.selection.skip_damage => {
                    copy.report
                        .note_left_out(format!("a message at {} ns: {why}", entry.time));
                }
                Err(other) => return Err(other),
            }
        }
        if self.done < self.messages.len() {
            return Ok(false);
        }
        for attachment in &reader.contents.attachments {
            match copy.copy_attachment(reader, writer, attachment.offset) {
                Err(Error::Damaged(_, why)) if copy.selection.skip_damage => {
                    copy.report.note_left_out(why);
                }
                other => other?,
            }
        }
        for (name, metadata) in &reader.contents.metadata {
            copy.copy_metadata(writer, name.clone(), metadata.clone())?;
        }
        Ok(true)
    }
}

//! Copies messages from one store to another without decoding payloads, so unknown types are copied, too.

use crate::chunk::{Input, Value};
use crate::error::{Error, Result};
use crate::format::Encoding;
use crate::reader::Reader;
use crate::writer::Writer;

/// Selects the messages to copy: those of a stream from an ordinal on and no later than `to`, until at least
/// `bytes` were read.
pub struct MessageRange<'a> {
    /// The store to read.
    pub reader: &'a Reader,
    /// The stream's number in that store.
    pub stream: u32,
    /// The ordinal of the first message.
    pub ordinal: u64,
    /// The latest originating time, ns.
    pub to: i64,
    /// The number of payload bytes after which copying stops.
    pub bytes: u64,
}

/// Copies a range of messages to stream `target` and commits them. Returns the number of messages and the ordinal
/// after them. `codec` maps a codec's number to its number in the new store. Damage ends the range; damage in the
/// first message is returned as an error.
pub fn copy_messages(
    range: &MessageRange<'_>,
    writer: &mut Writer,
    target: u32,
    codec: impl Fn(u16) -> u16,
) -> Result<(u64, u64)> {
    let (mut next, mut count, mut size) = (range.ordinal, 0, 0);
    let reader = range.reader;
    if reader.lacks_chunks(range.stream, next, range.to, u64::MAX, range.bytes) {
        return Err(Error::Absent);
    }
    while size < range.bytes {
        let Some(entry) = range.reader.entry_at(range.stream, next)? else {
            break;
        };
        if entry.first > range.to {
            break;
        }
        let chunk = match range.reader.read_checked_chunk(&entry, true) {
            Ok(chunk) => chunk,
            Err(error) if count == 0 => return Err(error),
            Err(_) => break,
        };
        let (encoding, body) = (chunk.header.encoding, chunk.body());
        let number = match encoding {
            Encoding::Codec => codec(chunk.header.codec),
            _ => 0,
        };
        let from = next;
        let mut at = entry.ordinal;
        for message in chunk.messages() {
            let (envelope, value) = match message {
                Ok(message) => message,
                Err(why) if count == 0 => return Err(range.reader.chunk_error(&entry, why)),
                Err(_) => break,
            };
            at += 1;
            if at <= from {
                continue;
            }
            if envelope.time > range.to {
                break;
            }
            let input = match value {
                Value::Int(value) => Input::Int(value),
                Value::Float(value) => Input::Float(value),
                Value::Bool(value) => Input::Bool(value),
                Value::Bytes { start, length } => {
                    Input::Bytes(body.get(start..start + length).ok_or_else(|| {
                        range
                            .reader
                            .chunk_error(&entry, "a payload ends after its chunk")
                    })?)
                }
            };
            writer.push(target, envelope, encoding, number, input)?;
            next = at;
            count += 1;
        }
        size += entry.length as u64;
        if next < entry.ordinal + entry.count as u64 {
            break;
        }
    }
    writer.commit()?;
    Ok((count, next))
}

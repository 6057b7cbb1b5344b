//! Copies messages of one store into another unchanged. No payload is decoded, so its type may be unknown.

use crate::chunk::{Input, Value};
use crate::error::Result;
use crate::format::Encoding;
use crate::reader::Reader;
use crate::writer::Writer;

/// The messages to copy: those of a stream from an ordinal on, no later than `to`, until at least `bytes` were read.
pub struct Part<'a> {
    /// The store to read.
    pub reader: &'a Reader,
    /// The stream's number there.
    pub stream: u32,
    /// The ordinal of the first message.
    pub ordinal: u64,
    /// The latest originating time, ns.
    pub to: i64,
    /// How many payload bytes are enough.
    pub bytes: u64,
}

/// Commits a part to stream `target`: how many messages, and the ordinal behind them. `codec` tells the number a
/// codec has in the new store. Damage ends the part; as its first message it is the error.
pub fn transfer(
    part: &Part<'_>,
    writer: &mut Writer,
    target: u32,
    codec: impl Fn(u16) -> u16,
) -> Result<(u64, u64)> {
    let (mut next, mut count, mut size) = (part.ordinal, 0, 0);
    while size < part.bytes {
        let Some(entry) = part.reader.entry_at(part.stream, next)? else {
            break;
        };
        if entry.first > part.to {
            break;
        }
        let chunk = match part.reader.chunk_checked(&entry, true) {
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
                Err(why) if count == 0 => return Err(part.reader.broken(&entry, why)),
                Err(_) => break,
            };
            at += 1;
            if at <= from {
                continue;
            }
            if envelope.time > part.to {
                break;
            }
            let input = match value {
                Value::Int(value) => Input::Int(value),
                Value::Float(value) => Input::Float(value),
                Value::Bool(value) => Input::Bool(value),
                Value::Bytes { start, length } => Input::Bytes(
                    body.get(start..start + length)
                        .ok_or_else(|| part.reader.broken(&entry, "a payload has no end"))?,
                ),
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

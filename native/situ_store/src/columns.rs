//! Plain numbers of a stream as columns: times and values as bytes, without a term for each message.

use crate::chunk::Value;
use crate::error::{Error, Result};
use crate::format::{Encoding, Entry};
use crate::reader::Reader;

/// The kinds of values in a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Eight bytes each, little-endian, two's complement.
    Int,
    /// Eight bytes each, little-endian, finite.
    Float,
    /// A byte each, 0 or 1.
    Bool,
}

impl Kind {
    fn of(encoding: Encoding) -> Option<Kind> {
        match encoding {
            Encoding::Int => Some(Kind::Int),
            Encoding::Float => Some(Kind::Float),
            Encoding::Bool => Some(Kind::Bool),
            _ => None,
        }
    }
}

/// Messages as columns of `count` entries each.
#[derive(Debug, Default)]
pub struct Columns {
    /// How many messages there are.
    pub count: u64,
    /// Originating times, `i64`, little-endian.
    pub times: Vec<u8>,
    /// Creation times, likewise.
    pub creations: Vec<u8>,
    /// Values, in the form of their kind.
    pub values: Vec<u8>,
}

/// The messages of a stream from an ordinal on.
#[derive(Debug)]
pub enum Found {
    /// Numbers of one kind, and the ordinal behind them.
    Numbers(Kind, Columns, u64),
    /// Messages that are not plain numbers, or that have `nil` or a float that is not finite among them.
    Others,
    /// Nothing (more) up to the time that was asked for.
    End,
}

/// Which messages are wanted: those of a stream from an ordinal on, no later than `to`, until at least `bytes` of
/// chunks were read or another kind begins.
pub struct Wanted {
    /// The stream's number.
    pub stream: u32,
    /// The ordinal of the first message.
    pub ordinal: u64,
    /// The latest originating time, ns.
    pub to: i64,
    /// How many bytes of chunks are enough.
    pub bytes: u64,
}

/// Reads columns. Damage ends them; as the first chunk it is the error.
pub fn read(reader: &Reader, wanted: &Wanted) -> Result<Found> {
    let (mut next, mut size) = (wanted.ordinal, 0);
    let mut found: Option<(Kind, Columns)> = None;
    while size < wanted.bytes {
        let entry = match reader.entry_at(wanted.stream, next) {
            Ok(Some(entry)) if entry.first <= wanted.to => entry,
            Ok(_) => break,
            Err(error) if found.is_none() => return Err(error),
            Err(_) => break,
        };
        let part = match chunk(reader, &entry, next, wanted.to, found.as_mut()) {
            Ok(part) => part,
            Err(error) if found.is_none() => return Err(error),
            Err(_) => break,
        };
        match part {
            Part::First(kind, columns) => {
                next += columns.count;
                found = Some((kind, columns));
            }
            Part::More(count) => next += count,
            Part::Other if found.is_none() => return Ok(Found::Others),
            Part::Other => break,
        }
        size += u64::from(entry.length);
        if next < entry.ordinal + u64::from(entry.count) {
            break;
        }
    }
    Ok(match found {
        Some((kind, columns)) if columns.count > 0 => Found::Numbers(kind, columns, next),
        _ => Found::End,
    })
}

enum Part {
    First(Kind, Columns),
    /// So many were added to what was found before.
    More(u64),
    Other,
}

/// The wanted messages of one chunk: into `known` where they are of its kind.
fn chunk(
    reader: &Reader,
    entry: &Entry,
    from: u64,
    to: i64,
    known: Option<&mut (Kind, Columns)>,
) -> Result<Part> {
    let chunk = reader.chunk(entry)?;
    let Some(kind) = Kind::of(chunk.header.encoding) else {
        return Ok(Part::Other);
    };
    let broken = |why| -> Error { reader.broken(entry, why) };
    let mut columns = Columns::default();
    let into = match known {
        Some((before, _)) if *before != kind => return Ok(Part::Other),
        Some((_, before)) => Some(before),
        None => None,
    };
    let more = into.is_some();
    let target = into.unwrap_or(&mut columns);
    let (count, ends) = (target.count, target.ends());
    target.reserve(entry.count as usize);
    for (ordinal, message) in (entry.ordinal..).zip(chunk.messages()) {
        let (envelope, value) = match message {
            Ok(message) => message,
            Err(why) => {
                target.cut(count, ends);
                return Err(broken(why));
            }
        };
        if ordinal < from {
            continue;
        }
        if envelope.time > to {
            break;
        }
        match value {
            Value::Int(value) => target.values.extend_from_slice(&value.to_le_bytes()),
            Value::Float(value) if value.is_finite() => {
                target.values.extend_from_slice(&value.to_le_bytes());
            }
            Value::Bool(value) if value < 2 => target.values.push(value),
            // Nothing among numbers.
            _ => {
                target.cut(count, ends);
                return Ok(Part::Other);
            }
        }
        target.times.extend_from_slice(&envelope.time.to_le_bytes());
        target
            .creations
            .extend_from_slice(&envelope.creation.to_le_bytes());
        target.count += 1;
    }
    let added = target.count - count;
    Ok(if more {
        Part::More(added)
    } else {
        Part::First(kind, columns)
    })
}

impl Columns {
    fn reserve(&mut self, count: usize) {
        self.times.reserve(count * 8);
        self.creations.reserve(count * 8);
        self.values.reserve(count * 8);
    }

    fn ends(&self) -> (usize, usize) {
        (self.times.len(), self.values.len())
    }

    fn cut(&mut self, count: u64, (times, values): (usize, usize)) {
        self.count = count;
        self.times.truncate(times);
        self.creations.truncate(times);
        self.values.truncate(values);
    }
}

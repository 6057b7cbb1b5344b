//! Reads a stream of plain numbers as columns: times and values as bytes, without a term for each message.

use crate::chunk::Value;
use crate::error::{Error, Result};
use crate::format::{Encoding, Entry};
use crate::reader::Reader;

/// The kind of values in a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Eight bytes each, little-endian, two's complement.
    Int,
    /// Eight bytes each, little-endian, finite.
    Float,
    /// One byte each, 0 or 1.
    Bool,
}

impl Kind {
    fn from_encoding(encoding: Encoding) -> Option<Kind> {
        match encoding {
            Encoding::Int => Some(Kind::Int),
            Encoding::Float => Some(Kind::Float),
            Encoding::Bool => Some(Kind::Bool),
            _ => None,
        }
    }
}

/// Messages as columns of `count` elements each.
#[derive(Debug, Default)]
pub struct Columns {
    /// The number of messages.
    pub count: u64,
    /// The sequence id of the first message.
    pub first_sequence: u64,
    /// Whether a sequence id is missing, so that the first one does not tell the others.
    pub gaps: bool,
    /// Originating times, `i64`, little-endian.
    pub times: Vec<u8>,
    /// Creation times, `i64`, little-endian.
    pub creations: Vec<u8>,
    /// Values, encoded as their kind says.
    pub values: Vec<u8>,
}

/// The result of reading columns.
#[derive(Debug)]
pub enum ColumnResult {
    /// Numbers of one kind, and the ordinal after them.
    Numbers(Kind, Columns, u64),
    /// The messages are not plain numbers, or `nil` or a non-finite float is among them.
    Others,
    /// There are no more messages up to the requested time.
    End,
}

/// Selects the messages of a stream from an ordinal on and no later than `to`, until at least `bytes` of chunks
/// were read or another kind of value begins.
pub struct ColumnQuery {
    /// The stream's number.
    pub stream: u32,
    /// The ordinal of the first message.
    pub ordinal: u64,
    /// The latest originating time, ns.
    pub to: i64,
    /// The number of chunk bytes after which reading stops.
    pub bytes: u64,
}

/// Reads columns. Damage ends them; damage in the first chunk is returned as an error.
pub fn read_columns(reader: &Reader, query: &ColumnQuery) -> Result<ColumnResult> {
    let (mut next, mut size) = (query.ordinal, 0);
    if reader.lacks_chunks(query.stream, next, query.to, u64::MAX, query.bytes) {
        return Err(Error::Absent);
    }
    let mut found: Option<(Kind, Columns)> = None;
    while size < query.bytes {
        let entry = match reader.entry_at(query.stream, next) {
            Ok(Some(entry)) if entry.first <= query.to => entry,
            Ok(_) => break,
            Err(error) if found.is_none() => return Err(error),
            Err(_) => break,
        };
        let part = match read_chunk_columns(reader, &entry, next, query.to, found.as_mut()) {
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
            Part::Other if found.is_none() => return Ok(ColumnResult::Others),
            Part::Other => break,
        }
        size += u64::from(entry.length);
        if next < entry.ordinal + u64::from(entry.count) {
            break;
        }
    }
    Ok(match found {
        Some((kind, columns)) if columns.count > 0 => ColumnResult::Numbers(kind, columns, next),
        _ => ColumnResult::End,
    })
}

enum Part {
    First(Kind, Columns),
    /// The number of messages added to the columns found before.
    More(u64),
    Other,
}

/// Reads the selected messages of one chunk and appends them to `known` if they are of its kind.
fn read_chunk_columns(
    reader: &Reader,
    entry: &Entry,
    from: u64,
    to: i64,
    known: Option<&mut (Kind, Columns)>,
) -> Result<Part> {
    let chunk = reader.read_chunk(entry)?;
    let Some(kind) = Kind::from_encoding(chunk.header.encoding) else {
        return Ok(Part::Other);
    };
    let broken = |why| -> Error { reader.chunk_error(entry, why) };
    let mut columns = Columns::default();
    let into = match known {
        Some((before, _)) if *before != kind => return Ok(Part::Other),
        Some((_, before)) => Some(before),
        None => None,
    };
    let more = into.is_some();
    let target = into.unwrap_or(&mut columns);
    let (count, ends) = (target.count, target.column_lengths());
    target.reserve(entry.count as usize);
    for (ordinal, message) in (entry.ordinal..).zip(chunk.messages()) {
        let (envelope, value) = match message {
            Ok(message) => message,
            Err(why) => {
                target.truncate(count, ends);
                return Err(broken(why));
            }
        };
        if ordinal < from {
            continue;
        }
        if envelope.time > to {
            break;
        }
        if target.count == 0 {
            target.first_sequence = envelope.sequence;
        }
        target.gaps |= envelope.sequence != target.first_sequence.wrapping_add(target.count);
        match value {
            Value::Int(value) => target.values.extend_from_slice(&value.to_le_bytes()),
            Value::Float(value) if value.is_finite() => {
                target.values.extend_from_slice(&value.to_le_bytes());
            }
            Value::Bool(value) if value < 2 => target.values.push(value),
            // `nil` and non-finite floats have no place among plain numbers.
            _ => {
                target.truncate(count, ends);
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

    fn column_lengths(&self) -> (usize, usize) {
        (self.times.len(), self.values.len())
    }

    fn truncate(&mut self, count: u64, (times, values): (usize, usize)) {
        self.count = count;
        self.times.truncate(times);
        self.creations.truncate(times);
        self.values.truncate(values);
    }
}

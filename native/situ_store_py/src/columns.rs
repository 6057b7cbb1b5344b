//! The class `ColumnReader`: reads a stream of numbers as columns, in steps.

use pyo3::prelude::*;
use situ_store::chunk::{Envelope, Value};
use situ_store::format::Entry;
use situ_store::{Encoding, Error, Result};

use crate::array::{Array, Numbers};
use crate::cursor::ChunkCursor;
use crate::errors::to_exception;

/// Messages with values of one type.
struct Part {
    times: Vec<i64>,
    numbers: Numbers,
}

impl Part {
    fn new(encoding: Encoding, count: usize) -> Option<Part> {
        let numbers = match encoding {
            Encoding::Int => Numbers::Ints(Vec::with_capacity(count)),
            Encoding::Float => Numbers::Floats(Vec::with_capacity(count)),
            Encoding::Bool => Numbers::Booleans(Vec::with_capacity(count)),
            _ => return None,
        };
        let times = Vec::with_capacity(count);
        Some(Part { times, numbers })
    }

    fn matches(&self, encoding: Encoding) -> bool {
        matches!(
            (&self.numbers, encoding),
            (Numbers::Ints(_), Encoding::Int)
                | (Numbers::Floats(_), Encoding::Float)
                | (Numbers::Booleans(_), Encoding::Bool)
        )
    }

    fn truncate(&mut self, count: usize) {
        self.times.truncate(count);
        match &mut self.numbers {
            Numbers::Ints(numbers) => numbers.truncate(count),
            Numbers::Floats(numbers) => numbers.truncate(count),
            Numbers::Booleans(numbers) => numbers.truncate(count),
            Numbers::Codes(numbers) => numbers.truncate(count),
        }
    }

    /// Adds messages. Returns `None` if one of them is not a number, and an error for damage.
    fn push_all(
        &mut self,
        messages: impl Iterator<Item = std::result::Result<(Envelope, Value), &'static str>>,
        (start, stop): (i64, i64),
    ) -> std::result::Result<Option<()>, &'static str> {
        for message in messages {
            let (envelope, value) = message?;
            if envelope.time < start {
                continue;
            }
            if envelope.time > stop {
                break;
            }
            match (&mut self.numbers, value) {
                (Numbers::Floats(numbers), Value::Float(number)) => numbers.push(number),
                (Numbers::Ints(numbers), Value::Int(number)) => numbers.push(number),
                (Numbers::Booleans(numbers), Value::Bool(truth)) if truth < 2 => {
                    numbers.push(truth)
                }
                _ => return Ok(None),
            }
            self.times.push(envelope.time);
        }
        Ok(Some(()))
    }
}

enum Found {
    Numbers(Part),
    /// The ordinal of a chunk whose messages are not plain numbers.
    Others(u64),
    Damage(u64, Error),
}

/// Reads a stream of numbers as columns, in steps, so that the caller can show progress and be interrupted.
#[pyclass(module = "situ_core")]
pub struct ColumnReader {
    cursor: ChunkCursor,
    found: Vec<Found>,
}

impl ColumnReader {
    pub fn new(cursor: ChunkCursor) -> Self {
        let found = Vec::new();
        ColumnReader { cursor, found }
    }

    fn read_step(&mut self, messages: u64) -> Result<()> {
        let until = self.cursor.position().saturating_add(messages);
        while self.cursor.position() < until {
            match self.cursor.next_entry()? {
                Some(entry) => self.read_chunk(&entry),
                None => break,
            }
        }
        Ok(())
    }

    fn read_chunk(&mut self, entry: &Entry) {
        let chunk = match self.cursor.store.read_chunk(entry) {
            Ok(chunk) => chunk,
            Err(error) => return self.found.push(Found::Damage(entry.ordinal, error)),
        };
        let encoding = chunk.header.encoding;
        if !matches!(self.found.last(), Some(Found::Numbers(part)) if part.matches(encoding)) {
            let rest = self.cursor.remaining() + u64::from(entry.count);
            match Part::new(encoding, rest.min(1 << 20) as usize) {
                Some(part) => self.found.push(Found::Numbers(part)),
                None => return self.found.push(Found::Others(entry.ordinal)),
            }
        }
        let Some(Found::Numbers(part)) = self.found.last_mut() else {
            return;
        };
        let before = part.times.len();
        match part.push_all(chunk.messages(), self.cursor.range) {
            Ok(Some(())) => {}
            Ok(None) => {
                part.truncate(before);
                self.found.push(Found::Others(entry.ordinal));
            }
            Err(why) => {
                part.truncate(before);
                let error = self.cursor.store.chunk_error(entry, why);
                self.found.push(Found::Damage(entry.ordinal, error));
            }
        }
    }
}

#[pymethods]
impl ColumnReader {
    /// Reads about this many messages. Returns the part that was read so far, from 0 to 1.
    fn step(&mut self, py: Python<'_>, messages: u64) -> PyResult<f64> {
        py.detach(|| self.read_step(messages))
            .map_err(|error| to_exception(py, error))?;
        Ok(self.cursor.progress())
    }

    /// Takes what was read so far, in order: (times, values) of numbers of one type, the ordinal of a chunk of other
    /// messages, or (ordinal, exception) for a damaged chunk.
    fn take<'py>(&mut self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyAny>>> {
        let found = std::mem::take(&mut self.found);
        let convert = |found| -> PyResult<Bound<'py, PyAny>> {
            Ok(match found {
                Found::Numbers(part) => {
                    let times = Array::new(Numbers::Ints(part.times));
                    (times, Array::new(part.numbers))
                        .into_pyobject(py)?
                        .into_any()
                }
                Found::Others(ordinal) => ordinal.into_pyobject(py)?.into_any(),
                Found::Damage(ordinal, error) => {
                    let error = to_exception(py, error).into_value(py);
                    (ordinal, error).into_pyobject(py)?.into_any()
                }
            })
        };
        found.into_iter().map(convert).collect()
    }
}

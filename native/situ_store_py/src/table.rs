//! The class `TableReader`: reads a stream of maps as a table, in steps.
//!
//! The fields of maps are columns, also those of maps inside of maps, and the fields of structs. It gives up at a
//! message for which this is not obvious (`situ.frames` in Python decides), so that both always have the same result.

use std::collections::HashMap;

use pyo3::prelude::*;
use pyo3::types::PyBytes;
use situ_store::chunk::Value;
use situ_store::etf::term_end;
use situ_store::format::{Entry, LANE_LARGE};
use situ_store::{Encoding, Error, Result};

use crate::array::{Array, Numbers};
use crate::cursor::ChunkCursor;
use crate::errors::to_exception;
use crate::table_column::{Cell, Column, Finished};

const MOST_DEPTH: usize = 32;
/// A stream with more different fields is not a table.
const MOST_COLUMNS: usize = 4096;

#[derive(Default)]
struct Table {
    times: Vec<i64>,
    columns: Vec<Column>,
    names: HashMap<Vec<u8>, usize>,
    /// The column of the next field, if the fields come in the same order as before.
    expected: usize,
    /// The number of columns that have a value for the current row.
    filled: usize,
    path: Vec<u8>,
}

impl Table {
    /// Adds a message: its term after the version byte. Returns `None` if it is not obvious how.
    fn push_message(&mut self, time: i64, term: &[u8]) -> Option<()> {
        (self.expected, self.filled) = (0, 0);
        self.path.clear();
        let end = if term.first() == Some(&116) {
            self.push_map(term, 0, 0)?
        } else {
            self.path.extend_from_slice(b"value");
            self.push_field(term, 0)?
        };
        if end != term.len() {
            return None;
        }
        self.times.push(time);
        if self.filled < self.columns.len() {
            let rows = self.times.len();
            let missing = self.columns.iter_mut().filter(|column| column.len() < rows);
            missing
                .into_iter()
                .try_for_each(|column| column.push(Cell::Nil))?;
        }
        Some(())
    }

    /// Adds the fields of the map at a position, and returns the position after it.
    fn push_map(&mut self, term: &[u8], at: usize, depth: usize) -> Option<usize> {
        let count = read_length(term, at + 1, 4)?;
        let mut at = at + 5;
        let (parent, before) = (self.path.len(), self.filled);
        for _ in 0..count {
            let (name, value, is_atom) = read_key(term, at)?;
            if is_atom && name == b"__struct__" {
                read_atom(term, value)?;
                at = term_end(term, value)?;
                continue;
            }
            if parent > 0 {
                self.path.push(b'.');
            }
            self.path.extend_from_slice(name);
            at = if term.get(value) == Some(&116) {
                if depth == MOST_DEPTH {
                    return None;
                }
                self.push_map(term, value, depth + 1)?
            } else {
                self.push_field(term, value)?
            };
            self.path.truncate(parent);
        }
        // An empty map inside of a map is a value.
        (depth == 0 || self.filled > before).then_some(at)
    }

    /// Adds the value at a position to the column of the current path, and returns the position after it.
    fn push_field(&mut self, term: &[u8], at: usize) -> Option<usize> {
        let (cell, end) = read_cell(term, at)?;
        let column = self.find_column()?;
        if self.columns[column].len() != self.times.len() {
            // Two fields have the same name.
            return None;
        }
        self.columns[column].push(cell)?;
        self.expected = column + 1;
        self.filled += 1;
        Some(end)
    }

    fn find_column(&mut self) -> Option<usize> {
        let expected = self.columns.get(self.expected);
        if expected.is_some_and(|column| column.name == self.path) {
            return Some(self.expected);
        }
        if let Some(found) = self.names.get(&self.path) {
            return Some(*found);
        }
        let (number, name) = (self.columns.len(), self.path.clone());
        if number == MOST_COLUMNS {
            return None;
        }
        self.columns
            .push(Column::new(name.clone(), self.times.len()));
        self.names.insert(name, number);
        Some(number)
    }
}

fn read_length(term: &[u8], at: usize, size: usize) -> Option<usize> {
    let bytes = term.get(at..at.checked_add(size)?)?;
    Some(bytes.iter().fold(0, |sum, byte| sum << 8 | *byte as usize))
}

/// Returns the name of the atom at a position, and the position after it.
fn read_atom(term: &[u8], at: usize) -> Option<(&[u8], usize)> {
    let size = match *term.get(at)? {
        115 | 119 => 1,
        100 | 118 => 2,
        _ => return None,
    };
    let start = at + 1 + size;
    let end = start.checked_add(read_length(term, at + 1, size)?)?;
    let name = term.get(start..end)?;
    std::str::from_utf8(name).ok()?;
    Some((name, end))
}

/// Returns the name of the key at a position, the position after it, and whether it is an atom.
fn read_key(term: &[u8], at: usize) -> Option<(&[u8], usize, bool)> {
    if let Some((name, end)) = read_atom(term, at) {
        return Some((name, end, true));
    }
    if *term.get(at)? != 109 {
        return None;
    }
    let start = at + 5;
    let end = start.checked_add(read_length(term, at + 1, 4)?)?;
    let name = term.get(start..end)?;
    std::str::from_utf8(name).ok()?;
    Some((name, end, false))
}

/// Returns the value at a position, and the position after it.
fn read_cell(term: &[u8], at: usize) -> Option<(Cell<'_>, usize)> {
    if let Some((name, end)) = read_atom(term, at) {
        let cell = match name {
            b"nil" => Cell::Nil,
            b"true" => Cell::Bool(true),
            b"false" => Cell::Bool(false),
            b"nan" => Cell::Float(f64::NAN),
            b"infinity" => Cell::Float(f64::INFINITY),
            b"neg_infinity" => Cell::Float(f64::NEG_INFINITY),
            _ => Cell::Text(term.get(at..end)?),
        };
        return Some((cell, end));
    }
    Some(match *term.get(at)? {
        70 => {
            let bits = read_length(term, at + 1, 8)? as u64;
            (Cell::Float(f64::from_bits(bits)), at + 9)
        }
        97 => (Cell::Int(read_length(term, at + 1, 1)? as i64), at + 2),
        98 => {
            let number = read_length(term, at + 1, 4)? as u32 as i32;
            (Cell::Int(number.into()), at + 5)
        }
        110 => {
            let count = read_length(term, at + 1, 1)?;
            let (sign, end) = (*term.get(at + 2)?, at + 3 + count);
            let digits = term.get(at + 3..end)?;
            (Cell::Int(read_big(sign, digits)?), end)
        }
        109 => {
            let end = term_end(term, at)?;
            (Cell::Text(term.get(at..end)?), end)
        }
        104..=108 => {
            let end = term_end(term, at)?;
            (Cell::Other(term.get(at..end)?), end)
        }
        _ => return None,
    })
}

fn read_big(sign: u8, digits: &[u8]) -> Option<i64> {
    if digits.len() > 8 {
        return None;
    }
    let magnitude = digits
        .iter()
        .rev()
        .fold(0u64, |sum, digit| sum << 8 | *digit as u64);
    match sign {
        0 => i64::try_from(magnitude).ok(),
        _ => 0i64.checked_sub_unsigned(magnitude),
    }
}

/// Reads a stream of maps as a table, in steps, so that the caller can show progress and be interrupted.
#[pyclass(module = "situ_core")]
pub struct TableReader {
    cursor: ChunkCursor,
    /// `None` after a message that does not fit into a table.
    table: Option<Table>,
    damage: Vec<(u64, Error)>,
}

impl TableReader {
    pub fn new(cursor: ChunkCursor) -> Self {
        TableReader {
            cursor,
            table: Some(Table::default()),
            damage: Vec::new(),
        }
    }

    fn read_step(&mut self, messages: u64) -> Result<()> {
        let until = self.cursor.position().saturating_add(messages);
        while self.table.is_some() && self.cursor.position() < until {
            let Some(entry) = self.cursor.next_entry()? else {
                break;
            };
            if self.read_chunk(&entry).is_none() {
                self.table = None;
            }
        }
        Ok(())
    }

    /// Adds the messages of a chunk, unless it is damaged. Returns `None` if one of them does not fit into a table.
    fn read_chunk(&mut self, entry: &Entry) -> Option<()> {
        let chunk = match self.cursor.store.read_chunk(entry) {
            Ok(chunk) => chunk,
            Err(error) => {
                self.damage.push((entry.ordinal, error));
                return Some(());
            }
        };
        if entry.lane == LANE_LARGE || chunk.header.encoding != Encoding::Term {
            return None;
        }
        let (table, (start, stop)) = (self.table.as_mut()?, self.cursor.range);
        for message in chunk.messages() {
            // A chunk that contradicts itself has its first messages in a frame, but not here.
            let (envelope, value) = message.ok()?;
            let Value::Bytes { start: at, length } = value else {
                return None;
            };
            if envelope.time < start || envelope.time > stop {
                continue;
            }
            match chunk.body().get(at..at.checked_add(length)?)? {
                [131, term @ ..] => table.push_message(envelope.time, term)?,
                _ => return None,
            }
        }
        Some(())
    }
}

#[pymethods]
impl TableReader {
    /// Reads about this many messages. Returns the part that was read so far, from 0 to 1; 1 also if there is no table.
    fn step(&mut self, py: Python<'_>, messages: u64) -> PyResult<f64> {
        py.detach(|| self.read_step(messages))
            .map_err(|error| to_exception(py, error))?;
        let ended = self.table.is_none();
        Ok(if ended { 1.0 } else { self.cursor.progress() })
    }

    /// Takes the table, or `None` if the messages are not one: (times, [(name, column)], damage).
    ///
    /// A column is an `Array`, or (array of numbers, list of the values with these numbers as external terms). Damage
    /// is (ordinal, exception).
    fn take<'py>(&mut self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let Some(table) = self.table.take() else {
            return Ok(None);
        };
        let times = Array::new(Numbers::Ints(table.times));
        let columns = table.columns.into_iter().map(|column| -> PyResult<_> {
            let name = String::from_utf8_lossy(&column.name).into_owned();
            let values = match column.finish() {
                Finished::Numbers(numbers) => Bound::new(py, Array::new(numbers))?.into_any(),
                Finished::Objects(codes, terms) => {
                    let terms = terms.iter().map(|term| PyBytes::new(py, term));
                    let codes = Array::new(Numbers::Codes(codes));
                    (codes, terms.collect::<Vec<_>>())
                        .into_pyobject(py)?
                        .into_any()
                }
            };
            Ok((name, values))
        });
        let columns = columns.collect::<PyResult<Vec<_>>>()?;
        let damage = std::mem::take(&mut self.damage).into_iter();
        let damage = damage.map(|(at, error)| (at, to_exception(py, error).into_value(py)));
        let damage = damage.collect::<Vec<_>>();
        let found = (times, columns, damage).into_pyobject(py)?;
        Ok(Some(found.into_any()))
    }
}

//! The class `Reader`.

use std::path::PathBuf;
use std::sync::Arc;

use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyBytes, PyFloat, PyInt, PyList, PyString};
use situ_store::chunk::{Envelope, Value};
use situ_store::format::{Entry, LANE_LARGE};
use situ_store::reader::Chunk;
use situ_store::{Encoding, Error};

use crate::array::Payload;
use crate::columns::ColumnReader;
use crate::cursor::ChunkCursor;
use crate::errors::{damaged, to_exception};
use crate::table::TableReader;

/// A store that is open for reading. Chunks are numbered by the ordinal of their first message.
#[pyclass(module = "situ_core", frozen)]
pub struct Reader {
    store: Arc<situ_store::Reader>,
}

type ChunkRange = (u64, i64, i64, u64, bool);

fn describe_entry(entry: &Entry) -> ChunkRange {
    let next = entry.ordinal.saturating_add(u64::from(entry.count).max(1));
    let large = entry.lane == LANE_LARGE;
    (entry.ordinal, entry.first, entry.last, next, large)
}

#[pymethods]
impl Reader {
    /// Opens the store in a folder.
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let opened = py.detach(|| situ_store::Reader::open(&path));
        let store = opened.map_err(|error| to_exception(py, error))?;
        Ok(Reader {
            store: Arc::new(store),
        })
    }

    /// Loads newly committed index entries and returns the number of entries.
    fn refresh(&self, py: Python<'_>) -> PyResult<u64> {
        py.detach(|| self.store.refresh())
            .map_err(|error| to_exception(py, error))
    }

    /// The creation time of the store, ns.
    #[getter]
    fn created(&self) -> i64 {
        self.store.header.created
    }

    /// Whether the store was closed.
    #[getter]
    fn closed(&self) -> bool {
        self.store.is_closed()
    }

    /// Returns whether a writer has the store open now.
    fn is_live(&self) -> bool {
        self.store.is_live()
    }

    /// Returns descriptions of the damage in the index.
    fn damage(&self) -> Vec<String> {
        let describe = |damage: situ_store::reader::Damage| {
            Error::Damaged(damage.file, damage.offset, damage.why).to_string()
        };
        self.store.damage().into_iter().map(describe).collect()
    }

    /// Returns the streams that have messages: number, message count, and the times (ns) of the first and last one.
    fn streams(&self, py: Python<'_>) -> Vec<(u32, u64, i64, i64)> {
        py.detach(|| {
            let describe = |number| {
                let count = self.store.message_count(number);
                let first = self.store.entry_at(number, 0).ok()??;
                let last = self.store.entry_at(number, count.checked_sub(1)?).ok()??;
                Some((number, count, first.first, last.last))
            };
            let numbers = self.store.stream_numbers().into_iter();
            numbers.filter_map(describe).collect()
        })
    }

    /// Returns the chunk that contains message `ordinal`, or `None` after the last message: (ordinal of its first
    /// message, first time, last time, ordinal after it, whether it is one large message).
    fn chunk(&self, py: Python<'_>, stream: u32, ordinal: u64) -> PyResult<Option<ChunkRange>> {
        let entry = self.store.entry_at(stream, ordinal);
        let entry = entry.map_err(|error| to_exception(py, error))?;
        Ok(entry.as_ref().map(describe_entry))
    }

    /// Returns the first chunk that ends at or after a time (ns), as `chunk` does.
    fn find_chunk(&self, py: Python<'_>, stream: u32, time: i64) -> PyResult<Option<ChunkRange>> {
        let entry = self.store.entry_from(stream, time);
        let entry = entry.map_err(|error| to_exception(py, error))?;
        Ok(entry.as_ref().map(describe_entry))
    }

    /// Returns the messages of the chunk that contains message `ordinal`: (encoding, number of the codec, list of
    /// (time, creation time, sequence id, data), None or the exception for damage after these messages).
    ///
    /// Data are numbers, booleans, None, or bytes. With `text`, unencoded bytes in UTF-8 are str. A large message is a
    /// `Payload`.
    fn messages<'py>(
        &self,
        py: Python<'py>,
        stream: u32,
        ordinal: u64,
        text: bool,
    ) -> PyResult<(u8, u16, Bound<'py, PyList>, Option<PyErr>)> {
        let read = py.detach(|| -> situ_store::Result<Option<(Entry, Chunk)>> {
            let Some(entry) = self.store.entry_at(stream, ordinal)? else {
                return Ok(None);
            };
            Ok(Some((entry, self.store.read_chunk(&entry)?)))
        });
        let found = read.map_err(|error| to_exception(py, error))?;
        let (entry, chunk) = found.ok_or_else(|| PyIndexError::new_err(ordinal))?;
        let (encoding, codec) = (chunk.header.encoding, chunk.header.codec);
        let list = PyList::empty(py);
        let describe = |why| to_exception(py, self.store.chunk_error(&entry, why));
        if entry.lane == LANE_LARGE {
            let first = chunk.messages().next().transpose();
            let error = match first {
                Ok(None) => None,
                Ok(Some((envelope, value))) => {
                    list.append(build_large(py, chunk, envelope, value)?)?;
                    None
                }
                Err(why) => Some(describe(why)),
            };
            return Ok((encoding as u8, codec, list, error));
        }
        let text = text && encoding == Encoding::Bytes;
        for message in chunk.messages() {
            let (envelope, value) = match message {
                Ok(message) => message,
                Err(why) => return Ok((encoding as u8, codec, list, Some(describe(why)))),
            };
            let data = build_data(py, &chunk, value, text)?;
            list.append((envelope.time, envelope.creation, envelope.sequence, data))?;
        }
        Ok((encoding as u8, codec, list, None))
    }

    /// Returns a reader of the messages of a stream as columns, from `start` to `stop` (ns, inclusive).
    fn columns(
        &self,
        py: Python<'_>,
        stream: u32,
        start: Option<i64>,
        stop: Option<i64>,
    ) -> PyResult<ColumnReader> {
        ChunkCursor::new(self.store.clone(), stream, start, stop)
            .map(ColumnReader::new)
            .map_err(|error| to_exception(py, error))
    }

    /// Returns a reader of the messages of a stream as a table, from `start` to `stop` (ns, inclusive).
    fn table(
        &self,
        py: Python<'_>,
        stream: u32,
        start: Option<i64>,
        stop: Option<i64>,
    ) -> PyResult<TableReader> {
        ChunkCursor::new(self.store.clone(), stream, start, stop)
            .map(TableReader::new)
            .map_err(|error| to_exception(py, error))
    }
}

type Row<'py> = (i64, i64, u64, Bound<'py, PyAny>);

fn build_large<'py>(
    py: Python<'py>,
    chunk: Chunk,
    envelope: Envelope,
    value: Value,
) -> PyResult<Row<'py>> {
    let data = match value {
        Value::Bytes { start, length } => {
            let payload = Payload::new(chunk, start, length);
            let payload =
                payload.ok_or_else(|| damaged(py, "a payload ends after its chunk".into()))?;
            Bound::new(py, payload)?.into_any()
        }
        number => build_data(py, &chunk, number, false)?,
    };
    Ok((envelope.time, envelope.creation, envelope.sequence, data))
}

fn build_data<'py>(
    py: Python<'py>,
    chunk: &Chunk,
    value: Value,
    text: bool,
) -> PyResult<Bound<'py, PyAny>> {
    Ok(match value {
        Value::Int(number) => PyInt::new(py, number).into_any(),
        Value::Float(number) => PyFloat::new(py, number).into_any(),
        Value::Bool(2) => py.None().into_bound(py),
        Value::Bool(truth) => PyBool::new(py, truth == 1).to_owned().into_any(),
        Value::Bytes { start, length } => {
            let bytes = chunk.body().get(start..start.saturating_add(length));
            let bytes =
                bytes.ok_or_else(|| damaged(py, "a payload ends after its chunk".into()))?;
            match std::str::from_utf8(bytes) {
                Ok(string) if text => PyString::new(py, string).into_any(),
                _ => PyBytes::new(py, bytes).into_any(),
            }
        }
    })
}

//! The class `Writer`.

use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard};
use std::time::{Duration, Instant};

use pyo3::exceptions::{PyFileExistsError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyBytes, PyFloat, PyInt, PyString};
use situ_store::chunk::{Envelope, Input};
use situ_store::reader::lock_mutex;
use situ_store::writer::system_time;
use situ_store::{Compression, Encoding, Error, Options, Result};

use crate::errors::to_exception;
use crate::pending::Pending;

/// A message waits no longer than this for a commit if others follow.
const MOST_WAITING: Duration = Duration::from_millis(100);

struct State {
    writer: situ_store::Writer,
    pending: Vec<Pending>,
    committed: Instant,
    closed: bool,
}

impl State {
    fn find_pending(&mut self, stream: u32) -> Result<&mut Pending> {
        let at = (stream as usize).checked_sub(1);
        let pending = at.and_then(|at| self.pending.get_mut(at));
        pending.ok_or(Error::UnknownStream(stream))
    }

    /// Commits all waiting messages. After an error they keep waiting.
    fn commit(&mut self) -> Result<()> {
        let waiting = self.pending.iter().filter(|pending| !pending.is_empty());
        let pushed = waiting
            .into_iter()
            .try_for_each(|pending| pending.push_to(&mut self.writer));
        if let Err(error) = pushed.and_then(|()| self.writer.commit().map(|_| ())) {
            self.writer.rollback();
            return Err(error);
        }
        self.pending.iter_mut().for_each(Pending::clear);
        self.committed = Instant::now();
        Ok(())
    }

    fn push(
        &mut self,
        stream: u32,
        kind: (Encoding, u16),
        (time, creation): (i64, i64),
        input: Input<'_>,
    ) -> Result<()> {
        if self.closed {
            return Err(Error::Closed);
        }
        let size = input.byte_size();
        let pending = self.find_pending(stream)?;
        let must_commit = pending.is_full_for(kind, size);
        if must_commit || self.committed.elapsed() > MOST_WAITING {
            self.commit()?;
        }
        self.find_pending(stream)?.advance(time)?;
        if size >= situ_store::format::LARGE_MESSAGE {
            return self.push_large(stream, kind, (time, creation), input);
        }
        self.find_pending(stream)?.push(kind, time, creation, input);
        Ok(())
    }

    /// Commits a large message from the caller's memory. No other message of the stream is waiting.
    fn push_large(
        &mut self,
        stream: u32,
        (encoding, codec): (Encoding, u16),
        (time, creation): (i64, i64),
        input: Input<'_>,
    ) -> Result<()> {
        let (_, count) = self.writer.stream_position(stream).unwrap_or_default();
        let envelope = Envelope {
            sequence: count + 1,
            time,
            creation,
        };
        let pushed = self.writer.push(stream, envelope, encoding, codec, input);
        if let Err(error) = pushed.and_then(|()| self.writer.commit().map(|_| ())) {
            self.writer.rollback();
            return Err(error);
        }
        Ok(())
    }

    fn push_column<'a>(
        &mut self,
        stream: u32,
        encoding: Encoding,
        rows: impl Iterator<Item = ((i64, i64), Input<'a>)>,
    ) -> Result<()> {
        for (times, input) in rows {
            self.push(stream, (encoding, 0), times, input)?;
        }
        self.commit()
    }
}

/// Writes a store. A message is safe from a kill of the process once `commit` has returned.
#[pyclass(module = "situ_core", frozen)]
pub struct Writer {
    state: Mutex<State>,
}

impl Writer {
    fn lock(&self) -> MutexGuard<'_, State> {
        lock_mutex(&self.state)
    }
}

#[pymethods]
impl Writer {
    /// Creates a store in an existing folder without one.
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let created = py.detach(|| situ_store::Writer::create(&path, Options::default()));
        let writer = created.map_err(|error| match error {
            Error::Locked => PyFileExistsError::new_err(error.to_string()),
            error => to_exception(py, error),
        })?;
        let state = State {
            writer,
            pending: Vec::new(),
            committed: Instant::now(),
            closed: false,
        };
        Ok(Writer {
            state: Mutex::new(state),
        })
    }

    /// Adds a record to the catalog and commits it.
    fn add_record(&self, py: Python<'_>, record: &[u8]) -> PyResult<()> {
        let added = py.detach(|| {
            let mut state = self.lock();
            let added = state.writer.append_record(record, system_time());
            added.inspect_err(|_| state.writer.rollback())
        });
        added.map(|_| ()).map_err(|error| to_exception(py, error))
    }

    /// Adds a stream and returns its number.
    fn add_stream(&self, py: Python<'_>) -> u32 {
        py.detach(|| {
            let mut state = self.lock();
            let number = state.writer.add_stream(Compression::None, false);
            state.pending.push(Pending::new(number));
            number
        })
    }

    /// Writes a message if its data are a finite number, a boolean, None, a str or bytes, and its times are integers
    /// of 64 bits. Returns whether they are.
    fn write(
        &self,
        py: Python<'_>,
        stream: u32,
        time: &Bound<'_, PyAny>,
        data: &Bound<'_, PyAny>,
        creation: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<bool> {
        let Ok(time) = time.extract::<i64>() else {
            return Ok(false);
        };
        let creation = match creation.map(|creation| creation.extract::<i64>()) {
            Some(Ok(creation)) => creation,
            Some(Err(_)) => return Ok(false),
            None => system_time().max(time),
        };
        let text;
        let (encoding, input) = if data.is_exact_instance_of::<PyFloat>() {
            match data.extract::<f64>() {
                Ok(number) if number.is_finite() => (Encoding::Float, Input::Float(number)),
                _ => return Ok(false),
            }
        } else if data.is_exact_instance_of::<PyInt>() {
            match data.extract::<i64>() {
                Ok(number) => (Encoding::Int, Input::Int(number)),
                Err(_) => return Ok(false),
            }
        } else if data.is_none() {
            (Encoding::Bool, Input::Bool(2))
        } else if let Ok(truth) = data.cast_exact::<PyBool>() {
            (Encoding::Bool, Input::Bool(truth.is_true().into()))
        } else if let Ok(string) = data.cast_exact::<PyString>() {
            match string.to_cow() {
                Ok(found) => text = found,
                Err(_) => return Ok(false),
            }
            (Encoding::Bytes, Input::Bytes(text.as_bytes()))
        } else if let Ok(bytes) = data.cast_exact::<PyBytes>() {
            (Encoding::Bytes, Input::Bytes(bytes.as_bytes()))
        } else {
            return Ok(false);
        };
        self.lock()
            .push(stream, (encoding, 0), (time, creation), input)
            .map_err(|error| to_exception(py, error))?;
        Ok(true)
    }

    /// Writes a message whose data are encoded: `kind` is (encoding, number of the codec), `times` are the originating
    /// and the creation time (ns), and the parts are stored one after the other.
    fn push(
        &self,
        py: Python<'_>,
        stream: u32,
        kind: (u8, u16),
        times: (i64, i64),
        parts: Vec<Bound<'_, PyBytes>>,
    ) -> PyResult<()> {
        let encoding = Encoding::from_u8(kind.0).filter(|encoding| encoding.has_lengths());
        let encoding = encoding.ok_or_else(|| PyValueError::new_err("unknown encoding"))?;
        let slices: Vec<&[u8]> = parts.iter().map(|part| part.as_bytes()).collect();
        let input = match slices.as_slice() {
            [bytes] => Input::Bytes(bytes),
            parts => Input::Parts(parts),
        };
        py.detach(|| self.lock().push(stream, (encoding, kind.1), times, input))
            .map_err(|error| to_exception(py, error))
    }

    /// Writes and commits many numbers of `kind` "i" (int64), "f" (float64, finite) or "b" (0 or 1). Times, creation
    /// times (which may be empty: they are then the times) and numbers are the little-endian bytes of arrays.
    fn push_column(
        &self,
        py: Python<'_>,
        stream: u32,
        kind: &str,
        times: (&[u8], &[u8]),
        values: &[u8],
    ) -> PyResult<()> {
        let creations = if times.1.is_empty() { times.0 } else { times.1 };
        let rows = read_words(times.0).zip(read_words(creations));
        let rows = rows.map(|(time, creation)| (time as i64, creation as i64));
        let count = if kind == "b" {
            values.len()
        } else {
            values.len() / 8
        };
        if times.0.len() != 8 * count || creations.len() != 8 * count {
            return Err(PyValueError::new_err("the columns have different lengths"));
        }
        let pushed = py.detach(|| {
            let mut state = self.lock();
            match kind {
                "i" => {
                    let inputs = read_words(values).map(|word| Input::Int(word as i64));
                    state.push_column(stream, Encoding::Int, rows.zip(inputs))
                }
                "f" => {
                    let inputs = read_words(values).map(|word| Input::Float(f64::from_bits(word)));
                    state.push_column(stream, Encoding::Float, rows.zip(inputs))
                }
                _ => {
                    let inputs = values.iter().map(|byte| Input::Bool(u8::from(*byte != 0)));
                    state.push_column(stream, Encoding::Bool, rows.zip(inputs))
                }
            }
        });
        pushed.map_err(|error| to_exception(py, error))
    }

    /// Returns the originating time (ns) of the last committed message of a stream, or `None`.
    fn last_time(&self, py: Python<'_>, stream: u32) -> Option<i64> {
        py.detach(|| self.lock().writer.stream_position(stream)?.0)
    }

    /// Commits all messages.
    fn commit(&self, py: Python<'_>) -> PyResult<()> {
        py.detach(|| self.lock().commit())
            .map_err(|error| to_exception(py, error))
    }

    /// Closes the store. Messages that were not committed are dropped.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        let closed = py.detach(|| {
            let mut state = self.lock();
            state.closed = true;
            state.writer.close()
        });
        closed.map_err(|error| to_exception(py, error))
    }
}

fn read_words(bytes: &[u8]) -> impl Iterator<Item = u64> + '_ {
    bytes.chunks_exact(8).map(|word| {
        let mut raw = [0; 8];
        raw.copy_from_slice(word);
        u64::from_le_bytes(raw)
    })
}

//! Exports columns of numpy arrays through Arrow's C stream interface, without a copy.
//! See https://arrow.apache.org/docs/format/CStreamInterface.html and
//! docs/adr/0193-frames-leave-python-through-arrows-c-interface.md.
#![allow(unsafe_code)]

use std::ffi::{c_char, c_int, c_void, CString};
use std::ptr;
use std::sync::Arc;

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyCapsule, PyList, PyTuple};

const FLAG_NULLABLE: i64 = 2;
const MOST_DEPTH: usize = 16;

#[repr(C)]
struct Schema {
    format: *const c_char,
    name: *const c_char,
    metadata: *const c_char,
    flags: i64,
    child_count: i64,
    children: *mut *mut Schema,
    dictionary: *mut Schema,
    release: Option<unsafe extern "C" fn(*mut Schema)>,
    private: *mut c_void,
}

#[repr(C)]
struct ArrayData {
    length: i64,
    null_count: i64,
    offset: i64,
    buffer_count: i64,
    child_count: i64,
    buffers: *mut *const c_void,
    children: *mut *mut ArrayData,
    dictionary: *mut ArrayData,
    release: Option<unsafe extern "C" fn(*mut ArrayData)>,
    private: *mut c_void,
}

#[repr(C)]
struct Stream {
    get_schema: unsafe extern "C" fn(*mut Stream, *mut Schema) -> c_int,
    get_next: unsafe extern "C" fn(*mut Stream, *mut ArrayData) -> c_int,
    get_last_error: unsafe extern "C" fn(*mut Stream) -> *const c_char,
    release: Option<unsafe extern "C" fn(*mut Stream)>,
    private: *mut c_void,
}

// SAFETY: the only pointer leads to `StreamState`, which is `Send`.
unsafe impl Send for Stream {}

/// A column and its parts. `owners` keep the memory of the buffers alive.
struct Column {
    name: CString,
    format: CString,
    length: i64,
    null_count: i64,
    buffers: Vec<usize>,
    owners: Vec<Py<PyAny>>,
    children: Vec<Arc<Column>>,
}

struct StreamState {
    table: Arc<Column>,
    is_read: bool,
}

impl Column {
    /// Reads (name, format, length, null count, [array or None], [column]).
    fn extract(spec: &Bound<'_, PyAny>, depth: usize) -> PyResult<Arc<Column>> {
        if depth > MOST_DEPTH {
            return Err(PyValueError::new_err("columns are nested too deeply"));
        }
        let spec = spec.cast::<PyTuple>()?;
        let read_text = |at| -> PyResult<CString> {
            Ok(CString::new(spec.get_item(at)?.extract::<String>()?)?)
        };
        let (mut buffers, mut owners) = (Vec::new(), Vec::new());
        for buffer in spec.get_item(4)?.cast::<PyList>()?.iter() {
            if buffer.is_none() {
                buffers.push(0);
                continue;
            }
            let interface = buffer.getattr("__array_interface__")?;
            let (address, _): (usize, bool) = interface.get_item("data")?.extract()?;
            buffers.push(address);
            owners.push(buffer.unbind());
        }
        let list = spec.get_item(5)?;
        let children = list.cast::<PyList>()?.iter();
        Ok(Arc::new(Column {
            name: read_text(0)?,
            format: read_text(1)?,
            length: spec.get_item(2)?.extract()?,
            null_count: spec.get_item(3)?.extract()?,
            buffers,
            owners,
            children: children
                .map(|child| Column::extract(&child, depth + 1))
                .collect::<PyResult<_>>()?,
        }))
    }
}

/// Moves each value to its own memory and returns the addresses. `free_list` frees them.
fn leak_list<T>(values: impl Iterator<Item = T>) -> (Vec<*mut T>, i64) {
    let list: Vec<*mut T> = values.map(|value| Box::into_raw(Box::new(value))).collect();
    let count = list.len() as i64;
    (list, count)
}

/// The parts of a schema that it has allocated.
struct SchemaParts {
    /// Keeps the texts alive.
    _column: Arc<Column>,
    children: Vec<*mut Schema>,
}

fn build_schema(column: &Arc<Column>) -> Schema {
    let (children, child_count) = leak_list(column.children.iter().map(build_schema));
    let mut parts = Box::new(SchemaParts {
        _column: column.clone(),
        children,
    });
    Schema {
        format: column.format.as_ptr(),
        name: column.name.as_ptr(),
        metadata: ptr::null(),
        flags: FLAG_NULLABLE,
        child_count,
        children: parts.children.as_mut_ptr(),
        dictionary: ptr::null_mut(),
        release: Some(release_schema),
        private: Box::into_raw(parts).cast(),
    }
}

unsafe extern "C" fn release_schema(schema: *mut Schema) {
    // SAFETY: the consumer passes a schema that `build_schema` has built, once: `private` is a box of parts, and the
    // children are boxes, whose own release callback the consumer may have called and cleared already.
    unsafe {
        let parts = Box::from_raw((*schema).private.cast::<SchemaParts>());
        for child in parts.children {
            if let Some(release) = (*child).release {
                release(child);
            }
            drop(Box::from_raw(child));
        }
        (*schema).release = None;
    }
}

/// The parts of an array that it has allocated.
struct ArrayParts {
    buffers: Vec<*const c_void>,
    children: Vec<*mut ArrayData>,
    /// Keeps the memory of the buffers alive.
    column: Arc<Column>,
}

fn build_array(column: &Arc<Column>) -> ArrayData {
    let (children, child_count) = leak_list(column.children.iter().map(build_array));
    let buffers = column.buffers.iter().map(|at| *at as *const c_void);
    let mut parts = Box::new(ArrayParts {
        buffers: buffers.collect(),
        children,
        column: column.clone(),
    });
    ArrayData {
        length: column.length,
        null_count: column.null_count,
        offset: 0,
        buffer_count: parts.buffers.len() as i64,
        child_count,
        buffers: parts.buffers.as_mut_ptr(),
        children: parts.children.as_mut_ptr(),
        dictionary: ptr::null_mut(),
        release: Some(release_array),
        private: Box::into_raw(parts).cast(),
    }
}

unsafe extern "C" fn release_array(array: *mut ArrayData) {
    // SAFETY: as in `release_schema`. A consumer may move children out of the array; their callback is then cleared.
    unsafe {
        let parts = Box::from_raw((*array).private.cast::<ArrayParts>());
        for child in parts.children {
            if let Some(release) = (*child).release {
                release(child);
            }
            drop(Box::from_raw(child));
        }
        drop_column(parts.column);
        (*array).release = None;
    }
}

/// Drops a column. The consumer's thread may not hold the lock of Python, and Python may have ended; the memory of the
/// arrays is then left to the end of the process.
fn drop_column(column: Arc<Column>) {
    let Some(last) = Arc::into_inner(column) else {
        return;
    };
    last.children.into_iter().for_each(drop_column);
    let owners = last.owners;
    if owners.is_empty() {
        return;
    }
    let mut waiting = Some(owners);
    Python::try_attach(|_| drop(waiting.take()));
    if let Some(owners) = waiting {
        std::mem::forget(owners);
    }
}

unsafe extern "C" fn get_schema(stream: *mut Stream, out: *mut Schema) -> c_int {
    // SAFETY: the consumer passes a stream of `export_stream` that it has not released, and memory for a schema.
    unsafe {
        let state = &*(*stream).private.cast::<StreamState>();
        ptr::write(out, build_schema(&state.table));
    }
    0
}

unsafe extern "C" fn get_next(stream: *mut Stream, out: *mut ArrayData) -> c_int {
    // SAFETY: as in `get_schema`. Consumers do not call the functions of a stream from two threads at once.
    unsafe {
        let state = &mut *(*stream).private.cast::<StreamState>();
        if state.is_read {
            // An array without a release callback marks the end of the stream.
            ptr::write(out, std::mem::zeroed());
        } else {
            state.is_read = true;
            ptr::write(out, build_array(&state.table));
        }
    }
    0
}

unsafe extern "C" fn get_last_error(_stream: *mut Stream) -> *const c_char {
    ptr::null()
}

unsafe extern "C" fn release_stream(stream: *mut Stream) {
    // SAFETY: `private` is the box of `export_stream`. The callback is cleared, so that it is called once.
    unsafe {
        let state = Box::from_raw((*stream).private.cast::<StreamState>());
        (*stream).release = None;
        drop_column(state.table);
    }
}

impl Drop for Stream {
    fn drop(&mut self) {
        if let Some(release) = self.release {
            // SAFETY: no consumer has taken the stream out of its capsule.
            unsafe { release(self) }
        }
    }
}

/// Returns a PyCapsule `arrow_array_stream` of one table. `spec` describes it and its columns: (name, format, length,
/// null count, list of arrays or None, list of columns).
///
/// The arrays must have the sizes that the format and length require: this is for the package `situ` only.
#[pyfunction]
pub fn export_stream<'py>(
    py: Python<'py>,
    spec: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyCapsule>> {
    let state = Box::new(StreamState {
        table: Column::extract(spec, 0)?,
        is_read: false,
    });
    let stream = Stream {
        get_schema,
        get_next,
        get_last_error,
        release: Some(release_stream),
        private: Box::into_raw(state).cast(),
    };
    PyCapsule::new_with_value(py, stream, c"arrow_array_stream")
}

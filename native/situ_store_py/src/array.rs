//! Memory of Rust that numpy reads without a copy, through its protocol `__array_interface__`. (The buffer protocol is
//! part of the stable ABI only since Python 3.11.)

use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use situ_store::reader::Chunk;

/// A column of numbers of one type.
pub enum Numbers {
    Ints(Vec<i64>),
    Floats(Vec<f64>),
    /// 0 or 1.
    Booleans(Vec<u8>),
    /// Numbers of values in a list.
    Codes(Vec<u32>),
}

impl Numbers {
    pub fn len(&self) -> usize {
        match self {
            Numbers::Ints(numbers) => numbers.len(),
            Numbers::Floats(numbers) => numbers.len(),
            Numbers::Booleans(numbers) => numbers.len(),
            Numbers::Codes(numbers) => numbers.len(),
        }
    }

    /// Returns numpy's name of the type, and the address of the first number.
    fn layout(&mut self) -> (&'static str, usize) {
        match self {
            Numbers::Ints(numbers) => ("<i8", numbers.as_mut_ptr() as usize),
            Numbers::Floats(numbers) => ("<f8", numbers.as_mut_ptr() as usize),
            Numbers::Booleans(numbers) => ("|b1", numbers.as_mut_ptr() as usize),
            Numbers::Codes(numbers) => ("<u4", numbers.as_mut_ptr() as usize),
        }
    }
}

/// A column of numbers. `numpy.asarray` returns an array of the same memory, which keeps this object alive.
///
/// Nothing in Rust reads or writes the memory after the object was created.
#[pyclass(module = "situ_core")]
pub struct Array {
    numbers: Numbers,
}

impl Array {
    pub fn new(numbers: Numbers) -> Self {
        Array { numbers }
    }
}

#[pymethods]
impl Array {
    #[getter]
    fn __array_interface__<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let count = self.numbers.len();
        let (kind, address) = self.numbers.layout();
        build_interface(py, kind, count, (address, false))
    }

    fn __len__(&self) -> usize {
        self.numbers.len()
    }
}

/// The bytes of one message in the mapped file. `numpy.asarray` returns them without a copy, read-only; `bytes`
/// returns a copy.
#[pyclass(module = "situ_core", frozen)]
pub struct Payload {
    chunk: Chunk,
    start: usize,
    length: usize,
}

impl Payload {
    /// Returns the payload at a range of the chunk's body, or `None` if the range is not in it.
    pub fn new(chunk: Chunk, start: usize, length: usize) -> Option<Self> {
        chunk.body().get(start..start.checked_add(length)?)?;
        Some(Payload {
            chunk,
            start,
            length,
        })
    }

    fn bytes(&self) -> &[u8] {
        let body = self.chunk.body();
        body.get(self.start..self.start + self.length)
            .unwrap_or_default()
    }
}

#[pymethods]
impl Payload {
    #[getter]
    fn __array_interface__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let address = self.bytes().as_ptr() as usize;
        build_interface(py, "|u1", self.length, (address, true))
    }

    fn __bytes__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        // The copy may wait for the disk.
        PyBytes::new_with(py, self.length, |to| {
            py.detach(|| to.copy_from_slice(self.bytes()));
            Ok(())
        })
    }

    fn __len__(&self) -> usize {
        self.length
    }
}

fn build_interface<'py>(
    py: Python<'py>,
    kind: &str,
    count: usize,
    data: (usize, bool),
) -> PyResult<Bound<'py, PyDict>> {
    let interface = PyDict::new(py);
    interface.set_item("version", 3)?;
    interface.set_item("shape", (count,))?;
    interface.set_item("typestr", kind)?;
    interface.set_item("data", data)?;
    Ok(interface)
}

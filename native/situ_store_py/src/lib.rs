//! The Python extension module `situ_core`: the native core of the Python package `situ`, which contains everything
//! that users call. It decodes, calls the crate `situ_store` and encodes.
//! See docs/adr/0191-the-python-package-has-an-optional-native-core.md.

mod array;
mod arrow;
mod columns;
mod cursor;
mod errors;
mod pending;
mod reader;
mod table;
mod table_column;
mod writer;

use pyo3::prelude::*;

/// The native core of the Python package situ, which contains everything that users call.
#[pymodule]
mod situ_core {
    #[pymodule_export]
    use crate::array::{Array, Payload};
    #[pymodule_export]
    use crate::arrow::export_stream;
    #[pymodule_export]
    use crate::columns::ColumnReader;
    #[pymodule_export]
    use crate::reader::Reader;
    #[pymodule_export]
    use crate::table::TableReader;
    #[pymodule_export]
    use crate::writer::Writer;

    /// The number that the package compares with its own, because both are installed separately.
    #[pymodule_export]
    const INTERFACE: u32 = 1;
}

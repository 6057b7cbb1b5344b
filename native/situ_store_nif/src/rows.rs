//! Rows of CSV files.

use std::path::Path;

use rustler::{Encoder, Env, Term};
use situ_csv::{rows, Error, Place};

use crate::atoms;

/// Up to `most` rows or `bytes` bytes from `byte` (in line `line`) on: `{:ok, [{line, [field]}], {byte, line}}`.
#[rustler::nif(schedule = "DirtyIo")]
fn csv_rows<'a>(
    env: Env<'a>,
    path: String,
    separator: u8,
    byte: u64,
    line: u64,
    most: usize,
    bytes: u64,
) -> Term<'a> {
    match rows(
        Path::new(&path),
        separator,
        Place { byte, line },
        most,
        bytes,
    ) {
        Ok((rows, place)) => {
            let rows: Vec<_> = rows.into_iter().map(|row| (row.line, row.fields)).collect();
            (atoms::ok(), rows, (place.byte, place.line)).encode(env)
        }
        Err(Error::Io(number, why)) => {
            (atoms::error(), (atoms::io(), "read", number, why)).encode(env)
        }
        Err(Error::Damaged(line, why)) => {
            (atoms::error(), (atoms::damaged(), line, why)).encode(env)
        }
    }
}

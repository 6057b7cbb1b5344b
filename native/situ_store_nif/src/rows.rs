//! Reads rows and columns of CSV files.

use std::path::Path;

use rustler::{Atom, Encoder, Env, NifResult, Term};
use situ_csv::{
    read_columns, read_rows, read_values, scan_parts, CellValues, Cells, ColumnQuery, Error,
    FilePosition, Kind, Layout, Part, Refusal, RowFault, Start, Unit, Value,
};
use situ_store::writer::{Column, ColumnValues};
use situ_store::Writer;

use crate::writing::{with_writer, Handle};
use crate::{atoms, errors};

/// Reads up to `most` rows or `bytes` bytes from `byte` (in line `line`) on: `{:ok, [{line, [field]}], {byte,
/// line}}`.
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
    match read_rows(
        Path::new(&path),
        separator,
        FilePosition { byte, line },
        most,
        bytes,
    ) {
        Ok((rows, position)) => {
            let rows: Vec<_> = rows.into_iter().map(|row| (row.line, row.fields)).collect();
            (atoms::ok(), rows, (position.byte, position.line)).encode(env)
        }
        Err(error) => encode_file_error(env, error),
    }
}

fn encode_file_error(env: Env, error: Error) -> Term {
    match error {
        Error::Io(number, why) => (atoms::error(), (atoms::io(), "read", number, why)).encode(env),
        Error::Damaged(line, why) => (atoms::error(), (atoms::damaged(), line, why)).encode(env),
    }
}

fn encode_refusal(env: Env, refusal: Refusal) -> Term {
    match refusal {
        Refusal::Unsure => atoms::slow().encode(env),
        Refusal::Failed(error) => encode_file_error(env, error),
    }
}

/// The separator; the number of fields and the column of times; the unit of times (nanoseconds, or 0 for ISO 8601)
/// and an offset in nanoseconds; the maximum rows and bytes of a part.
type GivenLayout = (u8, (usize, usize), (i64, i64), (usize, u64));

fn decode_layout((separator, (width, time), (unit, start), (rows, bytes)): GivenLayout) -> Layout {
    let unit = match unit {
        0 => Unit::Iso8601,
        factor => Unit::Nanoseconds(factor),
    };
    Layout {
        separator,
        width,
        time: (time, unit),
        start,
        rows,
        bytes,
    }
}

/// The position where a part begins, and the last time before it.
type GivenStart = ((u64, u64), Option<i64>);

fn decode_start(((byte, line), last): GivenStart) -> Start {
    let position = FilePosition { byte, line };
    Start { position, last }
}

/// Scans up to `parts` parts: `{:ok, [{rows, [{kind, count, first, last}], [{line, why}], {byte, line}, last}]}`,
/// or `:slow` if this code cannot parse a time.
#[rustler::nif(schedule = "DirtyIo")]
fn csv_scan<'a>(
    env: Env<'a>,
    path: String,
    given: GivenLayout,
    from: GivenStart,
    parts: usize,
) -> Term<'a> {
    match scan_parts(
        Path::new(&path),
        &decode_layout(given),
        decode_start(from),
        parts,
    ) {
        Ok(parts) => {
            let parts: Vec<_> = parts
                .into_iter()
                .map(|part| encode_part(env, part))
                .collect();
            (atoms::ok(), parts).encode(env)
        }
        Err(refusal) => encode_refusal(env, refusal),
    }
}

fn encode_part<'a>(env: Env<'a>, part: Part) -> Term<'a> {
    let columns: Vec<_> = part
        .columns
        .iter()
        .map(|column| {
            (
                column.kind.map(kind_atom),
                column.count,
                column.first,
                column.last,
            )
        })
        .collect();
    let damage: Vec<Term<'a>> = part
        .damage
        .into_iter()
        .map(|why| encode_reason(env, why))
        .collect();
    let position = part.next.position;
    (
        part.rows,
        columns,
        damage,
        (position.byte, position.line),
        part.next.last,
    )
        .encode(env)
}

fn encode_reason<'a>(env: Env<'a>, (line, why): (u64, RowFault)) -> Term<'a> {
    match why {
        RowFault::Width(fields) => (line, fields).encode(env),
        RowFault::Time(text) => (line, text).encode(env),
        RowFault::Backward => (line, atoms::not_increasing()).encode(env),
    }
}

fn kind_atom(kind: Kind) -> Atom {
    match kind {
        Kind::Integer => atoms::integer(),
        Kind::Float => atoms::float(),
        Kind::Text => atoms::string(),
    }
}

fn kind_from_atom(name: Atom) -> Kind {
    if name == atoms::integer() {
        Kind::Integer
    } else if name == atoms::float() {
        Kind::Float
    } else {
        Kind::Text
    }
}

/// Returns the values of one column in a part with their times: `{:ok, [{time, value}]}`, or `:slow`. Strings, and
/// integers of more than 64 bits, are binaries.
#[rustler::nif(schedule = "DirtyIo")]
fn csv_values<'a>(
    env: Env<'a>,
    path: String,
    given: GivenLayout,
    from: GivenStart,
    column: (usize, Atom),
) -> NifResult<Term<'a>> {
    let (at, kind) = column;
    let kind = kind_from_atom(kind);
    let mut found = Vec::new();
    let result = read_values(
        Path::new(&path),
        &decode_layout(given),
        decode_start(from),
        (at, kind),
        |time, value| {
            let value = match value {
                Value::Integer(n) => n.encode(env),
                Value::Float(x) => x.encode(env),
                Value::Text(text) => text.encode(env),
            };
            found.push((time, value));
        },
    );
    Ok(match result {
        Ok(()) => (atoms::ok(), found).encode(env),
        Err(refusal) => encode_refusal(env, refusal),
    })
}

/// A column, the kind of its fields, the stream for its values, and the sequence id of its first field.
type Target = (usize, Atom, u32, u64);

/// Appends columns of up to `parts` parts to streams of a writer and commits them: `{:ok, parts, [{fields,
/// appended}]}` with the number of fields of each column in these parts, and how many of them are in the interval.
/// Returns `:slow` if this code cannot parse the first part, `{:error, reason}` for an error of the file, and
/// `{:not_written, {:error, reason}, column}` for an error of the store.
#[rustler::nif(schedule = "DirtyIo")]
fn csv_append<'a>(
    env: Env<'a>,
    path: String,
    given: GivenLayout,
    from: GivenStart,
    targets: (Vec<Target>, (i64, i64), usize),
    writer: Handle,
) -> Term<'a> {
    let (targets, interval, parts) = targets;
    let query: Vec<_> = targets
        .iter()
        .map(|(at, kind, ..)| (*at, kind_from_atom(*kind)))
        .collect();
    let query = ColumnQuery {
        columns: &query,
        interval,
        parts,
    };
    let (parts, found) = match read_columns(
        Path::new(&path),
        &decode_layout(given),
        decode_start(from),
        &query,
    ) {
        Ok(found) => found,
        Err(refusal) => return encode_refusal(env, refusal),
    };
    let mut current = 0;
    let written = with_writer(&writer, |writer| {
        for ((column, _, stream, sequence), cells) in targets.iter().zip(&found) {
            current = *column;
            push_cells(writer, *stream, *sequence, cells)?;
        }
        writer.commit()
    });
    match written {
        Ok(_) => {
            let counts: Vec<_> = found
                .iter()
                .map(|cells| (cells.fields, cells.times.len()))
                .collect();
            (atoms::ok(), parts, counts).encode(env)
        }
        Err(error) => (
            atoms::not_written(),
            errors::encode_error(env, &error),
            current,
        )
            .encode(env),
    }
}

fn push_cells(
    writer: &mut Writer,
    stream: u32,
    sequence: u64,
    cells: &Cells,
) -> situ_store::Result<()> {
    let values = match &cells.values {
        CellValues::Integers(values) => ColumnValues::Ints(values),
        CellValues::Floats(values) => ColumnValues::Floats(values),
        CellValues::Texts(bytes, ends) => ColumnValues::Texts(bytes, ends),
    };
    let column = Column {
        sequence: sequence + cells.before,
        times: &cells.times,
        values,
    };
    writer.push_column(stream, column)
}

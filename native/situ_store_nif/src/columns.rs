//! Returns columns of plain numbers as binaries.

use rustler::{Encoder, Env, Term};
use situ_store::columns::{read_columns, ColumnQuery, ColumnResult, Kind};
use situ_store::Reader;

use crate::atoms;
use crate::errors::encode_error;
use crate::reading::Handle;
use crate::residency::with_bytes;
use crate::terms::encode_binary;

/// Returns plain numbers from `ordinal` on, no later than `to`, from about `bytes` of the store: `{:ok, {kind,
/// count, times, creation_times, values, first_sequence}, next}`
/// (the last is `nil` if a sequence id is missing), `:others` if the next messages are not plain numbers, or
/// `:ended`.
#[rustler::nif(schedule = "DirtyIo")]
fn reader_columns<'a>(
    env: Env<'a>,
    handle: Handle,
    stream: u32,
    ordinal: u64,
    to: i64,
    bytes: u64,
) -> Term<'a> {
    let reader = handle.store();
    if let Err(error) = reader.refresh() {
        return encode_error(env, &error);
    }
    let query = ColumnQuery {
        stream,
        ordinal,
        to,
        bytes,
    };
    with_bytes(env, handle.store(), || encode_columns(env, reader, &query))
}

fn encode_columns<'a>(env: Env<'a>, reader: &Reader, query: &ColumnQuery) -> Term<'a> {
    match read_columns(reader, query) {
        Ok(ColumnResult::Numbers(kind, columns, next)) => {
            let kind = match kind {
                Kind::Int => atoms::integer(),
                Kind::Float => atoms::float(),
                Kind::Bool => atoms::boolean(),
            };
            let times = encode_binary(env, &columns.times);
            let creations = encode_binary(env, &columns.creations);
            let values = encode_binary(env, &columns.values);
            let sequence = (!columns.gaps).then_some(columns.first_sequence);
            let found = (kind, columns.count, times, creations, values, sequence);
            (atoms::ok(), found, next).encode(env)
        }
        Ok(ColumnResult::Others) => atoms::others().encode(env),
        Ok(ColumnResult::End) => atoms::ended().encode(env),
        Err(error) => encode_error(env, &error),
    }
}

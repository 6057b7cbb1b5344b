//! Columns of plain numbers as binaries.

use rustler::{Encoder, Env, Term};
use situ_store::columns::{read, Found, Kind, Wanted};

use crate::atoms;
use crate::reading::{failed, Handle};
use crate::terms::copied;

/// Plain numbers from `ordinal` on, no later than `to`, of about `bytes` of the store:
/// `{:ok, {kind, count, times, creation_times, values}, next}`, `:others` where the next messages are none, or
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
        return failed(env, &error);
    }
    let wanted = Wanted {
        stream,
        ordinal,
        to,
        bytes,
    };
    match read(reader, &wanted) {
        Ok(Found::Numbers(kind, columns, next)) => {
            let kind = match kind {
                Kind::Int => atoms::integer(),
                Kind::Float => atoms::float(),
                Kind::Bool => atoms::boolean(),
            };
            let times = copied(env, &columns.times);
            let creations = copied(env, &columns.creations);
            let values = copied(env, &columns.values);
            let found = (kind, columns.count, times, creations, values);
            (atoms::ok(), found, next).encode(env)
        }
        Ok(Found::Others) => atoms::others().encode(env),
        Ok(Found::End) => atoms::ended().encode(env),
        Err(error) => failed(env, &error),
    }
}

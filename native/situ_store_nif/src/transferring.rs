//! Copies messages from a reader to a writer without converting them to terms.

use rustler::{Env, Term};
use situ_store::transfer::{copy_messages, MessageRange};

use crate::reading::Handle as Reader;
use crate::residency::with_bytes;
use crate::writing::{encode_result, with_writer, Handle as Writer};

/// Copies messages of `stream` from `ordinal` on, no later than `to`, to stream `target` of the writer and commits
/// them, until at least `bytes` were read: `{:ok, {count, next_ordinal}}`. `codecs` is `[{number in source, number
/// in target}]`.
#[rustler::nif(schedule = "DirtyIo")]
#[allow(clippy::too_many_arguments)]
fn store_transfer<'a>(
    env: Env<'a>,
    reader: Reader,
    stream: u32,
    ordinal: u64,
    to: i64,
    bytes: u64,
    writer: Writer,
    target: (u32, Vec<(u16, u16)>),
) -> Term<'a> {
    let (target, codecs) = target;
    let number = |old: u16| {
        let found = codecs.iter().find(|(number, _)| *number == old);
        found.map_or(old, |(_, new)| *new)
    };
    let range = MessageRange {
        reader: reader.store(),
        stream,
        ordinal,
        to,
        bytes,
    };
    if let Err(error) = reader.store().refresh() {
        return crate::errors::encode_error(env, &error);
    }
    with_bytes(env, reader.store(), || {
        encode_result(
            env,
            with_writer(&writer, |writer| {
                copy_messages(&range, writer, target, number)
            }),
        )
    })
}

//! From a reader to a writer without a detour through terms.

use rustler::{Env, Term};
use situ_store::transfer::{transfer, Part};

use crate::reading::Handle as Reader;
use crate::writing::{answer, with, Handle as Writer};

/// Takes messages of `stream` from `ordinal` on, no later than `to`, into stream `target` of the writer and commits
/// them, until at least `bytes` were read: `{:ok, {count, next_ordinal}}`. `codecs`: `[{number there, number here}]`.
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
    let part = Part {
        reader: reader.store(),
        stream,
        ordinal,
        to,
        bytes,
    };
    if let Err(error) = reader.store().refresh() {
        return crate::errors::term(env, &error);
    }
    answer(
        env,
        with(&writer, |writer| transfer(&part, writer, target, number)),
    )
}

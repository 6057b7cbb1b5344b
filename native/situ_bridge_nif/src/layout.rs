//! How an MCAP file is built.

use rustler::{Encoder, Env, ResourceArc, Term};

use crate::{answer, ReaderResource};

/// `{offset, length, compression, packed, unpacked, start, end}` of every chunk.
#[rustler::nif(schedule = "DirtyCpu")]
fn mcap_chunks<'a>(env: Env<'a>, handle: ResourceArc<ReaderResource>) -> Term<'a> {
    let chunks = handle.0.chunks();
    let chunks = chunks.iter().map(|c| {
        (
            c.offset,
            c.length,
            c.compression.as_str(),
            c.packed,
            c.unpacked,
            c.start,
            c.end,
        )
    });
    chunks.collect::<Vec<_>>().encode(env)
}

/// `{:ok, [{channel, bytes}]}` of a chunk, `{:ok, nil}` behind the last.
#[rustler::nif(schedule = "DirtyIo")]
fn mcap_sizes<'a>(env: Env<'a>, handle: ResourceArc<ReaderResource>, number: u32) -> Term<'a> {
    let sizes = handle.0.sizes(number);
    answer(
        env,
        sizes.map(|s| s.map(|s| s.into_iter().collect::<Vec<_>>())),
    )
}

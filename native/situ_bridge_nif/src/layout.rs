//! Describes the structure of an MCAP file.

use rustler::{Encoder, Env, ResourceArc, Term};

use crate::{encode_result, ReaderResource};

/// Returns `{offset, length, compression, packed, unpacked, start, end}` for every chunk.
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

/// Returns `{:ok, [{channel, bytes}]}` for a chunk, or `{:ok, nil}` after the last one.
#[rustler::nif(schedule = "DirtyIo")]
fn mcap_sizes<'a>(env: Env<'a>, handle: ResourceArc<ReaderResource>, number: u32) -> Term<'a> {
    let sizes = handle.0.channel_sizes(number);
    encode_result(
        env,
        sizes.map(|s| s.map(|s| s.into_iter().collect::<Vec<_>>())),
    )
}

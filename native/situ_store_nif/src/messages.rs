//! Returns messages of a reader as terms.

use rustler::{Binary, Encoder, Env, Term};
use situ_store::etf;
use situ_store::format::LANE_DATA;
use situ_store::Error;

use crate::atoms;
use crate::errors::encode_error;
use crate::parts::Part;
use crate::reading::{Handle, QUICK_ENTRIES};
use crate::residency::with_bytes;
use crate::terms::{decode_term, Decoded};

/// Returns messages from `ordinal` on, until one is later than `to`, or there are at least `most` messages or
/// `bytes` payload bytes: `{:ok, [{codec, messages}], next_ordinal}`. The messages of a chunk are `[{sequence,
/// originating, creation, data}]`, or `{:integers, rows}` (see `Part::read_integers`). A message whose data are not a
/// plain term is `{sequence, originating, creation, :unknown, {modules, bytes, term}}` or `{..., :undecodable, why}`.
/// Complete chunks are returned, so there may be a few more than `most` messages; with `bytes` 0 there are exactly
/// `most`. A damaged chunk ends the result; if it is the first chunk, the result is the error.
#[rustler::nif(schedule = "DirtyIo")]
fn reader_read<'a>(
    env: Env<'a>,
    handle: Handle,
    stream: u32,
    ordinal: u64,
    to: i64,
    most: u64,
    bytes: u64,
) -> Term<'a> {
    let limits = ReadLimits {
        to,
        most,
        bytes,
        quick: false,
    };
    let bytes = if bytes == 0 { u64::MAX } else { bytes };
    with_bytes(env, handle.store(), || {
        if handle.0.lacks_chunks(stream, ordinal, to, most, bytes) {
            return encode_error(env, &Error::Absent);
        }
        read_messages(env, &handle, stream, ordinal, &limits)
    })
}

/// Reads like `reader_read`, but on a normal scheduler, which saves two thread switches. It reads only messages
/// that need little time and no disk access, within one time slice, and returns `:slow` if there are none.
#[rustler::nif]
fn reader_read_quick<'a>(
    env: Env<'a>,
    handle: Handle,
    stream: u32,
    ordinal: u64,
    to: i64,
    most: u64,
    bytes: u64,
) -> Term<'a> {
    let limits = ReadLimits {
        to,
        most,
        bytes,
        quick: true,
    };
    let result = read_messages(env, &handle, stream, ordinal, &limits);
    rustler::schedule::consume_timeslice(env, if most > 64 { 15 } else { 2 });
    result
}

struct ReadLimits {
    to: i64,
    most: u64,
    bytes: u64,
    quick: bool,
}

/// The maximum number of bytes that a quick read checks and unpacks, about.
const QUICK_BYTES: u64 = 64 * 1024;

fn read_messages<'a>(
    env: Env<'a>,
    handle: &Handle,
    stream: u32,
    from: u64,
    limits: &ReadLimits,
) -> Term<'a> {
    let reader = &handle.0;
    if limits.quick && reader.pending_entries() > QUICK_ENTRIES {
        return atoms::slow().encode(env);
    }
    if let Err(error) = reader.refresh() {
        return encode_error(env, &error);
    }
    let exact = limits.bytes == 0;
    let mut runs: Vec<(u16, Term<'a>)> = Vec::new();
    let (mut next, mut count, mut size, mut work) = (from, 0u64, 0u64, 0u64);
    while count < limits.most && (exact || size < limits.bytes) && work < QUICK_BYTES {
        let entry = match reader.entry_at(stream, next) {
            Ok(Some(entry)) => entry,
            Ok(None) => break,
            Err(error) if runs.is_empty() => return encode_error(env, &error),
            Err(_) => break,
        };
        if entry.first > limits.to {
            break;
        }
        let chunk = if limits.quick {
            // A large message that is not checked takes almost no time.
            work += match entry.lane {
                LANE_DATA => entry.length.max(1024) as u64,
                _ => 1024,
            };
            reader.quick_chunk(&entry)
        } else {
            Some(reader.read_chunk(&entry))
        };
        let Some(chunk) = chunk else {
            if runs.is_empty() {
                return atoms::slow().encode(env);
            }
            break;
        };
        let left = if exact { limits.most - count } else { u64::MAX };
        let part = chunk.and_then(|chunk| {
            let part = Part::read(env, &chunk, next - entry.ordinal, limits.to, left);
            part.map_err(|why| reader.chunk_error(&entry, why))
        });
        match part {
            Ok(part) => {
                next += part.count;
                count += part.count;
                size += part.size;
                if limits.quick {
                    work += part.size.saturating_sub(entry.length.into());
                }
                runs.push((part.codec, part.messages));
                if part.ended {
                    break;
                }
            }
            Err(error) if runs.is_empty() => return encode_error(env, &error),
            Err(_) => break,
        }
    }
    (atoms::ok(), runs, next).encode(env)
}

/// Returns the ordinal after the chunk that contains `ordinal`, where reading can continue after damage.
#[rustler::nif]
fn reader_skip(handle: Handle, stream: u32, ordinal: u64) -> u64 {
    match handle.0.entry_at(stream, ordinal) {
        Ok(Some(entry)) => entry.ordinal + entry.count as u64,
        _ => ordinal,
    }
}

/// Decodes a term from external format: `{:ok, term}`, `{:unknown, modules, term}` or `{:undecodable, why}`. It
/// creates no atoms.
#[rustler::nif(schedule = "DirtyCpu")]
fn term_decode<'a>(env: Env<'a>, bytes: Binary<'a>) -> Term<'a> {
    encode_decoded(env, bytes)
}

/// Decodes like `term_decode`, on a normal scheduler. The caller limits the size.
#[rustler::nif]
fn term_decode_quick<'a>(env: Env<'a>, bytes: Binary<'a>) -> Term<'a> {
    encode_decoded(env, bytes)
}

fn encode_decoded<'a>(env: Env<'a>, bytes: Binary<'a>) -> Term<'a> {
    match decode_term(env, bytes.as_slice()).0 {
        Decoded::Plain(term) => (atoms::ok(), term).encode(env),
        Decoded::Unknown(modules, term) => (atoms::unknown(), modules, term).encode(env),
        Decoded::Refused(why) => (atoms::undecodable(), why).encode(env),
    }
}

/// Checks that bytes in external format are plain data: `:ok` or `{:error, what_else}`.
#[rustler::nif(schedule = "DirtyCpu")]
fn term_check<'a>(env: Env<'a>, bytes: Binary<'a>) -> Term<'a> {
    encode_check(env, bytes)
}

/// Checks like `term_check`, on a normal scheduler. The caller limits the size.
#[rustler::nif]
fn term_check_quick<'a>(env: Env<'a>, bytes: Binary<'a>) -> Term<'a> {
    encode_check(env, bytes)
}

fn encode_check<'a>(env: Env<'a>, bytes: Binary<'a>) -> Term<'a> {
    match etf::check_term(bytes.as_slice()) {
        Ok(_) => atoms::ok().encode(env),
        Err(refusal) => (atoms::error(), refusal.describe()).encode(env),
    }
}

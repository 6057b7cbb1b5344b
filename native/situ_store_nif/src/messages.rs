//! Returns messages of a reader as terms.

use std::sync::Arc;

use rustler::types::tuple::make_tuple;
use rustler::{Binary, Encoder, Env, ResourceArc, Term};
use situ_store::chunk::Value;
use situ_store::format::{LANE_DATA, MAX_CHUNK_MESSAGES};
use situ_store::guard::Map;
use situ_store::reader::Chunk;
use situ_store::{etf, Encoding};

use crate::atoms;
use crate::errors::encode_error;
use crate::reading::{Handle, QUICK_ENTRIES};
use crate::terms::{decode_term, encode_binary, Decoded, COPY_UP_TO};

/// The memory that the binaries of messages refer to: a mapped extent or an unpacked chunk.
pub enum Bytes {
    Map(Arc<Map>, usize, usize),
    Unpacked(Arc<Vec<u8>>),
}

#[rustler::resource_impl]
impl rustler::Resource for Bytes {}

/// Encodes the messages of one chunk as `{sequence, originating, creation, data}`.
struct Run<'a> {
    env: Env<'a>,
    encoding: Encoding,
    whole: Option<Binary<'a>>,
    /// The memory size of the terms' structure, bytes.
    structure: u64,
}

impl<'a> Run<'a> {
    fn start(env: Env<'a>, chunk: &Chunk) -> Self {
        let encoding = chunk.header.encoding;
        let is_shared = matches!(encoding, Encoding::Bytes | Encoding::Codec)
            && chunk.body().len() > COPY_UP_TO;
        let whole = is_shared.then(|| {
            let bytes = match (chunk.unpacked_body(), chunk.body_offset()) {
                (Some(bytes), _) => Bytes::Unpacked(bytes),
                (None, at) => Bytes::Map(chunk.map.clone(), at.unwrap_or(0), chunk.body().len()),
            };
            ResourceArc::new(bytes).make_binary(env, |bytes| match bytes {
                Bytes::Map(map, at, length) => &map[*at..*at + *length],
                Bytes::Unpacked(bytes) => bytes,
            })
        });
        Run {
            env,
            encoding,
            whole,
            structure: 0,
        }
    }

    /// Returns the last elements of a message's tuple: its data or, for terms that are not plain, a tag and
    /// details.
    fn encode_data(&mut self, body: &[u8], value: Value) -> (Term<'a>, Option<Term<'a>>) {
        let env = self.env;
        if let (Encoding::Term, Value::Bytes { start, length }) = (self.encoding, value) {
            let bytes = &body[start..start + length];
            let (decoded, structure) = decode_term(env, bytes);
            self.structure += structure as u64;
            return match decoded {
                Decoded::Plain(term) => (term, None),
                Decoded::Refused(why) => (atoms::undecodable().encode(env), Some(why.encode(env))),
                Decoded::Unknown(modules, term) => (
                    atoms::unknown().encode(env),
                    Some((modules, encode_binary(env, bytes), term).encode(env)),
                ),
            };
        }
        (self.encode_value(body, value), None)
    }

    fn encode_value(&self, body: &[u8], value: Value) -> Term<'a> {
        let env = self.env;
        match value {
            Value::Int(value) => value.encode(env),
            Value::Float(value) if value.is_finite() => value.encode(env),
            // The BEAM has no such floats, but a writer in another language may have stored them.
            Value::Float(_) => atoms::nil().encode(env),
            Value::Bool(0) => atoms::r#false().encode(env),
            Value::Bool(1) => atoms::r#true().encode(env),
            Value::Bool(_) => atoms::nil().encode(env),
            Value::Bytes { start, length } => {
                let bytes = &body[start..start + length];
                match &self.whole {
                    Some(whole) if length > COPY_UP_TO => {
                        match whole.make_subbinary(start, length) {
                            Ok(part) => part.encode(env),
                            Err(_) => encode_binary(env, bytes),
                        }
                    }
                    _ => encode_binary(env, bytes),
                }
            }
        }
    }
}

/// Returns messages from `ordinal` on, until one is later than `to`, or there are at least `most` messages or
/// `bytes` payload bytes: `{:ok, [{codec, [{sequence, originating, creation, data}]}], next_ordinal}`. A message
/// whose data are not a plain term is `{sequence, originating, creation, :unknown, {modules, bytes, term}}` or
/// `{..., :undecodable, why}`.
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
    read_messages(env, &handle, stream, ordinal, &limits)
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
    let mut runs: Vec<(u16, Vec<Term<'a>>)> = Vec::new();
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
                next += part.list.len() as u64;
                count += part.list.len() as u64;
                size += part.size;
                if limits.quick {
                    work += part.size.saturating_sub(entry.length.into());
                }
                runs.push((part.codec, part.list));
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

/// The selected messages of one chunk.
struct Part<'a> {
    codec: u16,
    list: Vec<Term<'a>>,
    /// Whether these are the last selected messages or, in a damaged chunk, the last readable ones. In the latter
    /// case the next read returns the error.
    ended: bool,
    /// Its unpacked size in memory, including the structure of terms, bytes.
    size: u64,
}

impl<'a> Part<'a> {
    /// Reads the messages after the first `skip`, up to time `to`, at most `most`.
    fn read(
        env: Env<'a>,
        chunk: &Chunk,
        skip: u64,
        to: i64,
        most: u64,
    ) -> Result<Part<'a>, &'static str> {
        let mut run = Run::start(env, chunk);
        let body = chunk.body();
        let mut list = Vec::with_capacity(chunk.header.count.min(MAX_CHUNK_MESSAGES) as usize);
        let mut ended = false;
        // Messages of one batch often have the same creation time, which is a big number, so its term is reused.
        let mut last_creation = (i64::MIN, i64::MIN.encode(env));
        for (at, message) in (0u64..).zip(chunk.messages()) {
            let (envelope, value) = match message {
                Ok(message) => message,
                Err(why) if list.is_empty() => return Err(why),
                Err(_) => {
                    ended = true;
                    break;
                }
            };
            if at < skip {
                continue;
            }
            if envelope.time > to || list.len() as u64 >= most {
                ended = true;
                break;
            }
            if envelope.creation != last_creation.0 {
                last_creation = (envelope.creation, envelope.creation.encode(env));
            }
            let (data, details) = run.encode_data(body, value);
            let terms = [
                envelope.sequence.encode(env),
                envelope.time.encode(env),
                last_creation.1,
                data,
                details.unwrap_or(data),
            ];
            let length = if details.is_some() { 5 } else { 4 };
            list.push(make_tuple(env, &terms[..length]));
        }
        let codec = chunk.header.codec;
        Ok(Part {
            codec,
            list,
            ended,
            size: body.len() as u64 + run.structure,
        })
    }
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
    match decode_term(env, bytes.as_slice()).0 {
        Decoded::Plain(term) => (atoms::ok(), term).encode(env),
        Decoded::Unknown(modules, term) => (atoms::unknown(), modules, term).encode(env),
        Decoded::Refused(why) => (atoms::undecodable(), why).encode(env),
    }
}

/// Checks that bytes in external format are plain data: `:ok` or `{:error, what_else}`.
#[rustler::nif(schedule = "DirtyCpu")]
fn term_check<'a>(env: Env<'a>, bytes: Binary<'a>) -> Term<'a> {
    match etf::check_term(bytes.as_slice()) {
        Ok(_) => atoms::ok().encode(env),
        Err(refusal) => (atoms::error(), refusal.describe()).encode(env),
    }
}

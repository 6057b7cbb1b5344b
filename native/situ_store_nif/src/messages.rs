//! Messages of a reader as terms.

use std::sync::Arc;

use rustler::types::tuple::make_tuple;
use rustler::{Binary, Encoder, Env, ResourceArc, Term};
use situ_store::chunk::Value;
use situ_store::format::{LANE_DATA, MAX_CHUNK_MESSAGES};
use situ_store::guard::Map;
use situ_store::reader::Chunk;
use situ_store::{etf, Encoding};

use crate::atoms;
use crate::reading::{failed, Handle, QUICK_ENTRIES};
use crate::terms::{copied, decode, Decoded, COPY_UP_TO};

/// The memory that binaries of read messages point into: a mapped extent, or an unpacked chunk.
pub enum Bytes {
    Map(Arc<Map>, usize, usize),
    Unpacked(Arc<Vec<u8>>),
}

#[rustler::resource_impl]
impl rustler::Resource for Bytes {}

/// Turns the messages of one chunk into `{sequence, originating, creation, data}`.
struct Run<'a> {
    env: Env<'a>,
    encoding: Encoding,
    whole: Option<Binary<'a>>,
    /// Bytes that the structure of terms takes.
    structure: u64,
}

impl<'a> Run<'a> {
    fn start(env: Env<'a>, chunk: &Chunk) -> Self {
        let encoding = chunk.header.encoding;
        let wants = matches!(encoding, Encoding::Bytes | Encoding::Codec)
            && chunk.body().len() > COPY_UP_TO;
        let whole = wants.then(|| {
            let bytes = match (chunk.unpacked(), chunk.mapped_at()) {
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

    /// The last elements of a message's tuple: its data, or (for terms that are not plain) a tag and what there is.
    fn data(&mut self, body: &[u8], value: Value) -> (Term<'a>, Option<Term<'a>>) {
        let env = self.env;
        if let (Encoding::Term, Value::Bytes { start, length }) = (self.encoding, value) {
            let bytes = &body[start..start + length];
            let (decoded, structure) = decode(env, bytes);
            self.structure += structure as u64;
            return match decoded {
                Decoded::Plain(term) => (term, None),
                Decoded::Refused(why) => (atoms::undecodable().encode(env), Some(why.encode(env))),
                Decoded::Unknown(modules, term) => (
                    atoms::unknown().encode(env),
                    Some((modules, copied(env, bytes), term).encode(env)),
                ),
            };
        }
        (self.value(body, value), None)
    }

    fn value(&self, body: &[u8], value: Value) -> Term<'a> {
        let env = self.env;
        match value {
            Value::Int(value) => value.encode(env),
            Value::Float(value) if value.is_finite() => value.encode(env),
            // The BEAM has no such floats; a writer of another language may.
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
                            Err(_) => copied(env, bytes),
                        }
                    }
                    _ => copied(env, bytes),
                }
            }
        }
    }
}

/// Messages from `ordinal` on, until one lies behind `to`, or at least `most` messages or `bytes` payload bytes are
/// there:
/// `{:ok, [{codec, [{sequence, originating, creation, data}]}], next_ordinal}`, a message whose data are no plain
/// term being
/// `{sequence, originating, creation, :unknown, {modules, bytes, term}}` or `{..., :undecodable, why}`. Whole chunks,
/// so a little more than `most` may come; `bytes` 0: exactly `most`. A damaged chunk ends the answer; as the first
/// one it is the error.
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
    let wanted = Wanted {
        to,
        most,
        bytes,
        quick: false,
    };
    read(env, &handle, stream, ordinal, &wanted)
}

/// As `reader_read`, on a normal scheduler, which saves two changes of threads: what takes little time and waits for
/// no disk, as much of it as fits into a time slice. `:slow` when that is nothing.
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
    let wanted = Wanted {
        to,
        most,
        bytes,
        quick: true,
    };
    let answer = read(env, &handle, stream, ordinal, &wanted);
    rustler::schedule::consume_timeslice(env, if most > 64 { 15 } else { 2 });
    answer
}

struct Wanted {
    to: i64,
    most: u64,
    bytes: u64,
    quick: bool,
}

/// A quick read checks and unpacks no more than about this many bytes.
const QUICK_BYTES: u64 = 64 * 1024;

fn read<'a>(env: Env<'a>, handle: &Handle, stream: u32, from: u64, wanted: &Wanted) -> Term<'a> {
    let reader = &handle.0;
    if wanted.quick && reader.behind() > QUICK_ENTRIES {
        return atoms::slow().encode(env);
    }
    if let Err(error) = reader.refresh() {
        return failed(env, &error);
    }
    let exact = wanted.bytes == 0;
    let mut runs: Vec<(u16, Vec<Term<'a>>)> = Vec::new();
    let (mut next, mut count, mut size, mut work) = (from, 0u64, 0u64, 0u64);
    while count < wanted.most && (exact || size < wanted.bytes) && work < QUICK_BYTES {
        let entry = match reader.entry_at(stream, next) {
            Ok(Some(entry)) => entry,
            Ok(None) => break,
            Err(error) if runs.is_empty() => return failed(env, &error),
            Err(_) => break,
        };
        if entry.first > wanted.to {
            break;
        }
        let opened = if wanted.quick {
            // A large message that is not checked takes next to no time.
            work += match entry.lane {
                LANE_DATA => entry.length.max(1024) as u64,
                _ => 1024,
            };
            reader.quick_chunk(&entry)
        } else {
            Some(reader.chunk(&entry))
        };
        let Some(opened) = opened else {
            if runs.is_empty() {
                return atoms::slow().encode(env);
            }
            break;
        };
        let left = if exact { wanted.most - count } else { u64::MAX };
        let part = opened.and_then(|chunk| {
            let part = Part::of(env, &chunk, next - entry.ordinal, wanted.to, left);
            part.map_err(|why| reader.broken(&entry, why))
        });
        match part {
            Ok(part) => {
                next += part.list.len() as u64;
                count += part.list.len() as u64;
                size += part.size;
                if wanted.quick {
                    work += part.size.saturating_sub(entry.length.into());
                }
                runs.push((part.codec, part.list));
                if part.ended {
                    break;
                }
            }
            Err(error) if runs.is_empty() => return failed(env, &error),
            Err(_) => break,
        }
    }
    (atoms::ok(), runs, next).encode(env)
}

/// The wanted messages of one chunk.
struct Part<'a> {
    codec: u16,
    list: Vec<Term<'a>>,
    /// These are the last messages wanted, or (when the chunk is damaged behind them) the last readable ones; the
    /// next read returns the error.
    ended: bool,
    /// Bytes it takes in memory: unpacked, with the structure of terms.
    size: u64,
}

impl<'a> Part<'a> {
    /// The messages behind the first `skip`, up to time `to`, at most `most`.
    fn of(
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
        // Messages of one batch often have one creation time, and that is a big number: made once.
        let mut made = (i64::MIN, i64::MIN.encode(env));
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
            if envelope.creation != made.0 {
                made = (envelope.creation, envelope.creation.encode(env));
            }
            let (data, more) = run.data(body, value);
            let terms = [
                envelope.sequence.encode(env),
                envelope.time.encode(env),
                made.1,
                data,
                more.unwrap_or(data),
            ];
            let length = if more.is_some() { 5 } else { 4 };
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

/// The ordinal behind the chunk that holds `ordinal`: where to go on after damage.
#[rustler::nif]
fn reader_skip(handle: Handle, stream: u32, ordinal: u64) -> u64 {
    match handle.0.entry_at(stream, ordinal) {
        Ok(Some(entry)) => entry.ordinal + entry.count as u64,
        _ => ordinal,
    }
}

/// A term from external format: `{:ok, term}`, `{:unknown, modules, term}` or `{:undecodable, why}`. No atoms are made.
#[rustler::nif(schedule = "DirtyCpu")]
fn term_decode<'a>(env: Env<'a>, bytes: Binary<'a>) -> Term<'a> {
    match decode(env, bytes.as_slice()).0 {
        Decoded::Plain(term) => (atoms::ok(), term).encode(env),
        Decoded::Unknown(modules, term) => (atoms::unknown(), modules, term).encode(env),
        Decoded::Refused(why) => (atoms::undecodable(), why).encode(env),
    }
}

/// Whether bytes in external format are plain data: `:ok` or `{:error, what_else}`.
#[rustler::nif(schedule = "DirtyCpu")]
fn term_check<'a>(env: Env<'a>, bytes: Binary<'a>) -> Term<'a> {
    match etf::check(bytes.as_slice()) {
        Ok(_) => atoms::ok().encode(env),
        Err(refusal) => (atoms::error(), refusal.text()).encode(env),
    }
}

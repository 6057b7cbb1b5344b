//! The reader's functions.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use memmap2::Mmap;
use rustler::types::tuple::make_tuple;
use rustler::{Binary, Encoder, Env, LocalPid, NifResult, OwnedEnv, ResourceArc, Term};
use situ_store::chunk::Value;
use situ_store::format::LANE_DATA;
use situ_store::reader::{Chunk, Damage};
use situ_store::watch::{self, News};
use situ_store::{pyramid, repair, Encoding, Error, Reader};

use crate::terms::{copied, decode, COPY_UP_TO};
use crate::{atoms, errors};

pub struct ReaderResource(Arc<Reader>);

#[rustler::resource_impl]
impl rustler::Resource for ReaderResource {}

/// What binaries that were read point into: a mapped extent, or an unpacked chunk.
pub enum Bytes {
    Map(Arc<Mmap>, usize, usize),
    Unpacked(Vec<u8>),
}

#[rustler::resource_impl]
impl rustler::Resource for Bytes {}

pub type Handle = ResourceArc<ReaderResource>;

impl ReaderResource {
    pub fn store(&self) -> &Reader {
        &self.0
    }
}

fn failed<'a>(env: Env<'a>, error: &Error) -> Term<'a> {
    errors::term(env, error)
}

#[rustler::nif(schedule = "DirtyIo")]
fn reader_open<'a>(env: Env<'a>, path: String, verify_large: bool) -> Term<'a> {
    match Reader::open(Path::new(&path)) {
        Ok(mut reader) => {
            reader.verify_large = verify_large;
            (
                atoms::ok(),
                ResourceArc::new(ReaderResource(Arc::new(reader))),
            )
                .encode(env)
        }
        Err(error) => failed(env, &error),
    }
}

/// `{:ok, {entries, closed?, live?, created, synced, id}}`
#[rustler::nif(schedule = "DirtyIo")]
fn reader_state<'a>(env: Env<'a>, handle: Handle) -> Term<'a> {
    let reader = &handle.0;
    // Liveness first: what a writer published before it went is then seen.
    let live = reader.is_live();
    match reader.refresh() {
        Ok(entries) => {
            let id = copied(env, &reader.header.id);
            let state = (
                entries,
                reader.is_closed(),
                live,
                reader.header.created,
                reader.synced(),
                id,
            );
            (atoms::ok(), state).encode(env)
        }
        Err(error) => failed(env, &error),
    }
}

/// Takes in what was published since; `{:ok, entries}`.
#[rustler::nif]
fn reader_refresh<'a>(env: Env<'a>, handle: Handle) -> Term<'a> {
    match handle.0.refresh() {
        Ok(entries) => (atoms::ok(), entries).encode(env),
        Err(error) => failed(env, &error),
    }
}

#[rustler::nif]
fn reader_count(handle: Handle, stream: u32) -> u64 {
    handle.0.count(stream)
}

/// `{:ok, nil}` or `{:ok, {count, first, last, first_creation, last_creation, size, latency, stored, chunks}}`
#[rustler::nif]
fn reader_statistics<'a>(env: Env<'a>, handle: Handle, stream: u32) -> Term<'a> {
    match handle.0.statistics(stream) {
        Ok(None) => (atoms::ok(), atoms::nil()).encode(env),
        Ok(Some(s)) => {
            let terms = [
                s.count.encode(env),
                s.first.encode(env),
                s.last.encode(env),
                s.first_creation.encode(env),
                s.last_creation.encode(env),
                s.size_sum.encode(env),
                if s.latency_sum.is_finite() {
                    s.latency_sum.encode(env)
                } else {
                    0.0.encode(env)
                },
                s.stored.encode(env),
                s.chunks.encode(env),
            ];
            (atoms::ok(), make_tuple(env, &terms)).encode(env)
        }
        Err(error) => failed(env, &error),
    }
}

/// The ordinal of the first message at or after `time`.
#[rustler::nif]
fn reader_seek<'a>(env: Env<'a>, handle: Handle, stream: u32, time: i64) -> Term<'a> {
    match handle.0.ordinal_from(stream, time) {
        Ok(ordinal) => (atoms::ok(), ordinal).encode(env),
        Err(error) => failed(env, &error),
    }
}

#[rustler::nif(schedule = "DirtyIo")]
fn reader_gaps(handle: Handle, stream: u32, least: i64) -> Vec<(i64, i64)> {
    handle.0.gaps(stream, least)
}

/// Turns the messages of one chunk into `{sequence, originating, creation, data}`.
struct Run<'a> {
    env: Env<'a>,
    encoding: Encoding,
    whole: Option<Binary<'a>>,
}

impl<'a> Run<'a> {
    fn start(env: Env<'a>, chunk: &Chunk) -> Self {
        let encoding = chunk.header.encoding;
        let wants = matches!(encoding, Encoding::Bytes | Encoding::Codec)
            && chunk.body().len() > COPY_UP_TO;
        let whole = wants.then(|| {
            let bytes = match chunk.mapped_at() {
                Some(at) => Bytes::Map(chunk.map.clone(), at, chunk.body().len()),
                None => Bytes::Unpacked(chunk.body().to_vec()),
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
        }
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
                match (self.encoding, &self.whole) {
                    (Encoding::Term, _) => decode(env, bytes),
                    (_, Some(whole)) if length > COPY_UP_TO => {
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

/// Messages from `ordinal` on, until one lies behind `to`, or at least `most` messages or `bytes` payload bytes are there:
/// `{:ok, [{codec, [{sequence, originating, creation, data}]}], next_ordinal}`. Whole chunks, so a little more than `most`
/// may come; `bytes` 0: exactly `most`. A damaged chunk ends the answer; as the first one it is the error.
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

/// As `reader_read`, on a normal scheduler, which saves two changes of threads: what takes little time and waits for no disk,
/// as much of it as fits into a time slice. `:slow` when that is nothing.
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
    let Wanted {
        to, most, bytes, ..
    } = *wanted;
    if let Err(error) = reader.refresh() {
        return failed(env, &error);
    }
    let exact = bytes == 0;
    let mut runs: Vec<(u16, Vec<Term<'a>>)> = Vec::new();
    let (mut next, mut count, mut size, mut work) = (from, 0u64, 0u64, 0u64);
    while count < most && (exact || size < bytes) && work < QUICK_BYTES {
        let Some(entry) = reader.entry_at(stream, next) else {
            break;
        };
        if entry.first > to {
            break;
        }
        if wanted.quick {
            // A large message that is not checked takes next to no time.
            work += if entry.lane == LANE_DATA {
                entry.length.max(1024) as u64
            } else {
                1024
            };
        }
        let opened = if wanted.quick {
            reader.quick_chunk(&entry)
        } else {
            Some(reader.chunk(&entry))
        };
        let opened = match opened {
            None if runs.is_empty() => return atoms::slow().encode(env),
            None => break,
            Some(opened) => opened,
        };
        let chunk = match opened {
            Ok(chunk) => chunk,
            Err(error) if runs.is_empty() => return failed(env, &error),
            Err(_) => break,
        };
        let run = Run::start(env, &chunk);
        let codec = chunk.header.codec;
        let body = chunk.body();
        let mut list = Vec::with_capacity(entry.count as usize);
        let mut at = entry.ordinal;
        let mut behind = false;
        // Messages of one batch often have one creation time, and that is a big number: made once.
        let mut made = (i64::MIN, i64::MIN.encode(env));
        for message in chunk.messages() {
            let (envelope, value) = match message {
                Ok(message) => message,
                Err(why) if runs.is_empty() && list.is_empty() => {
                    return failed(env, &reader.broken(&entry, why))
                }
                Err(_) => {
                    // The rest of this chunk is lost: the next read tells so.
                    behind = true;
                    break;
                }
            };
            at += 1;
            if at <= next {
                continue;
            }
            if envelope.time > to || (exact && count + list.len() as u64 >= most) {
                at -= 1;
                behind = true;
                break;
            }
            if envelope.creation != made.0 {
                made = (envelope.creation, envelope.creation.encode(env));
            }
            let terms = [
                envelope.sequence.encode(env),
                envelope.time.encode(env),
                made.1,
                run.value(body, value),
            ];
            list.push(make_tuple(env, &terms));
        }
        next = at;
        count += list.len() as u64;
        size += entry.length as u64;
        runs.push((codec, list));
        if behind {
            break;
        }
    }
    (atoms::ok(), runs, next).encode(env)
}

/// The ordinal behind the chunk that holds `ordinal`: where to go on after damage.
#[rustler::nif]
fn reader_skip(handle: Handle, stream: u32, ordinal: u64) -> u64 {
    handle
        .0
        .entry_at(stream, ordinal)
        .map_or(ordinal, |entry| entry.ordinal + entry.count as u64)
}

/// `{:ok, level, [{start, min, max, last, count}]}` with bins of 2^level ns.
#[rustler::nif(schedule = "DirtyCpu")]
fn reader_summary<'a>(
    env: Env<'a>,
    handle: Handle,
    stream: u32,
    from: i64,
    to: i64,
    pixels: u32,
) -> Term<'a> {
    let level = pyramid::level_for(from, to, pixels);
    match handle.0.summary(stream, from, to, level) {
        Ok(bins) => {
            let bins: Vec<Term<'a>> = bins
                .iter()
                .filter(|bin| bin.min.is_finite() && bin.max.is_finite() && bin.last.is_finite())
                .map(|bin| (bin.start, bin.min, bin.max, bin.last, bin.count).encode(env))
                .collect();
            (atoms::ok(), level, bins).encode(env)
        }
        Err(error) => failed(env, &error),
    }
}

#[rustler::nif]
fn summary_level(from: i64, to: i64, pixels: u32) -> u8 {
    pyramid::level_for(from, to, pixels)
}

/// A term from external format as `reader_read` gives it: no atoms are made.
#[rustler::nif]
fn term_decode<'a>(env: Env<'a>, bytes: Binary<'a>) -> Term<'a> {
    decode(env, bytes.as_slice())
}

fn damage(found: Vec<Damage>) -> Vec<(String, u64, String)> {
    found
        .into_iter()
        .map(|d| (d.file, d.offset, d.why))
        .collect()
}

#[rustler::nif]
fn reader_damage(handle: Handle) -> Vec<(String, u64, String)> {
    damage(handle.0.damage())
}

/// Checks index entries `from..from + n` wholly: `{:ok, [{file, offset, why}], entries}`.
#[rustler::nif(schedule = "DirtyIo")]
fn reader_verify<'a>(env: Env<'a>, handle: Handle, from: u64, n: u64) -> Term<'a> {
    match handle.0.verify(from, n) {
        Ok((found, total)) => (atoms::ok(), damage(found), total).encode(env),
        Err(error) => failed(env, &error),
    }
}

/// `{:ok, {kept, dropped, rebuilt?, damage}}`; meanwhile `{:situ_store, tag, {done, total}}` to `pid`.
#[rustler::nif(schedule = "DirtyIo")]
fn store_repair<'a>(env: Env<'a>, path: String, pid: LocalPid, tag: Term<'a>) -> Term<'a> {
    // Nobody is there any more who would want to know: then it is only mended.
    let tell = |done: u64, total: u64| {
        let _ = env.send(&pid, (atoms::situ_store(), tag, (done, total)));
    };
    match repair::repair(Path::new(&path), tell) {
        Ok(report) => (
            atoms::ok(),
            (
                report.kept,
                report.dropped,
                report.rebuilt,
                damage(report.damage),
            ),
        )
            .encode(env),
        Err(error) => failed(env, &error),
    }
}

/// Sends `{:situ_store, tag, {:published | :ended, entries}}` to `pid` once there are more than `known` entries or the
/// writer is gone. Waits in a thread of its own, on the writer's futex, in whatever process that lives.
#[rustler::nif]
fn reader_await(handle: Handle, known: u64, pid: LocalPid, tag: u64) -> NifResult<bool> {
    let reader = handle.0.clone();
    let spawned = std::thread::Builder::new()
        .name("situ-store-wait".into())
        .stack_size(64 * 1024)
        .spawn(move || loop {
            let news = match watch::wait(&reader, known, Duration::from_millis(500)) {
                News::Published(n) => (atoms::published(), n),
                News::Ended(n) => (atoms::ended(), n),
                News::Nothing => {
                    let alive = OwnedEnv::new().run(|env| pid.is_alive(env));
                    if alive {
                        continue;
                    }
                    return;
                }
            };
            let _ = OwnedEnv::new().send_and_clear(&pid, |_| (atoms::situ_store(), tag, news));
            return;
        });
    Ok(spawned.is_ok())
}

//! The functions of a reader.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use rustler::types::tuple::make_tuple;
use rustler::{Binary, Encoder, Env, LocalPid, OwnedEnv, ResourceArc, Term};
use situ_store::format::CATALOG;
use situ_store::reader::lock_mutex;
use situ_store::watch::{self, News};
use situ_store::{pyramid, Reader};

use crate::atoms;
use crate::errors::encode_error;
use crate::paths::FilePath;
use crate::residency::with_bytes;
use crate::terms::encode_binary;

/// A reader, terms derived from its catalog, and the processes that wait for its writer.
pub struct ReaderResource(pub Arc<Reader>, Mutex<TermCache>, Arc<Mutex<Waiting>>);

/// The waiting processes: the number of entries each knows, its pid, and the tag of its message. One thread serves
/// all of them.
#[derive(Default)]
pub struct Waiting {
    subscribers: Vec<(u64, LocalPid, u64)>,
    has_thread: bool,
}

/// External terms by name, derived from a catalog of `records` records.
#[derive(Default)]
struct TermCache {
    records: u64,
    terms: HashMap<Vec<u8>, Vec<u8>>,
}

#[rustler::resource_impl]
impl rustler::Resource for ReaderResource {}

pub type Handle = ResourceArc<ReaderResource>;

impl ReaderResource {
    pub fn store(&self) -> &Reader {
        &self.0
    }
}

#[rustler::nif(schedule = "DirtyIo")]
fn reader_open<'a>(
    env: Env<'a>,
    path: FilePath,
    verify_large: bool,
    max_unpacked: u64,
) -> Term<'a> {
    match Reader::open(&path.0) {
        Ok(mut reader) => {
            reader.verify_large = verify_large;
            reader.max_unpacked = max_unpacked as usize;
            (
                atoms::ok(),
                ResourceArc::new(ReaderResource(
                    Arc::new(reader),
                    Mutex::default(),
                    Arc::default(),
                )),
            )
                .encode(env)
        }
        Err(error) => encode_error(env, &error),
    }
}

/// Returns `{:ok, {entries, closed?, live?, created, synced, id}}`.
#[rustler::nif(schedule = "DirtyIo")]
fn reader_state<'a>(env: Env<'a>, handle: Handle) -> Term<'a> {
    let reader = &handle.0;
    // Liveness is checked first, so that everything a writer published before it ended is seen.
    let live = reader.is_live();
    match reader.refresh() {
        Ok(entries) => {
            let id = encode_binary(env, &reader.header.id);
            let state = (
                entries,
                reader.is_closed(),
                live,
                reader.header.created,
                reader.synced_entries(),
                id,
            );
            (atoms::ok(), state).encode(env)
        }
        Err(error) => encode_error(env, &error),
    }
}

/// The maximum number of entries loaded in one call on a normal scheduler.
pub const QUICK_ENTRIES: u64 = 4_096;

/// Loads newly published entries: `{:ok, entries}`, or `:slow` if there are many.
#[rustler::nif]
fn reader_refresh<'a>(env: Env<'a>, handle: Handle) -> Term<'a> {
    if handle.0.pending_entries() > QUICK_ENTRIES {
        return atoms::slow().encode(env);
    }
    match handle.0.refresh() {
        Ok(entries) => (atoms::ok(), entries).encode(env),
        Err(error) => encode_error(env, &error),
    }
}

/// Loads newly published entries like `reader_refresh`, but any number of them.
#[rustler::nif(schedule = "DirtyIo")]
fn reader_refresh_all<'a>(env: Env<'a>, handle: Handle) -> Term<'a> {
    match handle.0.refresh() {
        Ok(entries) => (atoms::ok(), entries).encode(env),
        Err(error) => encode_error(env, &error),
    }
}

fn lock_cache(handle: &Handle) -> MutexGuard<'_, TermCache> {
    lock_mutex(&handle.1)
}

/// Returns the term that `reader_shelve` stored under a name: `{:ok, external_term}`, `nil`, or `:stale` if the
/// catalog has grown since.
#[rustler::nif]
fn reader_shelved<'a>(env: Env<'a>, handle: Handle, name: Binary<'a>) -> Term<'a> {
    let cache = lock_cache(&handle);
    if cache.terms.is_empty() || cache.records != handle.0.message_count(CATALOG) {
        return atoms::stale().encode(env);
    }
    match cache.terms.get(name.as_slice()) {
        Some(bytes) => (atoms::ok(), encode_binary(env, bytes)).encode(env),
        None => atoms::nil().encode(env),
    }
}

/// Caches external terms by name, derived from a catalog of `records` records.
#[rustler::nif(schedule = "DirtyCpu")]
fn reader_shelve<'a>(handle: Handle, records: u64, terms: Vec<(Binary<'a>, Binary<'a>)>) -> bool {
    let terms = terms
        .iter()
        .map(|(name, term)| (name.as_slice().to_vec(), term.as_slice().to_vec()));
    let terms = terms.collect();
    *lock_cache(&handle) = TermCache { records, terms };
    true
}

#[rustler::nif]
fn reader_count(handle: Handle, stream: u32) -> u64 {
    handle.0.message_count(stream)
}

/// Returns `{:ok, nil}` or `{:ok, {count, first, last, first_creation, last_creation, size, latency, stored,
/// chunks}}`.
#[rustler::nif(schedule = "DirtyIo")]
fn reader_statistics<'a>(env: Env<'a>, handle: Handle, stream: u32) -> Term<'a> {
    with_bytes(env, handle.store(), || {
        encode_statistics(env, &handle, stream)
    })
}

fn encode_statistics<'a>(env: Env<'a>, handle: &Handle, stream: u32) -> Term<'a> {
    match handle.0.read_statistics(stream) {
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
        Err(error) => encode_error(env, &error),
    }
}

/// Returns the ordinal of the first message at or after `time`, or `:slow` if that needs disk access.
#[rustler::nif]
fn reader_seek_quick<'a>(env: Env<'a>, handle: Handle, stream: u32, time: i64) -> Term<'a> {
    if handle.0.pending_entries() > QUICK_ENTRIES {
        return atoms::slow().encode(env);
    }
    let found = handle.0.refresh();
    match found.and_then(|_| handle.0.quick_ordinal(stream, time)) {
        Ok(Some(ordinal)) => (atoms::ok(), ordinal).encode(env),
        Ok(None) => atoms::slow().encode(env),
        Err(error) => encode_error(env, &error),
    }
}

/// Returns the ordinal of the first message at or after `time`.
#[rustler::nif(schedule = "DirtyIo")]
fn reader_seek<'a>(env: Env<'a>, handle: Handle, stream: u32, time: i64) -> Term<'a> {
    if let Err(error) = handle.0.refresh() {
        return encode_error(env, &error);
    }
    with_bytes(env, handle.store(), || {
        match handle.0.ordinal_from(stream, time) {
            Ok(ordinal) => (atoms::ok(), ordinal).encode(env),
            Err(error) => encode_error(env, &error),
        }
    })
}

#[rustler::nif(schedule = "DirtyIo")]
fn reader_gaps<'a>(env: Env<'a>, handle: Handle, stream: u32, least: i64) -> Term<'a> {
    with_bytes(env, handle.store(), || {
        handle.0.find_gaps(stream, least).encode(env)
    })
}

/// Returns `{:ok, [{start, min, max, last, count}]}` with bins of 2^level ns.
#[rustler::nif(schedule = "DirtyCpu")]
fn reader_summary<'a>(
    env: Env<'a>,
    handle: Handle,
    stream: u32,
    from: i64,
    to: i64,
    level: u8,
) -> Term<'a> {
    with_bytes(env, handle.store(), || {
        match handle.0.read_summary(stream, from, to, level) {
            Ok(found) => (atoms::ok(), encode_bins(env, &found)).encode(env),
            Err(error) => encode_error(env, &error),
        }
    })
}

/// Encodes bins as `{start, min, max, last, count}` and leaves out those without a number.
pub fn encode_bins<'a>(env: Env<'a>, bins: &[pyramid::Bin]) -> Vec<Term<'a>> {
    bins.iter()
        .filter(|bin| bin.min.is_finite() && bin.max.is_finite() && bin.last.is_finite())
        .map(|bin| (bin.start, bin.min, bin.max, bin.last, bin.count).encode(env))
        .collect()
}

#[rustler::nif]
fn summary_level(from: i64, to: i64, pixels: u32) -> u8 {
    pyramid::level_for(from, to, pixels)
}

/// Sends `{:situ_store, tag, {:published | :ended, entries}}` to `pid` once there are more than `known` entries or
/// the writer has ended. Returns `false` if the system cannot start a thread to wait in.
#[rustler::nif]
fn reader_await(env: Env<'_>, handle: Handle, known: u64, pid: LocalPid, tag: u64) -> bool {
    let reader = &handle.0;
    let published = reader.published_entries();
    if published > known {
        let _ = env.send(
            &pid,
            (atoms::situ_store(), tag, (atoms::published(), published)),
        );
        return true;
    }
    let mut waiting = lock_mutex(&handle.2);
    waiting.subscribers.push((known, pid, tag));
    if !waiting.has_thread {
        let (reader, shared) = (reader.clone(), handle.2.clone());
        let spawned = std::thread::Builder::new()
            .name("situ-store-wait".into())
            .stack_size(64 * 1024)
            .spawn(move || notify_subscribers(&reader, &shared));
        if spawned.is_err() {
            waiting.subscribers.pop();
            return false;
        }
    }
    waiting.has_thread = true;
    true
}

/// Waits on the writer's futex, which may belong to another process, until no subscriber is left.
fn notify_subscribers(reader: &Arc<Reader>, waiting: &Mutex<Waiting>) {
    loop {
        let known = lock_mutex(waiting)
            .subscribers
            .iter()
            .map(|(known, _, _)| *known)
            .min();
        let news = watch::wait_for_entries(
            reader,
            known.unwrap_or(u64::MAX),
            Duration::from_millis(500),
        );
        let mut waiting = lock_mutex(waiting);
        let mut env = OwnedEnv::new();
        waiting.subscribers.retain(|(known, pid, tag)| {
            let event = match news {
                News::Published(n) if n > *known => (atoms::published(), n),
                News::Ended(n) => (atoms::ended(), n),
                _ => return env.run(|env| pid.is_alive(env)),
            };
            let _ = env.send_and_clear(pid, |_| (atoms::situ_store(), *tag, event));
            false
        });
        if waiting.subscribers.is_empty() {
            waiting.has_thread = false;
            return;
        }
    }
}

//! The reader's functions.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use rustler::types::tuple::make_tuple;
use rustler::{Binary, Encoder, Env, LocalPid, OwnedEnv, ResourceArc, Term};
use situ_store::format::CATALOG;
use situ_store::reader::lock;
use situ_store::watch::{self, News};
use situ_store::{pyramid, Error, Reader};

use crate::paths::FilePath;
use crate::terms::copied;
use crate::{atoms, errors};

/// A reader, what was worked out of its catalog, and who waits for its writer.
pub struct ReaderResource(pub Arc<Reader>, Mutex<Shelf>, Arc<Mutex<Waiting>>);

/// Who waits: the entries it knows, whom to tell and by which tag. One thread serves them all.
#[derive(Default)]
pub struct Waiting {
    asked: Vec<(u64, LocalPid, u64)>,
    served: bool,
}

/// External terms by name, made of a catalog of so many records.
#[derive(Default)]
struct Shelf {
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

pub fn failed<'a>(env: Env<'a>, error: &Error) -> Term<'a> {
    errors::term(env, error)
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

/// On a normal scheduler no more entries are taken in at once.
pub const QUICK_ENTRIES: u64 = 4_096;

/// Takes in what was published since; `{:ok, entries}`, or `:slow` when that is much.
#[rustler::nif]
fn reader_refresh<'a>(env: Env<'a>, handle: Handle) -> Term<'a> {
    if handle.0.behind() > QUICK_ENTRIES {
        return atoms::slow().encode(env);
    }
    match handle.0.refresh() {
        Ok(entries) => (atoms::ok(), entries).encode(env),
        Err(error) => failed(env, &error),
    }
}

/// As `reader_refresh`, however much it is.
#[rustler::nif(schedule = "DirtyIo")]
fn reader_refresh_all<'a>(env: Env<'a>, handle: Handle) -> Term<'a> {
    match handle.0.refresh() {
        Ok(entries) => (atoms::ok(), entries).encode(env),
        Err(error) => failed(env, &error),
    }
}

fn shelf(handle: &Handle) -> MutexGuard<'_, Shelf> {
    lock(&handle.1)
}

/// The term that `reader_shelve` put there under a name: `{:ok, external_term}`, `nil`, or `:stale` when the catalog
/// has grown since.
#[rustler::nif]
fn reader_shelved<'a>(env: Env<'a>, handle: Handle, name: Binary<'a>) -> Term<'a> {
    let shelf = shelf(&handle);
    if shelf.terms.is_empty() || shelf.records != handle.0.count(CATALOG) {
        return atoms::stale().encode(env);
    }
    match shelf.terms.get(name.as_slice()) {
        Some(bytes) => (atoms::ok(), copied(env, bytes)).encode(env),
        None => atoms::nil().encode(env),
    }
}

/// Keeps external terms by name, made of a catalog of so many records.
#[rustler::nif(schedule = "DirtyCpu")]
fn reader_shelve<'a>(handle: Handle, records: u64, terms: Vec<(Binary<'a>, Binary<'a>)>) -> bool {
    let terms = terms
        .iter()
        .map(|(name, term)| (name.as_slice().to_vec(), term.as_slice().to_vec()));
    let terms = terms.collect();
    *shelf(&handle) = Shelf { records, terms };
    true
}

#[rustler::nif]
fn reader_count(handle: Handle, stream: u32) -> u64 {
    handle.0.count(stream)
}

/// `{:ok, nil}` or `{:ok, {count, first, last, first_creation, last_creation, size, latency, stored, chunks}}`
#[rustler::nif(schedule = "DirtyIo")]
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

/// The ordinal of the first message at or after `time`, or `:slow` when a disk has to be waited for.
#[rustler::nif]
fn reader_seek_quick<'a>(env: Env<'a>, handle: Handle, stream: u32, time: i64) -> Term<'a> {
    if handle.0.behind() > QUICK_ENTRIES {
        return atoms::slow().encode(env);
    }
    let found = handle.0.refresh();
    match found.and_then(|_| handle.0.ordinal_quick(stream, time)) {
        Ok(Some(ordinal)) => (atoms::ok(), ordinal).encode(env),
        Ok(None) => atoms::slow().encode(env),
        Err(error) => failed(env, &error),
    }
}

/// The ordinal of the first message at or after `time`.
#[rustler::nif(schedule = "DirtyIo")]
fn reader_seek<'a>(env: Env<'a>, handle: Handle, stream: u32, time: i64) -> Term<'a> {
    if let Err(error) = handle.0.refresh() {
        return failed(env, &error);
    }
    match handle.0.ordinal_from(stream, time) {
        Ok(ordinal) => (atoms::ok(), ordinal).encode(env),
        Err(error) => failed(env, &error),
    }
}

#[rustler::nif(schedule = "DirtyIo")]
fn reader_gaps(handle: Handle, stream: u32, least: i64) -> Vec<(i64, i64)> {
    handle.0.gaps(stream, least)
}

/// `{:ok, [{start, min, max, last, count}]}` with bins of 2^level ns.
#[rustler::nif(schedule = "DirtyCpu")]
fn reader_summary<'a>(
    env: Env<'a>,
    handle: Handle,
    stream: u32,
    from: i64,
    to: i64,
    level: u8,
) -> Term<'a> {
    match handle.0.summary(stream, from, to, level) {
        Ok(found) => (atoms::ok(), bins(env, &found)).encode(env),
        Err(error) => failed(env, &error),
    }
}

/// Bins as `{start, min, max, last, count}`, those without a number left out.
pub fn bins<'a>(env: Env<'a>, bins: &[pyramid::Bin]) -> Vec<Term<'a>> {
    bins.iter()
        .filter(|bin| bin.min.is_finite() && bin.max.is_finite() && bin.last.is_finite())
        .map(|bin| (bin.start, bin.min, bin.max, bin.last, bin.count).encode(env))
        .collect()
}

#[rustler::nif]
fn summary_level(from: i64, to: i64, pixels: u32) -> u8 {
    pyramid::level_for(from, to, pixels)
}

/// Sends `{:situ_store, tag, {:published | :ended, entries}}` to `pid` once there are more than `known` entries or the
/// writer is gone. `false` when the system has no thread left to wait in.
#[rustler::nif]
fn reader_await(env: Env<'_>, handle: Handle, known: u64, pid: LocalPid, tag: u64) -> bool {
    let reader = &handle.0;
    let published = reader.published();
    if published > known {
        let _ = env.send(
            &pid,
            (atoms::situ_store(), tag, (atoms::published(), published)),
        );
        return true;
    }
    let mut waiting = lock(&handle.2);
    waiting.asked.push((known, pid, tag));
    if !waiting.served {
        let (reader, shared) = (reader.clone(), handle.2.clone());
        let spawned = std::thread::Builder::new()
            .name("situ-store-wait".into())
            .stack_size(64 * 1024)
            .spawn(move || serve(&reader, &shared));
        if spawned.is_err() {
            waiting.asked.pop();
            return false;
        }
    }
    waiting.served = true;
    true
}

/// Waits on the writer's futex, which may belong to another process, until no subscriber is left.
fn serve(reader: &Arc<Reader>, waiting: &Mutex<Waiting>) {
    loop {
        let known = lock(waiting).asked.iter().map(|(known, _, _)| *known).min();
        let news = watch::wait(
            reader,
            known.unwrap_or(u64::MAX),
            Duration::from_millis(500),
        );
        let mut waiting = lock(waiting);
        let mut env = OwnedEnv::new();
        waiting.asked.retain(|(known, pid, tag)| {
            let told = match news {
                News::Published(n) if n > *known => (atoms::published(), n),
                News::Ended(n) => (atoms::ended(), n),
                _ => return env.run(|env| pid.is_alive(env)),
            };
            let _ = env.send_and_clear(pid, |_| (atoms::situ_store(), *tag, told));
            false
        });
        if waiting.asked.is_empty() {
            waiting.served = false;
            return;
        }
    }
}

//! The functions of a writer.

use std::collections::HashSet;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use rustler::types::list::ListIterator;
use rustler::{Atom, Binary, Encoder, Env, Error as NifError, NifResult, ResourceArc, Term};
use situ_store::reader::lock_mutex;
use situ_store::writer::{Draft, Drafts, Durability};
use situ_store::{Compression, Encoding, Options, Writer};

use crate::drafts::{add_columns_to_draft, add_to_draft, CreationTimes};
use crate::inputs::{append_batches, append_runs, AppendError};
use crate::paths::FilePath;
use crate::{atoms, errors};

/// The writer, the names of its streams, and the messages that wait for a commit.
pub struct WriterResource(Mutex<Writer>, Mutex<HashSet<String>>, Arc<Drafts>);

#[rustler::resource_impl]
impl rustler::Resource for WriterResource {}

/// The messages of one stream that wait for a commit.
pub struct DraftResource(Arc<Draft>);

#[rustler::resource_impl]
impl rustler::Resource for DraftResource {}

pub type Handle = ResourceArc<WriterResource>;

pub fn encode_result<'a, T: Encoder>(env: Env<'a>, result: situ_store::Result<T>) -> Term<'a> {
    match result {
        Ok(value) => (atoms::ok(), value).encode(env),
        Err(error) => errors::encode_error(env, &error),
    }
}

pub fn with_writer<T>(
    handle: &Handle,
    act: impl FnOnce(&mut Writer) -> situ_store::Result<T>,
) -> situ_store::Result<T> {
    let mut writer = lock_mutex(&handle.0);
    let result = act(&mut writer);
    if result.is_err() {
        writer.rollback();
    }
    result
}

/// Creates a store. `durability` is `:none`, `:each` or milliseconds; `mode` is the mode of the files, or `nil`.
#[rustler::nif(schedule = "DirtyIo")]
fn writer_create<'a>(
    env: Env<'a>,
    path: FilePath,
    first_extent: u64,
    max_extent: u64,
    durability: Term<'a>,
    mode: Option<u32>,
) -> NifResult<Term<'a>> {
    let durability = if durability.is_atom() {
        if atoms::each() == durability {
            Durability::Each
        } else {
            Durability::None
        }
    } else {
        Durability::Interval(Duration::from_millis(durability.decode()?))
    };
    let options = Options {
        first_extent,
        max_extent,
        durability,
        mode,
        ..Options::default()
    };
    let created = Writer::create(&path.0, options);
    Ok(encode_result(
        env,
        created.map(|writer| {
            ResourceArc::new(WriterResource(
                Mutex::new(writer),
                Mutex::default(),
                Arc::default(),
            ))
        }),
    ))
}

#[rustler::nif(schedule = "DirtyIo")]
fn writer_stream<'a>(
    env: Env<'a>,
    handle: Handle,
    name: String,
    compression: Atom,
    large: bool,
) -> NifResult<Term<'a>> {
    let mut names = lock_mutex(&handle.1);
    if !names.insert(name) {
        return Ok((atoms::error(), atoms::stream_exists()).encode(env));
    }
    let compression = match compression {
        c if c == atoms::lz4() => Compression::Lz4,
        c if c == atoms::zstd() => Compression::Zstd,
        c if c == atoms::none() => Compression::None,
        _ => return Err(NifError::BadArg),
    };
    Ok(encode_result(
        env,
        with_writer(&handle, |writer| Ok(writer.add_stream(compression, large))),
    ))
}

/// Appends a record to the catalog, at `now` or later.
#[rustler::nif(schedule = "DirtyIo")]
fn writer_record<'a>(env: Env<'a>, handle: Handle, record: Binary<'a>, now: i64) -> Term<'a> {
    encode_result(
        env,
        with_writer(&handle, |writer| writer.append_record(&record, now)),
    )
}

/// Creates a draft of a stream.
#[rustler::nif]
fn writer_draft(handle: Handle, stream: u32) -> ResourceArc<DraftResource> {
    ResourceArc::new(DraftResource(handle.2.add_draft(stream)))
}

/// Adds `%Situ.Message{}`s to a draft and returns `{messages, bytes}`, the size of the draft. Adds none of them and
/// returns `:refused` if a draft cannot contain one of them.
#[rustler::nif]
fn draft_add<'a>(env: Env<'a>, draft: ResourceArc<DraftResource>, messages: Term<'a>) -> Term<'a> {
    match add_to_draft(&draft.0, messages) {
        Some((added, size)) => {
            rustler::schedule::consume_timeslice(env, (added / 100).clamp(1, 100) as i32);
            (size.messages, size.bytes).encode(env)
        }
        None => atoms::refused().encode(env),
    }
}

/// Adds columns of plain numbers to a draft, and returns as `draft_add` does.
#[rustler::nif]
fn draft_add_columns<'a>(
    env: Env<'a>,
    draft: ResourceArc<DraftResource>,
    kind: Atom,
    columns: (Binary<'a>, Binary<'a>),
    creation_times: CreationTimes<'a>,
    first_id: u64,
) -> NifResult<Term<'a>> {
    let encoding = match kind {
        kind if kind == atoms::integer() => Encoding::Int,
        kind if kind == atoms::float() => Encoding::Float,
        kind if kind == atoms::boolean() => Encoding::Bool,
        _ => return Err(NifError::BadArg),
    };
    let columns = (columns.0.as_slice(), columns.1.as_slice());
    let added = add_columns_to_draft(&draft.0, encoding, columns, &creation_times, first_id);
    Ok(match added {
        Some((added, size)) => {
            rustler::schedule::consume_timeslice(env, (added / 400).clamp(1, 100) as i32);
            (size.messages, size.bytes).encode(env)
        }
        None => atoms::refused().encode(env),
    })
}

/// Returns for how many milliseconds the oldest message of a draft has waited, or `nil`.
#[rustler::nif]
fn draft_waiting(draft: ResourceArc<DraftResource>) -> Option<u64> {
    let waited = draft.0.waiting_time();
    waited.map(|waited| waited.as_millis() as u64)
}

/// Commits the messages of a draft, and those of all other drafts of the store if `all`.
#[rustler::nif(schedule = "DirtyIo")]
fn draft_commit<'a>(
    env: Env<'a>,
    handle: Handle,
    draft: ResourceArc<DraftResource>,
    all: bool,
) -> Term<'a> {
    let committed = with_writer(&handle, |writer| {
        if all {
            handle.2.commit_all(writer)?;
        }
        draft.0.commit(writer).map(|()| writer.committed_entries())
    });
    encode_result(env, committed)
}

fn append_with<'a>(
    env: Env<'a>,
    handle: &Handle,
    act: impl FnOnce(&mut Writer) -> Result<u64, AppendError>,
) -> NifResult<Term<'a>> {
    let mut writer = lock_mutex(&handle.0);
    match act(&mut writer) {
        Ok(committed) => Ok((atoms::ok(), committed).encode(env)),
        Err(failed) => {
            writer.rollback();
            match failed {
                AppendError::Store(error) => Ok(errors::encode_error(env, &error)),
                AppendError::Argument(error) => Err(error),
            }
        }
    }
}

/// Appends lists of `%Situ.Message{}`s to a stream, either all or none.
#[rustler::nif(schedule = "DirtyIo")]
fn writer_append<'a>(
    env: Env<'a>,
    handle: Handle,
    stream: u32,
    batches: Term<'a>,
) -> NifResult<Term<'a>> {
    append_with(env, &handle, |writer| {
        append_batches(writer, stream, batches)
    })
}

/// Appends runs of messages, `{codec, messages, points}`, either all or none. Messages of a codec are `{sequence,
/// originating, creation, iodata}` with the points of their signal; messages of codec 0 are `%Situ.Message{}`s.
#[rustler::nif(schedule = "DirtyIo")]
fn writer_append_runs<'a>(
    env: Env<'a>,
    handle: Handle,
    stream: u32,
    runs: ListIterator<'a>,
) -> NifResult<Term<'a>> {
    append_with(env, &handle, |writer| append_runs(writer, stream, runs))
}

/// Returns the size of the store in bytes.
#[rustler::nif(schedule = "DirtyIo")]
fn writer_bytes(handle: Handle) -> u64 {
    lock_mutex(&handle.0).byte_size()
}

#[rustler::nif(schedule = "DirtyIo")]
fn writer_sync<'a>(env: Env<'a>, handle: Handle) -> Term<'a> {
    encode_result(
        env,
        with_writer(&handle, |writer| {
            writer.sync().map(|()| writer.committed_entries())
        }),
    )
}

#[rustler::nif(schedule = "DirtyIo")]
fn writer_close<'a>(env: Env<'a>, handle: Handle) -> Term<'a> {
    encode_result(
        env,
        with_writer(&handle, |writer| {
            // Components that ended without an error have committed their drafts. The rest is saved if possible.
            let _ = handle.2.commit_all(writer);
            writer.close().map(|()| writer.committed_entries())
        }),
    )
}

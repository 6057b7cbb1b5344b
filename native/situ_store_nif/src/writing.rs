//! The writer's functions.

use std::collections::HashSet;
use std::sync::Mutex;
use std::time::Duration;

use rustler::types::list::ListIterator;
use rustler::{Atom, Encoder, Env, Error as NifError, NifResult, ResourceArc, Term};
use situ_store::reader::lock;
use situ_store::writer::Durability;
use situ_store::{Compression, Error, Options, Writer};

use crate::inputs::{append, append_runs, Failed};
use crate::paths::FilePath;
use crate::{atoms, errors};

/// The writer and the names its streams have.
pub struct WriterResource(Mutex<Writer>, Mutex<HashSet<String>>);

#[rustler::resource_impl]
impl rustler::Resource for WriterResource {}

pub type Handle = ResourceArc<WriterResource>;

pub fn answer<'a, T: Encoder>(env: Env<'a>, result: situ_store::Result<T>) -> Term<'a> {
    match result {
        Ok(value) => (atoms::ok(), value).encode(env),
        Err(error) => errors::term(env, &error),
    }
}

pub fn with<T>(
    handle: &Handle,
    act: impl FnOnce(&mut Writer) -> situ_store::Result<T>,
) -> situ_store::Result<T> {
    let mut writer = lock(&handle.0);
    let result = act(&mut writer);
    if result.is_err() {
        writer.rollback();
    }
    result
}

/// durability: `:none`, `:each` or milliseconds; mode: of the files, or `nil`.
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
    Ok(answer(
        env,
        created
            .map(|writer| ResourceArc::new(WriterResource(Mutex::new(writer), Mutex::default()))),
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
    let mut names = lock(&handle.1);
    if !names.insert(name) {
        return Ok((atoms::error(), atoms::stream_exists()).encode(env));
    }
    let compression = match compression {
        c if c == atoms::lz4() => Compression::Lz4,
        c if c == atoms::zstd() => Compression::Zstd,
        c if c == atoms::none() => Compression::None,
        _ => return Err(NifError::BadArg),
    };
    Ok(answer(
        env,
        with(&handle, |writer| Ok(writer.add_stream(compression, large))),
    ))
}

#[rustler::nif(schedule = "DirtyIo")]
fn writer_position<'a>(env: Env<'a>, handle: Handle, stream: u32) -> Term<'a> {
    answer(
        env,
        with(&handle, |writer| {
            writer.position(stream).ok_or(Error::UnknownStream(stream))
        }),
    )
}

fn finish<'a>(
    env: Env<'a>,
    handle: &Handle,
    act: impl FnOnce(&mut Writer) -> Result<u64, Failed>,
) -> NifResult<Term<'a>> {
    let mut writer = lock(&handle.0);
    match act(&mut writer) {
        Ok(committed) => Ok((atoms::ok(), committed).encode(env)),
        Err(failed) => {
            writer.rollback();
            match failed {
                Failed::Store(error) => Ok(errors::term(env, &error)),
                Failed::Argument(error) => Err(error),
            }
        }
    }
}

/// Appends lists of `%Situ.Message{}`s to a stream, all or none.
#[rustler::nif(schedule = "DirtyIo")]
fn writer_append<'a>(
    env: Env<'a>,
    handle: Handle,
    stream: u32,
    batches: Term<'a>,
) -> NifResult<Term<'a>> {
    finish(env, &handle, |writer| append(writer, stream, batches))
}

/// Appends runs of messages, `{codec, messages, points}`, all or none. Messages of a codec are
/// `{sequence, originating, creation, iodata}`, and points those of their signal; of codec 0 they are
/// `%Situ.Message{}`s.
#[rustler::nif(schedule = "DirtyIo")]
fn writer_append_runs<'a>(
    env: Env<'a>,
    handle: Handle,
    stream: u32,
    runs: ListIterator<'a>,
) -> NifResult<Term<'a>> {
    finish(env, &handle, |writer| append_runs(writer, stream, runs))
}

/// How many bytes the store takes.
#[rustler::nif(schedule = "DirtyIo")]
fn writer_bytes(handle: Handle) -> u64 {
    lock(&handle.0).bytes()
}

#[rustler::nif(schedule = "DirtyIo")]
fn writer_sync<'a>(env: Env<'a>, handle: Handle) -> Term<'a> {
    answer(
        env,
        with(&handle, |writer| writer.sync().map(|()| writer.committed())),
    )
}

#[rustler::nif(schedule = "DirtyIo")]
fn writer_close<'a>(env: Env<'a>, handle: Handle) -> Term<'a> {
    answer(
        env,
        with(&handle, |writer| {
            writer.close().map(|()| writer.committed())
        }),
    )
}

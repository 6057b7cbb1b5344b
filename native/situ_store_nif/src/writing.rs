//! The writer's functions.

use std::collections::HashSet;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use rustler::types::list::ListIterator;
use rustler::{
    Atom, Binary, Encoder, Env, Error as NifError, NifResult, ResourceArc, Term, TermType,
};
use situ_store::chunk::{Envelope, Input};
use situ_store::extent::Fault;
use situ_store::format::LARGE_MESSAGE;
use situ_store::pyramid::Bin;
use situ_store::writer::Durability;
use situ_store::{etf, Compression, Encoding, Error, Options, Writer};

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
    let mut writer = handle
        .0
        .lock()
        .unwrap_or_else(|poisoned| poisoned.into_inner());
    let result = act(&mut writer);
    if result.is_err() {
        writer.rollback();
    }
    result
}

/// durability: `:none`, `:each` or milliseconds; `fault`: 0, or the step at which the process is to be killed (tests).
#[rustler::nif(schedule = "DirtyIo")]
fn writer_create<'a>(
    env: Env<'a>,
    path: String,
    first_extent: u64,
    max_extent: u64,
    durability: Term<'a>,
    fault: i64,
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
    let fault = if fault == 0 {
        Arc::default()
    } else {
        Fault::after(fault.abs(), fault > 0)
    };
    let options = Options {
        first_extent,
        max_extent,
        durability,
        fault,
    };
    let created = Writer::create(Path::new(&path), options);
    Ok(answer(
        env,
        created
            .map(|writer| ResourceArc::new(WriterResource(Mutex::new(writer), Mutex::default()))),
    ))
}

#[rustler::nif]
fn writer_stream<'a>(
    env: Env<'a>,
    handle: Handle,
    name: String,
    compression: Atom,
    large: bool,
) -> NifResult<Term<'a>> {
    let mut names = handle
        .1
        .lock()
        .unwrap_or_else(|poisoned| poisoned.into_inner());
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

#[rustler::nif]
fn writer_position<'a>(env: Env<'a>, handle: Handle, stream: u32) -> Term<'a> {
    answer(
        env,
        with(&handle, |writer| {
            writer.position(stream).ok_or(Error::UnknownStream(stream))
        }),
    )
}

fn envelope(message: Term<'_>) -> NifResult<Envelope> {
    Ok(Envelope {
        sequence: message.map_get(atoms::sequence_id())?.decode()?,
        time: message.map_get(atoms::originating_time())?.decode()?,
        creation: message.map_get(atoms::creation_time())?.decode()?,
    })
}

fn encoding_of(data: Term<'_>) -> Encoding {
    match data.get_type() {
        TermType::Integer if data.decode::<i64>().is_ok() => Encoding::Int,
        TermType::Float => Encoding::Float,
        TermType::Binary if data.is_binary() => Encoding::Bytes,
        TermType::Atom if boolean(data).is_some() => Encoding::Bool,
        _ => Encoding::Term,
    }
}

fn fits(encoding: Encoding, data: Term<'_>) -> bool {
    match encoding {
        Encoding::Int => data.decode::<i64>().is_ok(),
        Encoding::Float => data.is_float(),
        Encoding::Bytes => data.is_binary(),
        Encoding::Bool => boolean(data).is_some(),
        _ => true,
    }
}

fn boolean(data: Term<'_>) -> Option<u8> {
    if atoms::r#false() == data {
        Some(0)
    } else if atoms::r#true() == data {
        Some(1)
    } else if atoms::nil() == data {
        Some(2)
    } else {
        None
    }
}

enum Failed {
    Store(Error),
    Argument(NifError),
}

impl From<Error> for Failed {
    fn from(error: Error) -> Self {
        Failed::Store(error)
    }
}

impl From<NifError> for Failed {
    fn from(error: NifError) -> Self {
        Failed::Argument(error)
    }
}

fn push(
    writer: &mut Writer,
    stream: u32,
    encoding: Encoding,
    envelope: Envelope,
    data: Term<'_>,
) -> Result<(), Failed> {
    match encoding {
        Encoding::Int => writer.push(stream, envelope, encoding, 0, Input::Int(data.decode()?))?,
        Encoding::Float => {
            writer.push(stream, envelope, encoding, 0, Input::Float(data.decode()?))?
        }
        Encoding::Bool => writer.push(
            stream,
            envelope,
            encoding,
            0,
            Input::Bool(boolean(data).unwrap_or(2)),
        )?,
        Encoding::Bytes => {
            let bytes: Binary<'_> = data.decode()?;
            writer.push(
                stream,
                envelope,
                encoding,
                0,
                Input::Bytes(bytes.as_slice()),
            )?;
        }
        _ => {
            let bytes = data.to_binary();
            etf::check(bytes.as_slice()).map_err(|refusal| Error::NotStorable(refusal.text()))?;
            writer.push(
                stream,
                envelope,
                Encoding::Term,
                0,
                Input::Bytes(bytes.as_slice()),
            )?;
        }
    }
    Ok(())
}

/// Pushes all messages of the batches in one encoding; `false` when one does not fit it.
fn push_all(
    writer: &mut Writer,
    stream: u32,
    encoding: Encoding,
    batches: ListIterator<'_>,
) -> Result<bool, Failed> {
    for batch in batches {
        for message in batch.into_list_iterator()? {
            let data = message.map_get(atoms::data())?;
            if !fits(encoding, data) {
                return Ok(false);
            }
            push(writer, stream, encoding, envelope(message)?, data)?;
        }
    }
    Ok(true)
}

fn all_fit(encoding: Encoding, batches: ListIterator<'_>) -> NifResult<bool> {
    for batch in batches {
        for message in batch.into_list_iterator()? {
            if !fits(encoding, message.map_get(atoms::data())?) {
                return Ok(false);
            }
        }
    }
    Ok(true)
}

/// A batch is stored in the encoding of its first message; any mixture as terms, so that chunks stay long.
fn append(writer: &mut Writer, stream: u32, batches: Term<'_>) -> Result<u64, Failed> {
    let first = batches
        .into_list_iterator()?
        .find_map(|batch| batch.into_list_iterator().ok()?.next());
    let data = match first {
        Some(message) => message.map_get(atoms::data())?,
        None => return Ok(writer.committed()),
    };
    let encoding = encoding_of(data);
    // Large messages are written as they are pushed: they are looked through first.
    let large = |bytes: Binary<'_>| bytes.len() >= LARGE_MESSAGE;
    let fit = !(encoding == Encoding::Bytes && data.decode().is_ok_and(large))
        || all_fit(encoding, batches.into_list_iterator()?)?;
    if !fit || !push_all(writer, stream, encoding, batches.into_list_iterator()?)? {
        writer.rollback();
        push_all(
            writer,
            stream,
            Encoding::Term,
            batches.into_list_iterator()?,
        )?;
    }
    Ok(writer.commit()?)
}

fn finish<'a>(
    env: Env<'a>,
    handle: &Handle,
    act: impl FnOnce(&mut Writer) -> Result<u64, Failed>,
) -> NifResult<Term<'a>> {
    let mut writer = handle
        .0
        .lock()
        .unwrap_or_else(|poisoned| poisoned.into_inner());
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

/// The binaries of an iolist, none of them copied; loose bytes are gathered.
fn parts<'a>(term: Term<'a>, found: &mut Vec<Part<'a>>, depth: u32) -> NifResult<()> {
    if let Ok(binary) = term.decode::<Binary<'a>>() {
        found.push(Part::Binary(binary));
        return Ok(());
    }
    if depth > 64 {
        return Err(NifError::BadArg);
    }
    for element in term.into_list_iterator()? {
        if let Ok(byte) = element.decode::<u8>() {
            match found.last_mut() {
                Some(Part::Loose(bytes)) => bytes.push(byte),
                _ => found.push(Part::Loose(vec![byte])),
            }
        } else {
            parts(element, found, depth + 1)?;
        }
    }
    Ok(())
}

enum Part<'a> {
    Binary(Binary<'a>),
    Loose(Vec<u8>),
}

fn append_encoded(
    writer: &mut Writer,
    stream: u32,
    codec: u16,
    messages: ListIterator<'_>,
    points: ListIterator<'_>,
) -> Result<u64, Failed> {
    let mut found = Vec::new();
    for message in messages {
        let (sequence, time, creation, bytes): (u64, i64, i64, Term<'_>) = message.decode()?;
        found.clear();
        parts(bytes, &mut found, 0)?;
        let slices: Vec<&[u8]> = found
            .iter()
            .map(|part| match part {
                Part::Binary(binary) => binary.as_slice(),
                Part::Loose(bytes) => bytes.as_slice(),
            })
            .collect();
        let envelope = Envelope {
            sequence,
            time,
            creation,
        };
        writer.push(
            stream,
            envelope,
            Encoding::Codec,
            codec,
            Input::Parts(&slices),
        )?;
    }
    for point in points {
        let (start, min, max, last, count): (i64, f64, f64, f64, u64) = point.decode()?;
        writer.push_point(
            stream,
            Bin {
                start,
                min,
                max,
                last,
                count,
            },
        )?;
    }
    Ok(writer.commit()?)
}

/// Appends `{sequence, originating, creation, iodata}` of a codec, with the points of its signal, all or none.
#[rustler::nif(schedule = "DirtyIo")]
fn writer_append_encoded<'a>(
    env: Env<'a>,
    handle: Handle,
    stream: u32,
    codec: u16,
    messages: ListIterator<'a>,
    points: ListIterator<'a>,
) -> NifResult<Term<'a>> {
    finish(env, &handle, |writer| {
        append_encoded(writer, stream, codec, messages, points)
    })
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

//! BEAM glue of situ_mcap and situ_csv: decode, call, encode. No algorithms here.

mod bytes;
mod copy;
mod layout;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Mutex, MutexGuard};

use rustler::{Atom, Binary, Encoder, Env, NewBinary, ResourceArc, Term};
use situ_mcap::{ChannelSpec, Compression, Error, Message, Options, Query, Reader, Times, Writer};

mod atoms {
    rustler::atoms! {
        ok, error, nil, io, not_mcap, damaged, closed,
        integer, float, boolean,
        none, lz4, zstd, log, publish, ros1_header, cdr_header, file
    }
}

struct ReaderResource(Reader);

#[rustler::resource_impl]
impl rustler::Resource for ReaderResource {}

struct WriterResource(Mutex<Writer>);

#[rustler::resource_impl]
impl rustler::Resource for WriterResource {}

impl WriterResource {
    fn lock(&self) -> MutexGuard<'_, Writer> {
        self.0
            .lock()
            .unwrap_or_else(|poisoned| poisoned.into_inner())
    }
}

fn failed<'a>(env: Env<'a>, error: &Error) -> Term<'a> {
    let reason = match error {
        Error::Io(what, errno, why) => (atoms::io(), what, errno, why).encode(env),
        Error::NotMcap => atoms::not_mcap().encode(env),
        Error::Damaged(at, why) => (atoms::damaged(), at, why).encode(env),
        Error::Closed => atoms::closed().encode(env),
    };
    (atoms::error(), reason).encode(env)
}

fn answer<'a, T: Encoder>(env: Env<'a>, result: situ_mcap::Result<T>) -> Term<'a> {
    match result {
        Ok(value) => (atoms::ok(), value).encode(env),
        Err(error) => failed(env, &error),
    }
}

fn binary<'a>(env: Env<'a>, bytes: &[u8]) -> Term<'a> {
    let mut new = NewBinary::new(env, bytes.len());
    new.as_mut_slice().copy_from_slice(bytes);
    new.into()
}

fn times(atom: Atom) -> Times {
    if atom == atoms::publish() {
        Times::Publish
    } else if atom == atoms::ros1_header() {
        Times::Ros1Header
    } else if atom == atoms::cdr_header() {
        Times::CdrHeader
    } else {
        Times::Log
    }
}

// Numbers from Elixir may be beyond any time that a file can hold.
fn clamped(time: Term) -> i128 {
    time.decode::<i64>()
        .map(i128::from)
        .or_else(|_| time.decode::<u64>().map(i128::from))
        .unwrap_or_else(|_| {
            if time.is_atom() {
                i128::MAX
            } else {
                i128::from(i64::MIN)
            }
        })
}

#[rustler::nif(schedule = "DirtyIo")]
fn mcap_open<'a>(env: Env<'a>, path: String) -> Term<'a> {
    let reader = Reader::open(Path::new(&path));
    answer(env, reader.map(|r| ResourceArc::new(ReaderResource(r))))
}

/// The same by passing over the file, since its index is wrong: `why`.
#[rustler::nif(schedule = "DirtyIo")]
fn mcap_open_without_index<'a>(env: Env<'a>, path: String, why: String) -> Term<'a> {
    let reader = Reader::open_without_index(Path::new(&path), &why);
    answer(env, reader.map(|r| ResourceArc::new(ReaderResource(r))))
}

/// `{profile, library, channels, schemas, attachments, metadata, damage, finished?}`
#[rustler::nif(schedule = "DirtyIo")]
fn mcap_info<'a>(env: Env<'a>, handle: ResourceArc<ReaderResource>) -> Term<'a> {
    let info = handle.0.info();
    let channels: Vec<Term> = info
        .channels
        .iter()
        .map(|(c, count)| {
            (
                c.id,
                &c.topic,
                &c.encoding,
                c.schema,
                pairs(&c.metadata),
                *count,
            )
                .encode(env)
        })
        .collect();
    let schemas: Vec<Term> = info
        .schemas
        .iter()
        .map(|(id, s)| (*id, &s.name, &s.encoding, binary(env, &s.data)).encode(env))
        .collect();
    let attachments: Vec<Term> = info
        .attachments
        .iter()
        .map(|a| (&a.name, &a.media_type, a.log_time, a.offset, a.size).encode(env))
        .collect();
    let metadata: Vec<Term> = info
        .metadata
        .iter()
        .map(|(name, map)| (name, pairs(map)).encode(env))
        .collect();
    (
        info.profile.as_str(),
        info.library.as_str(),
        channels,
        schemas,
        attachments,
        metadata,
        (info.damage, info.finished),
    )
        .encode(env)
}

fn pairs(map: &BTreeMap<String, String>) -> Vec<(String, String)> {
    map.iter().map(|(k, v)| (k.clone(), v.clone())).collect()
}

/// `{:ok, {first, last, count}}`, or `{:ok, nil}` for a channel without messages.
#[rustler::nif(schedule = "DirtyIo")]
fn mcap_span<'a>(
    env: Env<'a>,
    handle: ResourceArc<ReaderResource>,
    channel: u16,
    by: Atom,
) -> Term<'a> {
    answer(env, handle.0.span(channel, times(by)))
}

#[rustler::nif(schedule = "DirtyIo")]
fn mcap_seek<'a>(
    env: Env<'a>,
    handle: ResourceArc<ReaderResource>,
    channel: u16,
    by: Atom,
    time: Term<'a>,
) -> Term<'a> {
    answer(env, handle.0.seek(channel, times(by), clamped(time)))
}

type Wanted<'a> = ((u16, Atom), u64, Term<'a>, (usize, usize), (bool, bool));

/// `{:ok, {[{time, log_time, publish_time, sequence, data}], next}}`; `what` is `{{channel, times}, from, to, {most,
/// bytes}, {envelopes?, skip_damage?}}`.
#[rustler::nif(schedule = "DirtyIo")]
fn mcap_read<'a>(env: Env<'a>, handle: ResourceArc<ReaderResource>, what: Wanted<'a>) -> Term<'a> {
    let ((channel, by), from, to, (most, bytes), (envelopes, skip_damage)) = what;
    let query = Query {
        channel,
        times: times(by),
        from,
        to: clamped(to),
        most,
        bytes,
        envelopes,
        skip_damage,
    };
    match handle.0.read(&query) {
        Ok((messages, next)) => {
            let messages: Vec<Term> = messages.iter().map(|m| message(env, m)).collect();
            (atoms::ok(), (messages, next)).encode(env)
        }
        Err(error) => failed(env, &error),
    }
}

fn message<'a>(env: Env<'a>, m: &Message) -> Term<'a> {
    (
        m.time,
        m.log_time,
        m.publish_time,
        m.sequence,
        binary(env, &m.data),
    )
        .encode(env)
}

#[rustler::nif(schedule = "DirtyIo")]
fn mcap_attachment<'a>(env: Env<'a>, handle: ResourceArc<ReaderResource>, offset: u64) -> Term<'a> {
    match handle.0.attachment(offset) {
        Ok(bytes) => (atoms::ok(), binary(env, &bytes)).encode(env),
        Err(error) => failed(env, &error),
    }
}

fn packed(compression: Atom) -> Compression {
    if compression == atoms::lz4() {
        Compression::Lz4
    } else if compression == atoms::zstd() {
        Compression::Zstd
    } else {
        Compression::None
    }
}

#[rustler::nif(schedule = "DirtyIo")]
fn mcap_create<'a>(
    env: Env<'a>,
    path: String,
    profile: String,
    compression: Atom,
    chunk: u64,
) -> Term<'a> {
    let options = Options {
        profile: &profile,
        library: None,
        compression: packed(compression),
        chunk: Some(chunk),
    };
    let writer = Writer::create(Path::new(&path), &options);
    answer(
        env,
        writer.map(|w| ResourceArc::new(WriterResource(Mutex::new(w)))),
    )
}

/// `schema` is `{name, encoding, data}` or `nil`.
#[rustler::nif(schedule = "DirtyIo")]
fn mcap_channel<'a>(
    env: Env<'a>,
    handle: ResourceArc<WriterResource>,
    topic: String,
    encoding: String,
    schema: Option<(String, String, Binary<'a>)>,
    metadata: Vec<(String, String)>,
) -> Term<'a> {
    let spec = ChannelSpec {
        topic: &topic,
        encoding: &encoding,
        schema: schema
            .as_ref()
            .map(|(name, encoding, data)| (name.as_str(), encoding.as_str(), data.as_slice())),
        metadata: metadata.into_iter().collect(),
    };
    answer(env, handle.lock().channel(&spec))
}

/// `messages` are `{channel, sequence, log_time, publish_time, data}`.
#[rustler::nif(schedule = "DirtyIo")]
fn mcap_write<'a>(
    env: Env<'a>,
    handle: ResourceArc<WriterResource>,
    messages: Vec<(u16, u32, u64, u64, Binary<'a>)>,
) -> Term<'a> {
    let mut writer = handle.lock();
    for (channel, sequence, log, publish, data) in &messages {
        if let Err(error) = writer.write(*channel, *sequence, *log, *publish, data) {
            return failed(env, &error);
        }
    }
    (atoms::ok(), messages.len()).encode(env)
}

#[rustler::nif(schedule = "DirtyIo")]
fn mcap_attach<'a>(
    env: Env<'a>,
    handle: ResourceArc<WriterResource>,
    name: String,
    media_type: String,
    time: u64,
    data: Binary<'a>,
) -> Term<'a> {
    let result = handle.lock().attach(&name, &media_type, time, &data);
    answer(env, result.map(|()| atoms::nil()))
}

#[rustler::nif(schedule = "DirtyIo")]
fn mcap_metadata<'a>(
    env: Env<'a>,
    handle: ResourceArc<WriterResource>,
    name: String,
    metadata: Vec<(String, String)>,
) -> Term<'a> {
    let result = handle
        .lock()
        .metadata(&name, metadata.into_iter().collect());
    answer(env, result.map(|()| atoms::nil()))
}

#[rustler::nif(schedule = "DirtyIo")]
fn mcap_flush<'a>(env: Env<'a>, handle: ResourceArc<WriterResource>) -> Term<'a> {
    let result = handle.lock().flush();
    answer(env, result.map(|()| atoms::nil()))
}

#[rustler::nif(schedule = "DirtyIo")]
fn mcap_finish<'a>(env: Env<'a>, handle: ResourceArc<WriterResource>) -> Term<'a> {
    let result = handle.lock().finish();
    answer(env, result.map(|()| atoms::nil()))
}

rustler::init!("Elixir.Situ.Bridge.Native");

//! BEAM glue for situ_mcap and situ_csv: decode, call, encode. It contains no algorithms.

mod bytes;
mod copy;
mod layout;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Mutex, MutexGuard};

use rustler::{Atom, Binary, Encoder, Env, NewBinary, NifResult, ResourceArc, Term};
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

fn encode_error<'a>(env: Env<'a>, error: &Error) -> Term<'a> {
    let reason = match error {
        Error::Io(what, errno, why) => (atoms::io(), what, errno, why).encode(env),
        Error::NotMcap => atoms::not_mcap().encode(env),
        Error::Damaged(at, why) => (atoms::damaged(), at, why).encode(env),
        Error::Closed => atoms::closed().encode(env),
    };
    (atoms::error(), reason).encode(env)
}

fn encode_result<'a, T: Encoder>(env: Env<'a>, result: situ_mcap::Result<T>) -> Term<'a> {
    match result {
        Ok(value) => (atoms::ok(), value).encode(env),
        Err(error) => encode_error(env, &error),
    }
}

fn encode_binary<'a>(env: Env<'a>, bytes: &[u8]) -> Term<'a> {
    let mut new = NewBinary::new(env, bytes.len());
    new.as_mut_slice().copy_from_slice(bytes);
    new.into()
}

fn decode_times(atom: Atom) -> Times {
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

// Numbers from Elixir may be outside the range of times that a file can contain.
fn decode_time(time: Term) -> i128 {
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
    encode_result(env, reader.map(|r| ResourceArc::new(ReaderResource(r))))
}

/// Opens a file by scanning all records, because its index is wrong for the reason `why`.
#[rustler::nif(schedule = "DirtyIo")]
fn mcap_open_without_index<'a>(env: Env<'a>, path: String, why: String) -> Term<'a> {
    let reader = Reader::open_without_index(Path::new(&path), &why);
    encode_result(env, reader.map(|r| ResourceArc::new(ReaderResource(r))))
}

/// Returns `{profile, library, channels, schemas, attachments, metadata, {damage, finished?}}`.
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
                metadata_pairs(&c.metadata),
                *count,
            )
                .encode(env)
        })
        .collect();
    let schemas: Vec<Term> = info
        .schemas
        .iter()
        .map(|(id, s)| (*id, &s.name, &s.encoding, encode_binary(env, &s.data)).encode(env))
        .collect();
    let attachments: Vec<Term> = info
        .attachments
        .iter()
        .map(|a| (&a.name, &a.media_type, a.log_time, a.offset, a.size).encode(env))
        .collect();
    let metadata: Vec<Term> = info
        .metadata
        .iter()
        .map(|(name, map)| (name, metadata_pairs(map)).encode(env))
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

fn metadata_pairs(map: &BTreeMap<String, String>) -> Vec<(String, String)> {
    map.iter().map(|(k, v)| (k.clone(), v.clone())).collect()
}

/// Returns `{:ok, {first, last, count}}`, or `{:ok, nil}` for a channel without messages.
#[rustler::nif(schedule = "DirtyIo")]
fn mcap_span<'a>(
    env: Env<'a>,
    handle: ResourceArc<ReaderResource>,
    channel: u16,
    by: Atom,
) -> Term<'a> {
    encode_result(env, handle.0.channel_span(channel, decode_times(by)))
}

#[rustler::nif(schedule = "DirtyIo")]
fn mcap_seek<'a>(
    env: Env<'a>,
    handle: ResourceArc<ReaderResource>,
    channel: u16,
    by: Atom,
    time: Term<'a>,
) -> Term<'a> {
    encode_result(
        env,
        handle.0.seek(channel, decode_times(by), decode_time(time)),
    )
}

type ReadQuery<'a> = ((u16, Atom), u64, Term<'a>, (usize, usize), (bool, bool));

/// Returns `{:ok, {[{time, log_time, publish_time, sequence, data}], next}}`. `what` is `{{channel, times}, from,
/// to, {most, bytes}, {envelopes?, skip_damage?}}`.
#[rustler::nif(schedule = "DirtyIo")]
fn mcap_read<'a>(
    env: Env<'a>,
    handle: ResourceArc<ReaderResource>,
    what: ReadQuery<'a>,
) -> Term<'a> {
    let ((channel, by), from, to, (most, bytes), (envelopes, skip_damage)) = what;
    let query = Query {
        channel,
        times: decode_times(by),
        from,
        to: decode_time(to),
        most,
        bytes,
        envelopes,
        skip_damage,
    };
    match handle.0.read(&query) {
        Ok((messages, next)) => {
            let messages: Vec<Term> = messages.iter().map(|m| encode_message(env, m)).collect();
            (atoms::ok(), (messages, next)).encode(env)
        }
        Err(error) => encode_error(env, &error),
    }
}

fn encode_message<'a>(env: Env<'a>, m: &Message) -> Term<'a> {
    (
        m.time,
        m.log_time,
        m.publish_time,
        m.sequence,
        encode_binary(env, &m.data),
    )
        .encode(env)
}

#[rustler::nif(schedule = "DirtyIo")]
fn mcap_attachment<'a>(env: Env<'a>, handle: ResourceArc<ReaderResource>, offset: u64) -> Term<'a> {
    match handle.0.read_attachment(offset) {
        Ok(bytes) => (atoms::ok(), encode_binary(env, &bytes)).encode(env),
        Err(error) => encode_error(env, &error),
    }
}

fn decode_compression(compression: Atom) -> Compression {
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
        compression: decode_compression(compression),
        chunk: Some(chunk),
    };
    let writer = Writer::create(Path::new(&path), &options);
    encode_result(
        env,
        writer.map(|w| ResourceArc::new(WriterResource(Mutex::new(w)))),
    )
}

/// Adds a channel. `schema` is `{name, encoding, data}` or `nil`.
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
    encode_result(env, handle.lock().add_channel(&spec))
}

/// Writes messages, `{channel, sequence, log_time, publish_time, data}`.
#[rustler::nif(schedule = "DirtyIo")]
fn mcap_write<'a>(
    env: Env<'a>,
    handle: ResourceArc<WriterResource>,
    messages: Vec<(u16, u32, u64, u64, Binary<'a>)>,
) -> Term<'a> {
    let mut writer = handle.lock();
    for (channel, sequence, log, publish, data) in &messages {
        if let Err(error) = writer.write_message(*channel, *sequence, *log, *publish, data) {
            return encode_error(env, &error);
        }
    }
    (atoms::ok(), messages.len()).encode(env)
}

/// Writes an attachment; `times` is `{log_time, create_time}`, or one time for both.
#[rustler::nif(schedule = "DirtyIo")]
fn mcap_attach<'a>(
    env: Env<'a>,
    handle: ResourceArc<WriterResource>,
    name: String,
    media_type: String,
    times: Term<'a>,
    data: Binary<'a>,
) -> NifResult<Term<'a>> {
    let times = match times.decode::<(u64, u64)>() {
        Ok(times) => times,
        Err(_) => times.decode::<u64>().map(|time| (time, time))?,
    };
    let result = handle
        .lock()
        .write_attachment(&name, &media_type, times, &data);
    Ok(encode_result(env, result.map(|()| atoms::nil())))
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
        .write_metadata(&name, metadata.into_iter().collect());
    encode_result(env, result.map(|()| atoms::nil()))
}

#[rustler::nif(schedule = "DirtyIo")]
fn mcap_flush<'a>(env: Env<'a>, handle: ResourceArc<WriterResource>) -> Term<'a> {
    let result = handle.lock().flush();
    encode_result(env, result.map(|()| atoms::nil()))
}

#[rustler::nif(schedule = "DirtyIo")]
fn mcap_finish<'a>(env: Env<'a>, handle: ResourceArc<WriterResource>) -> Term<'a> {
    let result = handle.lock().finish();
    encode_result(env, result.map(|()| atoms::nil()))
}

rustler::init!("Elixir.Situ.Bridge.Native");

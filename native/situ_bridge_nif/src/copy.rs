//! Copies MCAP files.

use std::path::Path;
use std::sync::Mutex;

use rustler::{Atom, Encoder, Env, ResourceArc, Term};
use situ_mcap::{Compression, Copy, Options, Order, Selection, Writer};

use crate::{
    atoms, decode_compression, decode_time, encode_error, encode_result, ReaderResource,
    WriterResource,
};

struct CopyResource {
    copy: Mutex<Copy>,
    reader: ResourceArc<ReaderResource>,
    writer: ResourceArc<WriterResource>,
}

#[rustler::resource_impl]
impl rustler::Resource for CopyResource {}

/// Begins a copy: `{:ok, {copy, writer}}`. `packing` is `{profile | nil, compression | nil, chunk}`, and
/// `selection` is `{channels | nil, {from, to}, :file | :log, replaced, skip_damage?}`.
#[rustler::nif(schedule = "DirtyIo")]
fn mcap_copy_begin<'a>(
    env: Env<'a>,
    reader: ResourceArc<ReaderResource>,
    path: String,
    packing: Packing,
    selection: CopySelection<'a>,
) -> Term<'a> {
    let (channels, (from, to), order, replaced, skip_damage) = selection;
    let selection = Selection {
        channels: channels.map(|ids| ids.into_iter().collect()),
        from: decode_time(from),
        to: decode_time(to),
        order: if order == atoms::file() {
            Order::File
        } else {
            Order::LogTime
        },
        replaced: replaced.into_iter().collect(),
        skip_damage,
    };
    encode_result(env, begin_copy(reader, &path, packing, selection))
}

type CopySelection<'a> = (
    Option<Vec<u16>>,
    (Term<'a>, Term<'a>),
    Atom,
    Vec<String>,
    bool,
);
type Packing = (Option<String>, Atom, u64);
type CopyHandles = (ResourceArc<CopyResource>, ResourceArc<WriterResource>);

fn begin_copy(
    reader: ResourceArc<ReaderResource>,
    path: &str,
    packing: Packing,
    selection: Selection,
) -> situ_mcap::Result<CopyHandles> {
    let (profile, compression, chunk) = packing;
    let (compression, chunk) = choose_style(&reader, compression, chunk);
    let info = reader.0.info();
    let options = Options {
        profile: profile.as_ref().unwrap_or(&info.profile),
        library: Some(&info.library),
        compression,
        chunk,
    };
    let mut writer = Writer::create(Path::new(path), &options)?;
    let copy = Copy::begin(&reader.0, &mut writer, selection)?;
    let writer = ResourceArc::new(WriterResource(Mutex::new(writer)));
    let copy = CopyResource {
        copy: Mutex::new(copy),
        reader,
        writer: writer.clone(),
    };
    Ok((ResourceArc::new(copy), writer))
}

/// Returns the wanted compression and chunk size, or those of the original.
fn choose_style(reader: &ReaderResource, wanted: Atom, chunk: u64) -> (Compression, Option<u64>) {
    let (compression, chunked) = reader.0.chunk_style();
    if wanted == atoms::nil() {
        (compression, chunked.then_some(chunk))
    } else {
        (decode_compression(wanted), Some(chunk))
    }
}

/// Copies the next part: `{:ok, {done?, messages, left_out}}`.
#[rustler::nif(schedule = "DirtyIo")]
fn mcap_copy_step<'a>(env: Env<'a>, handle: ResourceArc<CopyResource>) -> Term<'a> {
    let mut copy = handle
        .copy
        .lock()
        .unwrap_or_else(|poisoned| poisoned.into_inner());
    match copy.step(&handle.reader.0, &mut handle.writer.lock()) {
        Ok(done) => {
            let report = copy.report();
            let left_out = if done { &report.left_out[..] } else { &[] };
            (atoms::ok(), (done, report.messages, left_out)).encode(env)
        }
        Err(error) => encode_error(env, &error),
    }
}

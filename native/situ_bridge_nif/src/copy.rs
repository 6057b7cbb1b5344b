//! Copies of MCAP files.

use std::path::Path;
use std::sync::Mutex;

use rustler::{Atom, Encoder, Env, ResourceArc, Term};
use situ_mcap::{Compression, Copy, Options, Order, Selection, Writer};

use crate::{answer, atoms, clamped, failed, packed, ReaderResource, WriterResource};

struct CopyResource {
    copy: Mutex<Copy>,
    reader: ResourceArc<ReaderResource>,
    writer: ResourceArc<WriterResource>,
}

#[rustler::resource_impl]
impl rustler::Resource for CopyResource {}

/// `{:ok, {copy, writer}}`. `packing` is `{profile | nil, compression | nil, chunk}`,
/// `selection` `{channels | nil, {from, to}, :file | :log, replaced, skip_damage?}`.
#[rustler::nif(schedule = "DirtyIo")]
fn mcap_copy_begin<'a>(
    env: Env<'a>,
    reader: ResourceArc<ReaderResource>,
    path: String,
    packing: Packing,
    selection: Wanted<'a>,
) -> Term<'a> {
    let (channels, (from, to), order, replaced, skip_damage) = selection;
    let selection = Selection {
        channels: channels.map(|ids| ids.into_iter().collect()),
        from: clamped(from),
        to: clamped(to),
        order: if order == atoms::file() {
            Order::File
        } else {
            Order::LogTime
        },
        replaced: replaced.into_iter().collect(),
        skip_damage,
    };
    answer(env, begin(reader, &path, packing, selection))
}

type Wanted<'a> = (
    Option<Vec<u16>>,
    (Term<'a>, Term<'a>),
    Atom,
    Vec<String>,
    bool,
);
type Packing = (Option<String>, Atom, u64);
type Begun = (ResourceArc<CopyResource>, ResourceArc<WriterResource>);

fn begin(
    reader: ResourceArc<ReaderResource>,
    path: &str,
    packing: Packing,
    selection: Selection,
) -> situ_mcap::Result<Begun> {
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

/// The compression and the chunks of the original, where no others are wanted.
fn choose_style(reader: &ReaderResource, wanted: Atom, chunk: u64) -> (Compression, Option<u64>) {
    let (compression, chunked) = reader.0.style();
    if wanted == atoms::nil() {
        (compression, chunked.then_some(chunk))
    } else {
        (packed(wanted), Some(chunk))
    }
}

/// `{:ok, {done?, messages, left_out}}`
#[rustler::nif(schedule = "DirtyIo")]
fn mcap_copy_step<'a>(env: Env<'a>, handle: ResourceArc<CopyResource>) -> Term<'a> {
    let mut copy = handle
        .copy
        .lock()
        .unwrap_or_else(|poisoned| poisoned.into_inner());
    match copy.step(&handle.reader.0, &mut handle.writer.lock()) {
        Ok(done) => {
            let copied = copy.copied();
            let left_out = if done { &copied.left_out[..] } else { &[] };
            (atoms::ok(), (done, copied.messages, left_out)).encode(env)
        }
        Err(error) => failed(env, &error),
    }
}

//! Memory that another process maps too. Values that it has written become binaries without a copy.

use std::sync::Arc;

use rustler::{Binary, Encoder, Env, ResourceArc, Term};
use situ_store::shared::{SharedReader, SharedWriter};

use crate::atoms;
use crate::errors::encode_error;
use crate::paths::FilePath;
use crate::terms::encode_binary;

pub struct WriterResource(SharedWriter);

#[rustler::resource_impl]
impl rustler::Resource for WriterResource {}

pub struct ReaderResource(Arc<SharedReader>);

#[rustler::resource_impl]
impl rustler::Resource for ReaderResource {}

/// A slot that a binary refers to. The VM drops it with the last reference.
pub struct SlotResource {
    memory: Arc<SharedReader>,
    slot: u32,
    at: u64,
    length: u64,
}

#[rustler::resource_impl]
impl rustler::Resource for SlotResource {}

impl Drop for SlotResource {
    fn drop(&mut self) {
        self.memory.release(self.slot, self.length);
    }
}

type Writer = ResourceArc<WriterResource>;
type Reader = ResourceArc<ReaderResource>;

/// Creates a file that this VM writes, for at most `limit` bytes: `{:ok, memory}`.
#[rustler::nif(schedule = "DirtyIo")]
fn shared_writer<'a>(env: Env<'a>, path: FilePath, limit: u64) -> Term<'a> {
    match SharedWriter::create(&path.0, limit) {
        Ok(memory) => (atoms::ok(), ResourceArc::new(WriterResource(memory))).encode(env),
        Err(error) => encode_error(env, &error),
    }
}

/// Creates a file that another process writes, for at most `limit` bytes: `{:ok, memory}`.
#[rustler::nif(schedule = "DirtyIo")]
fn shared_reader<'a>(env: Env<'a>, path: FilePath, limit: u64) -> Term<'a> {
    match SharedReader::create(&path.0, limit) {
        Ok(memory) => (
            atoms::ok(),
            ResourceArc::new(ReaderResource(Arc::new(memory))),
        )
            .encode(env),
        Err(error) => encode_error(env, &error),
    }
}

/// Allocates memory for the first `size` bytes.
#[rustler::nif(schedule = "DirtyIo")]
fn shared_reserve<'a>(env: Env<'a>, memory: Writer, size: u64) -> Term<'a> {
    encode_result(env, memory.0.reserve(size))
}

/// Copies binaries, one after another, to an offset.
#[rustler::nif(schedule = "DirtyCpu")]
fn shared_write<'a>(env: Env<'a>, memory: Writer, at: u64, parts: Vec<Binary<'a>>) -> Term<'a> {
    write_parts(env, &memory, at, &parts)
}

/// Copies like `shared_write`, on a normal scheduler. The caller limits the size.
#[rustler::nif]
fn shared_write_quick<'a>(
    env: Env<'a>,
    memory: Writer,
    at: u64,
    parts: Vec<Binary<'a>>,
) -> Term<'a> {
    rustler::schedule::consume_timeslice(env, 10);
    write_parts(env, &memory, at, &parts)
}

fn write_parts<'a>(env: Env<'a>, memory: &Writer, at: u64, parts: &[Binary<'a>]) -> Term<'a> {
    let parts: Vec<&[u8]> = parts.iter().map(|part| part.as_slice()).collect();
    encode_result(env, memory.0.write(at, &parts))
}

fn encode_result(env: Env<'_>, result: situ_store::Result<()>) -> Term<'_> {
    match result {
        Ok(()) => atoms::ok().encode(env),
        Err(error) => encode_error(env, &error),
    }
}

/// Returns the value in a slot, without a copy: `{:ok, binary}`, or `:slow` if too much memory is in use by such
/// binaries. The slot is released with the binary.
#[rustler::nif]
fn shared_read<'a>(env: Env<'a>, memory: Reader, slot: u32, at: u64, length: u64) -> Term<'a> {
    if let Err(error) = memory.0.read(at, length) {
        return encode_error(env, &error);
    }
    if !memory.0.hold(length) {
        return atoms::slow().encode(env);
    }
    let held = ResourceArc::new(SlotResource {
        memory: memory.0.clone(),
        slot,
        at,
        length,
    });
    let binary = held.make_binary(env, |held| held.memory.bytes(held.at, held.length));
    (atoms::ok(), binary).encode(env)
}

/// Returns a copy of the value in a slot: `{:ok, binary}`.
#[rustler::nif(schedule = "DirtyCpu")]
fn shared_copy<'a>(env: Env<'a>, memory: Reader, at: u64, length: u64) -> Term<'a> {
    match memory.0.read(at, length) {
        Ok(bytes) => (atoms::ok(), encode_binary(env, bytes)).encode(env),
        Err(error) => encode_error(env, &error),
    }
}

/// Returns the slots that were released since the last call.
#[rustler::nif]
fn shared_released(memory: Reader) -> Vec<u32> {
    memory.0.take_released()
}

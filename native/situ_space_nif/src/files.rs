//! Bindings of the functions that read point cloud files.

use rustler::NifTaggedEnum;
use rustler::{Binary, Encoder, Env, Term};
use situ_space::las::{self, Records};
use situ_space::records::{self, Field, Kind};

use crate::{copy_to_binary, encode_binary_reply, encode_reply, to_f64_array, Vector};

#[rustler::nif(schedule = "DirtyCpu")]
fn las_unpack<'a>(
    env: Env<'a>,
    file: Binary<'a>,
    (at, size, count): (u64, u32, u64),
    packing: Binary<'a>,
) -> Term<'a> {
    let records = Records {
        at: at as usize,
        size: size as usize,
        count: count as usize,
    };
    let unpacked = las::unpack_records(file.as_slice(), records, packing.as_slice());
    encode_binary_reply(env, unpacked)
}

/// Converts records to points. `colors` is the offset of the colors in a record, or -1.
#[rustler::nif(schedule = "DirtyCpu")]
fn las_points<'a>(
    env: Env<'a>,
    records: Binary<'a>,
    size: u32,
    colors: i64,
    scale: Vector,
    offset: Vector,
) -> Term<'a> {
    let colors = usize::try_from(colors).ok();
    let found = las::read_cloud(
        records.as_slice(),
        size as usize,
        colors,
        to_f64_array(scale),
        to_f64_array(offset),
    );
    encode_reply(
        env,
        found.and_then(|(p, c, s)| {
            Ok((
                copy_to_binary(env, &p)?,
                copy_to_binary(env, &c)?,
                copy_to_binary(env, &s)?,
            )
                .encode(env))
        }),
    )
}

/// The type of a number: `{:float, bytes}`, `{:int, bytes}` or `{:uint, bytes}`.
#[derive(NifTaggedEnum)]
enum KindTerm {
    Float(u32),
    Int(u32),
    Uint(u32),
}

fn record_fields(given: Vec<(u32, KindTerm)>) -> Vec<Field> {
    given
        .into_iter()
        .map(|(at, kind)| {
            let kind = match kind {
                KindTerm::Float(n) => Kind::Float(n as usize),
                KindTerm::Int(n) => Kind::Signed(n as usize),
                KindTerm::Uint(n) => Kind::Unsigned(n as usize),
            };
            (at as usize, kind)
        })
        .collect()
}

#[rustler::nif(schedule = "DirtyCpu")]
fn record_floats<'a>(
    env: Env<'a>,
    records: Binary<'a>,
    row: u32,
    given: Vec<(u32, KindTerm)>,
    big: bool,
) -> Term<'a> {
    let found = records::read_floats(records.as_slice(), row as usize, &record_fields(given), big);
    encode_binary_reply(env, found)
}

#[rustler::nif(schedule = "DirtyCpu")]
fn record_tones<'a>(
    env: Env<'a>,
    records: Binary<'a>,
    row: u32,
    given: Vec<(u32, KindTerm)>,
    big: bool,
) -> Term<'a> {
    let found = records::read_colors(records.as_slice(), row as usize, &record_fields(given), big);
    encode_binary_reply(env, found)
}

//! Glue of the points of files.

use rustler::NifTaggedEnum;
use rustler::{Binary, Encoder, Env, Term};
use situ_space::las::{self, Records};
use situ_space::records::{self, Field, Kind};

use crate::{binary, reply, row, Row};

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
    let unpacked = las::unpack(file.as_slice(), records, packing.as_slice());
    reply(env, unpacked.and_then(|r| Ok(binary(env, &r)?.encode(env))))
}

/// `colors` is the byte of a record at which they begin, or -1.
#[rustler::nif(schedule = "DirtyCpu")]
fn las_points<'a>(
    env: Env<'a>,
    records: Binary<'a>,
    size: u32,
    colors: i64,
    scale: Row,
    offset: Row,
) -> Term<'a> {
    let colors = usize::try_from(colors).ok();
    let found = las::cloud(
        records.as_slice(),
        size as usize,
        colors,
        row(scale),
        row(offset),
    );
    reply(
        env,
        found.and_then(|(p, c, s)| {
            Ok((binary(env, &p)?, binary(env, &c)?, binary(env, &s)?).encode(env))
        }),
    )
}

/// `{:float, bytes}`, `{:int, bytes}` or `{:uint, bytes}`.
#[derive(NifTaggedEnum)]
enum KindTerm {
    Float(u32),
    Int(u32),
    Uint(u32),
}

fn fields(given: Vec<(u32, KindTerm)>) -> Vec<Field> {
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
    let found = records::floats(records.as_slice(), row as usize, &fields(given), big);
    reply(env, found.and_then(|f| Ok(binary(env, &f)?.encode(env))))
}

#[rustler::nif(schedule = "DirtyCpu")]
fn record_tones<'a>(
    env: Env<'a>,
    records: Binary<'a>,
    row: u32,
    given: Vec<(u32, KindTerm)>,
    big: bool,
) -> Term<'a> {
    let found = records::tones(records.as_slice(), row as usize, &fields(given), big);
    reply(env, found.and_then(|t| Ok(binary(env, &t)?.encode(env))))
}

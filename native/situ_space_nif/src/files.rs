//! Glue of the points of files.

use rustler::{Binary, Encoder, Env, Term};
use situ_space::las::{self, Records};

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

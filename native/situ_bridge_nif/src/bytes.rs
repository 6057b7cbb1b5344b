//! Bytes compressed and unpacked, and lines of CSV.

use rustler::{Atom, Binary, Encoder, Env, Term};
use situ_csv::Values;

use crate::{atoms, binary};

/// `{:ok, bytes}` or `{:error, why}`: at most `size` bytes.
#[rustler::nif(schedule = "DirtyCpu")]
fn unpack<'a>(env: Env<'a>, compression: String, bytes: Binary<'a>, size: u64) -> Term<'a> {
    match situ_mcap::unpack(&compression, &bytes, size) {
        Ok(bytes) => (atoms::ok(), binary(env, &bytes)).encode(env),
        Err(why) => (atoms::error(), why).encode(env),
    }
}

#[rustler::nif(schedule = "DirtyCpu")]
fn pack_lz4<'a>(env: Env<'a>, bytes: Binary<'a>) -> Term<'a> {
    match situ_mcap::pack_lz4(&bytes) {
        Ok(bytes) => (atoms::ok(), binary(env, &bytes)).encode(env),
        Err(why) => (atoms::error(), why.to_string()).encode(env),
    }
}

/// Lines of CSV for columns of `Situ.Store.columns/3`; an empty text for another kind.
#[rustler::nif(schedule = "DirtyCpu")]
fn csv_lines<'a>(env: Env<'a>, kind: Atom, times: Binary<'a>, values: Binary<'a>) -> Term<'a> {
    let values = if kind == atoms::integer() {
        Values::Integers(&values)
    } else if kind == atoms::float() {
        Values::Floats(&values)
    } else if kind == atoms::boolean() {
        Values::Booleans(&values)
    } else {
        Values::Booleans(&[])
    };
    binary(env, &situ_csv::lines(&times, values))
}

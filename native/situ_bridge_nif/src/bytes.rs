//! Compresses and unpacks bytes, and formats lines of CSV.

use rustler::{Atom, Binary, Encoder, Env, Term};
use situ_csv::Values;

use crate::{atoms, encode_binary};

/// Unpacks at most `size` bytes: `{:ok, bytes}` or `{:error, why}`.
#[rustler::nif(schedule = "DirtyCpu")]
fn unpack<'a>(env: Env<'a>, compression: String, bytes: Binary<'a>, size: u64) -> Term<'a> {
    match situ_mcap::unpack(&compression, &bytes, size) {
        Ok(bytes) => (atoms::ok(), encode_binary(env, &bytes)).encode(env),
        Err(why) => (atoms::error(), why).encode(env),
    }
}

#[rustler::nif(schedule = "DirtyCpu")]
fn pack_lz4<'a>(env: Env<'a>, bytes: Binary<'a>) -> Term<'a> {
    match situ_mcap::pack_lz4(&bytes) {
        Ok(bytes) => (atoms::ok(), encode_binary(env, &bytes)).encode(env),
        Err(why) => (atoms::error(), why.to_string()).encode(env),
    }
}

/// Formats columns of `Situ.Store.columns/3` as lines of CSV. Returns an empty binary for other kinds.
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
    encode_binary(env, &situ_csv::format_lines(&times, values))
}

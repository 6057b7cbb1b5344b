//! Names of files as bytes, and renaming in one step.

use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::path::PathBuf;

use rustler::{Binary, Decoder, Encoder, Env, NifResult, Term};
use situ_store::names::{self, Outcome};

use crate::{atoms, errors};

/// A path in a binary, as the file functions of Erlang take it. It need not be UTF-8.
pub struct FilePath(pub PathBuf);

impl<'a> Decoder<'a> for FilePath {
    fn decode(term: Term<'a>) -> NifResult<Self> {
        let bytes: Binary<'a> = term.decode()?;
        Ok(FilePath(PathBuf::from(OsStr::from_bytes(bytes.as_slice()))))
    }
}

fn outcome(env: Env<'_>, result: situ_store::Result<Outcome>) -> Term<'_> {
    match result {
        Ok(Outcome::Done) => atoms::ok().encode(env),
        Ok(Outcome::Exists) => atoms::exists().encode(env),
        Ok(Outcome::Unsupported) => atoms::unsupported().encode(env),
        Err(error) => errors::term(env, &error),
    }
}

/// `:ok`, `:exists`, or `:unsupported`.
#[rustler::nif(schedule = "DirtyIo")]
fn rename_new(env: Env<'_>, from: FilePath, to: FilePath) -> Term<'_> {
    outcome(env, names::rename_new(&from.0, &to.0))
}

/// `:ok` or `:unsupported`.
#[rustler::nif(schedule = "DirtyIo")]
fn rename_exchange(env: Env<'_>, one: FilePath, other: FilePath) -> Term<'_> {
    outcome(env, names::exchange(&one.0, &other.0))
}

//! File paths as bytes, and atomic renames.

use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::path::PathBuf;

use rustler::{Binary, Decoder, Encoder, Env, NifResult, Term};
use situ_store::rename::{self, Outcome};

use crate::{atoms, errors};

/// A path in a binary, as Erlang's file functions accept it. It need not be UTF-8.
pub struct FilePath(pub PathBuf);

impl<'a> Decoder<'a> for FilePath {
    fn decode(term: Term<'a>) -> NifResult<Self> {
        let bytes: Binary<'a> = term.decode()?;
        Ok(FilePath(PathBuf::from(OsStr::from_bytes(bytes.as_slice()))))
    }
}

fn encode_outcome(env: Env<'_>, result: situ_store::Result<Outcome>) -> Term<'_> {
    match result {
        Ok(Outcome::Done) => atoms::ok().encode(env),
        Ok(Outcome::Exists) => atoms::exists().encode(env),
        Ok(Outcome::Unsupported) => atoms::unsupported().encode(env),
        Err(error) => errors::encode_error(env, &error),
    }
}

/// Renames `from` to a name that does not exist yet: `:ok`, `:exists`, or `:unsupported`.
#[rustler::nif(schedule = "DirtyIo")]
fn rename_new(env: Env<'_>, from: FilePath, to: FilePath) -> Term<'_> {
    encode_outcome(env, rename::rename_new(&from.0, &to.0))
}

/// Exchanges two names: `:ok` or `:unsupported`.
#[rustler::nif(schedule = "DirtyIo")]
fn rename_exchange(env: Env<'_>, one: FilePath, other: FilePath) -> Term<'_> {
    encode_outcome(env, rename::exchange_names(&one.0, &other.0))
}

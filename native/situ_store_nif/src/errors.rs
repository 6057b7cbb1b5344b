//! Encodes the crate's errors as tagged tuples. `Situ.Store.NativeErrors` turns them into sentences.

use rustler::{Encoder, Env, Term};
use situ_store::Error;

use crate::atoms;

pub fn encode_error<'a>(env: Env<'a>, error: &Error) -> Term<'a> {
    let reason = match error {
        Error::Io(what, errno, why) => (atoms::io(), what, errno, why).encode(env),
        Error::Locked => atoms::locked().encode(env),
        Error::NoStore => atoms::no_store().encode(env),
        Error::NotAStore => atoms::not_a_store().encode(env),
        Error::Newer(version) => (atoms::newer_version(), version).encode(env),
        Error::NotIncreasing(stream, last, got) => {
            (atoms::not_increasing(), stream, last, got).encode(env)
        }
        Error::TooLarge(size) => (atoms::too_large(), size).encode(env),
        Error::NotStorable(what) => (atoms::not_storable(), *what).encode(env),
        Error::UnknownStream(stream) => (atoms::unknown_stream(), stream).encode(env),
        Error::Deleted => atoms::deleted().encode(env),
        Error::Closed => atoms::closed().encode(env),
        Error::Damaged(file, offset, why) => (atoms::damaged(), file, offset, why).encode(env),
        Error::MissingExtent(file) => (atoms::missing_extent(), file).encode(env),
        Error::Absent => atoms::absent().encode(env),
        Error::Crash => atoms::crash().encode(env),
    };
    (atoms::error(), reason).encode(env)
}

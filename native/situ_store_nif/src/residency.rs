//! Returns the bytes that a mirror lacks for an operation, instead of its result.

use rustler::{Encoder, Env, Term};
use situ_store::reader::take_absent;
use situ_store::Reader;

use crate::atoms;

/// Runs an operation on a reader. If the store is a mirror that lacks bytes, returns `{:absent, [{lane, extent, offset,
/// length}]}`. The caller fetches them and repeats the operation.
pub fn with_bytes<'a>(env: Env<'a>, reader: &Reader, run: impl FnOnce() -> Term<'a>) -> Term<'a> {
    if !reader.is_mirror() {
        return run();
    }
    take_absent();
    let result = run();
    let absent = take_absent();
    if absent.is_empty() {
        return result;
    }
    let ranges: Vec<_> = absent
        .iter()
        .map(|range| (range.lane, range.extent, range.offset, range.length))
        .collect();
    (atoms::absent(), ranges).encode(env)
}

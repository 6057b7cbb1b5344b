//! Finds, lists and repairs damage of a store.

use rustler::{Encoder, Env, LocalPid, Term};
use situ_store::reader::Damage;
use situ_store::repair;

use crate::atoms;
use crate::errors::encode_error;
use crate::paths::FilePath;
use crate::reading::Handle;
use crate::residency::with_bytes;

fn encode_damage(found: Vec<Damage>) -> Vec<(String, u64, String)> {
    found
        .into_iter()
        .map(|d| (d.file, d.offset, d.why))
        .collect()
}

/// Returns the extents that the index refers to: `[{lane, number}]`.
#[rustler::nif(schedule = "DirtyIo")]
fn reader_extents(handle: Handle) -> Vec<(u8, u32)> {
    let entries = handle.0.all_entries();
    let mut extents: Vec<_> = entries.iter().map(|e| (e.lane, e.extent)).collect();
    extents.sort_unstable();
    extents.dedup();
    extents
}

#[rustler::nif]
fn reader_damage(handle: Handle) -> Vec<(String, u64, String)> {
    encode_damage(handle.0.damage())
}

/// Checks the index entries `from..from + n` and their chunks: `{:ok, [{file, offset, why}], entries}`.
#[rustler::nif(schedule = "DirtyIo")]
fn reader_verify<'a>(env: Env<'a>, handle: Handle, from: u64, n: u64) -> Term<'a> {
    with_bytes(env, handle.store(), || {
        match handle.0.verify_entries(from, n) {
            Ok((found, total)) => (atoms::ok(), encode_damage(found), total).encode(env),
            Err(error) => encode_error(env, &error),
        }
    })
}

/// Repairs a store: `{:ok, {kept, dropped, recovered, unconfirmed, rebuilt?, damage}}`. With `dry` it only reports.
/// Sends its progress as `{:situ_store, tag, {done, total}}` to `pid`.
#[rustler::nif(schedule = "DirtyIo")]
fn store_repair<'a>(
    env: Env<'a>,
    path: FilePath,
    dry: bool,
    pid: LocalPid,
    tag: Term<'a>,
) -> Term<'a> {
    // If the caller has ended, the repair continues without progress reports.
    let report_progress = |done: u64, total: u64| {
        let _ = env.send(&pid, (atoms::situ_store(), tag, (done, total)));
    };
    match repair::repair_store(&path.0, dry, report_progress) {
        Ok(report) => (
            atoms::ok(),
            (
                report.kept,
                report.dropped,
                report.recovered,
                report.unconfirmed,
                report.rebuilt,
                encode_damage(report.damage),
            ),
        )
            .encode(env),
        Err(error) => encode_error(env, &error),
    }
}

//! Damage of a store: finding, listing and repairing it.

use rustler::{Encoder, Env, LocalPid, Term};
use situ_store::reader::Damage;
use situ_store::repair;

use crate::atoms;
use crate::paths::FilePath;
use crate::reading::{failed, Handle};

fn damage(found: Vec<Damage>) -> Vec<(String, u64, String)> {
    found
        .into_iter()
        .map(|d| (d.file, d.offset, d.why))
        .collect()
}

/// The extents that the index names: `[{lane, number}]`.
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
    damage(handle.0.damage())
}

/// Checks index entries `from..from + n` wholly: `{:ok, [{file, offset, why}], entries}`.
#[rustler::nif(schedule = "DirtyIo")]
fn reader_verify<'a>(env: Env<'a>, handle: Handle, from: u64, n: u64) -> Term<'a> {
    match handle.0.verify(from, n) {
        Ok((found, total)) => (atoms::ok(), damage(found), total).encode(env),
        Err(error) => failed(env, &error),
    }
}

/// `{:ok, {kept, dropped, recovered, unconfirmed, rebuilt?, damage}}`, with `dry` of what would be done; meanwhile
/// `{:situ_store, tag, {done, total}}` to `pid`.
#[rustler::nif(schedule = "DirtyIo")]
fn store_repair<'a>(
    env: Env<'a>,
    path: FilePath,
    dry: bool,
    pid: LocalPid,
    tag: Term<'a>,
) -> Term<'a> {
    // If the caller is gone, the repair goes on without reports of progress.
    let tell = |done: u64, total: u64| {
        let _ = env.send(&pid, (atoms::situ_store(), tag, (done, total)));
    };
    match repair::repair(&path.0, dry, tell) {
        Ok(report) => (
            atoms::ok(),
            (
                report.kept,
                report.dropped,
                report.recovered,
                report.unconfirmed,
                report.rebuilt,
                damage(report.damage),
            ),
        )
            .encode(env),
        Err(error) => failed(env, &error),
    }
}

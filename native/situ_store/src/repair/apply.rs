//! Applies the plan of a repair.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use rustix::fs::{fdatasync, fsync, ftruncate};

use super::Plan;
use crate::error::{Error, Result};
use crate::extent::{self, write_all};
use crate::format::*;
use crate::index;
use crate::reader::file_length;

pub(super) fn apply_plan(dir: &Path, plan: &Plan) -> Result<()> {
    for (lane, number) in &plan.damaged_headers {
        rewrite_extent_header(dir, &plan.header.id, *lane, *number)?;
    }
    if plan.report.rebuilt {
        replace_index(dir, plan)
    } else if plan.closed {
        Ok(())
    } else {
        close_index(dir, &plan.entries)
    }
}

/// Closes a sound store whose writer died: truncates everything that was not committed and marks the store closed.
fn close_index(dir: &Path, entries: &[Entry]) -> Result<()> {
    trim_extents(dir, entries)?;
    let failed = |e| Error::io("write index.situ", e);
    let file = OpenOptions::new()
        .read(true)
        .write(true)
        .open(dir.join(index::FILE))
        .map_err(|e| Error::io("open index.situ", e))?;
    let n = entries.len() as u64;
    let end = (INDEX_HEADER as u64 + n * ENTRY as u64).next_multiple_of(4096);
    if file_length(&file, index::FILE)? > end {
        ftruncate(&file, end).map_err(|e| Error::io("trim index.situ", e))?;
    }
    write_all(&file, &n.to_le_bytes(), SYNCED_AT as u64).map_err(failed)?;
    write_all(&file, &[1], STATE_AT as u64).map_err(failed)?;
    fdatasync(&file).map_err(|e| Error::io("sync index.situ", e))
}

/// Truncates each extent after its last chunk.
fn trim_extents(dir: &Path, entries: &[Entry]) -> Result<()> {
    let mut ends: BTreeMap<(u8, u32), u64> = BTreeMap::new();
    for entry in entries.iter().filter(|entry| !entry.is_placeholder()) {
        let end = ends.entry((entry.lane, entry.extent)).or_default();
        *end = (*end).max(entry.offset + entry.length as u64);
    }
    for ((lane, number), end) in ends {
        let name = extent::file_name(lane, number);
        let file = OpenOptions::new()
            .write(true)
            .open(dir.join(&name))
            .map_err(|e| Error::io(format!("open {name}"), e))?;
        let end = end.next_multiple_of(4096);
        if file_length(&file, &name)? > end {
            ftruncate(&file, end).map_err(|e| Error::io(format!("trim {name}"), e))?;
        }
        fdatasync(&file).map_err(|e| Error::io(format!("sync {name}"), e))?;
    }
    Ok(())
}

/// Rewrites the header of an extent and keeps a copy of the damaged one.
fn rewrite_extent_header(dir: &Path, id: &[u8; 16], lane: u8, number: u32) -> Result<()> {
    let name = extent::file_name(lane, number);
    let failed = |e: std::io::Error| Error::io(format!("write the header of {name}"), e);
    let path = dir.join(&name);
    let file = OpenOptions::new()
        .read(true)
        .write(true)
        .open(&path)
        .map_err(failed)?;
    let mut old = [0; EXTENT_HEADER];
    std::os::unix::fs::FileExt::read_exact_at(&file, &mut old, 0).map_err(failed)?;
    let backup = unused_path(&dir.join(format!("{name}.before-repair")));
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    let mode = file.metadata().map_err(failed)?.mode() & 0o777;
    let backup = extent::open_with(&mut options, &backup, Some(mode)).map_err(failed)?;
    write_all(&backup, &old, 0).map_err(|e| failed(e.into()))?;
    backup.sync_all().map_err(failed)?;
    write_all(&file, &encode_extent_header(id, lane, number), 0).map_err(|e| failed(e.into()))?;
    fdatasync(&file).map_err(|e| failed(e.into()))
}

/// Replaces the old index with a new one in a single step.
fn replace_index(dir: &Path, plan: &Plan) -> Result<()> {
    let failed = |e: std::io::Error| Error::io("write the new index", e);
    let fresh = dir.join("index.situ.new");
    let old = dir.join(index::FILE);
    let mode = std::fs::metadata(&old).ok().map(|m| m.mode() & 0o777);
    let mut options = OpenOptions::new();
    options.write(true).create(true).truncate(true);
    let file = extent::open_with(&mut options, &fresh, mode).map_err(failed)?;
    let n = (plan.entries.len() as u64).to_le_bytes();
    let mut bytes = plan.header.encode().to_vec();
    bytes[COMMITTED_AT..COMMITTED_AT + 8].copy_from_slice(&n);
    bytes[SYNCED_AT..SYNCED_AT + 8].copy_from_slice(&n);
    bytes[STATE_AT] = 1;
    for entry in &plan.entries {
        bytes.extend_from_slice(&entry.encode());
    }
    bytes.resize(bytes.len().next_multiple_of(4096), 0);
    write_all(&file, &bytes, 0).map_err(|e| failed(e.into()))?;
    fdatasync(&file).map_err(|e| failed(e.into()))?;
    if old.exists() {
        let backup = unused_path(&dir.join("index.situ.before-repair"));
        std::fs::copy(&old, &backup).map_err(failed)?;
        // The backup must be on disk before the rename makes it the only copy.
        File::open(&backup)
            .and_then(|backup| backup.sync_all())
            .map_err(failed)?;
    }
    std::fs::rename(&fresh, &old).map_err(failed)?;
    let folder = File::open(dir).map_err(failed)?;
    fsync(&folder).map_err(|e| failed(e.into()))
}

/// Returns `path`, or `path` with the first number that makes it unused, so that no backup overwrites another.
fn unused_path(path: &Path) -> PathBuf {
    let numbered = (2..).map(|n| {
        let mut name = path.as_os_str().to_owned();
        name.push(format!("-{n}"));
        PathBuf::from(name)
    });
    std::iter::once(path.to_path_buf())
        .chain(numbered)
        .find(|path| !path.exists())
        .unwrap_or_else(|| path.to_path_buf())
}

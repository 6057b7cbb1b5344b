//! Writing down what a repair decided.

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

pub(super) fn apply(dir: &Path, plan: &Plan) -> Result<()> {
    for (lane, number) in &plan.heads {
        entitle(dir, &plan.header.id, *lane, *number)?;
    }
    if plan.report.rebuilt {
        rewrite(dir, plan)
    } else if plan.closed {
        Ok(())
    } else {
        finish(dir, &plan.entries)
    }
}

/// A sound store whose writer died: cuts what was never committed, and marks it closed.
fn finish(dir: &Path, entries: &[Entry]) -> Result<()> {
    trim(dir, entries)?;
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

/// Cuts each extent behind its last chunk.
fn trim(dir: &Path, entries: &[Entry]) -> Result<()> {
    let mut ends: BTreeMap<(u8, u32), u64> = BTreeMap::new();
    for entry in entries.iter().filter(|entry| !entry.is_hole()) {
        let end = ends.entry((entry.lane, entry.extent)).or_default();
        *end = (*end).max(entry.offset + entry.length as u64);
    }
    for ((lane, number), end) in ends {
        let name = extent::name(lane, number);
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

/// Gives an extent its header back; the damaged one is kept beside it.
fn entitle(dir: &Path, id: &[u8; 16], lane: u8, number: u32) -> Result<()> {
    let name = extent::name(lane, number);
    let failed = |e: std::io::Error| Error::io(format!("write the header of {name}"), e);
    let path = dir.join(&name);
    let file = OpenOptions::new()
        .read(true)
        .write(true)
        .open(&path)
        .map_err(failed)?;
    let mut old = [0; EXTENT_HEADER];
    std::os::unix::fs::FileExt::read_exact_at(&file, &mut old, 0).map_err(failed)?;
    let kept = unused(&dir.join(format!("{name}.before-repair")));
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    let mode = file.metadata().map_err(failed)?.mode() & 0o777;
    let kept = extent::open_with(&mut options, &kept, Some(mode)).map_err(failed)?;
    write_all(&kept, &old, 0).map_err(|e| failed(e.into()))?;
    kept.sync_all().map_err(failed)?;
    write_all(&file, &extent_header(id, lane, number), 0).map_err(|e| failed(e.into()))?;
    fdatasync(&file).map_err(|e| failed(e.into()))
}

/// Puts a new index in the old one's place, in one step.
fn rewrite(dir: &Path, plan: &Plan) -> Result<()> {
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
        let kept = unused(&dir.join("index.situ.before-repair"));
        std::fs::copy(&old, &kept).map_err(failed)?;
        // On the disk before it is the only one.
        File::open(&kept)
            .and_then(|kept| kept.sync_all())
            .map_err(failed)?;
    }
    std::fs::rename(&fresh, &old).map_err(failed)?;
    let folder = File::open(dir).map_err(failed)?;
    fsync(&folder).map_err(|e| failed(e.into()))
}

/// The path, or that with the first number behind it that is free: no backup takes another's place.
fn unused(path: &Path) -> PathBuf {
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

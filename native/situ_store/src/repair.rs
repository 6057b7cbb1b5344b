//! Mending a store whose index or data are damaged, and closing one whose writer died.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{File, OpenOptions};
use std::path::Path;

use rustix::fs::{fdatasync, ftruncate};

use crate::chunk;
use crate::error::{Error, Result};
use crate::extent::{self, write_all};
use crate::format::*;
use crate::index;
use crate::reader::{file_length, map_file, Damage, Reader};
use crate::writer;

/// Chunks that are checked between two words on how far it is.
const STEP: u64 = 128;

#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    pub kept: u64,
    pub dropped: u64,
    pub rebuilt: bool,
    pub damage: Vec<Damage>,
}

/// Makes the store in `dir` whole: drops what is damaged from the index (data is never rewritten), cuts unused bytes,
/// marks it closed. The old index is kept as `index.situ.before-repair` when anything was dropped.
pub fn repair(dir: &Path, mut progress: impl FnMut(u64, u64)) -> Result<Report> {
    let _lock = writer::lock(dir)?;
    match Reader::open(dir) {
        Ok(reader) => from_index(dir, &reader, &mut progress),
        Err(Error::Damaged(..)) | Err(Error::NotAStore) => from_scan(dir, &mut progress),
        Err(Error::NoStore) if extent_files(dir)?.is_empty() => Err(Error::NoStore),
        Err(Error::NoStore) => from_scan(dir, &mut progress),
        Err(error) => Err(error),
    }
}

fn from_index(dir: &Path, reader: &Reader, progress: &mut impl FnMut(u64, u64)) -> Result<Report> {
    let total = reader.refresh()?;
    let mut damage = reader.damage();
    let mut bad = BTreeSet::new();
    let mut at = 0;
    while at < total {
        let (found, _) = reader.verify(at, STEP)?;
        for item in found {
            bad.insert((item.file.clone(), item.offset));
            damage.push(item);
        }
        at += STEP;
        progress(at.min(total), total);
    }
    if damage.is_empty() {
        finish(dir, reader)?;
        return Ok(Report {
            kept: total,
            dropped: 0,
            rebuilt: false,
            damage,
        });
    }
    if damage.iter().any(|d| d.file == index::FILE) {
        // Entries are lost: the extents know what they held.
        return from_scan(dir, progress);
    }
    let good = |e: &Entry| !bad.contains(&(extent::name(e.lane, e.extent), e.offset));
    let entries: Vec<Entry> = reader.all_entries().into_iter().filter(good).collect();
    rewrite(dir, reader.header, &entries)?;
    let kept = entries.len() as u64;
    Ok(Report {
        kept,
        dropped: total.saturating_sub(kept),
        rebuilt: true,
        damage,
    })
}

/// An unclosed but sound store: cut and mark it.
fn finish(dir: &Path, reader: &Reader) -> Result<()> {
    if reader.is_closed() {
        return Ok(());
    }
    trim(dir, &reader.all_entries())?;
    let file = OpenOptions::new()
        .read(true)
        .write(true)
        .open(dir.join(index::FILE))
        .map_err(|e| Error::io("open index.situ", e))?;
    let end = (INDEX_HEADER as u64 + reader.entries_loaded() * ENTRY as u64).next_multiple_of(4096);
    if file_length(&file, index::FILE)? > end {
        ftruncate(&file, end).map_err(|e| Error::io("trim index.situ", e))?;
    }
    write_all(
        &file,
        &reader.entries_loaded().to_le_bytes(),
        SYNCED_AT as u64,
    )
    .map_err(|e| Error::io("write index.situ", e))?;
    write_all(&file, &[1], STATE_AT as u64).map_err(|e| Error::io("write index.situ", e))?;
    fdatasync(&file).map_err(|e| Error::io("sync index.situ", e))
}

/// Cuts each extent behind its last chunk.
fn trim(dir: &Path, entries: &[Entry]) -> Result<()> {
    let mut ends: BTreeMap<(u8, u32), u64> = BTreeMap::new();
    for entry in entries {
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

fn extent_files(dir: &Path) -> Result<Vec<(u8, u32)>> {
    let listing = std::fs::read_dir(dir).map_err(|e| Error::io("list the store", e))?;
    let mut found = Vec::new();
    for item in listing {
        let item = item.map_err(|e| Error::io("list the store", e))?;
        let name = item.file_name().to_string_lossy().into_owned();
        let Some(stem) = name.strip_suffix(".situ") else {
            continue;
        };
        let parsed = match stem.split_once('-') {
            Some(("data", n)) => n.parse().ok().map(|n| (LANE_DATA, n)),
            Some(("large", n)) => n.parse().ok().map(|n| (LANE_LARGE, n)),
            _ => None,
        };
        found.extend(parsed);
    }
    found.sort();
    Ok(found)
}

/// A new index from the chunks themselves.
fn from_scan(dir: &Path, progress: &mut impl FnMut(u64, u64)) -> Result<Report> {
    let files = extent_files(dir)?;
    let total = files.len() as u64;
    let mut damage = Vec::new();
    let mut entries: Vec<Entry> = Vec::new();
    let mut header: Option<IndexHeader> = None;
    for (at, (lane, number)) in files.into_iter().enumerate() {
        let name = extent::name(lane, number);
        let file = File::open(dir.join(&name)).map_err(|e| Error::io(format!("open {name}"), e))?;
        let length = file_length(&file, &name)?;
        if length < EXTENT_HEADER as u64 {
            damage.push(Damage {
                file: name,
                offset: 0,
                why: "shorter than an extent's header".into(),
            });
            continue;
        }
        let map = map_file(&file, 0, length, &name)?;
        let mut id = [0; 16];
        id.copy_from_slice(&map[16..32]);
        let id = header.map_or(id, |h| h.id);
        if let Err(why) = check_extent(&map, &id, lane, number) {
            damage.push(Damage {
                file: name,
                offset: 0,
                why: why.into(),
            });
            continue;
        }
        header.get_or_insert(IndexHeader {
            id,
            created: writer::now(),
        });
        scan(&map, lane, number, &mut entries, &mut damage);
        progress(at as u64 + 1, total);
    }
    let Some(mut header) = header else {
        return Err(Error::NotAStore);
    };
    // Chunks found twice (a failed commit that was repeated) or out of order: the first wins.
    entries.sort_by_key(|e| (e.stream, e.level, e.first, e.ordinal, e.extent, e.offset));
    let found = entries.len() as u64;
    let mut kept: Vec<Entry> = Vec::with_capacity(entries.len());
    for entry in entries {
        match kept.last() {
            Some(last)
                if (last.stream, last.level) == (entry.stream, entry.level)
                    && entry.first <= last.last => {}
            _ => kept.push(entry),
        }
    }
    let creation = |e: &Entry| (e.stream == CATALOG).then_some(e.first_creation);
    if let Some(created) = kept.iter().filter_map(creation).min() {
        header.created = created;
    }
    rewrite(dir, header, &kept)?;
    Ok(Report {
        kept: kept.len() as u64,
        dropped: found - kept.len() as u64 + damage.len() as u64,
        rebuilt: true,
        damage,
    })
}

fn scan(map: &[u8], lane: u8, number: u32, entries: &mut Vec<Entry>, damage: &mut Vec<Damage>) {
    let mut at = EXTENT_HEADER;
    while at + CHUNK_HEADER <= map.len() {
        if u32_at(map, at) != CHUNK_MAGIC {
            at += 8;
            continue;
        }
        let checked = ChunkHeader::decode(&map[at..])
            .and_then(|header| chunk::open(&header, &map[at..], false).map(|_| header));
        match checked {
            Ok(header) => {
                let entry = Entry {
                    stream: header.stream,
                    level: header.level,
                    lane,
                    extent: number,
                    offset: at as u64,
                    length: header.length,
                    count: header.count,
                    ordinal: header.ordinal,
                    first: header.first,
                    last: header.last,
                    first_creation: header.first_creation,
                };
                entries.extend(Entry::decode(&entry.encode()));
                at += (header.length as usize).next_multiple_of(8);
            }
            Err(why) => {
                damage.push(Damage {
                    file: extent::name(lane, number),
                    offset: at as u64,
                    why: why.into(),
                });
                at += 8;
            }
        }
    }
}

/// Puts a new index in the old one's place, in one step.
fn rewrite(dir: &Path, header: IndexHeader, entries: &[Entry]) -> Result<()> {
    let failed = |e: std::io::Error| Error::io("write the new index", e);
    let fresh = dir.join("index.situ.new");
    let file = OpenOptions::new()
        .write(true)
        .create(true)
        .truncate(true)
        .open(&fresh)
        .map_err(failed)?;
    let mut bytes = header.encode().to_vec();
    bytes[COMMITTED_AT..COMMITTED_AT + 8].copy_from_slice(&(entries.len() as u64).to_le_bytes());
    bytes[SYNCED_AT..SYNCED_AT + 8].copy_from_slice(&(entries.len() as u64).to_le_bytes());
    bytes[STATE_AT] = 1;
    let mut ordinals: BTreeMap<(u32, u8), u64> = BTreeMap::new();
    for entry in entries {
        let ordinal = ordinals.entry((entry.stream, entry.level)).or_default();
        bytes.extend_from_slice(
            &Entry {
                ordinal: *ordinal,
                ..*entry
            }
            .encode(),
        );
        *ordinal += entry.count as u64;
    }
    bytes.resize(bytes.len().next_multiple_of(4096), 0);
    write_all(&file, &bytes, 0).map_err(|e| Error::io("write the new index", e))?;
    fdatasync(&file).map_err(|e| Error::io("sync the new index", e))?;
    let old = dir.join(index::FILE);
    if old.exists() {
        std::fs::copy(&old, dir.join("index.situ.before-repair")).map_err(failed)?;
    }
    std::fs::rename(&fresh, &old).map_err(failed)
}

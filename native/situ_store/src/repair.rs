//! Repairs a store whose index or data are damaged, and closes a store whose writer died.
//!
//! Every message that was readable before a repair is readable afterwards, because the repair keeps each index
//! entry that refers to a sound chunk. It fills damaged entries with the chunks that carry their numbers, if these
//! chunks are known to have been committed. An entry that cannot be filled becomes a placeholder, so that every
//! other entry keeps its number. Data are never rewritten.
//! See docs/adr/0039-chunks-carry-their-index-position.md.

mod apply;
mod old_index;
mod scan;

use std::collections::BTreeMap;
use std::path::Path;

use crate::error::{Error, Result};
use crate::extent;
use crate::format::*;
use crate::index;
use crate::reader::{matches_header, Damage};
use crate::writer;

use old_index::OldIndex;
use scan::Files;

/// The number of chunks checked between two progress reports.
const STEP: usize = 128;

/// The damage that was found and the repairs that were made.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// Chunks that the store contains after the repair.
    pub kept: u64,
    /// Chunks that had been acknowledged and are lost.
    pub dropped: u64,
    /// Chunks whose index entry was lost and that were found in the data.
    pub recovered: u64,
    /// Sound chunks at the end that are left out, because the index that would show whether they were acknowledged
    /// is lost.
    pub unconfirmed: u64,
    /// Whether the index was replaced by a new one (in a dry run: would be).
    pub rebuilt: bool,
    /// All damage found.
    pub damage: Vec<Damage>,
}

/// The repairs to make.
struct Plan {
    report: Report,
    header: IndexHeader,
    entries: Vec<Entry>,
    /// Extents that contain chunks of this store, although their headers are damaged.
    damaged_headers: Vec<(u8, u32)>,
    closed: bool,
}

/// Repairs the store in `dir` and marks it closed. With `dry` it only reports. When a new index is written, the old
/// one is kept as `index.situ.before-repair` (`.before-repair-2` ...).
pub fn repair_store(dir: &Path, dry: bool, mut progress: impl FnMut(u64, u64)) -> Result<Report> {
    // No lock file is created in a folder without a store.
    let files = Files::open(dir)?;
    if files.is_empty() && !dir.join(index::FILE).exists() {
        return Err(Error::NoStore);
    }
    let _lock = writer::lock_store(dir, None)?;
    let plan = build_plan(dir, files, &mut progress)?;
    if !dry {
        apply::apply_plan(dir, &plan)?;
    }
    Ok(plan.report)
}

fn build_plan(dir: &Path, mut files: Files, progress: &mut impl FnMut(u64, u64)) -> Result<Plan> {
    let old_index = OldIndex::read(dir)?;
    let mut damage = old_index.damage.clone();
    let id = old_index.header.map(|header| header.id);
    let id = id.or_else(|| files.store_id()).ok_or(Error::NotAStore)?;
    files.check_headers(id, &mut damage);

    let sound = check_entries(&old_index, &files, &mut damage, progress);
    let mut scan = if old_index.is_complete() {
        scan::Scan::default()
    } else {
        files.scan_chunks(&sound, &mut damage, progress)
    };
    let header = old_index.header.unwrap_or(IndexHeader {
        id,
        created: scan.created.unwrap_or_else(writer::system_time),
        version: if scan.unnumbered.is_empty() {
            VERSION
        } else {
            1
        },
    });
    let found = scan.numbered.keys().next_back().map_or(0, |last| last + 1);
    // The header counts the acknowledged chunks, even if the entries themselves are lost. The count has no
    // checksum, so it is trusted only as far as chunks exist.
    let committed = match old_index.header {
        Some(_) => scan.committed.max(old_index.published.min(found)),
        None => scan.committed,
    };
    scan.committed = committed;
    let unconfirmed = scan.numbered.range(committed..).count() as u64;
    let intact_count = sound
        .iter()
        .filter(|read_entry| read_entry.is_some())
        .count() as u64;
    let (entries, lost) = if header.version == 1 {
        merge_by_time(&old_index, sound, scan.unnumbered)
    } else {
        merge_by_number(sound, scan)
    };
    let kept = entries
        .iter()
        .filter(|entry| !entry.is_placeholder())
        .count() as u64;
    let damaged_headers = files.damaged_headers(&entries);
    Ok(Plan {
        report: Report {
            kept,
            dropped: lost,
            recovered: kept.saturating_sub(intact_count),
            unconfirmed,
            rebuilt: !damage.is_empty(),
            damage,
        },
        header,
        entries,
        damaged_headers,
        closed: old_index.closed,
    })
}

/// Returns the entries whose chunks are sound, with `None` for the others.
fn check_entries(
    old_index: &OldIndex,
    files: &Files,
    damage: &mut Vec<Damage>,
    progress: &mut impl FnMut(u64, u64),
) -> Vec<Option<Entry>> {
    let total = old_index.entries.len();
    let mut sound = Vec::with_capacity(total);
    let mut last: BTreeMap<(u32, u8), i64> = BTreeMap::new();
    for (number, read_entry) in old_index.entries.iter().enumerate() {
        if number % STEP == 0 {
            progress(number as u64, total as u64);
        }
        let Some(entry) = read_entry.filter(|entry| !entry.is_placeholder()) else {
            sound.push(*read_entry);
            continue;
        };
        let before = last.get(&(entry.stream, entry.level));
        if before.is_some_and(|before| entry.first <= *before) {
            damage.push(Damage {
                file: index::FILE.into(),
                offset: (INDEX_HEADER + number * ENTRY) as u64,
                why: "the entry goes back in time".into(),
            });
            sound.push(None);
            continue;
        }
        let checked = files.check_chunk(entry.lane, entry.extent, entry.offset);
        let checked = checked.and_then(|header| match matches_header(&entry, &header) {
            true => Ok(()),
            false => Err("the chunk is not the one the index names"),
        });
        match checked {
            Ok(()) => {
                last.insert((entry.stream, entry.level), entry.last);
                sound.push(Some(entry));
            }
            Err(why) => {
                damage.push(Damage {
                    file: extent::file_name(entry.lane, entry.extent),
                    offset: entry.offset,
                    why: why.into(),
                });
                sound.push(None);
            }
        }
    }
    progress(total as u64, total as u64);
    sound
}

/// Puts every entry at its number. A scanned chunk fills an empty number if it is known to have been committed.
fn merge_by_number(sound: Vec<Option<Entry>>, scan: scan::Scan) -> (Vec<Entry>, u64) {
    let mut found = scan.numbered;
    found.retain(|number, _| *number < scan.committed);
    let end = found
        .keys()
        .next_back()
        .map_or(0, |last| *last as usize + 1);
    let mut entries: Vec<Option<Entry>> = sound;
    entries.resize(entries.len().max(end), None);
    // A chunk found in the files is skipped if a later sound entry of its stream contradicts it.
    let mut next: BTreeMap<(u32, u8), i64> = BTreeMap::new();
    for number in (0..entries.len()).rev() {
        let entry = match entries[number] {
            Some(entry) => Some(entry),
            None => found.remove(&(number as u64)).filter(|entry| {
                let next = next.get(&(entry.stream, entry.level));
                next.is_none_or(|next| entry.last < *next)
            }),
        };
        if let Some(entry) = entry.filter(|entry| !entry.is_placeholder()) {
            next.insert((entry.stream, entry.level), entry.first);
        }
        entries[number] = entry;
    }
    let mut last: BTreeMap<(u32, u8), i64> = BTreeMap::new();
    let mut lost = scan.committed.saturating_sub(entries.len() as u64);
    for entry in &mut entries {
        let kept = entry.filter(|entry| {
            let before = last.get(&(entry.stream, entry.level));
            entry.is_placeholder() || before.is_none_or(|before| entry.first > *before)
        });
        if let Some(kept) = kept.filter(|kept| !kept.is_placeholder()) {
            last.insert((kept.stream, kept.level), kept.last);
        }
        lost += u64::from(kept.is_none());
        *entry = kept;
    }
    let mut entries: Vec<Entry> = entries
        .into_iter()
        .map(|entry| entry.unwrap_or(Entry::placeholder()))
        .collect();
    // Ordinals continue without a gap over lost chunks.
    let mut ordinals: BTreeMap<(u32, u8), u64> = BTreeMap::new();
    for entry in entries.iter_mut().filter(|entry| !entry.is_placeholder()) {
        let next = ordinals.entry((entry.stream, entry.level)).or_default();
        entry.ordinal = *next;
        *next += u64::from(entry.count);
    }
    (entries, lost)
}

/// Orders the entries of a version 1 store, whose chunks carry no number. A scanned chunk is added if its stream
/// has no other chunk at its times. If two chunks cover the same times, the later one in the file wins: it was
/// written after the first one had failed.
fn merge_by_time(
    old_index: &OldIndex,
    sound: Vec<Option<Entry>>,
    found: Vec<Entry>,
) -> (Vec<Entry>, u64) {
    let mut streams: BTreeMap<(u32, u8), BTreeMap<i64, Entry>> = BTreeMap::new();
    let expected = old_index.published.max(sound.len() as u64);
    for entry in sound
        .into_iter()
        .flatten()
        .filter(|entry| !entry.is_placeholder())
    {
        let stream = streams.entry((entry.stream, entry.level)).or_default();
        stream.insert(entry.first, entry);
    }
    for entry in found.into_iter().rev() {
        let stream = streams.entry((entry.stream, entry.level)).or_default();
        let before = stream.range(..=entry.last).next_back();
        if before.is_none_or(|(_, before)| before.last < entry.first) {
            stream.insert(entry.first, entry);
        }
    }
    let mut entries = Vec::new();
    for stream in streams.into_values() {
        let mut ordinal = 0;
        for entry in stream.into_values() {
            entries.push(Entry { ordinal, ..entry });
            ordinal += u64::from(entry.count);
        }
    }
    let lost = expected
        .min(old_index.room)
        .saturating_sub(entries.len() as u64);
    (entries, lost)
}

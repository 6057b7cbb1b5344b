//! Mending a store whose index or data are damaged, and closing one whose writer died.
//! All messages that a reader could get before are there afterwards: the repair keeps every entry of the index that
//! names a sound chunk. It fills damaged entries with the chunks that carry their numbers, as far as these are known
//! to have been committed; an entry that stays empty becomes a hole, so that every other entry keeps its number. Data
//! are never rewritten.

mod apply;
mod claims;
mod scan;

use std::collections::BTreeMap;
use std::path::Path;

use crate::error::{Error, Result};
use crate::extent;
use crate::format::*;
use crate::index;
use crate::reader::{names, Damage};
use crate::writer;

use claims::Claims;
use scan::Files;

/// Chunks checked between two reports of progress.
const STEP: usize = 128;

/// The damage found, and the repairs made.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// Chunks that the store has now.
    pub kept: u64,
    /// Chunks that were acknowledged once and are lost.
    pub dropped: u64,
    /// Chunks whose place in the index was lost and that were found in the data.
    pub recovered: u64,
    /// Sound chunks at the end that are left out: the index is lost that would show whether they were acknowledged.
    pub unconfirmed: u64,
    /// Whether the index is (or, in a dry run, would be) a new one.
    pub rebuilt: bool,
    /// All damage found.
    pub damage: Vec<Damage>,
}

/// The repairs to make.
struct Plan {
    report: Report,
    header: IndexHeader,
    entries: Vec<Entry>,
    /// Extents whose headers are damaged though they hold chunks of this store.
    heads: Vec<(u8, u32)>,
    closed: bool,
}

/// Repairs the store in `dir` and marks it closed; with `dry` it only reports. The old index stays as
/// `index.situ.before-repair` (`.before-repair-2` ...) when a new one is written.
pub fn repair(dir: &Path, dry: bool, mut progress: impl FnMut(u64, u64)) -> Result<Report> {
    // A folder without a store gets no lock file.
    let files = Files::open(dir)?;
    if files.is_empty() && !dir.join(index::FILE).exists() {
        return Err(Error::NoStore);
    }
    let _lock = writer::lock(dir, None)?;
    let plan = plan(dir, files, &mut progress)?;
    if !dry {
        apply::apply(dir, &plan)?;
    }
    Ok(plan.report)
}

fn plan(dir: &Path, mut files: Files, progress: &mut impl FnMut(u64, u64)) -> Result<Plan> {
    let claims = Claims::read(dir)?;
    let mut damage = claims.damage.clone();
    let id = claims.header.map(|header| header.id);
    let id = id.or_else(|| files.id()).ok_or(Error::NotAStore)?;
    files.expect(id, &mut damage);

    let good = check_claims(&claims, &files, &mut damage, progress);
    let mut scan = if claims.whole() {
        scan::Scan::default()
    } else {
        files.scan(&good, &mut damage, progress)
    };
    let header = claims.header.unwrap_or(IndexHeader {
        id,
        created: scan.created.unwrap_or_else(writer::now),
        version: if scan.unnumbered.is_empty() {
            VERSION
        } else {
            1
        },
    });
    let found = scan.numbered.keys().next_back().map_or(0, |last| last + 1);
    // The header counts the acknowledged chunks, even if the entries themselves are gone. The count has no checksum, so
    // it is trusted only as far as there are chunks.
    let committed = match claims.header {
        Some(_) => scan.committed.max(claims.published.min(found)),
        None => scan.committed,
    };
    scan.committed = committed;
    let unconfirmed = scan.numbered.range(committed..).count() as u64;
    let wanted = good.iter().filter(|claim| claim.is_some()).count() as u64;
    let (entries, lost) = if header.version == 1 {
        by_time(&claims, good, scan.unnumbered)
    } else {
        by_number(good, scan)
    };
    let kept = entries.iter().filter(|entry| !entry.is_hole()).count() as u64;
    let heads = files.mistitled(&entries);
    Ok(Plan {
        report: Report {
            kept,
            dropped: lost,
            recovered: kept.saturating_sub(wanted),
            unconfirmed,
            rebuilt: !damage.is_empty(),
            damage,
        },
        header,
        entries,
        heads,
        closed: claims.closed,
    })
}

/// The entries whose chunks are sound.
fn check_claims(
    claims: &Claims,
    files: &Files,
    damage: &mut Vec<Damage>,
    progress: &mut impl FnMut(u64, u64),
) -> Vec<Option<Entry>> {
    let total = claims.entries.len();
    let mut good = Vec::with_capacity(total);
    let mut last: BTreeMap<(u32, u8), i64> = BTreeMap::new();
    for (number, claim) in claims.entries.iter().enumerate() {
        if number % STEP == 0 {
            progress(number as u64, total as u64);
        }
        let Some(entry) = claim.filter(|entry| !entry.is_hole()) else {
            good.push(*claim);
            continue;
        };
        let before = last.get(&(entry.stream, entry.level));
        if before.is_some_and(|before| entry.first <= *before) {
            damage.push(Damage {
                file: index::FILE.into(),
                offset: (INDEX_HEADER + number * ENTRY) as u64,
                why: "the entry goes back in time".into(),
            });
            good.push(None);
            continue;
        }
        let checked = files.check(entry.lane, entry.extent, entry.offset);
        let checked = checked.and_then(|header| match names(&entry, &header) {
            true => Ok(()),
            false => Err("the chunk is not the one the index names"),
        });
        match checked {
            Ok(()) => {
                last.insert((entry.stream, entry.level), entry.last);
                good.push(Some(entry));
            }
            Err(why) => {
                damage.push(Damage {
                    file: extent::name(entry.lane, entry.extent),
                    offset: entry.offset,
                    why: why.into(),
                });
                good.push(None);
            }
        }
    }
    progress(total as u64, total as u64);
    good
}

/// Every entry at its number. A chunk from the scan fills an empty place when it was committed for certain.
fn by_number(good: Vec<Option<Entry>>, scan: scan::Scan) -> (Vec<Entry>, u64) {
    let mut found = scan.numbered;
    found.retain(|number, _| *number < scan.committed);
    let behind = found
        .keys()
        .next_back()
        .map_or(0, |last| *last as usize + 1);
    let mut entries: Vec<Option<Entry>> = good;
    entries.resize(entries.len().max(behind), None);
    // A chunk found in the files does not belong here if a later sound entry of its stream contradicts it.
    let mut next: BTreeMap<(u32, u8), i64> = BTreeMap::new();
    for number in (0..entries.len()).rev() {
        let entry = match entries[number] {
            Some(entry) => Some(entry),
            None => found.remove(&(number as u64)).filter(|entry| {
                let next = next.get(&(entry.stream, entry.level));
                next.is_none_or(|next| entry.last < *next)
            }),
        };
        if let Some(entry) = entry.filter(|entry| !entry.is_hole()) {
            next.insert((entry.stream, entry.level), entry.first);
        }
        entries[number] = entry;
    }
    let mut last: BTreeMap<(u32, u8), i64> = BTreeMap::new();
    let mut lost = scan.committed.saturating_sub(entries.len() as u64);
    for entry in &mut entries {
        let kept = entry.filter(|entry| {
            let before = last.get(&(entry.stream, entry.level));
            entry.is_hole() || before.is_none_or(|before| entry.first > *before)
        });
        if let Some(kept) = kept.filter(|kept| !kept.is_hole()) {
            last.insert((kept.stream, kept.level), kept.last);
        }
        lost += u64::from(kept.is_none());
        *entry = kept;
    }
    let mut entries: Vec<Entry> = entries
        .into_iter()
        .map(|entry| entry.unwrap_or(Entry::hole()))
        .collect();
    // Ordinals go on without a gap over what is lost.
    let mut ordinals: BTreeMap<(u32, u8), u64> = BTreeMap::new();
    for entry in entries.iter_mut().filter(|entry| !entry.is_hole()) {
        let next = ordinals.entry((entry.stream, entry.level)).or_default();
        entry.ordinal = *next;
        *next += u64::from(entry.count);
    }
    (entries, lost)
}

/// Stores of version 1, whose chunks tell no number: chunks from the scan go where their stream has nothing at their
/// times. Of two for the same times the one behind in the file was written when the other had failed.
fn by_time(claims: &Claims, good: Vec<Option<Entry>>, found: Vec<Entry>) -> (Vec<Entry>, u64) {
    let mut streams: BTreeMap<(u32, u8), BTreeMap<i64, Entry>> = BTreeMap::new();
    let expected = claims.published.max(good.len() as u64);
    for entry in good.into_iter().flatten().filter(|entry| !entry.is_hole()) {
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
        .min(claims.room)
        .saturating_sub(entries.len() as u64);
    (entries, lost)
}

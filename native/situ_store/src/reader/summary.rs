//! Summaries: bins over any span, from stored pyramids, finer levels and at last the messages.

use std::collections::BTreeMap;

use super::Reader;
use crate::error::Result;
use crate::format::*;
use crate::pyramid::{self, Bin, Folder};

/// A pyramid computed for want of a stored one.
#[derive(Default)]
pub(super) struct Computed {
    builder: pyramid::Builder<Bin>,
    levels: BTreeMap<u8, Vec<Bin>>,
    seen: u64,
}

impl Reader {
    pub(super) fn entries_between(&self, stream: u32, level: u8, from: i64, to: i64) -> Vec<Entry> {
        let index = self.lock_index();
        let Some(entries) = index.entries(stream, level) else {
            return Vec::new();
        };
        entries
            .from(entries.at_time(from))
            .take_while(|entry| entry.first <= to)
            .collect()
    }

    /// Bins of width 2^k over `from..=to`: stored ones where there are, the rest folded from finer levels and the
    /// messages.
    pub fn summary(&self, stream: u32, from: i64, to: i64, k: u8) -> Result<Vec<Bin>> {
        let k = k.min(62);
        let from = pyramid::floor(from, k);
        let to = pyramid::floor(to, k).saturating_add((1i64 << k) - 1);
        let mut folder = Folder::new(k);
        let levels: Vec<u8> = {
            let index = self.lock_index();
            let range = index.directories.range((stream, 0)..=(stream, k.min(62)));
            range
                .filter(|((_, level), _)| *level > 0)
                .map(|((_, level), _)| *level)
                .rev()
                .collect()
        };
        let mut at = from;
        for level in levels {
            at = self.fold_level(stream, level, at, to, &mut folder)?;
            if at > to {
                return Ok(folder.bins);
            }
        }
        self.fold_messages(stream, at, to, k, &mut folder)?;
        Ok(folder.bins)
    }

    /// Adds the stored bins of a level from `from` on; the time behind the last of them.
    fn fold_level(
        &self,
        stream: u32,
        level: u8,
        from: i64,
        to: i64,
        folder: &mut Folder<Bin>,
    ) -> Result<i64> {
        let width = 1i64 << level;
        let mut at = from;
        for entry in self.entries_between(stream, level, from, to) {
            // A damaged pyramid is no damage to the recording: finer levels and the messages tell what it lacks.
            let Ok(chunk) = self.chunk(&entry) else {
                return Ok(at);
            };
            for bin in chunk.body().chunks_exact(BIN).filter_map(Bin::decode) {
                if bin.start < at {
                    continue;
                }
                if bin.start > to {
                    return Ok(i64::MAX);
                }
                folder.add(bin);
                at = bin.start.saturating_add(width);
            }
        }
        // Past the last stored bin of the level nothing is known; before it all is.
        let covered = {
            let index = self.lock_index();
            let last = index
                .entries(stream, level)
                .and_then(|entries| entries.last())
                .map(|e| e.last);
            last.map_or(i64::MIN, |last| last.saturating_add(width))
        };
        Ok(at.max(covered.min(to.saturating_add(1))))
    }

    fn fold_messages(
        &self,
        stream: u32,
        from: i64,
        to: i64,
        k: u8,
        folder: &mut Folder<Bin>,
    ) -> Result<()> {
        let entries = self.entries_between(stream, 0, from, to);
        let messages: u64 = entries.iter().map(|e| e.count as u64).sum();
        if messages > 400_000 {
            return self.fold_computed(stream, from, to, k, folder);
        }
        for entry in &entries {
            let Ok(chunk) = self.chunk(entry) else {
                continue;
            };
            for message in chunk.messages() {
                let Ok((envelope, value)) = message else {
                    break;
                };
                if envelope.time > to {
                    break;
                }
                if envelope.time >= from {
                    if let Some(number) = chunk.number(&value) {
                        folder.add(Bin::sample(envelope.time, number));
                    }
                }
            }
        }
        Ok(())
    }

    /// A store without (enough of) a pyramid: computes one in memory, once, and follows a growing store.
    fn fold_computed(
        &self,
        stream: u32,
        from: i64,
        to: i64,
        k: u8,
        folder: &mut Folder<Bin>,
    ) -> Result<()> {
        let mut all = self.computed.lock().unwrap_or_else(|p| p.into_inner());
        let computed = all.entry(stream).or_default();
        self.catch_up(stream, computed);
        let level = computed
            .levels
            .range(..=k)
            .next_back()
            .map(|(level, _)| *level);
        let mut at = from;
        if let Some(bins) = level.and_then(|level| computed.levels.get(&level)) {
            let width = 1i64 << level.unwrap_or(0);
            let start = bins.partition_point(|bin| bin.start < from);
            for bin in bins[start..].iter().take_while(|bin| bin.start <= to) {
                folder.add(*bin);
                at = bin.start.saturating_add(width);
            }
            let last = bins
                .last()
                .map_or(from, |bin| bin.start.saturating_add(width));
            at = at.max(last.min(to.saturating_add(1)));
        }
        if at > to {
            return Ok(());
        }
        for entry in self.entries_between(stream, 0, at, to) {
            let Ok(chunk) = self.chunk(&entry) else {
                continue;
            };
            for (envelope, value) in chunk.messages().flatten() {
                if envelope.time >= at && envelope.time <= to {
                    if let Some(number) = chunk.number(&value) {
                        folder.add(Bin::sample(envelope.time, number));
                    }
                }
            }
        }
        Ok(())
    }

    fn catch_up(&self, stream: u32, computed: &mut Computed) {
        let count = self.count(stream);
        while computed.seen < count {
            let Ok(Some(entry)) = self.entry_at(stream, computed.seen) else {
                break;
            };
            if let Ok(chunk) = self.chunk(&entry) {
                for (envelope, value) in chunk.messages().flatten() {
                    if let Some(number) = chunk.number(&value) {
                        computed.builder.add(Bin::sample(envelope.time, number));
                    }
                }
            }
            computed.seen = entry.ordinal + entry.count as u64;
        }
        for (level, bins) in computed.builder.take_ready(1) {
            computed.levels.entry(level).or_default().extend(bins);
        }
    }
}

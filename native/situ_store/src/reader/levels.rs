//! Bins over any span: stored ones where there are, finer ones where those end, and at last what the messages say. The
//! way down that a stream's signal and its tracks share.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use super::{lock, Chunk, Reader};
use crate::format::*;
use crate::pyramid::{self, Builder, Fold, Folder};

/// More messages without stored bins are folded once and kept.
const MANY: u64 = 400_000;

/// Times that are asked about, both ends included.
#[derive(Debug, Clone, Copy)]
pub(super) struct Span {
    pub from: i64,
    pub to: i64,
}

impl Span {
    pub const EVER: Span = Span {
        from: i64::MIN,
        to: i64::MAX,
    };

    /// As far out as bins of width 2^k reach that hold a part of it.
    pub fn in_bins(self, k: u8) -> Span {
        Span {
            from: pyramid::floor(self.from, k),
            to: pyramid::floor(self.to, k).saturating_add((1i64 << k) - 1),
        }
    }

    pub fn holds(&self, time: i64) -> bool {
        self.from <= time && time <= self.to
    }
}

/// All levels of a stream that has none stored, made in memory once; they follow a store that grows.
pub(super) struct Made<B> {
    builder: Builder<B>,
    levels: BTreeMap<u8, Vec<B>>,
    seen: u64,
}

impl<B> Default for Made<B> {
    fn default() -> Self {
        Made {
            builder: Builder::default(),
            levels: BTreeMap::new(),
            seen: 0,
        }
    }
}

/// The part of a message that a bin takes in.
type Value<P> = <<P as Pyramid>::Bin as Fold>::Value;

/// A kind of bins, and how they and the messages are read.
pub(super) trait Pyramid {
    type Bin: Fold;

    /// Its levels stand so much higher than the widths of their bins.
    const ABOVE: u8;

    /// The bins of a chunk of a level that begin at `from` or later, until `each` says `false`; `None` where the chunk
    /// contradicts itself.
    fn bins(
        &mut self,
        chunk: &Chunk,
        level: u8,
        from: i64,
        each: impl FnMut(Self::Bin) -> bool,
    ) -> Option<()>;

    /// The values of a chunk's messages within a span, each with its time. Damage ends the list.
    fn messages(
        &mut self,
        reader: &Reader,
        entry: &Entry,
        span: Span,
        each: impl FnMut(i64, &Value<Self>),
    );

    /// The levels of a stream that were made in memory.
    fn made(&self, reader: &Reader, stream: u32) -> Arc<Mutex<Made<Self::Bin>>>;
}

/// Header and table of a large chunk take at most so many bytes before its payload.
const LARGE_HEAD: usize = 192;

/// Whether an entry's message is for certain so large that nothing of it is drawn: to look at it would cost its bytes.
pub(super) fn undrawn(entry: &Entry) -> bool {
    entry.lane == LANE_LARGE && entry.length as usize >= LARGE_MESSAGE + LARGE_HEAD
}

impl Reader {
    pub(super) fn entries_between(&self, stream: u32, level: u8, span: Span) -> Vec<Entry> {
        let index = self.lock_index();
        let Some(entries) = index.entries(stream, level) else {
            return Vec::new();
        };
        entries
            .from(entries.at_time(span.from))
            .take_while(|entry| entry.first <= span.to)
            .collect()
    }

    /// Bins of width 2^k over a span that begins and ends with one.
    pub(super) fn bins<P: Pyramid>(
        &self,
        stream: u32,
        span: Span,
        k: u8,
        pyramid: &mut P,
    ) -> Vec<P::Bin> {
        let mut folder = Folder::new(k);
        let mut rest = span;
        for level in self.levels::<P>(stream, k).into_iter().rev() {
            rest.from = self.stored(stream, level, rest, pyramid, |bin| folder.add(bin));
            if rest.from > rest.to {
                return folder.bins;
            }
        }
        self.fold_messages(stream, rest, k, pyramid, &mut folder);
        folder.bins
    }

    /// The levels that are stored of a stream, as powers of two up to `k`, the finest first.
    pub(super) fn levels<P: Pyramid>(&self, stream: u32, k: u8) -> Vec<u8> {
        let index = self.lock_index();
        let range = (stream, P::ABOVE)..=(stream, P::ABOVE + k.min(62));
        let present = index.directories.range(range);
        let levels = present.map(|((_, level), _)| *level - P::ABOVE);
        levels.filter(|level| *level > 0).collect()
    }

    /// The stored bins of a level that begin within a span; the time behind the last of them.
    pub(super) fn stored<P: Pyramid>(
        &self,
        stream: u32,
        level: u8,
        span: Span,
        pyramid: &mut P,
        mut each: impl FnMut(P::Bin),
    ) -> i64 {
        let width = 1i64 << level;
        let mut at = span.from;
        for entry in self.entries_between(stream, P::ABOVE + level, span) {
            // Damaged bins are no damage to the recording: finer levels and the messages tell what they lack.
            let Ok(chunk) = self.chunk(&entry) else {
                return at;
            };
            let whole = pyramid.bins(&chunk, level, at, |bin| {
                let start = bin.start();
                if start > span.to {
                    return false;
                }
                if start >= at {
                    at = start.saturating_add(width);
                    each(bin);
                }
                true
            });
            if whole.is_none() {
                return at;
            }
        }
        // Past the last stored bin of the level nothing is known; before it all is.
        let last = {
            let index = self.lock_index();
            let entries = index.entries(stream, P::ABOVE + level);
            entries.and_then(|entries| entries.last()).map(|e| e.last)
        };
        let covered = last.map_or(i64::MIN, |last| last.saturating_add(width));
        at.max(covered.min(span.to.saturating_add(1)))
    }

    fn fold_messages<P: Pyramid>(
        &self,
        stream: u32,
        mut span: Span,
        k: u8,
        pyramid: &mut P,
        folder: &mut Folder<P::Bin>,
    ) {
        let entries = self.entries_between(stream, 0, span);
        let messages: u64 = entries.iter().map(|e| u64::from(e.count)).sum();
        if messages > MANY {
            span.from = self.fold_made(stream, span, k, pyramid, folder);
        }
        for entry in entries.iter().filter(|entry| entry.last >= span.from) {
            pyramid.messages(self, entry, span, |time, value| folder.observe(time, value));
        }
    }

    /// Bins from the levels made in memory; the time behind the last of them.
    fn fold_made<P: Pyramid>(
        &self,
        stream: u32,
        span: Span,
        k: u8,
        pyramid: &mut P,
        folder: &mut Folder<P::Bin>,
    ) -> i64 {
        let made = pyramid.made(self, stream);
        let mut made = lock(&made);
        self.catch_up(stream, pyramid, &mut made);
        let Some((level, bins)) = made.levels.range(..=k).next_back() else {
            return span.from;
        };
        let first = bins.partition_point(|bin| bin.start() < span.from);
        for bin in bins[first..]
            .iter()
            .take_while(|bin| bin.start() <= span.to)
        {
            folder.add(bin.clone());
        }
        let behind = |bin: &P::Bin| bin.start().saturating_add(1i64 << level);
        let covered = bins.last().map_or(span.from, behind);
        span.from.max(covered.min(span.to.saturating_add(1)))
    }

    fn catch_up<P: Pyramid>(&self, stream: u32, pyramid: &mut P, made: &mut Made<P::Bin>) {
        let count = self.count(stream);
        while made.seen < count {
            let Ok(Some(entry)) = self.entry_at(stream, made.seen) else {
                break;
            };
            let builder = &mut made.builder;
            pyramid.messages(self, &entry, Span::EVER, |time, value| {
                builder.observe(time, value);
            });
            made.seen = entry.ordinal + u64::from(entry.count);
        }
        for (level, bins) in made.builder.take_ready(1) {
            made.levels.entry(level).or_default().extend(bins);
        }
    }
}

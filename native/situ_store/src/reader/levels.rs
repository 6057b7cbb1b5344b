//! Reads bins over any span: stored bins if they exist, then finer bins where those end, and finally the messages.
//! The signal and the tracks of a stream share this code.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use super::{has_absent, lock_mutex, Chunk, Reader};
use crate::format::*;
use crate::pyramid::{self, Builder, Fold, Folder};

/// Above this number of messages without stored bins, their bins are computed once and cached.
const MANY_MESSAGES: u64 = 400_000;

/// The requested times, including both ends.
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

    /// Extends the span to complete bins of width 2^k.
    pub fn extend_to_bins(self, k: u8) -> Span {
        Span {
            from: pyramid::bin_start(self.from, k),
            to: pyramid::bin_start(self.to, k).saturating_add((1i64 << k) - 1),
        }
    }

    pub fn contains(&self, time: i64) -> bool {
        self.from <= time && time <= self.to
    }
}

/// All levels of a stream without stored ones, computed once in memory and updated when the store grows.
pub(super) struct MemoryPyramid<B> {
    builder: Builder<B>,
    levels: BTreeMap<u8, Vec<B>>,
    seen: u64,
}

impl<B> Default for MemoryPyramid<B> {
    fn default() -> Self {
        MemoryPyramid {
            builder: Builder::default(),
            levels: BTreeMap::new(),
            seen: 0,
        }
    }
}

/// The part of a message that is added to a bin.
type Value<P> = <<P as Pyramid>::Bin as Fold>::Value;

/// A kind of bins, with functions to read them and the messages they summarize.
pub(super) trait Pyramid {
    type Bin: Fold;

    /// The difference between level numbers and bin widths (as powers of two).
    const LEVEL_OFFSET: u8;

    /// Passes the bins of a chunk that begin at `from` or later to `each` until it returns `false`. Returns `None`
    /// if the chunk contradicts itself.
    fn decode_bins(
        &mut self,
        chunk: &Chunk,
        level: u8,
        from: i64,
        each: impl FnMut(Self::Bin) -> bool,
    ) -> Option<()>;

    /// Passes the values of a chunk's messages within a span to `each`, with their times. Damage ends the chunk.
    fn visit_messages(
        &mut self,
        reader: &Reader,
        entry: &Entry,
        span: Span,
        each: impl FnMut(i64, &Value<Self>),
    );

    /// Returns the levels of a stream that were computed in memory.
    fn memory_pyramid(&self, reader: &Reader, stream: u32) -> Arc<Mutex<MemoryPyramid<Self::Bin>>>;
}

/// The maximum size of header and table of a large chunk, before its payload.
const LARGE_HEAD: usize = 192;

/// Returns whether an entry's message is certainly too large for a plot to show any of it. Reading it would cost
/// its full size.
pub(super) fn is_too_large_to_draw(entry: &Entry) -> bool {
    entry.lane == LANE_LARGE && entry.length as usize >= LARGE_MESSAGE + LARGE_HEAD
}

impl Reader {
    pub(super) fn entries_between(&self, stream: u32, level: u8, span: Span) -> Vec<Entry> {
        let index = self.lock_index();
        let Some(entries) = index.stream_entries(stream, level) else {
            return Vec::new();
        };
        entries
            .iter_from(entries.position_at_time(span.from))
            .take_while(|entry| entry.first <= span.to)
            .collect()
    }

    /// Returns bins of width 2^k over a span that consists of complete bins.
    pub(super) fn fold_bins<P: Pyramid>(
        &self,
        stream: u32,
        span: Span,
        k: u8,
        pyramid: &mut P,
    ) -> Vec<P::Bin> {
        let mut folder = Folder::new(k);
        let mut rest = span;
        for level in self.stored_levels::<P>(stream, k).into_iter().rev() {
            rest.from = self.visit_stored_bins(stream, level, rest, pyramid, |bin| folder.add(bin));
            // Without these bins, finer ones and messages would be fetched, too.
            if rest.from > rest.to || has_absent() {
                return folder.bins;
            }
        }
        self.fold_messages(stream, rest, k, pyramid, &mut folder);
        folder.bins
    }

    /// Returns the stored levels of a stream up to `k` (as powers of two), finest first.
    pub(super) fn stored_levels<P: Pyramid>(&self, stream: u32, k: u8) -> Vec<u8> {
        let index = self.lock_index();
        let range = (stream, P::LEVEL_OFFSET)..=(stream, P::LEVEL_OFFSET + k.min(62));
        let present = index.directories.range(range);
        let levels = present.map(|((_, level), _)| *level - P::LEVEL_OFFSET);
        levels.filter(|level| *level > 0).collect()
    }

    /// Passes the stored bins of a level that begin within a span to `each`. Returns the time after the last of
    /// them.
    pub(super) fn visit_stored_bins<P: Pyramid>(
        &self,
        stream: u32,
        level: u8,
        span: Span,
        pyramid: &mut P,
        mut each: impl FnMut(P::Bin),
    ) -> i64 {
        let width = 1i64 << level;
        let mut at = span.from;
        for entry in self.entries_between(stream, P::LEVEL_OFFSET + level, span) {
            if !self.has_chunk(&entry) {
                continue;
            }
            // Damaged bins do not damage the recording: finer levels and the messages contain the same information.
            let Ok(chunk) = self.read_chunk(&entry) else {
                return at;
            };
            let whole = pyramid.decode_bins(&chunk, level, at, |bin| {
                let start = bin.start_time();
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
        // After the last stored bin of the level nothing is known; before it everything is.
        let last = {
            let index = self.lock_index();
            let entries = index.stream_entries(stream, P::LEVEL_OFFSET + level);
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
        if messages > MANY_MESSAGES {
            span.from = self.fold_memory_pyramid(stream, span, k, pyramid, folder);
        }
        for entry in entries.iter().filter(|entry| entry.last >= span.from) {
            pyramid.visit_messages(self, entry, span, |time, value| folder.observe(time, value));
        }
    }

    /// Adds bins from the levels computed in memory. Returns the time after the last of them.
    fn fold_memory_pyramid<P: Pyramid>(
        &self,
        stream: u32,
        span: Span,
        k: u8,
        pyramid: &mut P,
        folder: &mut Folder<P::Bin>,
    ) -> i64 {
        let memory_pyramid = pyramid.memory_pyramid(self, stream);
        let mut memory_pyramid = lock_mutex(&memory_pyramid);
        self.update_memory_pyramid(stream, pyramid, &mut memory_pyramid);
        let Some((level, bins)) = memory_pyramid.levels.range(..=k).next_back() else {
            return span.from;
        };
        let first = bins.partition_point(|bin| bin.start_time() < span.from);
        for bin in bins[first..]
            .iter()
            .take_while(|bin| bin.start_time() <= span.to)
        {
            folder.add(bin.clone());
        }
        let end_of = |bin: &P::Bin| bin.start_time().saturating_add(1i64 << level);
        let covered = bins.last().map_or(span.from, end_of);
        span.from.max(covered.min(span.to.saturating_add(1)))
    }

    fn update_memory_pyramid<P: Pyramid>(
        &self,
        stream: u32,
        pyramid: &mut P,
        memory_pyramid: &mut MemoryPyramid<P::Bin>,
    ) {
        let count = self.message_count(stream);
        let seen = memory_pyramid.seen;
        if self.lacks_chunks(stream, seen, i64::MAX, u64::MAX, u64::MAX) {
            return;
        }
        while memory_pyramid.seen < count {
            let Ok(Some(entry)) = self.entry_at(stream, memory_pyramid.seen) else {
                break;
            };
            let builder = &mut memory_pyramid.builder;
            pyramid.visit_messages(self, &entry, Span::EVER, |time, value| {
                builder.observe(time, value);
            });
            memory_pyramid.seen = entry.ordinal + u64::from(entry.count);
        }
        for (level, bins) in memory_pyramid.builder.take_ready(1) {
            memory_pyramid.levels.entry(level).or_default().extend(bins);
        }
    }
}

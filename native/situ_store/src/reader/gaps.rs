//! Finds the gaps of a stream.

use super::levels::Span;
use super::tracks::TrackCache;
use super::{has_absent, lock_mutex, Reader};
use crate::format::*;

impl Reader {
    /// Returns the gaps of at least `least` ns between consecutive messages of a stream: `(from, to)`, in order.
    /// The index shows gaps between chunks. Within a chunk, the messages show them, and they are read only if the
    /// stored counts leave space for such a gap. If the counts are fine enough, a recording without gaps is not
    /// read.
    pub fn find_gaps(&self, stream: u32, least: i64) -> Vec<(i64, i64)> {
        let least = least.max(1);
        let spans = self.possible_gaps(stream, least);
        let mut gaps = Vec::new();
        if has_absent() {
            return gaps;
        }
        let mut last = None;
        let mut note_step = |from: Option<i64>, to: i64| {
            if let Some(from) = from.filter(|from| to.saturating_sub(*from) >= least) {
                gaps.push((from, to));
            }
        };
        for entry in self.entries_between(stream, 0, Span::EVER) {
            note_step(last, entry.first);
            last = Some(entry.first);
            if entry.last.saturating_sub(entry.first) >= least && may_contain_gap(&spans, &entry) {
                // The payloads are not needed here, and damage ends the chunk.
                if let Ok(chunk) = self.read_checked_chunk(&entry, false) {
                    for (envelope, _) in chunk.messages().map_while(|message| message.ok()) {
                        note_step(last, envelope.time);
                        last = Some(envelope.time);
                    }
                }
            }
            last = Some(entry.last);
        }
        gaps
    }

    /// Returns the time spans that may contain a gap, in order, from the counts of bins at most half as wide.
    /// Returns `None` if no such counts are stored.
    fn possible_gaps(&self, stream: u32, least: i64) -> Option<Vec<Span>> {
        let widest = (least / 2).checked_ilog2()? as u8;
        let level = *self.stored_levels::<TrackCache>(stream, widest).last()?;
        let width = 1i64 << level;
        let cache = self.track_cache(stream);
        let mut cache = lock_mutex(&cache);
        let mut spans = Vec::new();
        let mut last: Option<i64> = None;
        self.visit_stored_bins(stream, level, Span::EVER, &mut *cache, |bin| {
            // A gap of two widths contains a complete bin, which is empty and therefore not stored.
            if let Some(last) = last.filter(|last| bin.start > last.saturating_add(width)) {
                spans.push(Span {
                    from: last,
                    to: bin.start.saturating_add(width - 1),
                });
            }
            last = Some(bin.start);
        });
        // The messages after the last bin are not counted yet.
        spans.push(Span {
            from: last.unwrap_or(i64::MIN),
            to: i64::MAX,
        });
        Some(spans)
    }
}

/// Returns whether the chunk of an entry may contain a gap.
fn may_contain_gap(spans: &Option<Vec<Span>>, entry: &Entry) -> bool {
    let Some(spans) = spans else { return true };
    let at = spans.partition_point(|span| span.to < entry.first);
    spans.get(at).is_some_and(|span| span.from <= entry.last)
}

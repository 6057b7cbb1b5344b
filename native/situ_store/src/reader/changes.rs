//! Lists the changes of a state one by one, unless there are too many.

use super::levels::{Pyramid, Span};
use super::tracks::TrackCache;
use super::Reader;
use crate::error::Result;
use crate::pyramid;
use crate::tracks::{Track, TrackBin, TrackValue};

impl Reader {
    /// Returns the changes of a key's state within a span, or `None` if there are more than `most`.
    pub(super) fn list_changes(
        &self,
        stream: u32,
        span: Span,
        key: u32,
        (bins, k): (&[TrackBin], u8),
        most: usize,
        cache: &mut TrackCache,
    ) -> Result<Option<Vec<(i64, u32)>>> {
        if min_change_count(bins, key) > most as u64 {
            return Ok(None);
        }
        let mut line = Changes {
            key,
            seeded: 0,
            most,
            list: Vec::new(),
        };
        if let Some((time, state)) = self.state_at(stream, span.from, key, cache)? {
            line.list.push((time, state));
            line.seeded = 1;
        }
        let base = self
            .stored_levels::<TrackCache>(stream, k.saturating_sub(1))
            .first()
            .copied();
        let after = Span {
            from: span.from.saturating_add(1),
            ..span
        };
        for bin in bins {
            let end = bin.start.saturating_add((1i64 << k) - 1);
            let part = Span {
                from: bin.start.max(after.from),
                to: end.min(after.to),
            };
            let cut = part.from != bin.start || part.to != end;
            if part.from > part.to || !line.may_hold_change(bin, cut) {
                continue;
            }
            let Some(base) = base else {
                self.collect_changes(stream, part, cache, &mut line);
                continue;
            };
            let mut finer = Vec::new();
            let floored = Span {
                from: pyramid::bin_start(part.from, base),
                ..part
            };
            let covered =
                self.visit_stored_bins(stream, base, floored, cache, |bin| finer.push(bin));
            for bin in &finer {
                let end = bin.start.saturating_add((1i64 << base) - 1);
                let small = Span {
                    from: bin.start.max(part.from),
                    to: end.min(part.to),
                };
                if line.may_hold_change(bin, small.from != bin.start || small.to != end) {
                    self.collect_changes(stream, small, cache, &mut line);
                }
            }
            if covered <= part.to {
                let rest = Span {
                    from: covered.max(part.from),
                    ..part
                };
                self.collect_changes(stream, rest, cache, &mut line);
            }
            if line.is_full() {
                return Ok(None);
            }
        }
        Ok((!line.is_full()).then_some(line.list))
    }

    fn collect_changes(&self, stream: u32, span: Span, cache: &mut TrackCache, line: &mut Changes) {
        for entry in self.entries_between(stream, 0, span) {
            if line.is_full() {
                return;
            }
            cache.visit_messages(self, &entry, span, |time, values| {
                line.note_values(time, values)
            });
        }
    }

    /// Returns the time and state of the last message at or before `time`, if it has a state for this key.
    fn state_at(
        &self,
        stream: u32,
        time: i64,
        key: u32,
        cache: &mut TrackCache,
    ) -> Result<Option<(i64, u32)>> {
        let next = self.ordinal_from(stream, time.saturating_add(1))?;
        let Some(ordinal) = next.checked_sub(1) else {
            return Ok(None);
        };
        let Some(entry) = self.entry_at(stream, ordinal)? else {
            return Ok(None);
        };
        let mut found = None;
        let latest = Span {
            from: i64::MIN,
            to: time,
        };
        cache.visit_messages(self, &entry, latest, |at, values| {
            found = values.iter().find_map(|(name, value)| match value {
                TrackValue::State(state) if *name == key => Some((at, *state)),
                _ => None,
            });
        });
        Ok(found)
    }
}

/// The changes found so far.
struct Changes {
    key: u32,
    /// 1 if the first item is the state at the start of the span and not a change.
    seeded: usize,
    most: usize,
    list: Vec<(i64, u32)>,
}

impl Changes {
    fn is_full(&self) -> bool {
        self.list.len() - self.seeded > self.most
    }

    fn last_state(&self) -> Option<u32> {
        self.list.last().map(|(_, state)| *state)
    }

    /// Returns whether a bin may contain a change; `cut` says that the span covers only a part of the bin.
    fn may_hold_change(&self, bin: &TrackBin, cut: bool) -> bool {
        bin.tracks.iter().any(|(key, track)| match track {
            Track::States { first, changes, .. } if *key == self.key => {
                cut || *changes > 0 || Some(*first) != self.last_state()
            }
            _ => false,
        })
    }

    fn note_values(&mut self, time: i64, values: &[(u32, TrackValue)]) {
        for (key, value) in values {
            if let TrackValue::State(state) = value {
                if *key == self.key && self.last_state() != Some(*state) && !self.is_full() {
                    self.list.push((time, *state));
                }
            }
        }
    }
}

/// Counts the changes that are certain to be between the first bin and the last.
fn min_change_count(bins: &[TrackBin], key: u32) -> u64 {
    let inner = bins.get(1..bins.len().saturating_sub(1)).unwrap_or(&[]);
    let mut before = None;
    let mut sum = 0;
    for (name, track) in inner.iter().flat_map(|bin| &bin.tracks) {
        if let Track::States {
            first,
            last,
            changes,
            ..
        } = track
        {
            if *name == key {
                sum += changes + u64::from(before.is_some_and(|before| before != *first));
                before = Some(*last);
            }
        }
    }
    sum
}

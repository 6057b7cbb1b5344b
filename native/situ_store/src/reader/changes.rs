//! When a state changed: one by one, as long as that is not too often.

use super::levels::{Pyramid, Span};
use super::tracks::Known;
use super::Reader;
use crate::error::Result;
use crate::pyramid;
use crate::tracks::{Noted, Tally, Track};

impl Reader {
    /// The changes of a key's state within a span, if there are at most so many.
    pub(super) fn changes(
        &self,
        stream: u32,
        span: Span,
        key: u32,
        (bins, k): (&[Tally], u8),
        most: usize,
        known: &mut Known,
    ) -> Result<Option<Vec<(i64, u32)>>> {
        if least_changes(bins, key) > most as u64 {
            return Ok(None);
        }
        let mut line = Changes {
            key,
            seeded: 0,
            most,
            told: Vec::new(),
        };
        if let Some((time, state)) = self.in_force(stream, span.from, key, known)? {
            line.told.push((time, state));
            line.seeded = 1;
        }
        let base = self
            .levels::<Known>(stream, k.saturating_sub(1))
            .first()
            .copied();
        let behind = Span {
            from: span.from.saturating_add(1),
            ..span
        };
        for bin in bins {
            let end = bin.start.saturating_add((1i64 << k) - 1);
            let part = Span {
                from: bin.start.max(behind.from),
                to: end.min(behind.to),
            };
            let cut = part.from != bin.start || part.to != end;
            if part.from > part.to || !line.wants(bin, cut) {
                continue;
            }
            let Some(base) = base else {
                self.changes_of_messages(stream, part, known, &mut line);
                continue;
            };
            let mut finer = Vec::new();
            let floored = Span {
                from: pyramid::floor(part.from, base),
                ..part
            };
            let covered = self.stored(stream, base, floored, known, |bin| finer.push(bin));
            for bin in &finer {
                let end = bin.start.saturating_add((1i64 << base) - 1);
                let small = Span {
                    from: bin.start.max(part.from),
                    to: end.min(part.to),
                };
                if line.wants(bin, small.from != bin.start || small.to != end) {
                    self.changes_of_messages(stream, small, known, &mut line);
                }
            }
            if covered <= part.to {
                let rest = Span {
                    from: covered.max(part.from),
                    ..part
                };
                self.changes_of_messages(stream, rest, known, &mut line);
            }
            if line.full() {
                return Ok(None);
            }
        }
        Ok((!line.full()).then_some(line.told))
    }

    fn changes_of_messages(&self, stream: u32, span: Span, known: &mut Known, line: &mut Changes) {
        for entry in self.entries_between(stream, 0, span) {
            if line.full() {
                return;
            }
            known.messages(self, &entry, span, |time, values| line.see(time, values));
        }
    }

    /// The last message at or before a time, if it has a state of this key.
    fn in_force(
        &self,
        stream: u32,
        time: i64,
        key: u32,
        known: &mut Known,
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
        known.messages(self, &entry, latest, |at, values| {
            found = values.iter().find_map(|(name, value)| match value {
                Noted::State(state) if *name == key => Some((at, *state)),
                _ => None,
            });
        });
        Ok(found)
    }
}

/// The changes found so far.
struct Changes {
    key: u32,
    /// 1 when the first one told was in force before.
    seeded: usize,
    most: usize,
    told: Vec<(i64, u32)>,
}

impl Changes {
    fn full(&self) -> bool {
        self.told.len() - self.seeded > self.most
    }

    fn state(&self) -> Option<u32> {
        self.told.last().map(|(_, state)| *state)
    }

    /// Whether a bin (of which a part is `cut` off) may hold a change.
    fn wants(&self, bin: &Tally, cut: bool) -> bool {
        bin.tracks.iter().any(|(key, track)| match track {
            Track::States { first, changes, .. } if *key == self.key => {
                cut || *changes > 0 || Some(*first) != self.state()
            }
            _ => false,
        })
    }

    fn see(&mut self, time: i64, values: &[(u32, Noted)]) {
        for (key, value) in values {
            if let Noted::State(state) = value {
                if *key == self.key && self.state() != Some(*state) && !self.full() {
                    self.told.push((time, *state));
                }
            }
        }
    }
}

/// Changes that lie between the first bin and the last for certain.
fn least_changes(bins: &[Tally], key: u32) -> u64 {
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

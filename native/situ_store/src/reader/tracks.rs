//! What a timeline shows of any stream: counts, states and the keys of maps, from stored bins, and at last from the
//! messages.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard};

use super::Reader;
use crate::error::Result;
use crate::format::*;
use crate::pyramid::{self, Bin, Builder, Folder};
use crate::tracks::{self, Names, Noted, Part, Tally, Track, ITSELF};

/// More messages without stored bins are folded once and kept.
const MANY: u64 = 400_000;

/// The answer of `Reader::tracks`; keys and states are numbers of `names`.
pub struct Told {
    pub counts: Vec<(i64, u64)>,
    pub tracks: Vec<(u32, Line)>,
}

/// A bin's start and last state, and how many messages had which.
pub type StateBin = (i64, u32, Vec<(u32, u64)>);

/// What one track shows.
pub enum Line {
    Numbers(Vec<Bin>),
    /// When the state changed, the one in force at the beginning first.
    Changes(Vec<(i64, u32)>),
    /// Per bin its last state, and how many messages had which, the most frequent first.
    States(Vec<StateBin>),
}

/// What is remembered of one stream between questions.
#[derive(Default)]
pub struct Known {
    pub names: Names,
    computed: Option<Computed>,
}

#[derive(Default)]
struct Computed {
    builder: Builder<Tally>,
    levels: BTreeMap<u8, Vec<Tally>>,
    seen: u64,
}

/// Times that are asked about, both ends included.
#[derive(Clone, Copy)]
struct Span {
    from: i64,
    to: i64,
}

const EVER: Span = Span {
    from: i64::MIN,
    to: i64::MAX,
};

pub type KnownStreams = Mutex<BTreeMap<u32, Arc<Mutex<Known>>>>;

pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex
        .lock()
        .unwrap_or_else(|poisoned| poisoned.into_inner())
}

impl Reader {
    /// The names that the answers about a stream speak in. Held while one is read.
    pub fn known(&self, stream: u32) -> Arc<Mutex<Known>> {
        lock(&self.known).entry(stream).or_default().clone()
    }

    /// Counts and tracks of a stream from `from` to `to` in bins of 2^k ns. Up to `most` changes of a state are told
    /// one by one.
    pub fn tracks(
        &self,
        stream: u32,
        from: i64,
        to: i64,
        k: u8,
        most: usize,
        known: &mut Known,
    ) -> Result<Told> {
        let k = k.min(62);
        let span = Span { from, to };
        let whole = Span {
            from: pyramid::floor(from, k),
            to: pyramid::floor(to, k).saturating_add((1i64 << k) - 1),
        };
        let bins = self.tallies(stream, whole, k, known)?;
        let mut keys: Vec<(u32, bool)> = Vec::new();
        for (key, track) in bins.iter().flat_map(|bin| &bin.tracks) {
            let kind = (*key, matches!(track, Track::Numbers { .. }));
            if !keys.contains(&kind) {
                keys.push(kind);
            }
        }
        let mut told = Told {
            counts: bins.iter().map(|bin| (bin.start, bin.count)).collect(),
            tracks: Vec::new(),
        };
        if !self.boolean(&bins, &known.names) {
            let numbers = self.summary(stream, from, to, k)?;
            if !numbers.is_empty() && !told.counts.is_empty() {
                told.tracks.push((ITSELF, Line::Numbers(numbers)));
            }
        }
        for (key, numbers) in keys {
            let line = if numbers {
                Line::Numbers(numbers_of(&bins, key))
            } else {
                match self.changes(stream, span, key, (&bins, k), most, known)? {
                    Some(changes) => Line::Changes(changes),
                    None => Line::States(states_of(&bins, key)),
                }
            };
            told.tracks.push((key, line));
        }
        self.whole()?;
        Ok(told)
    }

    /// Truths are states, though they have a signal too.
    fn boolean(&self, bins: &[Tally], names: &Names) -> bool {
        let truth = |state: &u32| {
            names
                .state_term(*state)
                .is_some_and(|term| term.ends_with(b"true") || term.ends_with(b"false"))
        };
        let of_itself = bins
            .iter()
            .flat_map(|bin| &bin.tracks)
            .filter(|(key, _)| *key == ITSELF);
        of_itself.into_iter().any(|(_, track)| match track {
            Track::States { counts, .. } => counts.iter().any(|(state, _)| truth(state)),
            Track::Numbers { .. } => false,
        })
    }

    /// Bins of width 2^k over a span that begins and ends with one.
    fn tallies(&self, stream: u32, span: Span, k: u8, known: &mut Known) -> Result<Vec<Tally>> {
        let mut folder = Folder::new(k);
        let levels: Vec<u8> = {
            let index = self.lock_index();
            let range = (stream, TRACKS)..=(stream, TRACKS + k);
            let present = index.directories.range(range);
            present
                .map(|((_, level), _)| *level - TRACKS)
                .rev()
                .collect()
        };
        let mut at = span.from;
        for level in levels {
            at = self.stored(stream, level, Span { from: at, ..span }, known, |bin| {
                folder.add(bin);
            });
            if at > span.to {
                return Ok(folder.bins);
            }
        }
        self.fold_noted(stream, Span { from: at, ..span }, k, known, &mut folder)?;
        Ok(folder.bins)
    }

    /// The stored bins of a level that begin within a span; the time behind the last of them.
    fn stored(
        &self,
        stream: u32,
        level: u8,
        span: Span,
        known: &mut Known,
        mut each: impl FnMut(Tally),
    ) -> i64 {
        let width = 1i64 << level;
        let mut at = span.from;
        for entry in self.entries_between(stream, TRACKS + level, span.from, span.to) {
            // Damaged bins are no damage to the recording: finer levels and the messages tell what they lack.
            let Ok(chunk) = self.chunk(&entry) else {
                return at;
            };
            let wanted = tracks::Wanted {
                count: chunk.header.count,
                first: chunk.header.first,
                k: level,
                from: at,
            };
            let whole = tracks::decode(chunk.body(), wanted, &mut known.names, |bin| {
                if bin.start > span.to {
                    return false;
                }
                if bin.start >= at {
                    at = bin.start.saturating_add(width);
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
            let entries = index.entries(stream, TRACKS + level);
            entries.and_then(|entries| entries.last()).map(|e| e.last)
        };
        let covered = last.map_or(i64::MIN, |last| last.saturating_add(width));
        at.max(covered.min(span.to.saturating_add(1)))
    }

    fn fold_noted(
        &self,
        stream: u32,
        span: Span,
        k: u8,
        known: &mut Known,
        folder: &mut Folder<Tally>,
    ) -> Result<()> {
        let entries = self.entries_between(stream, 0, span.from, span.to);
        let messages: u64 = entries.iter().map(|e| u64::from(e.count)).sum();
        let mut at = span.from;
        if messages > MANY {
            self.catch_up_tracks(stream, known);
            if let Some(computed) = &known.computed {
                if let Some((level, bins)) = computed.levels.range(..=k).next_back() {
                    let start = bins.partition_point(|bin| bin.start < at);
                    for bin in bins[start..].iter().take_while(|bin| bin.start <= span.to) {
                        at = bin.start.saturating_add(1i64 << level);
                        folder.add(bin.clone());
                    }
                }
            }
        }
        for entry in entries.iter().filter(|entry| entry.last >= at) {
            let rest = Span { from: at, ..span };
            self.each_noted(entry, rest, &mut known.names, |time, values| {
                let mut bin = Tally::empty(time);
                bin.note(values);
                folder.add(bin);
            });
        }
        Ok(())
    }

    /// All levels of a stream that has none, made in memory once; follows a store that grows.
    fn catch_up_tracks(&self, stream: u32, known: &mut Known) {
        let count = self.count(stream);
        let mut computed = known.computed.take().unwrap_or_default();
        while computed.seen < count {
            let Ok(Some(entry)) = self.entry_at(stream, computed.seen) else {
                break;
            };
            self.each_noted(&entry, EVER, &mut known.names, |time, values| {
                computed.builder.observe(
                    time,
                    |bin| bin.note(values),
                    || {
                        let mut bin = Tally::empty(time);
                        bin.note(values);
                        bin
                    },
                );
            });
            computed.seen = entry.ordinal + u64::from(entry.count);
        }
        for (level, bins) in computed.builder.take_ready(1) {
            computed.levels.entry(level).or_default().extend(bins);
        }
        known.computed = Some(computed);
    }

    /// Every message of a chunk within a span, with the values of its keys.
    fn each_noted(
        &self,
        entry: &Entry,
        span: Span,
        names: &mut Names,
        mut each: impl FnMut(i64, &[(u32, Noted)]),
    ) {
        // A large message has no tracks, and looking at it costs its bytes.
        if entry.lane == LANE_LARGE && entry.length as usize >= LARGE_MESSAGE {
            if entry.first >= span.from && entry.first <= span.to {
                each(entry.first, &[]);
            }
            return;
        }
        let Ok(chunk) = self.chunk(entry) else { return };
        let mut values = Vec::new();
        for (envelope, value) in chunk.messages().map_while(|message| message.ok()) {
            if envelope.time < span.from {
                continue;
            }
            if envelope.time > span.to {
                return;
            }
            values.clear();
            tracks::parts(chunk.header.encoding, &value, chunk.body(), |key, part| {
                let key = match key {
                    [] => Some(ITSELF),
                    key => names.key(key),
                };
                let Some(key) = key else { return };
                values.push(match part {
                    Part::Number(x) => (key, Noted::Number(x)),
                    Part::State(term) => (key, Noted::State(names.state(key, term))),
                });
            });
            each(envelope.time, &values);
        }
    }

    /// The changes of a key's state within a span, if there are at most so many.
    fn changes(
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
        let base = {
            let index = self.lock_index();
            let range = (stream, TRACKS)..=(stream, TRACKS + k.saturating_sub(1));
            let lowest = (k > 1).then(|| index.directories.range(range).next());
            lowest.flatten().map(|((_, level), _)| *level - TRACKS)
        };
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
        for entry in self.entries_between(stream, 0, span.from, span.to) {
            if line.full() {
                return;
            }
            self.each_noted(&entry, span, &mut known.names, |time, values| {
                line.see(time, values);
            });
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
        self.each_noted(&entry, latest, &mut known.names, |at, values| {
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

fn numbers_of(bins: &[Tally], key: u32) -> Vec<Bin> {
    let of = |bin: &Tally| {
        bin.tracks.iter().find_map(|(name, track)| match *track {
            Track::Numbers {
                min,
                max,
                last,
                count,
            } if *name == key => Some(Bin {
                start: bin.start,
                min,
                max,
                last,
                count,
            }),
            _ => None,
        })
    };
    bins.iter().filter_map(of).collect()
}

fn states_of(bins: &[Tally], key: u32) -> Vec<StateBin> {
    let of = |bin: &Tally| {
        bin.tracks.iter().find_map(|(name, track)| match track {
            Track::States { last, counts, .. } if *name == key => {
                let mut counts = counts.clone();
                counts.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
                Some((bin.start, *last, counts))
            }
            _ => None,
        })
    };
    bins.iter().filter_map(of).collect()
}

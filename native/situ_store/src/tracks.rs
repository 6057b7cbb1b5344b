//! Tracks: bins that count messages of any type, and hold their states and the values of their keys. See
//! `priv/schema/store.md`.

mod coding;
mod names;
mod parts;

pub use coding::{check, decode, encode, Wanted};
pub use names::{Names, OTHER};
use parts::{parts, Part};

use crate::chunk::Value;
use crate::format::Encoding;
use crate::pyramid::Fold;

/// The key of the message itself.
pub const ITSELF: u32 = 0;

/// One key's values of one kind in one bin.
#[derive(Debug, Clone, PartialEq)]
pub enum Track {
    /// Extremes, last value and how many there were.
    Numbers {
        /// The lowest value.
        min: f64,
        /// The highest value.
        max: f64,
        /// The latest value.
        last: f64,
        /// How many values there were.
        count: u64,
    },
    /// First and last state, how often it changed in between, and how many messages had which, in the order they came.
    States {
        /// The number of the first state.
        first: u32,
        /// The number of the last state.
        last: u32,
        /// How often the state changed.
        changes: u64,
        /// How many messages had which state, in the order of their first appearance.
        counts: Vec<(u32, u64)>,
    },
}

impl Track {
    fn of(value: Noted) -> Track {
        match value {
            Noted::Number(x) => Track::Numbers {
                min: x,
                max: x,
                last: x,
                count: 1,
            },
            Noted::State(state) => Track::States {
                first: state,
                last: state,
                changes: 0,
                counts: vec![(state, 1)],
            },
        }
    }

    fn same_kind(&self, other: &Track) -> bool {
        matches!(self, Track::Numbers { .. }) == matches!(other, Track::Numbers { .. })
    }

    /// Takes in one more value of its kind; `false` when it is of the other.
    fn note(&mut self, value: Noted) -> bool {
        match (self, value) {
            (
                Track::Numbers {
                    min,
                    max,
                    last,
                    count,
                },
                Noted::Number(x),
            ) => {
                *min = min.min(x);
                *max = max.max(x);
                *last = x;
                *count += 1;
                true
            }
            (
                Track::States {
                    last,
                    changes,
                    counts,
                    ..
                },
                Noted::State(state),
            ) => {
                *changes += u64::from(*last != state);
                *last = state;
                add(counts, state, 1);
                true
            }
            _ => false,
        }
    }

    fn absorb(&mut self, later: &Track) {
        match (self, later) {
            (
                Track::Numbers {
                    min,
                    max,
                    last,
                    count,
                },
                Track::Numbers {
                    min: low,
                    max: high,
                    last: end,
                    count: n,
                },
            ) => {
                *min = min.min(*low);
                *max = max.max(*high);
                *last = *end;
                *count += n;
            }
            (
                Track::States {
                    last,
                    changes,
                    counts,
                    ..
                },
                Track::States {
                    first,
                    last: end,
                    changes: more,
                    counts: others,
                },
            ) => {
                *changes += more + u64::from(*last != *first);
                *last = *end;
                others.iter().for_each(|(state, n)| add(counts, *state, *n));
            }
            _ => {}
        }
    }
}

fn add(counts: &mut Vec<(u32, u64)>, state: u32, n: u64) {
    match counts.iter_mut().find(|(known, _)| *known == state) {
        Some((_, count)) => *count += n,
        None => counts.push((state, n)),
    }
}

/// A value of a key, its state by number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Noted {
    /// A number.
    Number(f64),
    /// The number of a state.
    State(u32),
}

/// Adds a message's values, each with the number that `names` gives its key.
pub fn note(
    encoding: Encoding,
    value: &Value,
    body: &[u8],
    names: &mut Names,
    into: &mut Vec<(u32, Noted)>,
) {
    parts(encoding, value, body, |key, part| {
        let key = match key {
            [] => Some(ITSELF),
            key => names.key(key),
        };
        into.extend(key.map(|key| match part {
            Part::Number(value) => (key, Noted::Number(value)),
            Part::State(term) => (key, Noted::State(names.state(key, term))),
        }));
    });
}

/// A bin: how many messages lie in it, and its tracks by key.
#[derive(Debug, Clone, PartialEq)]
pub struct Tally {
    /// Where the bin starts, ns.
    pub start: i64,
    /// How many messages lie in it.
    pub count: u64,
    /// Its tracks, by the number of their key.
    pub tracks: Vec<(u32, Track)>,
}

impl Tally {
    /// A bin with nothing in it yet.
    pub fn empty(start: i64) -> Self {
        Tally {
            start,
            count: 0,
            tracks: Vec::new(),
        }
    }
}

impl Fold for Tally {
    type Value = [(u32, Noted)];

    fn of(time: i64, values: &[(u32, Noted)]) -> Self {
        let mut bin = Tally::empty(time);
        bin.note(values);
        bin
    }

    fn note(&mut self, values: &[(u32, Noted)]) {
        self.count += 1;
        for (key, value) in values {
            let known = self
                .tracks
                .iter_mut()
                .any(|(name, track)| name == key && track.note(*value));
            if !known {
                self.tracks.push((*key, Track::of(*value)));
            }
        }
    }

    fn start(&self) -> i64 {
        self.start
    }

    fn at(mut self, start: i64) -> Self {
        self.start = start;
        self
    }

    fn absorb(&mut self, later: &Self) {
        self.count += later.count;
        for (key, track) in &later.tracks {
            let known = self
                .tracks
                .iter_mut()
                .find(|(name, known)| name == key && known.same_kind(track));
            match known {
                Some((_, known)) => known.absorb(track),
                None => self.tracks.push((*key, track.clone())),
            }
        }
    }
}

//! Tracks: bins that count messages of any type and summarize their states and the values of their keys. See
//! `priv/schema/store.md`.

mod coding;
mod names;
mod parts;

pub use coding::{check_bins, decode_bins, encode_bins, BinQuery};
pub use names::{Names, OTHER_STATES};
use parts::{visit_parts, Part};

use crate::chunk::Value;
use crate::format::Encoding;
use crate::pyramid::Fold;

/// The key of the message itself.
pub const MESSAGE_KEY: u32 = 0;

/// The values of one kind that one key has in one bin.
#[derive(Debug, Clone, PartialEq)]
pub enum Track {
    /// Extremes, last value, and count.
    Numbers {
        /// The lowest value.
        min: f64,
        /// The highest value.
        max: f64,
        /// The latest value.
        last: f64,
        /// The number of values.
        count: u64,
    },
    /// First and last state, the number of changes in between, and the number of messages with each state.
    States {
        /// The number of the first state.
        first: u32,
        /// The number of the last state.
        last: u32,
        /// The number of state changes.
        changes: u64,
        /// The number of messages with each state, in order of first appearance.
        counts: Vec<(u32, u64)>,
    },
}

impl Track {
    fn from_value(value: TrackValue) -> Track {
        match value {
            TrackValue::Number(x) => Track::Numbers {
                min: x,
                max: x,
                last: x,
                count: 1,
            },
            TrackValue::State(state) => Track::States {
                first: state,
                last: state,
                changes: 0,
                counts: vec![(state, 1)],
            },
        }
    }

    fn has_same_kind(&self, other: &Track) -> bool {
        matches!(self, Track::Numbers { .. }) == matches!(other, Track::Numbers { .. })
    }

    /// Adds a value of the same kind. Returns `false` if it is of the other kind.
    fn add_value(&mut self, value: TrackValue) -> bool {
        match (self, value) {
            (
                Track::Numbers {
                    min,
                    max,
                    last,
                    count,
                },
                TrackValue::Number(x),
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
                TrackValue::State(state),
            ) => {
                *changes += u64::from(*last != state);
                *last = state;
                add_count(counts, state, 1);
                true
            }
            _ => false,
        }
    }

    fn merge(&mut self, later: &Track) {
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
                others
                    .iter()
                    .for_each(|(state, n)| add_count(counts, *state, *n));
            }
            _ => {}
        }
    }
}

fn add_count(counts: &mut Vec<(u32, u64)>, state: u32, n: u64) {
    match counts.iter_mut().find(|(known, _)| *known == state) {
        Some((_, count)) => *count += n,
        None => counts.push((state, n)),
    }
}

/// A value of a key. States are represented by their numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TrackValue {
    /// A number.
    Number(f64),
    /// The number of a state.
    State(u32),
}

/// Appends a message's values to `into`, each with the number of its key in `names`.
pub fn collect_values(
    encoding: Encoding,
    value: &Value,
    body: &[u8],
    names: &mut Names,
    into: &mut Vec<(u32, TrackValue)>,
) {
    visit_parts(encoding, value, body, |key, part| {
        let key = match key {
            [] => Some(MESSAGE_KEY),
            key => names.key_number(key),
        };
        into.extend(key.map(|key| match part {
            Part::Number(value) => (key, TrackValue::Number(value)),
            Part::State(term) => (key, TrackValue::State(names.state_number(key, term))),
        }));
    });
}

/// A bin: its message count and its tracks by key.
#[derive(Debug, Clone, PartialEq)]
pub struct TrackBin {
    /// The start of the bin, ns.
    pub start: i64,
    /// The number of messages.
    pub count: u64,
    /// Its tracks, by key number.
    pub tracks: Vec<(u32, Track)>,
}

impl TrackBin {
    /// Creates an empty bin.
    pub fn empty(start: i64) -> Self {
        TrackBin {
            start,
            count: 0,
            tracks: Vec::new(),
        }
    }
}

impl Fold for TrackBin {
    type Value = [(u32, TrackValue)];

    fn from_value(time: i64, values: &[(u32, TrackValue)]) -> Self {
        let mut bin = TrackBin::empty(time);
        bin.add_value(values);
        bin
    }

    fn add_value(&mut self, values: &[(u32, TrackValue)]) {
        self.count += 1;
        for (key, value) in values {
            let known = self
                .tracks
                .iter_mut()
                .any(|(name, track)| name == key && track.add_value(*value));
            if !known {
                self.tracks.push((*key, Track::from_value(*value)));
            }
        }
    }

    fn start_time(&self) -> i64 {
        self.start
    }

    fn with_start(mut self, start: i64) -> Self {
        self.start = start;
        self
    }

    fn merge(&mut self, later: &Self) {
        self.count += later.count;
        for (key, track) in &later.tracks {
            let known = self
                .tracks
                .iter_mut()
                .find(|(name, known)| name == key && known.has_same_kind(track));
            match known {
                Some((_, known)) => known.merge(track),
                None => self.tracks.push((*key, track.clone())),
            }
        }
    }
}

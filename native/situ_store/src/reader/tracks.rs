//! The data of a timeline for streams of any type: counts, states and the keys of maps, from stored bins, and where
//! these lack from the messages.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use super::levels::{self, Made, Pyramid, Span};
use super::{lock, Chunk, Reader};
use crate::error::Result;
use crate::format::*;
use crate::pyramid::Bin;
use crate::tracks::{self, Names, Noted, Tally, Track, ITSELF};

/// The answer of `Reader::tracks`; keys and states are numbers of `names`.
pub struct Told {
    /// Per bin its start (ns) and how many messages lie in it.
    pub counts: Vec<(i64, u64)>,
    /// The tracks, by the number of their key.
    pub tracks: Vec<(u32, Line)>,
}

/// A bin's start and last state, and how many messages had which.
pub type StateBin = (i64, u32, Vec<(u32, u64)>);

/// The data of one track.
pub enum Line {
    /// Bins of a number.
    Numbers(Vec<Bin>),
    /// The times (ns) of the state's changes with the new states; first the state at the beginning.
    Changes(Vec<(i64, u32)>),
    /// Per bin its last state, and how many messages had which, the most frequent first.
    States(Vec<StateBin>),
}

/// One stream's names and bins, kept between calls.
#[derive(Default)]
pub struct Known {
    /// Numbers of the stream's keys and states.
    pub names: Names,
    made: Arc<Mutex<Made<Tally>>>,
}

pub type KnownStreams = Mutex<BTreeMap<u32, Arc<Mutex<Known>>>>;

impl Pyramid for Known {
    type Bin = Tally;

    const ABOVE: u8 = TRACKS;

    fn bins(
        &mut self,
        chunk: &Chunk,
        level: u8,
        from: i64,
        each: impl FnMut(Tally) -> bool,
    ) -> Option<()> {
        let wanted = tracks::Wanted {
            count: chunk.header.count,
            first: chunk.header.first,
            k: level,
            from,
        };
        tracks::decode(chunk.body(), wanted, &mut self.names, each)
    }

    fn messages(
        &mut self,
        reader: &Reader,
        entry: &Entry,
        span: Span,
        mut each: impl FnMut(i64, &[(u32, Noted)]),
    ) {
        // It is counted only.
        if levels::undrawn(entry) {
            if span.holds(entry.first) {
                each(entry.first, &[]);
            }
            return;
        }
        let Ok(chunk) = reader.chunk(entry) else {
            return;
        };
        let mut values = Vec::new();
        for (envelope, value) in chunk.messages().map_while(|message| message.ok()) {
            if envelope.time > span.to {
                return;
            }
            if envelope.time >= span.from {
                values.clear();
                let (encoding, body) = (chunk.header.encoding, chunk.body());
                tracks::note(encoding, &value, body, &mut self.names, &mut values);
                each(envelope.time, &values);
            }
        }
    }

    fn made(&self, _reader: &Reader, _stream: u32) -> Arc<Mutex<Made<Tally>>> {
        self.made.clone()
    }
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
        let bins = self.bins(stream, span.in_bins(k), k, known);
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

//! Reads the data of a timeline for streams of any type: counts, states and the keys of maps, from stored bins or,
//! where there are none, from the messages.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use super::levels::{self, MemoryPyramid, Pyramid, Span};
use super::{has_absent, lock_mutex, Chunk, Reader};
use crate::error::{Error, Result};
use crate::format::*;
use crate::pyramid::Bin;
use crate::tracks::{self, Names, Track, TrackBin, TrackValue, MESSAGE_KEY};

/// The result of `Reader::read_tracks`. Keys and states are numbers of `names`.
pub struct TrackData {
    /// The start (ns) and the number of messages of each bin.
    pub counts: Vec<(i64, u64)>,
    /// The tracks, by key number.
    pub tracks: Vec<(u32, Line)>,
}

/// A bin's start, its last state, and the number of messages with each state.
pub type StateBin = (i64, u32, Vec<(u32, u64)>);

/// The data of one track.
pub enum Line {
    /// Bins of a number.
    Numbers(Vec<Bin>),
    /// The times (ns) of the state's changes with the new states, starting with the state at the beginning.
    Changes(Vec<(i64, u32)>),
    /// The last state of each bin and the number of messages with each state, most frequent first.
    States(Vec<StateBin>),
}

/// One stream's names and bins, cached between calls.
#[derive(Default)]
pub struct TrackCache {
    /// The numbers of the stream's keys and states.
    pub names: Names,
    memory_pyramid: Arc<Mutex<MemoryPyramid<TrackBin>>>,
}

pub type TrackCaches = Mutex<BTreeMap<u32, Arc<Mutex<TrackCache>>>>;

impl Pyramid for TrackCache {
    type Bin = TrackBin;

    const LEVEL_OFFSET: u8 = TRACKS;

    fn decode_bins(
        &mut self,
        chunk: &Chunk,
        level: u8,
        from: i64,
        each: impl FnMut(TrackBin) -> bool,
    ) -> Option<()> {
        let query = tracks::BinQuery {
            count: chunk.header.count,
            first: chunk.header.first,
            k: level,
            from,
        };
        tracks::decode_bins(chunk.body(), query, &mut self.names, each)
    }

    fn visit_messages(
        &mut self,
        reader: &Reader,
        entry: &Entry,
        span: Span,
        mut each: impl FnMut(i64, &[(u32, TrackValue)]),
    ) {
        // The message is only counted.
        if levels::is_too_large_to_draw(entry) {
            if span.contains(entry.first) {
                each(entry.first, &[]);
            }
            return;
        }
        let Ok(chunk) = reader.read_chunk(entry) else {
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
                tracks::collect_values(encoding, &value, body, &mut self.names, &mut values);
                each(envelope.time, &values);
            }
        }
    }

    fn memory_pyramid(
        &self,
        _reader: &Reader,
        _stream: u32,
    ) -> Arc<Mutex<MemoryPyramid<TrackBin>>> {
        self.memory_pyramid.clone()
    }
}

impl Reader {
    /// Returns the cache that contains the names used in results about a stream. It is locked while a result is
    /// read.
    pub fn track_cache(&self, stream: u32) -> Arc<Mutex<TrackCache>> {
        lock_mutex(&self.track_caches)
            .entry(stream)
            .or_default()
            .clone()
    }

    /// Returns counts and tracks of a stream from `from` to `to` in bins of 2^k ns. Up to `most` changes of a state
    /// are listed one by one.
    pub fn read_tracks(
        &self,
        stream: u32,
        from: i64,
        to: i64,
        k: u8,
        most: usize,
        cache: &mut TrackCache,
    ) -> Result<TrackData> {
        let k = k.min(62);
        let span = Span { from, to };
        let bins = self.fold_bins(stream, span.extend_to_bins(k), k, cache);
        if has_absent() {
            return Err(Error::Absent);
        }
        let mut keys: Vec<(u32, bool)> = Vec::new();
        for (key, track) in bins.iter().flat_map(|bin| &bin.tracks) {
            let kind = (*key, matches!(track, Track::Numbers { .. }));
            if !keys.contains(&kind) {
                keys.push(kind);
            }
        }
        let mut data = TrackData {
            counts: bins.iter().map(|bin| (bin.start, bin.count)).collect(),
            tracks: Vec::new(),
        };
        if !self.has_booleans(&bins, &cache.names) {
            let numbers = self.read_summary(stream, from, to, k)?;
            if !numbers.is_empty() && !data.counts.is_empty() {
                data.tracks.push((MESSAGE_KEY, Line::Numbers(numbers)));
            }
        }
        for (key, numbers) in keys {
            let line = if numbers {
                Line::Numbers(number_bins(&bins, key))
            } else {
                match self.list_changes(stream, span, key, (&bins, k), most, cache)? {
                    Some(changes) => Line::Changes(changes),
                    None => Line::States(state_bins(&bins, key)),
                }
            };
            data.tracks.push((key, line));
        }
        self.check_intact()?;
        Ok(data)
    }

    /// Returns whether the messages are booleans, which are states although they also have a signal.
    fn has_booleans(&self, bins: &[TrackBin], names: &Names) -> bool {
        let truth = |state: &u32| {
            names
                .state_term(*state)
                .is_some_and(|term| term.ends_with(b"true") || term.ends_with(b"false"))
        };
        let of_itself = bins
            .iter()
            .flat_map(|bin| &bin.tracks)
            .filter(|(key, _)| *key == MESSAGE_KEY);
        of_itself.into_iter().any(|(_, track)| match track {
            Track::States { counts, .. } => counts.iter().any(|(state, _)| truth(state)),
            Track::Numbers { .. } => false,
        })
    }
}

fn number_bins(bins: &[TrackBin], key: u32) -> Vec<Bin> {
    let of = |bin: &TrackBin| {
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

fn state_bins(bins: &[TrackBin], key: u32) -> Vec<StateBin> {
    let of = |bin: &TrackBin| {
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

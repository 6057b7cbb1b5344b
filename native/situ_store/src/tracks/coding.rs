//! Encodes and decodes the body of a chunk of bins.

use std::collections::BTreeMap;

use super::{Names, Track, TrackBin, MESSAGE_KEY, OTHER_STATES};
use crate::varint::{self, Cursor};

/// The maximum of any count in a chunk. A chunk with a larger count is damaged.
const MAX_COUNT: u64 = 1 << 16;

/// Encodes bins of width 2^k in time order: first the terms of their keys and states, then the bins.
pub fn encode_bins(bins: &[TrackBin], k: u8, names: &Names) -> Vec<u8> {
    let mut keys: BTreeMap<u32, u64> = BTreeMap::new();
    let mut states: BTreeMap<u32, u64> = BTreeMap::new();
    for (key, track) in bins.iter().flat_map(|bin| &bin.tracks) {
        keys.insert(*key, 0);
        if let Track::States { counts, .. } = track {
            states.extend(counts.iter().map(|(state, _)| (*state, 0)));
        }
    }
    keys.remove(&MESSAGE_KEY);
    states.remove(&OTHER_STATES);
    let mut out = Vec::new();
    put_terms(&mut out, &mut keys, |number| names.key_term(number));
    put_terms(&mut out, &mut states, |number| names.state_term(number));
    let state = |number: &u32| states.get(number).copied().unwrap_or(0);
    let mut previous = bins.first().map_or(0, |bin| bin.start);
    for bin in bins {
        varint::put(&mut out, (bin.start.wrapping_sub(previous) as u64) >> k);
        previous = bin.start;
        varint::put(&mut out, bin.count);
        varint::put(&mut out, bin.tracks.len() as u64);
        for (key, track) in &bin.tracks {
            let key = keys.get(key).copied().unwrap_or(0);
            match track {
                Track::Numbers {
                    min,
                    max,
                    last,
                    count,
                } => {
                    varint::put(&mut out, key * 2);
                    varint::put(&mut out, *count);
                    for value in [min, max, last] {
                        out.extend_from_slice(&value.to_bits().to_le_bytes());
                    }
                }
                Track::States {
                    first,
                    last,
                    changes,
                    counts,
                } => {
                    varint::put(&mut out, key * 2 + 1);
                    varint::put(&mut out, *changes);
                    varint::put(&mut out, state(first));
                    varint::put(&mut out, state(last));
                    varint::put(&mut out, counts.len() as u64);
                    for (number, count) in counts {
                        varint::put(&mut out, state(number));
                        varint::put(&mut out, *count);
                    }
                }
            }
        }
    }
    out
}

/// Appends the external terms of these numbers and assigns local numbers to them, from 1 on.
fn put_terms<'a>(
    out: &mut Vec<u8>,
    numbers: &mut BTreeMap<u32, u64>,
    term: impl Fn(u32) -> Option<&'a [u8]>,
) {
    varint::put(out, numbers.len() as u64);
    for (index, (number, local)) in (1..).zip(numbers.iter_mut()) {
        *local = index;
        let term = term(*number).unwrap_or(&[]);
        varint::put(out, term.len() as u64);
        out.extend_from_slice(term);
    }
}

/// Selects bins of a chunk and describes how the chunk numbers them.
pub struct BinQuery {
    /// The number of bins in the chunk.
    pub count: u32,
    /// The start of the first bin.
    pub first: i64,
    /// The bins are 2^k ns wide.
    pub k: u8,
    /// Bins that begin earlier are skipped.
    pub from: i64,
}

/// Decodes the selected bins of a chunk's body and passes them to `each` until it returns `false`. Keys and states
/// get their numbers from `names`. Returns `None` if the body contradicts itself.
pub fn decode_bins(
    body: &[u8],
    query: BinQuery,
    names: &mut Names,
    mut each: impl FnMut(TrackBin) -> bool,
) -> Option<()> {
    let BinQuery {
        count,
        first,
        k,
        from,
    } = query;
    let mut cursor = Cursor::new(body);
    let key_terms = read_terms(&mut cursor)?;
    let state_terms = read_terms(&mut cursor)?;
    let keys: Vec<Option<u32>> = std::iter::once(Some(MESSAGE_KEY))
        .chain(key_terms.iter().map(|term| names.key_number(term)))
        .collect();
    let mut start = first;
    for _ in 0..count {
        let step = cursor.next_varint()?;
        let step = step.checked_shl(u32::from(k)).filter(|s| s >> k == step)?;
        start = start.checked_add_unsigned(step)?;
        if start < from {
            skip_bin(&mut cursor)?;
            continue;
        }
        let mut bin = TrackBin::empty(start);
        bin.count = cursor.next_varint()?;
        for _ in 0..check_bound(cursor.next_varint()?)? {
            let word = cursor.next_varint()?;
            let key = *keys.get((word / 2) as usize)?;
            let track = match word % 2 {
                0 => read_numbers(&mut cursor)?,
                _ => read_states(&mut cursor, key, &state_terms, names)?,
            };
            bin.tracks.extend(key.map(|key| (key, track)));
        }
        if !each(bin) {
            return Some(());
        }
    }
    (cursor.remaining() == 0).then_some(())
}

/// Skips the rest of a bin after its start.
fn skip_bin(cursor: &mut Cursor<'_>) -> Option<()> {
    cursor.next_varint()?;
    for _ in 0..check_bound(cursor.next_varint()?)? {
        if cursor.next_varint()? % 2 == 0 {
            cursor.next_varint()?;
            cursor.take(24)?;
        } else {
            cursor.next_varint()?;
            cursor.next_varint()?;
            cursor.next_varint()?;
            for _ in 0..2 * check_bound(cursor.next_varint()?)? {
                cursor.next_varint()?;
            }
        }
    }
    Some(())
}

fn check_bound(n: u64) -> Option<u64> {
    (n <= MAX_COUNT).then_some(n)
}

fn read_terms<'a>(cursor: &mut Cursor<'a>) -> Option<Vec<&'a [u8]>> {
    let n = check_bound(cursor.next_varint()?)?;
    (0..n)
        .map(|_| {
            let length = check_bound(cursor.next_varint()?)?;
            cursor.take(length as usize)
        })
        .collect()
}

fn read_numbers(cursor: &mut Cursor<'_>) -> Option<Track> {
    let count = cursor.next_varint()?;
    let mut value = || {
        let bytes = cursor.take(8)?;
        Some(crate::format::f64_at(bytes, 0))
    };
    Some(Track::Numbers {
        min: value()?,
        max: value()?,
        last: value()?,
        count,
    })
}

fn read_states(
    cursor: &mut Cursor<'_>,
    key: Option<u32>,
    terms: &[&[u8]],
    names: &mut Names,
) -> Option<Track> {
    let mut state = |cursor: &mut Cursor<'_>| {
        let local = cursor.next_varint()? as usize;
        if local == 0 {
            return Some(OTHER_STATES);
        }
        let term = terms.get(local - 1)?;
        Some(key.map_or(OTHER_STATES, |key| names.state_number(key, term)))
    };
    let changes = cursor.next_varint()?;
    let first = state(cursor)?;
    let last = state(cursor)?;
    let n = check_bound(cursor.next_varint()?)?;
    let mut counts = Vec::with_capacity(n.min(64) as usize);
    for _ in 0..n {
        let number = state(cursor)?;
        super::add_count(&mut counts, number, cursor.next_varint()?);
    }
    Some(Track::States {
        first,
        last,
        changes,
        counts,
    })
}

/// Checks that the body of a chunk contains exactly this many bins.
pub fn check_bins(body: &[u8], count: u32) -> std::result::Result<(), &'static str> {
    let mut seen = 0;
    let all = BinQuery {
        count,
        first: 0,
        k: 0,
        from: 0,
    };
    let decoded = decode_bins(body, all, &mut Names::default(), |_| {
        seen += 1;
        true
    });
    match decoded {
        Some(()) if seen == count => Ok(()),
        _ => Err("the chunk's bins contradict its length"),
    }
}

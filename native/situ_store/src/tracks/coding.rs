//! The body of a chunk of bins.

use std::collections::BTreeMap;

use super::{Names, Tally, Track, ITSELF, OTHER};
use crate::varint::{self, Cursor};

/// A chunk with more of anything than this is damaged.
const MOST: u64 = 1 << 16;

/// Bins of width 2^k in time order: the keys and states they speak of, then the bins.
pub fn encode(bins: &[Tally], k: u8, names: &Names) -> Vec<u8> {
    let mut keys: BTreeMap<u32, u64> = BTreeMap::new();
    let mut states: BTreeMap<u32, u64> = BTreeMap::new();
    for (key, track) in bins.iter().flat_map(|bin| &bin.tracks) {
        keys.insert(*key, 0);
        if let Track::States { counts, .. } = track {
            states.extend(counts.iter().map(|(state, _)| (*state, 0)));
        }
    }
    keys.remove(&ITSELF);
    states.remove(&OTHER);
    let mut out = Vec::new();
    table(&mut out, &mut keys, |number| names.key_term(number));
    table(&mut out, &mut states, |number| names.state_term(number));
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

/// The external terms of these numbers, which get those of their places, from 1 on.
fn table<'a>(
    out: &mut Vec<u8>,
    numbers: &mut BTreeMap<u32, u64>,
    term: impl Fn(u32) -> Option<&'a [u8]>,
) {
    varint::put(out, numbers.len() as u64);
    for (place, (number, local)) in (1..).zip(numbers.iter_mut()) {
        *local = place;
        let term = term(*number).unwrap_or(&[]);
        varint::put(out, term.len() as u64);
        out.extend_from_slice(term);
    }
}

/// Which bins of a chunk are wanted, and how the chunk numbers them.
pub struct Wanted {
    /// Bins in the chunk.
    pub count: u32,
    /// The start of its first.
    pub first: i64,
    /// Their width is 2^k ns.
    pub k: u8,
    /// Those that begin earlier are passed over.
    pub from: i64,
}

/// The wanted bins of a chunk's body, their keys and states numbered by `names`, until `each` says `false`. `None`
/// where the body contradicts itself.
pub fn decode(
    body: &[u8],
    wanted: Wanted,
    names: &mut Names,
    mut each: impl FnMut(Tally) -> bool,
) -> Option<()> {
    let Wanted {
        count,
        first,
        k,
        from,
    } = wanted;
    let mut cursor = Cursor::new(body);
    let key_terms = terms(&mut cursor)?;
    let state_terms = terms(&mut cursor)?;
    let keys: Vec<Option<u32>> = std::iter::once(Some(ITSELF))
        .chain(key_terms.iter().map(|term| names.key(term)))
        .collect();
    let mut start = first;
    for _ in 0..count {
        let step = cursor.varint()?;
        let step = step.checked_shl(u32::from(k)).filter(|s| s >> k == step)?;
        start = start.checked_add_unsigned(step)?;
        if start < from {
            pass(&mut cursor)?;
            continue;
        }
        let mut bin = Tally::empty(start);
        bin.count = cursor.varint()?;
        for _ in 0..bounded(cursor.varint()?)? {
            let word = cursor.varint()?;
            let key = *keys.get((word / 2) as usize)?;
            let track = match word % 2 {
                0 => numbers(&mut cursor)?,
                _ => states(&mut cursor, key, &state_terms, names)?,
            };
            bin.tracks.extend(key.map(|key| (key, track)));
        }
        if !each(bin) {
            return Some(());
        }
    }
    (cursor.remaining() == 0).then_some(())
}

/// Passes over a bin behind its start.
fn pass(cursor: &mut Cursor<'_>) -> Option<()> {
    cursor.varint()?;
    for _ in 0..bounded(cursor.varint()?)? {
        if cursor.varint()? % 2 == 0 {
            cursor.varint()?;
            cursor.take(24)?;
        } else {
            cursor.varint()?;
            cursor.varint()?;
            cursor.varint()?;
            for _ in 0..2 * bounded(cursor.varint()?)? {
                cursor.varint()?;
            }
        }
    }
    Some(())
}

fn bounded(n: u64) -> Option<u64> {
    (n <= MOST).then_some(n)
}

fn terms<'a>(cursor: &mut Cursor<'a>) -> Option<Vec<&'a [u8]>> {
    let n = bounded(cursor.varint()?)?;
    (0..n)
        .map(|_| {
            let length = bounded(cursor.varint()?)?;
            cursor.take(length as usize)
        })
        .collect()
}

fn numbers(cursor: &mut Cursor<'_>) -> Option<Track> {
    let count = cursor.varint()?;
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

fn states(
    cursor: &mut Cursor<'_>,
    key: Option<u32>,
    terms: &[&[u8]],
    names: &mut Names,
) -> Option<Track> {
    let mut state = |cursor: &mut Cursor<'_>| {
        let local = cursor.varint()? as usize;
        if local == 0 {
            return Some(OTHER);
        }
        let term = terms.get(local - 1)?;
        Some(key.map_or(OTHER, |key| names.state(key, term)))
    };
    let changes = cursor.varint()?;
    let first = state(cursor)?;
    let last = state(cursor)?;
    let n = bounded(cursor.varint()?)?;
    let mut counts = Vec::with_capacity(n.min(64) as usize);
    for _ in 0..n {
        let number = state(cursor)?;
        super::add(&mut counts, number, cursor.varint()?);
    }
    Some(Track::States {
        first,
        last,
        changes,
        counts,
    })
}

/// Whether the body of a chunk of so many bins is whole.
pub fn check(body: &[u8], count: u32) -> std::result::Result<(), &'static str> {
    let mut seen = 0;
    let all = Wanted {
        count,
        first: 0,
        k: 0,
        from: 0,
    };
    let decoded = decode(body, all, &mut Names::default(), |_| {
        seen += 1;
        true
    });
    match decoded {
        Some(()) if seen == count => Ok(()),
        _ => Err("the chunk's bins contradict its length"),
    }
}

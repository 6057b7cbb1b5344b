//! Min/max/last/count over bins of 2^k ns.

use crate::format::{f64_at, i64_at, u64_at, BIN};

/// Levels stand this many powers of two apart.
pub const STEP: u8 = 2;
/// The highest level: its bins are 2^44 ns wide, almost five hours.
pub const TOP: u8 = 44;
const WARM_UP: usize = 256;
const POINTS_PER_BIN: i64 = 32;
/// Bins of a level are written when this many are complete.
pub const FLUSH: usize = 512;

/// A span of samples: its start, extremes, last value and how many there were.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bin {
    /// The time of the sample, or where the bin starts, ns.
    pub start: i64,
    /// The lowest value.
    pub min: f64,
    /// The highest value.
    pub max: f64,
    /// The latest value.
    pub last: f64,
    /// How many values there were.
    pub count: u64,
}

impl Bin {
    /// The bin of a single sample.
    pub fn sample(time: i64, value: f64) -> Self {
        Bin {
            start: time,
            min: value,
            max: value,
            last: value,
            count: 1,
        }
    }

    /// Appends the bin's 40 bytes.
    pub fn encode(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(&self.start.to_le_bytes());
        for value in [self.min, self.max, self.last] {
            out.extend_from_slice(&value.to_bits().to_le_bytes());
        }
        out.extend_from_slice(&self.count.to_le_bytes());
    }

    /// Parses the bin that `bytes` begin with; `None` if they are too short.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        (bytes.len() >= BIN).then(|| Bin {
            start: i64_at(bytes, 0),
            min: f64_at(bytes, 8),
            max: f64_at(bytes, 16),
            last: f64_at(bytes, 24),
            count: u64_at(bytes, 32),
        })
    }
}

impl Fold for Bin {
    type Value = f64;

    fn of(time: i64, value: &f64) -> Self {
        Bin::sample(time, *value)
    }

    #[inline]
    fn note(&mut self, value: &f64) {
        self.absorb(&Bin::sample(self.start, *value));
    }

    fn start(&self) -> i64 {
        self.start
    }

    fn at(self, start: i64) -> Self {
        Bin { start, ..self }
    }

    #[inline]
    fn absorb(&mut self, later: &Bin) {
        // NaN never becomes an extreme, so one bad sample does not blank a whole zoom level.
        self.min = self.min.min(later.min);
        self.max = self.max.max(later.max);
        self.last = later.last;
        self.count += later.count;
    }
}

/// The content of a bin, folded from messages in order of time.
pub trait Fold: Clone {
    /// The part of a message that a bin takes in.
    type Value: ?Sized;
    /// A bin of one message.
    fn of(time: i64, value: &Self::Value) -> Self;
    /// Takes in a message.
    fn note(&mut self, value: &Self::Value);
    /// Its time, or that of the bin's beginning.
    fn start(&self) -> i64;
    /// The same content at another time.
    fn at(self, start: i64) -> Self;
    /// Takes in a later bin.
    fn absorb(&mut self, later: &Self);
}

/// Where the bin of level `k` that holds `time` starts.
#[inline]
pub fn floor(time: i64, k: u8) -> i64 {
    (time >> k) << k
}

/// The bin width for `pixels` over a span: the largest power of two that gives each pixel a bin of its own.
pub fn level_for(from: i64, to: i64, pixels: u32) -> u8 {
    let span = (to as i128 - from as i128).max(1) as u128;
    let width = (span / pixels.max(1) as u128).max(1);
    (127 - width.leading_zeros()).min(62) as u8
}

#[derive(Debug, Clone)]
struct Level<B> {
    k: u8,
    current: Option<B>,
    ready: Vec<B>,
}

/// Builds all levels of one stream while it is recorded.
#[derive(Debug, Clone)]
pub struct Builder<B> {
    warm: Vec<B>,
    levels: Vec<Level<B>>,
}

impl<B> Default for Builder<B> {
    fn default() -> Self {
        Builder {
            warm: Vec::new(),
            levels: Vec::new(),
        }
    }
}

impl<B: Fold> Builder<B> {
    /// Takes in a message, which mostly lies in the bin under way.
    #[inline]
    pub fn observe(&mut self, time: i64, value: &B::Value) {
        if let Some(level) = self.levels.first_mut() {
            let start = floor(time, level.k);
            if let Some(bin) = level.current.as_mut().filter(|bin| bin.start() >= start) {
                return bin.note(value);
            }
        }
        self.add(B::of(time, value));
    }

    /// Takes in a point or a bin that comes behind all others.
    pub fn add(&mut self, point: B) {
        if !self.levels.is_empty() {
            return self.feed(0, point);
        }
        self.warm.push(point);
        if self.warm.len() >= WARM_UP {
            self.choose();
        }
    }

    fn choose(&mut self) {
        let (Some(first), Some(last)) = (self.warm.first(), self.warm.last()) else {
            return;
        };
        let span = (last.start() as i128 - first.start() as i128).max(1);
        let interval = (span / (self.warm.len() as i128 - 1).max(1)).clamp(1, 1 << 40) as i64;
        let wanted = (interval * POINTS_PER_BIN) as u64;
        let base = (64 - (wanted - 1).leading_zeros()).clamp(4, (TOP - STEP) as u32) as u8;
        self.levels = (base..=TOP)
            .step_by(STEP as usize)
            .map(|k| Level {
                k,
                current: None,
                ready: Vec::new(),
            })
            .collect();
        for point in std::mem::take(&mut self.warm) {
            self.feed(0, point);
        }
    }

    #[inline]
    fn feed(&mut self, mut at: usize, point: B) {
        let mut point = point;
        while let Some(level) = self.levels.get_mut(at) {
            let start = floor(point.start(), level.k);
            match level.current.as_mut() {
                Some(bin) if bin.start() >= start => return bin.absorb(&point),
                _ => {
                    let begun = point.at(start);
                    match level.current.replace(begun) {
                        None => return,
                        Some(done) => {
                            level.ready.push(done.clone());
                            point = done;
                            at += 1;
                        }
                    }
                }
            }
        }
    }

    /// Levels with at least `least` complete bins, and those bins.
    pub fn take_ready(&mut self, least: usize) -> Vec<(u8, Vec<B>)> {
        let full = |level: &mut Level<B>| {
            (level.ready.len() >= least).then(|| (level.k, std::mem::take(&mut level.ready)))
        };
        self.levels.iter_mut().filter_map(full).collect()
    }

    /// Whether the lowest level has at least so many complete bins to write.
    pub fn has_ready(&self, least: usize) -> bool {
        self.levels
            .first()
            .is_some_and(|level| level.ready.len() >= least)
    }

    /// Puts back bins that could not be written.
    pub fn put_back(&mut self, k: u8, mut bins: Vec<B>) {
        if let Some(level) = self.levels.iter_mut().find(|level| level.k == k) {
            bins.append(&mut level.ready);
            level.ready = bins;
        }
    }

    /// The stream has ended: every bin is complete.
    pub fn finish(&mut self) {
        if self.levels.is_empty() {
            self.choose();
        }
        for at in 0..self.levels.len() {
            if let Some(done) = self.levels[at].current.take() {
                self.levels[at].ready.push(done.clone());
                self.feed(at + 1, done);
            }
        }
    }
}

/// Folds points in time order into bins of level `k`.
pub struct Folder<B> {
    k: u8,
    /// The bins so far, in order of time.
    pub bins: Vec<B>,
}

impl<B: Fold> Folder<B> {
    /// A folder without bins.
    pub fn new(k: u8) -> Self {
        Folder {
            k,
            bins: Vec::new(),
        }
    }

    /// Takes in a point or a bin that comes behind all others.
    #[inline]
    pub fn add(&mut self, point: B) {
        let start = floor(point.start(), self.k);
        match self.bins.last_mut() {
            Some(bin) if bin.start() >= start => bin.absorb(&point),
            _ => self.bins.push(point.at(start)),
        }
    }

    /// Takes in a message, as `add` does a bin of it.
    #[inline]
    pub fn observe(&mut self, time: i64, value: &B::Value) {
        let start = floor(time, self.k);
        match self.bins.last_mut() {
            Some(bin) if bin.start() >= start => bin.note(value),
            _ => self.bins.push(B::of(start, value)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_agree_with_folding_the_points() {
        let mut builder = Builder::default();
        let points: Vec<Bin> = (0..50_000)
            .map(|i| Bin::sample(i * 1_000 + (i % 7), ((i * 37) % 101) as f64))
            .collect();
        points.iter().for_each(|p| builder.add(*p));
        builder.finish();
        let levels = builder.take_ready(1);
        assert!(levels.len() > 5);
        for (k, bins) in levels {
            let mut folder = Folder::new(k);
            points.iter().for_each(|p| folder.add(*p));
            assert_eq!(bins, folder.bins, "level {k}");
            assert_eq!(bins.iter().map(|b| b.count).sum::<u64>(), 50_000);
        }
    }

    #[test]
    fn level_for_pixels() {
        assert_eq!(level_for(0, 2000, 2000), 0);
        assert_eq!(level_for(0, 4001, 2000), 1);
        assert_eq!(level_for(i64::MIN, i64::MAX, 1), 62);
    }
}

//! Summarizes values (min, max, last, count) in bins of 2^k ns.

use crate::format::{f64_at, i64_at, u64_at, BIN};

/// The step between levels, in powers of two.
pub const STEP: u8 = 2;
/// The highest level. Its bins are 2^44 ns wide, almost five hours.
pub const TOP: u8 = 44;
const WARM_UP: usize = 256;
const POINTS_PER_BIN: i64 = 32;
/// The number of complete bins of a level at which they are written.
pub const FLUSH: usize = 512;

/// A span of samples: its start, extremes, last value, and count.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bin {
    /// The time of the sample or the start of the bin, ns.
    pub start: i64,
    /// The lowest value.
    pub min: f64,
    /// The highest value.
    pub max: f64,
    /// The latest value.
    pub last: f64,
    /// The number of values.
    pub count: u64,
}

impl Bin {
    /// Builds the bin of a single sample.
    pub fn from_sample(time: i64, value: f64) -> Self {
        Bin {
            start: time,
            min: value,
            max: value,
            last: value,
            count: 1,
        }
    }

    /// Appends the bin to `out`, encoded as 40 bytes.
    pub fn encode(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(&self.start.to_le_bytes());
        for value in [self.min, self.max, self.last] {
            out.extend_from_slice(&value.to_bits().to_le_bytes());
        }
        out.extend_from_slice(&self.count.to_le_bytes());
    }

    /// Parses the bin at the start of `bytes`. Returns `None` if they are too short.
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

    fn from_value(time: i64, value: &f64) -> Self {
        Bin::from_sample(time, *value)
    }

    #[inline]
    fn add_value(&mut self, value: &f64) {
        self.merge(&Bin::from_sample(self.start, *value));
    }

    fn start_time(&self) -> i64 {
        self.start
    }

    fn with_start(self, start: i64) -> Self {
        Bin { start, ..self }
    }

    #[inline]
    fn merge(&mut self, later: &Bin) {
        // NaN never becomes an extreme, so one bad sample does not blank a whole zoom level.
        self.min = self.min.min(later.min);
        self.max = self.max.max(later.max);
        self.last = later.last;
        self.count += later.count;
    }
}

/// The content of a bin, folded from messages in time order.
pub trait Fold: Clone {
    /// The part of a message that is added to a bin.
    type Value: ?Sized;
    /// Builds a bin of one message.
    fn from_value(time: i64, value: &Self::Value) -> Self;
    /// Adds a message.
    fn add_value(&mut self, value: &Self::Value);
    /// Returns the time of its message, or the start of the bin.
    fn start_time(&self) -> i64;
    /// Returns the same content at another time.
    fn with_start(self, start: i64) -> Self;
    /// Merges a later bin into this one.
    fn merge(&mut self, later: &Self);
}

/// Returns the start of the level `k` bin that contains `time`.
#[inline]
pub fn bin_start(time: i64, k: u8) -> i64 {
    (time >> k) << k
}

/// Returns the bin width for `pixels` over a span: the largest power of two that gives each pixel its own bin.
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

/// Builds all levels of one stream during recording.
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
    /// Adds a message. It usually belongs to the current bin.
    #[inline]
    pub fn observe(&mut self, time: i64, value: &B::Value) {
        if let Some(level) = self.levels.first_mut() {
            let start = bin_start(time, level.k);
            if let Some(bin) = level
                .current
                .as_mut()
                .filter(|bin| bin.start_time() >= start)
            {
                return bin.add_value(value);
            }
        }
        self.add(B::from_value(time, value));
    }

    /// Adds a point or bin that is later than all others.
    pub fn add(&mut self, point: B) {
        if !self.levels.is_empty() {
            return self.feed_level(0, point);
        }
        self.warm.push(point);
        if self.warm.len() >= WARM_UP {
            self.choose_levels();
        }
    }

    fn choose_levels(&mut self) {
        let (Some(first), Some(last)) = (self.warm.first(), self.warm.last()) else {
            return;
        };
        let span = (last.start_time() as i128 - first.start_time() as i128).max(1);
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
            self.feed_level(0, point);
        }
    }

    #[inline]
    fn feed_level(&mut self, mut at: usize, point: B) {
        let mut point = point;
        while let Some(level) = self.levels.get_mut(at) {
            let start = bin_start(point.start_time(), level.k);
            match level.current.as_mut() {
                Some(bin) if bin.start_time() >= start => return bin.merge(&point),
                _ => {
                    let started = point.with_start(start);
                    match level.current.replace(started) {
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

    /// Takes the complete bins of all levels that have at least `least` of them.
    pub fn take_ready(&mut self, least: usize) -> Vec<(u8, Vec<B>)> {
        let full = |level: &mut Level<B>| {
            (level.ready.len() >= least).then(|| (level.k, std::mem::take(&mut level.ready)))
        };
        self.levels.iter_mut().filter_map(full).collect()
    }

    /// Returns whether the lowest level has at least `least` complete bins to write.
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

    /// Completes all bins at the end of the stream.
    pub fn finish(&mut self) {
        if self.levels.is_empty() {
            self.choose_levels();
        }
        for at in 0..self.levels.len() {
            if let Some(done) = self.levels[at].current.take() {
                self.levels[at].ready.push(done.clone());
                self.feed_level(at + 1, done);
            }
        }
    }
}

/// Folds points in time order into bins of level `k`.
pub struct Folder<B> {
    k: u8,
    /// The bins so far, in time order.
    pub bins: Vec<B>,
}

impl<B: Fold> Folder<B> {
    /// Creates a folder without bins.
    pub fn new(k: u8) -> Self {
        Folder {
            k,
            bins: Vec::new(),
        }
    }

    /// Adds a point or bin that is later than all others.
    #[inline]
    pub fn add(&mut self, point: B) {
        let start = bin_start(point.start_time(), self.k);
        match self.bins.last_mut() {
            Some(bin) if bin.start_time() >= start => bin.merge(&point),
            _ => self.bins.push(point.with_start(start)),
        }
    }

    /// Adds a message like `add` adds its bin.
    #[inline]
    pub fn observe(&mut self, time: i64, value: &B::Value) {
        let start = bin_start(time, self.k);
        match self.bins.last_mut() {
            Some(bin) if bin.start_time() >= start => bin.add_value(value),
            _ => self.bins.push(B::from_value(start, value)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_equal_the_folded_points() {
        let mut builder = Builder::default();
        let points: Vec<Bin> = (0..50_000)
            .map(|i| Bin::from_sample(i * 1_000 + (i % 7), ((i * 37) % 101) as f64))
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
    fn chooses_a_level_for_a_number_of_pixels() {
        assert_eq!(level_for(0, 2000, 2000), 0);
        assert_eq!(level_for(0, 4001, 2000), 1);
        assert_eq!(level_for(i64::MIN, i64::MAX, 1), 62);
    }
}

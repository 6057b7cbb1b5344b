//! One stream being written: where it stands, and its pyramid.

use crate::chunk::{Input, Value};
use crate::format::Compression;
use crate::format::Encoding;
use crate::pyramid::{self, Bin};
use crate::tracks::{self, Names, Noted, Tally};

/// The position to return to when a commit fails.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Position {
    pub ordinal: u64,
    pub last_time: Option<i64>,
    pub size_sum: u64,
    pub latency_sum: f64,
}

#[derive(Debug)]
pub(super) struct Stream {
    pub compression: Compression,
    pub large: bool,
    pub position: Position,
    pub saved: Option<Position>,
    pub pyramid: pyramid::Builder<Bin>,
    pub tallies: pyramid::Builder<Tally>,
    /// Ordinals per level of both.
    pub bins: [u64; 128],
    pub last_bin: [i64; 128],
    pub points: Vec<Bin>,
    pub names: Names,
    /// Messages of the commit under way: their times, and how many of `noted` are theirs.
    pub marks: Vec<(i64, u32)>,
    pub noted: Vec<(u32, Noted)>,
}

impl Stream {
    pub fn new(compression: Compression, large: bool) -> Self {
        Stream {
            compression,
            large,
            position: Position {
                ordinal: 0,
                last_time: None,
                size_sum: 0,
                latency_sum: 0.0,
            },
            saved: None,
            pyramid: pyramid::Builder::default(),
            tallies: pyramid::Builder::default(),
            bins: [0; 128],
            last_bin: [i64::MIN; 128],
            points: Vec::new(),
            names: Names::default(),
            marks: Vec::new(),
            noted: Vec::new(),
        }
    }

    /// Notes a message for the tracks. Small ones only are looked into.
    pub fn mark(&mut self, time: i64, encoding: Encoding, input: &Input<'_>) {
        let before = self.noted.len();
        let (value, body): (Value, &[u8]) = match input {
            Input::Bool(value) => (Value::Bool(*value), &[]),
            Input::Bytes(bytes) => {
                let (start, length) = (0, bytes.len());
                (Value::Bytes { start, length }, bytes)
            }
            // Numbers have a pyramid of their own.
            _ => (Value::Int(0), &[]),
        };
        tracks::note(encoding, &value, body, &mut self.names, &mut self.noted);
        self.marks.push((time, (self.noted.len() - before) as u32));
    }

    /// Moves the values of committed messages into the pyramids.
    pub fn settle(&mut self) {
        for point in self.points.drain(..) {
            self.pyramid.add(point);
        }
        let mut rest = self.noted.as_slice();
        for (time, n) in self.marks.drain(..) {
            let (values, behind) = rest.split_at((n as usize).min(rest.len()));
            rest = behind;
            self.tallies.observe(time, values);
        }
        self.noted.clear();
    }

    /// Drops the values of messages whose commit failed.
    pub fn forget(&mut self) {
        self.points.clear();
        self.marks.clear();
        self.noted.clear();
    }
}

//! The state of one stream being written: its position and its pyramid.

use crate::chunk::{Input, Value};
use crate::format::Compression;
use crate::format::Encoding;
use crate::pyramid::{self, Bin};
use crate::tracks::{self, Names, TrackBin, TrackValue};

/// The position that is restored when a commit fails.
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
    pub track_bins: pyramid::Builder<TrackBin>,
    /// Ordinals per level of both pyramids.
    pub bins: [u64; 128],
    pub last_bin: [i64; 128],
    pub pending_points: Vec<Bin>,
    pub names: Names,
    /// Messages of the current commit: their times, and the number of their values in `pending_values`.
    pub pending_times: Vec<(i64, u32)>,
    pub pending_values: Vec<(u32, TrackValue)>,
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
            track_bins: pyramid::Builder::default(),
            bins: [0; 128],
            last_bin: [i64::MIN; 128],
            pending_points: Vec::new(),
            names: Names::default(),
            pending_times: Vec::new(),
            pending_values: Vec::new(),
        }
    }

    /// Records a message for the tracks. Only small messages are inspected.
    pub fn note_message(&mut self, time: i64, encoding: Encoding, input: &Input<'_>) {
        // Numbers have their own pyramid.
        if matches!(encoding, Encoding::Int | Encoding::Float) {
            return self.pending_times.push((time, 0));
        }
        let before = self.pending_values.len();
        let (value, body): (Value, &[u8]) = match input {
            Input::Bool(value) => (Value::Bool(*value), &[]),
            Input::Bytes(bytes) => {
                let (start, length) = (0, bytes.len());
                (Value::Bytes { start, length }, bytes)
            }
            _ => (Value::Int(0), &[]),
        };
        tracks::collect_values(
            encoding,
            &value,
            body,
            &mut self.names,
            &mut self.pending_values,
        );
        self.pending_times
            .push((time, (self.pending_values.len() - before) as u32));
    }

    /// Moves the values of committed messages into the pyramids.
    pub fn settle_values(&mut self) {
        for point in self.pending_points.drain(..) {
            self.pyramid.add(point);
        }
        let mut rest = self.pending_values.as_slice();
        for (time, n) in self.pending_times.drain(..) {
            let (values, after) = rest.split_at((n as usize).min(rest.len()));
            rest = after;
            self.track_bins.observe(time, values);
        }
        self.pending_values.clear();
    }

    /// Drops the values of messages whose commit failed.
    pub fn drop_values(&mut self) {
        self.pending_points.clear();
        self.pending_times.clear();
        self.pending_values.clear();
    }
}

//! One stream being written: where it stands, and its pyramid.

use crate::format::Compression;
use crate::pyramid::{self, Bin};

/// What must be put back when a commit fails.
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
    pub pyramid: pyramid::Builder,
    /// Ordinals per pyramid level.
    pub bins: [u64; 64],
    pub last_bin: [i64; 64],
    pub points: Vec<Bin>,
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
            bins: [0; 64],
            last_bin: [i64::MIN; 64],
            points: Vec::new(),
        }
    }
}

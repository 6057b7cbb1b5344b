//! Summarizes a stream's signal: extremes, last value, and count.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};

use super::levels::{self, Pyramid, Span};
use super::{lock_mutex, Chunk, Reader};
use crate::error::Result;
use crate::format::*;
use crate::pyramid::Bin;

/// Pyramids computed in memory for streams without stored ones, by stream.
pub(super) type MemoryPyramids = Mutex<HashMap<u32, Arc<Mutex<levels::MemoryPyramid<Bin>>>>>;

struct Signal;

impl Pyramid for Signal {
    type Bin = Bin;

    const LEVEL_OFFSET: u8 = 0;

    fn decode_bins(
        &mut self,
        chunk: &Chunk,
        _level: u8,
        from: i64,
        mut each: impl FnMut(Bin) -> bool,
    ) -> Option<()> {
        let bins = chunk.body().chunks_exact(BIN).filter_map(Bin::decode);
        for bin in bins.filter(|bin| bin.start >= from) {
            if !each(bin) {
                break;
            }
        }
        Some(())
    }

    fn visit_messages(
        &mut self,
        reader: &Reader,
        entry: &Entry,
        span: Span,
        mut each: impl FnMut(i64, &f64),
    ) {
        // A message of this size is not a number.
        if levels::is_too_large_to_draw(entry) {
            return;
        }
        let Ok(chunk) = reader.read_chunk(entry) else {
            return;
        };
        for (envelope, value) in chunk.messages().map_while(|message| message.ok()) {
            if envelope.time > span.to {
                return;
            }
            if let (true, Some(number)) = (envelope.time >= span.from, chunk.numeric_value(&value))
            {
                each(envelope.time, &number);
            }
        }
    }

    fn memory_pyramid(
        &self,
        reader: &Reader,
        stream: u32,
    ) -> Arc<Mutex<levels::MemoryPyramid<Bin>>> {
        lock_mutex(&reader.memory_pyramids)
            .entry(stream)
            .or_default()
            .clone()
    }
}

impl Reader {
    /// Returns bins of width 2^k ns of a stream's signal that overlap `from..=to`. Empty bins are left out.
    pub fn read_summary(&self, stream: u32, from: i64, to: i64, k: u8) -> Result<Vec<Bin>> {
        let k = k.min(62);
        let bins = self.fold_bins(stream, Span { from, to }.extend_to_bins(k), k, &mut Signal);
        self.check_intact()?;
        Ok(bins)
    }
}

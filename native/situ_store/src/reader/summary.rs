//! Summaries: extremes, last value and count of a stream's signal.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};

use super::levels::{self, Pyramid, Span};
use super::{lock, Chunk, Reader};
use crate::error::Result;
use crate::format::*;
use crate::pyramid::Bin;

/// Pyramids made in memory where the store has none, by stream.
pub(super) type Made = Mutex<HashMap<u32, Arc<Mutex<levels::Made<Bin>>>>>;

struct Signal;

impl Pyramid for Signal {
    type Bin = Bin;

    const ABOVE: u8 = 0;

    fn bins(
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

    fn messages(
        &mut self,
        reader: &Reader,
        entry: &Entry,
        span: Span,
        mut each: impl FnMut(i64, &f64),
    ) {
        // No number is as large as that.
        if levels::undrawn(entry) {
            return;
        }
        let Ok(chunk) = reader.chunk(entry) else {
            return;
        };
        for (envelope, value) in chunk.messages().map_while(|message| message.ok()) {
            if envelope.time > span.to {
                return;
            }
            if let (true, Some(number)) = (envelope.time >= span.from, chunk.number(&value)) {
                each(envelope.time, &number);
            }
        }
    }

    fn made(&self, reader: &Reader, stream: u32) -> Arc<Mutex<levels::Made<Bin>>> {
        lock(&reader.made).entry(stream).or_default().clone()
    }
}

impl Reader {
    /// Bins of width 2^k ns of a stream's signal, those that hold a part of `from..=to`; empty ones are left out.
    pub fn summary(&self, stream: u32, from: i64, to: i64, k: u8) -> Result<Vec<Bin>> {
        let k = k.min(62);
        let bins = self.bins(stream, Span { from, to }.in_bins(k), k, &mut Signal);
        self.whole()?;
        Ok(bins)
    }
}

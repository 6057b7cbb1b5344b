//! Pyramids on their way into the store: bins as they become complete.

use super::Writer;
use crate::error::{Error, Result};
use crate::format::*;
use crate::pyramid::{self, Bin};

impl Writer {
    /// Writes the bins that make a chunk. A full disk is told by the next message; the bins wait.
    pub(super) fn write_ready_pyramids(&mut self) -> Result<()> {
        let ready = |stream: &super::Stream| stream.pyramid.has_ready(pyramid::FLUSH);
        if self.streams.iter().any(ready) {
            match self.write_pyramids(pyramid::FLUSH) {
                Err(Error::Crash) => return Err(Error::Crash),
                _ => self.entries.clear(),
            }
        }
        Ok(())
    }

    pub(super) fn write_pyramids(&mut self, least: usize) -> Result<()> {
        for number in 0..self.streams.len() {
            let mut failed = Ok(());
            for (k, bins) in self.streams[number].pyramid.take_ready(least) {
                if failed.is_ok() {
                    failed = self.write_bins(number, k, &bins);
                }
                if failed.is_err() {
                    self.streams[number].pyramid.put_back(k, bins);
                }
            }
            failed?;
        }
        Ok(())
    }

    fn write_bins(&mut self, number: usize, k: u8, bins: &[Bin]) -> Result<()> {
        for bins in bins.chunks(MAX_CHUNK_MESSAGES as usize) {
            let (Some(first), Some(last)) = (bins.first(), bins.last()) else {
                continue;
            };
            let stream = &self.streams[number];
            if first.start <= stream.last_bin[k as usize] {
                // Points of a codec that went back in time: their bins are left out, the messages are there.
                continue;
            }
            let mut body = Vec::with_capacity(bins.len() * BIN);
            bins.iter().for_each(|bin| bin.encode(&mut body));
            let header = ChunkHeader {
                length: (CHUNK_HEADER + body.len()) as u32,
                stream: number as u32,
                level: k,
                encoding: Encoding::Bins,
                compression: Compression::None,
                count: bins.len() as u32,
                ordinal: stream.bins[k as usize],
                first: first.start,
                last: last.start,
                first_sequence: 0,
                first_creation: 0,
                size_sum: 0,
                latency_sum: 0.0,
                raw_length: body.len() as u32,
                table_length: 0,
                codec: 0,
                body_crc: crc32c::crc32c(&body),
                number: Some(self.next_number()),
                committed: self.index.committed,
            };
            let entry = self.place(LANE_DATA, 8, &header, &[&header.encode(&[]), &body])?;
            self.index.publish(&[entry])?;
            let stream = &mut self.streams[number];
            stream.bins[k as usize] += bins.len() as u64;
            stream.last_bin[k as usize] = last.start;
        }
        Ok(())
    }
}

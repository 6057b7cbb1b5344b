//! Writes the bins of pyramids into the store as they become complete.

use super::stream::Stream;
use super::Writer;
use crate::error::{Error, Result};
use crate::format::*;
use crate::pyramid::{self, Bin, Builder, Fold};
use crate::tracks::{self, TrackBin};

/// The bins of one level that form a chunk.
struct Bins {
    stream: usize,
    level: u8,
    encoding: Encoding,
    count: u32,
    first: i64,
    last: i64,
    body: Vec<u8>,
}

/// If a level has no more bins than this, the levels above it are left out: readers compute them from these bins as
/// fast as they would read them.
const FEW_BINS: usize = 4;

fn leave_out_short_levels<B>(ready: &mut Vec<(u8, Vec<B>)>, written: impl Fn(u8) -> u64) {
    let short = |(k, bins): &(u8, Vec<B>)| written(*k) == 0 && bins.len() <= FEW_BINS;
    if let Some(at) = ready.iter().position(short) {
        ready.truncate(at + 1);
    }
}

impl Writer {
    /// Writes bins that fill a chunk. If the disk is full, the bins wait, and the next message reports the error.
    pub(super) fn write_ready_pyramids(&mut self) -> Result<()> {
        for number in std::mem::take(&mut self.ready) {
            match self.write_pyramids(number, pyramid::FLUSH) {
                Err(Error::Crash) => return Err(Error::Crash),
                _ => self.entries.clear(),
            }
        }
        Ok(())
    }

    /// Writes the bins that remain at the end.
    pub(super) fn finish_pyramids(&mut self, number: usize) -> Result<()> {
        self.streams[number].pyramid.finish();
        self.streams[number].track_bins.finish();
        self.write_pyramids(number, 1)
    }

    fn write_pyramids(&mut self, number: usize, least: usize) -> Result<()> {
        let mut ready = self.streams[number].pyramid.take_ready(least);
        self.leave_out_levels(number, 0, least, &mut ready);
        let encode = |_: &Stream, _: u8, bins: &[Bin]| {
            let mut body = Vec::with_capacity(bins.len() * BIN);
            bins.iter().for_each(|bin| bin.encode(&mut body));
            body
        };
        self.write_levels(number, (0, Encoding::Bins), ready, encode, |stream| {
            &mut stream.pyramid
        })?;
        let mut ready = self.streams[number].track_bins.take_ready(least);
        self.leave_out_levels(number, TRACKS, least, &mut ready);
        let encode =
            |stream: &Stream, k: u8, bins: &[TrackBin]| tracks::encode_bins(bins, k, &stream.names);
        self.write_levels(
            number,
            (TRACKS, Encoding::Tracks),
            ready,
            encode,
            |stream| &mut stream.track_bins,
        )
    }

    fn leave_out_levels<B>(
        &self,
        number: usize,
        above: u8,
        least: usize,
        ready: &mut Vec<(u8, Vec<B>)>,
    ) {
        if least == 1 {
            let stream = &self.streams[number];
            leave_out_short_levels(ready, |k| stream.bins[(above + k) as usize]);
        }
    }

    /// Writes complete bins of levels. Bins that could not be written are kept for the next time.
    fn write_levels<B: Fold>(
        &mut self,
        number: usize,
        (above, encoding): (u8, Encoding),
        ready: Vec<(u8, Vec<B>)>,
        encode: impl Fn(&Stream, u8, &[B]) -> Vec<u8>,
        builder: impl Fn(&mut Stream) -> &mut Builder<B>,
    ) -> Result<()> {
        let mut written = Ok(());
        for (k, bins) in ready {
            for bins in bins.chunks(MAX_CHUNK_MESSAGES as usize) {
                let (Some(first), Some(last)) = (bins.first(), bins.last()) else {
                    continue;
                };
                if written.is_ok() {
                    written = self.write_bins(Bins {
                        stream: number,
                        level: above + k,
                        encoding,
                        count: bins.len() as u32,
                        first: first.start_time(),
                        last: last.start_time(),
                        body: encode(&self.streams[number], k, bins),
                    });
                }
            }
            if written.is_err() {
                builder(&mut self.streams[number]).put_back(k, bins);
            }
        }
        written
    }

    fn write_bins(&mut self, bins: Bins) -> Result<()> {
        let stream = &self.streams[bins.stream];
        let level = bins.level as usize;
        if bins.first <= stream.last_bin[level] {
            // A codec returned points that went back in time. Their bins are left out, but the messages are stored.
            return Ok(());
        }
        let header = ChunkHeader {
            length: (CHUNK_HEADER + bins.body.len()) as u32,
            stream: bins.stream as u32,
            level: bins.level,
            encoding: bins.encoding,
            compression: Compression::None,
            count: bins.count,
            ordinal: stream.bins[level],
            first: bins.first,
            last: bins.last,
            first_sequence: 0,
            first_creation: 0,
            size_sum: 0,
            latency_sum: 0.0,
            raw_length: bins.body.len() as u32,
            table_length: 0,
            codec: 0,
            body_crc: crc32c::crc32c(&bins.body),
            number: Some(self.next_number()),
            committed: self.index.committed,
        };
        let entry = self.place_chunk(LANE_DATA, 8, &header, &[&header.encode(&[]), &bins.body])?;
        self.index.publish(&[entry])?;
        let stream = &mut self.streams[bins.stream];
        stream.bins[level] += u64::from(bins.count);
        stream.last_bin[level] = bins.last;
        Ok(())
    }
}

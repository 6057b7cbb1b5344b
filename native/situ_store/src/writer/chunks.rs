//! Writes chunks into the extents.

use super::Writer;
use crate::chunk::{compress_body, Envelope, Input};
use crate::error::Result;
use crate::format::*;

impl Writer {
    fn build_header(
        &self,
        stored: usize,
        raw: usize,
        compression: Compression,
        body_crc: u32,
    ) -> ChunkHeader {
        let builder = &self.builder;
        let position = self.streams[builder.stream as usize].position;
        ChunkHeader {
            length: (CHUNK_HEADER + stored) as u32,
            stream: builder.stream,
            level: 0,
            encoding: builder.encoding,
            compression,
            count: builder.count,
            ordinal: position.ordinal,
            first: builder.first.time,
            last: builder.last.time,
            first_sequence: builder.first.sequence,
            first_creation: builder.first.creation,
            size_sum: position.size_sum,
            latency_sum: position.latency_sum,
            raw_length: raw as u32,
            table_length: builder.table.len() as u32,
            codec: builder.codec,
            body_crc,
            number: Some(self.next_number()),
            committed: self.index.committed,
        }
    }

    /// Returns the entry number of the next chunk.
    pub(super) fn next_number(&self) -> u64 {
        self.index.committed + self.entries.len() as u64
    }

    pub(super) fn flush_chunk(&mut self) -> Result<()> {
        if self.builder.count == 0 {
            return Ok(());
        }
        let compression = self.streams[self.builder.stream as usize].compression;
        let packed = compress_body(compression, &self.builder.table, &self.builder.payload)?;
        let raw = self.builder.table.len() + self.builder.payload.len();
        let entry = match &packed {
            Some(body) => {
                let header = self.build_header(body.len(), raw, compression, crc32c::crc32c(body));
                let bytes = header.encode(&[]);
                self.place_chunk(LANE_DATA, 8, &header, &[&bytes, body])?
            }
            None => {
                let crc = crc32c::crc32c(&self.builder.payload);
                let header = self.build_header(raw, raw, Compression::None, crc);
                let bytes = header.encode(&self.builder.table);
                let (table, payload) = (
                    std::mem::take(&mut self.builder.table),
                    std::mem::take(&mut self.builder.payload),
                );
                let placed = self.place_chunk(LANE_DATA, 8, &header, &[&bytes, &table, &payload]);
                self.builder.table = table;
                self.builder.payload = payload;
                placed?
            }
        };
        self.entries.push(entry);
        self.streams[self.builder.stream as usize].position.ordinal += self.builder.count as u64;
        self.builder.count = 0;
        Ok(())
    }

    /// Writes a message as its own chunk, directly from the caller's memory.
    pub(super) fn write_large(
        &mut self,
        envelope: Envelope,
        size: usize,
        input: Input<'_>,
    ) -> Result<()> {
        let compression = self.streams[self.builder.stream as usize].compression;
        let position = &mut self.streams[self.builder.stream as usize].position;
        // The header contains sums that include this message; `push` adds them permanently once it is written.
        let before = *position;
        position.size_sum += size as u64;
        position.latency_sum += envelope.creation as f64 - envelope.time as f64;
        let placed = self.place_large(envelope, size, input, compression);
        self.streams[self.builder.stream as usize].position = before;
        self.builder.count = 0;
        self.entries.push(placed?);
        Ok(())
    }

    fn place_large(
        &mut self,
        envelope: Envelope,
        size: usize,
        input: Input<'_>,
        compression: Compression,
    ) -> Result<Entry> {
        let small;
        let parts: &[&[u8]] = match input {
            Input::Bytes(bytes) => {
                small = [bytes];
                &small
            }
            Input::Parts(parts) => parts,
            other => {
                self.builder.push(envelope, other);
                let payload = std::mem::take(&mut self.builder.payload);
                let placed = self.place_parts(&[&payload], size, compression);
                self.builder.payload = payload;
                return placed;
            }
        };
        self.builder.push_envelope(envelope, size);
        self.place_parts(parts, size, compression)
    }

    fn place_parts(
        &mut self,
        parts: &[&[u8]],
        size: usize,
        compression: Compression,
    ) -> Result<Entry> {
        // The payload starts at a multiple of 64, because copying from unaligned addresses runs at a tenth of the
        // speed.
        let padded = (CHUNK_HEADER + self.builder.table.len()).next_multiple_of(64) - CHUNK_HEADER;
        self.builder.table.resize(padded, 0);
        if compression != Compression::None && size + self.builder.table.len() <= MAX_UNPACKED {
            let whole = parts.concat();
            if let Some(body) = compress_body(compression, &self.builder.table, &whole)? {
                let raw = self.builder.table.len() + size;
                let header = self.build_header(body.len(), raw, compression, crc32c::crc32c(&body));
                return self.place_chunk(LANE_LARGE, 64, &header, &[&header.encode(&[]), &body]);
            }
        }
        let crc = parts
            .iter()
            .fold(0, |crc, part| crc32c::crc32c_append(crc, part));
        let raw = self.builder.table.len() + size;
        let header = self.build_header(raw, raw, Compression::None, crc);
        let bytes = header.encode(&self.builder.table);
        let table = std::mem::take(&mut self.builder.table);
        let mut slices: Vec<&[u8]> = Vec::with_capacity(parts.len() + 2);
        slices.extend([&bytes[..], &table[..]]);
        slices.extend_from_slice(parts);
        let placed = self.place_chunk(LANE_LARGE, 64, &header, &slices);
        self.builder.table = table;
        placed
    }

    pub(super) fn place_chunk(
        &mut self,
        lane: u8,
        align: u64,
        header: &ChunkHeader,
        slices: &[&[u8]],
    ) -> Result<Entry> {
        let (extent, offset) =
            self.lanes[lane as usize].reserve_space(header.length as u64, align)?;
        self.lanes[lane as usize].write(offset, slices)?;
        Ok(Entry {
            stream: header.stream,
            level: header.level,
            lane,
            extent,
            offset,
            length: header.length,
            count: header.count,
            ordinal: header.ordinal,
            first: header.first,
            last: header.last,
            first_creation: header.first_creation,
        })
    }
}

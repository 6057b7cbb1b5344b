//! A chunk as the reader returns it: mapped, checked, and unpacked if it was compressed.

use std::sync::Arc;

use super::{maps, Reader};
use crate::chunk::{self, Body, Messages};
use crate::error::{Error, Result};
use crate::extent;
use crate::format::*;
use crate::guard::Map;
use crate::index::FILE_WAS_CUT;

/// A checked chunk: its header, its raw body, and the map that contains it.
pub struct Chunk {
    /// The chunk's header.
    pub header: ChunkHeader,
    /// The map of the extent that contains the chunk.
    pub map: Arc<Map>,
    start: usize,
    in_memory: MemoryPart,
}

/// The part of a chunk that is in memory outside its map.
enum MemoryPart {
    Nothing,
    /// Its table, so that reading the table does not touch the map.
    Table(Vec<u8>),
    /// Its unpacked body.
    Body(Arc<Vec<u8>>),
}

impl Chunk {
    /// Returns the raw body: table and payloads.
    pub fn body(&self) -> &[u8] {
        match &self.in_memory {
            MemoryPart::Body(bytes) => bytes,
            _ => {
                &self.map[self.start + self.header.header_size()
                    ..self.start + self.header.length as usize]
            }
        }
    }

    /// Returns the offset of the body in the map, or `None` if the body was compressed.
    pub fn body_offset(&self) -> Option<usize> {
        (!matches!(self.in_memory, MemoryPart::Body(_)))
            .then(|| self.start + self.header.header_size())
    }

    /// Returns the unpacked body of a compressed chunk.
    pub fn unpacked_body(&self) -> Option<Arc<Vec<u8>>> {
        match &self.in_memory {
            MemoryPart::Body(bytes) => Some(bytes.clone()),
            _ => None,
        }
    }

    /// Returns the number that a plot shows for a message, if any.
    pub fn numeric_value(&self, value: &chunk::Value) -> Option<f64> {
        match *value {
            chunk::Value::Bytes { start, length } if self.header.encoding == Encoding::Term => {
                chunk::term_number(self.body().get(start..start + length)?)
            }
            _ => value.numeric_value(),
        }
    }

    /// Iterates over the messages of the chunk, in order.
    pub fn messages(&self) -> Messages<'_> {
        match &self.in_memory {
            MemoryPart::Table(table) => Messages::with_table(&self.header, self.body(), table),
            _ => Messages::new(&self.header, self.body()),
        }
    }
}

pub(crate) fn matches_header(entry: &Entry, header: &ChunkHeader) -> bool {
    header.stream == entry.stream
        && header.level == entry.level
        && header.count == entry.count
        && header.length == entry.length
        && header.first == entry.first
        && header.last == entry.last
}

impl Reader {
    /// Reads and checks the header of an entry's chunk, but not its body.
    pub fn read_chunk_header(&self, entry: &Entry) -> Result<ChunkHeader> {
        let map = self.extents.get_chunk(entry, CHUNK_HEADER as u64)?;
        let at = usize::try_from(entry.offset).ok();
        let bytes = at.and_then(|at| map.get(at..));
        let header = bytes
            .ok_or("the extent ends before the chunk")
            .and_then(ChunkHeader::decode)
            .map_err(|why| self.chunk_error(entry, why))?;
        Ok(header)
    }

    /// Reads an entry's chunk and checks it.
    pub fn read_chunk(&self, entry: &Entry) -> Result<Chunk> {
        self.read_checked_chunk(entry, self.verify_large || entry.lane == LANE_DATA)
    }

    /// Reads an entry's chunk and checks it. The body of a large chunk is checked only with `body_too`.
    pub fn read_checked_chunk(&self, entry: &Entry, body_too: bool) -> Result<Chunk> {
        let map = self.extents.get_chunk(entry, entry.length.into())?;
        if entry.lane == LANE_LARGE && !body_too {
            if let Some(chunk) = self.read_large_head(entry, &map, true) {
                return Ok(chunk);
            }
        }
        let broken = |why: &str| {
            let why = if map.is_torn() { FILE_WAS_CUT } else { why };
            Error::damaged(
                extent::file_name(entry.lane, entry.extent),
                entry.offset,
                why,
            )
        };
        let start = usize::try_from(entry.offset)
            .ok()
            .filter(|at| *at <= map.len());
        let start = start.ok_or_else(|| broken("the extent ends before the chunk"))?;
        let header = ChunkHeader::decode(&map[start..]).map_err(broken)?;
        if !matches_header(entry, &header) {
            return Err(broken("the chunk is not the one the index names"));
        }
        self.extents.touch(&map, start, header.length as usize);
        let most = match entry.lane {
            LANE_DATA => MAX_SMALL_BODY,
            _ => self.max_unpacked,
        };
        let in_memory =
            match chunk::open_body(&header, &map[start..], !body_too, most).map_err(broken)? {
                Body::Mapped(_) => MemoryPart::Nothing,
                Body::Unpacked(bytes) => MemoryPart::Body(Arc::new(bytes)),
            };
        Ok(Chunk {
            header,
            map,
            start,
            in_memory,
        })
    }

    /// Reads a large chunk without checking its payload or touching its map.
    fn read_large_head(&self, entry: &Entry, map: &Arc<Map>, wait: bool) -> Option<Chunk> {
        let (header, table) = self.extents.read_large_head(entry, map, wait)?;
        let start = usize::try_from(entry.offset).ok()?;
        let end = start.checked_add(header.length as usize)?;
        if !matches_header(entry, &header) || end > map.len() {
            return None;
        }
        self.extents.touch(map, start, end - start);
        Some(Chunk {
            header,
            map: map.clone(),
            start,
            in_memory: MemoryPart::Table(table),
        })
    }

    /// Reads an entry's chunk (and checks it where required) if this needs little time and no disk access; returns
    /// `None` otherwise.
    pub fn quick_chunk(&self, entry: &Entry) -> Option<Result<Chunk>> {
        let map = self.extents.cached_map(entry.lane, entry.extent)?;
        if self.is_mirror() && self.extents.get_chunk(entry, entry.length.into()).is_err() {
            return None;
        }
        if entry.lane == LANE_LARGE {
            // Building a term of that size takes long.
            let chunk = match self.verify_large {
                true => None,
                false => self.read_large_head(entry, &map, false),
            };
            return chunk
                .filter(|chunk| chunk.header.encoding != Encoding::Term)
                .map(Ok);
        }
        let start = usize::try_from(entry.offset).ok()?;
        maps::is_resident(&map, start, entry.length as usize).then(|| self.read_chunk(entry))
    }

    /// Builds the error for a damaged chunk.
    pub fn chunk_error(&self, entry: &Entry, why: &str) -> Error {
        Error::damaged(
            extent::file_name(entry.lane, entry.extent),
            entry.offset,
            why,
        )
    }
}

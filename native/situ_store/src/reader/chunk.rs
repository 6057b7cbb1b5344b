//! A chunk as the reader finds it: in a map, checked, unpacked where it is packed.

use std::sync::Arc;

use super::{maps, Reader};
use crate::chunk::{self, Body, Messages};
use crate::error::{Error, Result};
use crate::extent;
use crate::format::*;
use crate::guard::Map;
use crate::index::CUT;

/// A checked chunk: its header, its raw body, and the map it lies in.
pub struct Chunk {
    /// The chunk's header.
    pub header: ChunkHeader,
    /// The map of the extent that holds the chunk.
    pub map: Arc<Map>,
    start: usize,
    held: Held,
}

/// The parts of a chunk that are held beside its map.
enum Held {
    Nothing,
    /// Its table, so that reading it does not touch the map.
    Table(Vec<u8>),
    /// Its body, unpacked.
    Body(Arc<Vec<u8>>),
}

impl Chunk {
    /// The raw body: table and payloads.
    pub fn body(&self) -> &[u8] {
        match &self.held {
            Held::Body(bytes) => bytes,
            _ => {
                &self.map[self.start + self.header.size()..self.start + self.header.length as usize]
            }
        }
    }

    /// Where the body lies in the map, when it lies there (it was not compressed).
    pub fn mapped_at(&self) -> Option<usize> {
        (!matches!(self.held, Held::Body(_))).then(|| self.start + self.header.size())
    }

    /// The unpacked body of a compressed chunk.
    pub fn unpacked(&self) -> Option<Arc<Vec<u8>>> {
        match &self.held {
            Held::Body(bytes) => Some(bytes.clone()),
            _ => None,
        }
    }

    /// The number drawn for a message, where there is one.
    pub fn number(&self, value: &chunk::Value) -> Option<f64> {
        match *value {
            chunk::Value::Bytes { start, length } if self.header.encoding == Encoding::Term => {
                chunk::term_number(self.body().get(start..start + length)?)
            }
            _ => value.number(),
        }
    }

    /// The messages of the chunk, in order.
    pub fn messages(&self) -> Messages<'_> {
        match &self.held {
            Held::Table(table) => Messages::with_table(&self.header, self.body(), table),
            _ => Messages::new(&self.header, self.body()),
        }
    }
}

pub(crate) fn names(entry: &Entry, header: &ChunkHeader) -> bool {
    header.stream == entry.stream
        && header.level == entry.level
        && header.count == entry.count
        && header.length == entry.length
        && header.first == entry.first
        && header.last == entry.last
}

impl Reader {
    /// The header of the chunk an entry names; its body is not looked at.
    pub fn chunk_header(&self, entry: &Entry) -> Result<ChunkHeader> {
        let map = self.extents.get(entry.lane, entry.extent)?;
        let at = usize::try_from(entry.offset).ok();
        let bytes = at.and_then(|at| map.get(at..));
        let header = bytes
            .ok_or("the extent ends before the chunk")
            .and_then(ChunkHeader::decode)
            .map_err(|why| self.broken(entry, why))?;
        Ok(header)
    }

    /// The chunk an entry names, checked.
    pub fn chunk(&self, entry: &Entry) -> Result<Chunk> {
        self.chunk_checked(entry, self.verify_large || entry.lane == LANE_DATA)
    }

    /// The chunk of an entry, checked; the body of a large one only with `body_too`.
    pub fn chunk_checked(&self, entry: &Entry, body_too: bool) -> Result<Chunk> {
        let map = self.extents.get(entry.lane, entry.extent)?;
        if entry.lane == LANE_LARGE && !body_too {
            if let Some(chunk) = self.headed(entry, &map, true) {
                return Ok(chunk);
            }
        }
        let broken = |why: &str| {
            let why = if map.torn() { CUT } else { why };
            Error::damaged(extent::name(entry.lane, entry.extent), entry.offset, why)
        };
        let start = usize::try_from(entry.offset)
            .ok()
            .filter(|at| *at <= map.len());
        let start = start.ok_or_else(|| broken("the extent ends before the chunk"))?;
        let header = ChunkHeader::decode(&map[start..]).map_err(broken)?;
        if !names(entry, &header) {
            return Err(broken("the chunk is not the one the index names"));
        }
        self.extents.touch(&map, start, header.length as usize);
        let most = match entry.lane {
            LANE_DATA => MAX_SMALL_BODY,
            _ => self.max_unpacked,
        };
        let held = match chunk::open(&header, &map[start..], !body_too, most).map_err(broken)? {
            Body::Mapped(_) => Held::Nothing,
            Body::Unpacked(bytes) => Held::Body(Arc::new(bytes)),
        };
        Ok(Chunk {
            header,
            map,
            start,
            held,
        })
    }

    /// A large chunk whose payload is not checked: its map is not touched.
    fn headed(&self, entry: &Entry, map: &Arc<Map>, wait: bool) -> Option<Chunk> {
        let (header, table) = self.extents.head(entry, map, wait)?;
        let start = usize::try_from(entry.offset).ok()?;
        let end = start.checked_add(header.length as usize)?;
        if !names(entry, &header) || end > map.len() {
            return None;
        }
        self.extents.touch(map, start, end - start);
        Some(Chunk {
            header,
            map: map.clone(),
            start,
            held: Held::Table(table),
        })
    }

    /// The chunk, when it can be read (and, where it is to be, checked) without waiting for a disk, and in little time.
    pub fn quick_chunk(&self, entry: &Entry) -> Option<Result<Chunk>> {
        let map = self.extents.mapped(entry.lane, entry.extent)?;
        if entry.lane == LANE_LARGE {
            // A term of that size takes long to make.
            let chunk = match self.verify_large {
                true => None,
                false => self.headed(entry, &map, false),
            };
            return chunk
                .filter(|chunk| chunk.header.encoding != Encoding::Term)
                .map(Ok);
        }
        let start = usize::try_from(entry.offset).ok()?;
        maps::resident(&map, start, entry.length as usize).then(|| self.chunk(entry))
    }

    /// The error for a chunk that is damaged.
    pub fn broken(&self, entry: &Entry, why: &str) -> Error {
        Error::damaged(extent::name(entry.lane, entry.extent), entry.offset, why)
    }
}

//! Scans extents without their index: chunks are recognized by their magic and their checksums.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};

use crate::chunk::{self, Messages};
use crate::error::{Error, Result};
use crate::extent;
use crate::format::*;
use crate::guard::Map;
use crate::reader::{file_length, map_file, Damage};
use crate::tracks;

/// The chunks that a scan found in addition to those of sound entries.
#[derive(Default)]
pub(super) struct Scan {
    /// Chunks by the number of their entry.
    pub numbered: BTreeMap<u64, Entry>,
    /// Chunks of version 1, in file order.
    pub unnumbered: Vec<Entry>,
    /// Entries below this number are known to have been committed, from the header of a chunk written later.
    pub committed: u64,
    /// The creation time of the first catalog record.
    pub created: Option<i64>,
}

/// The mapped extents of a store.
pub(super) struct Files {
    dir: PathBuf,
    maps: BTreeMap<(u8, u32), Map>,
    /// Extents whose headers do not match this store.
    mismatched: Vec<(u8, u32)>,
}

impl Files {
    pub fn open(dir: &Path) -> Result<Files> {
        let mut maps = BTreeMap::new();
        for (lane, number) in list_extents(dir)? {
            let name = extent::file_name(lane, number);
            let file =
                File::open(dir.join(&name)).map_err(|e| Error::io(format!("open {name}"), e))?;
            let length = file_length(&file, &name)?;
            if length >= EXTENT_HEADER as u64 {
                maps.insert((lane, number), map_file(&file, 0, length, &name)?);
            }
        }
        Ok(Files {
            dir: dir.to_path_buf(),
            maps,
            mismatched: Vec::new(),
        })
    }

    pub fn is_empty(&self) -> bool {
        self.maps.is_empty()
    }

    /// Returns the store's id from the first extent with a valid header.
    pub fn store_id(&self) -> Option<[u8; 16]> {
        let sound = self.maps.iter().find_map(|((lane, number), map)| {
            let mut id = [0; 16];
            id.copy_from_slice(map.get(16..32)?);
            check_extent_header(map, &id, *lane, *number)
                .is_ok()
                .then_some(id)
        });
        sound
    }

    /// Checks the extents' headers against the store's id.
    pub fn check_headers(&mut self, id: [u8; 16], damage: &mut Vec<Damage>) {
        for ((lane, number), map) in &self.maps {
            if let Err(why) = check_extent_header(map, &id, *lane, *number) {
                self.mismatched.push((*lane, *number));
                if !is_blank(map) {
                    damage.push(Damage {
                        file: extent::file_name(*lane, *number),
                        offset: 0,
                        why: why.into(),
                    });
                }
            }
        }
    }

    /// Returns the extents with a damaged header that contain chunks of `entries`. Extents of other stores are left
    /// alone.
    pub fn damaged_headers(&self, entries: &[Entry]) -> Vec<(u8, u32)> {
        let holds = |extent: &(u8, u32)| {
            entries
                .iter()
                .any(|e| !e.is_placeholder() && (e.lane, e.extent) == *extent)
        };
        self.mismatched.iter().copied().filter(holds).collect()
    }

    /// Returns the header of a chunk, or the reason why the chunk is damaged.
    pub fn check_chunk(
        &self,
        lane: u8,
        number: u32,
        offset: u64,
    ) -> std::result::Result<ChunkHeader, &'static str> {
        let map = self.maps.get(&(lane, number));
        let Some(map) = map else {
            let there = self.dir.join(extent::file_name(lane, number)).exists();
            return Err(if there {
                "shorter than an extent's header"
            } else {
                "the file is missing"
            });
        };
        if self.is_foreign(lane, number, map) {
            return Err("the extent belongs to another store");
        }
        let start = usize::try_from(offset).ok().and_then(|at| map.get(at..));
        decode_sound_chunk(start.ok_or("the extent ends before the chunk")?)
    }

    /// Returns whether an extent has the valid header of another store. Its chunks may look like ours, but they are
    /// not.
    fn is_foreign(&self, lane: u8, number: u32, map: &[u8]) -> bool {
        let mut id = [0; 16];
        id.copy_from_slice(&map[16..32]);
        self.mismatched.contains(&(lane, number))
            && &map[..8] == EXTENT_MAGIC
            && crc32c::crc32c(&map[16..64]) == u32_at(map, 12)
    }

    /// Finds the chunks that no sound entry refers to.
    pub fn scan_chunks(
        &self,
        good: &[Option<Entry>],
        damage: &mut Vec<Damage>,
        progress: &mut impl FnMut(u64, u64),
    ) -> Scan {
        let mut known: BTreeMap<(u8, u32, u64), u32> = BTreeMap::new();
        for entry in good
            .iter()
            .flatten()
            .filter(|entry| !entry.is_placeholder())
        {
            known.insert((entry.lane, entry.extent, entry.offset), entry.length);
        }
        let mut scan = Scan::default();
        let total = self.maps.len() as u64;
        for (done, ((lane, number), map)) in self.maps.iter().enumerate() {
            progress(done as u64, total);
            if !self.is_foreign(*lane, *number, map) {
                scan.scan_extent((*lane, *number), map, &known, damage);
            }
        }
        progress(total, total);
        scan
    }
}

/// Returns whether the first page of an extent is empty: its space was allocated when the writer's machine went
/// down. If a page of a used extent was lost instead, the scan of its first chunk finds the damage.
fn is_blank(map: &[u8]) -> bool {
    map.iter().take(4096).all(|byte| *byte == 0)
}

impl Scan {
    fn scan_extent(
        &mut self,
        (lane, number): (u8, u32),
        map: &[u8],
        known: &BTreeMap<(u8, u32, u64), u32>,
        damage: &mut Vec<Damage>,
    ) {
        let mut at = EXTENT_HEADER;
        while at + CHUNK_HEADER_1 <= map.len() {
            let magic = u32_at(map, at);
            if magic != CHUNK_MAGIC && magic != CHUNK_MAGIC_1 {
                at += 8;
                continue;
            }
            if let Some(length) = known.get(&(lane, number, at as u64)) {
                if let Ok(header) = ChunkHeader::decode(&map[at..]) {
                    self.committed = self.committed.max(header.committed);
                }
                at += (*length as usize).next_multiple_of(8);
                continue;
            }
            match decode_sound_chunk(&map[at..]) {
                Ok(header) => {
                    self.add_chunk(&header, (lane, number), at as u64);
                    if is_end_record(&header, &map[at..]) {
                        // It contains no message, so it needs no later chunk as evidence that it was committed.
                        let own = header.number.map_or(0, |number| number + 1);
                        self.committed = self.committed.max(own);
                    }
                    at += (header.length as usize).next_multiple_of(8);
                }
                Err(why) => {
                    damage.push(Damage {
                        file: extent::file_name(lane, number),
                        offset: at as u64,
                        why: why.into(),
                    });
                    at += 8;
                }
            }
        }
    }

    fn add_chunk(&mut self, header: &ChunkHeader, (lane, extent): (u8, u32), offset: u64) {
        let entry = Entry {
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
        };
        if Entry::decode(&entry.encode()).is_none() {
            return;
        }
        if header.stream == CATALOG {
            let created = header.first_creation;
            self.created = Some(self.created.map_or(created, |known| known.min(created)));
        }
        self.committed = self.committed.max(header.committed);
        match header.number {
            Some(number) => drop(self.numbered.insert(number, entry)),
            None => self.unnumbered.push(entry),
        }
    }
}

/// Returns whether the chunk is the last record of a store that was closed.
fn is_end_record(header: &ChunkHeader, bytes: &[u8]) -> bool {
    if header.stream != CATALOG || header.count != 1 {
        return false;
    }
    let Ok(body) = chunk::open_body(header, bytes, false, MAX_SMALL_BODY) else {
        return false;
    };
    // Writers in other languages put spaces into their JSON.
    let text = String::from_utf8_lossy(body.as_bytes());
    let text: String = text.chars().filter(|c| !c.is_whitespace()).collect();
    text.ends_with(r#"{"kind":"end"}"#)
}

/// Returns the header of the chunk at the start of `bytes` if the whole chunk is sound.
fn decode_sound_chunk(bytes: &[u8]) -> std::result::Result<ChunkHeader, &'static str> {
    let header = ChunkHeader::decode(bytes)?;
    let body = chunk::open_body(&header, bytes, false, MAX_UNPACKED.max(MAX_MESSAGE))?;
    match header.encoding {
        Encoding::Tracks => tracks::check_bins(body.as_bytes(), header.count)?,
        Encoding::Bins if body.as_bytes().len() != header.count as usize * BIN => {
            return Err("the chunk's length is not that of its bins");
        }
        _ => Messages::new(&header, body.as_bytes()).try_for_each(|message| message.map(|_| ()))?,
    }
    Ok(header)
}

/// Lists the extent files in a folder: (lane, number).
fn list_extents(dir: &Path) -> Result<Vec<(u8, u32)>> {
    let listing = std::fs::read_dir(dir).map_err(|e| Error::io("list the store", e))?;
    let mut found = Vec::new();
    for item in listing {
        let item = item.map_err(|e| Error::io("list the store", e))?;
        let name = item.file_name().to_string_lossy().into_owned();
        let Some(stem) = name.strip_suffix(".situ") else {
            continue;
        };
        let parsed = match stem.split_once('-') {
            Some(("data", n)) => n.parse().ok().map(|n| (LANE_DATA, n)),
            Some(("large", n)) => n.parse().ok().map(|n| (LANE_LARGE, n)),
            _ => None,
        };
        found.extend(parsed.filter(|(lane, n)| extent::file_name(*lane, *n) == name));
    }
    found.sort_unstable();
    Ok(found)
}

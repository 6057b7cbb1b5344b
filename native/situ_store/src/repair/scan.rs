//! The extents without their index: chunks are known by what they begin with, and by their checksums.

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

/// The chunks that a scan found beside those of sound entries.
#[derive(Default)]
pub(super) struct Scan {
    /// By the number of their entry.
    pub numbered: BTreeMap<u64, Entry>,
    /// Of version 1, in the order of the files.
    pub unnumbered: Vec<Entry>,
    /// Entries below this number were committed for certain, by the header of a chunk written later.
    pub committed: u64,
    /// When the first record of the catalog was made.
    pub created: Option<i64>,
}

/// The extents of a store, mapped.
pub(super) struct Files {
    dir: PathBuf,
    maps: BTreeMap<(u8, u32), Map>,
    /// Extents whose headers are not this store's.
    wrong: Vec<(u8, u32)>,
}

impl Files {
    pub fn open(dir: &Path) -> Result<Files> {
        let mut maps = BTreeMap::new();
        for (lane, number) in extents(dir)? {
            let name = extent::name(lane, number);
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
            wrong: Vec::new(),
        })
    }

    pub fn is_empty(&self) -> bool {
        self.maps.is_empty()
    }

    /// The store's id as its extents have it.
    pub fn id(&self) -> Option<[u8; 16]> {
        let sound = self.maps.iter().find_map(|((lane, number), map)| {
            let mut id = [0; 16];
            id.copy_from_slice(map.get(16..32)?);
            check_extent(map, &id, *lane, *number).is_ok().then_some(id)
        });
        sound
    }

    /// Looks at the extents' headers.
    pub fn expect(&mut self, id: [u8; 16], damage: &mut Vec<Damage>) {
        for ((lane, number), map) in &self.maps {
            if let Err(why) = check_extent(map, &id, *lane, *number) {
                self.wrong.push((*lane, *number));
                if !begun(map) {
                    damage.push(Damage {
                        file: extent::name(*lane, *number),
                        offset: 0,
                        why: why.into(),
                    });
                }
            }
        }
    }

    /// Extents with a damaged header that hold chunks which are wanted. An extent of another store is left alone.
    pub fn mistitled(&self, entries: &[Entry]) -> Vec<(u8, u32)> {
        let holds = |extent: &(u8, u32)| {
            entries
                .iter()
                .any(|e| !e.is_hole() && (e.lane, e.extent) == *extent)
        };
        self.wrong.iter().copied().filter(holds).collect()
    }

    /// The header of a chunk that is sound.
    pub fn check(
        &self,
        lane: u8,
        number: u32,
        offset: u64,
    ) -> std::result::Result<ChunkHeader, &'static str> {
        let map = self.maps.get(&(lane, number));
        let Some(map) = map else {
            let there = self.dir.join(extent::name(lane, number)).exists();
            return Err(if there {
                "shorter than an extent's header"
            } else {
                "the file is missing"
            });
        };
        if self.foreign(lane, number, map) {
            return Err("the extent belongs to another store");
        }
        let start = usize::try_from(offset).ok().and_then(|at| map.get(at..));
        sound(start.ok_or("the extent ends before the chunk")?)
    }

    /// A sound header that is another's: its chunks may look like ours, and are not.
    fn foreign(&self, lane: u8, number: u32, map: &[u8]) -> bool {
        let mut id = [0; 16];
        id.copy_from_slice(&map[16..32]);
        self.wrong.contains(&(lane, number))
            && &map[..8] == EXTENT_MAGIC
            && crc32c::crc32c(&map[16..64]) == u32_at(map, 12)
    }

    /// Finds the chunks beside those that sound entries name.
    pub fn scan(
        &self,
        good: &[Option<Entry>],
        damage: &mut Vec<Damage>,
        progress: &mut impl FnMut(u64, u64),
    ) -> Scan {
        let mut known: BTreeMap<(u8, u32, u64), u32> = BTreeMap::new();
        for entry in good.iter().flatten().filter(|entry| !entry.is_hole()) {
            known.insert((entry.lane, entry.extent, entry.offset), entry.length);
        }
        let mut scan = Scan::default();
        let total = self.maps.len() as u64;
        for (done, ((lane, number), map)) in self.maps.iter().enumerate() {
            progress(done as u64, total);
            if !self.foreign(*lane, *number, map) {
                scan.extent((*lane, *number), map, &known, damage);
            }
        }
        progress(total, total);
        scan
    }
}

/// An extent whose space was allocated when its writer's machine went down: nothing stands where its header and its
/// first chunk would. If a page of a used extent was lost, its first chunk tells.
fn begun(map: &[u8]) -> bool {
    map.iter().take(4096).all(|byte| *byte == 0)
}

impl Scan {
    fn extent(
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
            match sound(&map[at..]) {
                Ok(header) => {
                    self.add(&header, (lane, number), at as u64);
                    if is_end(&header, &map[at..]) {
                        // It contains no message, so it needs no later chunk as evidence that it was committed.
                        let own = header.number.map_or(0, |number| number + 1);
                        self.committed = self.committed.max(own);
                    }
                    at += (header.length as usize).next_multiple_of(8);
                }
                Err(why) => {
                    damage.push(Damage {
                        file: extent::name(lane, number),
                        offset: at as u64,
                        why: why.into(),
                    });
                    at += 8;
                }
            }
        }
    }

    fn add(&mut self, header: &ChunkHeader, (lane, extent): (u8, u32), offset: u64) {
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

/// Whether the chunk is the last record of a store that was closed.
fn is_end(header: &ChunkHeader, bytes: &[u8]) -> bool {
    if header.stream != CATALOG || header.count != 1 {
        return false;
    }
    let Ok(body) = chunk::open(header, bytes, false, MAX_SMALL_BODY) else {
        return false;
    };
    // Writers in other languages put spaces into their JSON.
    let text = String::from_utf8_lossy(body.bytes());
    let text: String = text.chars().filter(|c| !c.is_whitespace()).collect();
    text.ends_with(r#"{"kind":"end"}"#)
}

/// The header of the chunk that `bytes` begin with, when all of it is sound.
fn sound(bytes: &[u8]) -> std::result::Result<ChunkHeader, &'static str> {
    let header = ChunkHeader::decode(bytes)?;
    let body = chunk::open(&header, bytes, false, MAX_UNPACKED.max(MAX_MESSAGE))?;
    match header.encoding {
        Encoding::Tracks => tracks::check(body.bytes(), header.count)?,
        Encoding::Bins if body.bytes().len() != header.count as usize * BIN => {
            return Err("the chunk's length is not that of its bins");
        }
        _ => Messages::new(&header, body.bytes()).try_for_each(|message| message.map(|_| ()))?,
    }
    Ok(header)
}

/// The files of extents in a folder.
fn extents(dir: &Path) -> Result<Vec<(u8, u32)>> {
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
        found.extend(parsed.filter(|(lane, n)| extent::name(*lane, *n) == name));
    }
    found.sort_unstable();
    Ok(found)
}

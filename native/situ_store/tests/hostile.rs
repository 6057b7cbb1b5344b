#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
//! Reads hostile files with false contents and correct checksums: no panic, no endless loop, no message that
//! contradicts the index, and no more memory than the store needs. `SITU_MUTATIONS` sets the number of stores.
mod common;

use common::*;
use rustix::process::{setrlimit, Resource, Rlimit};
use situ_store::chunk::Value;
use situ_store::format::*;
use situ_store::{pyramid, repair, Reader, Writer};

const MESSAGES: u64 = 600;

/// Generates numbers that an attacker would try.
trait Hostile {
    fn next_number(&mut self) -> u64;
    fn put_number(&mut self, bytes: &mut [u8], from: usize, to: usize);
}

impl Hostile for Random {
    fn next_number(&mut self) -> u64 {
        let near = self.below(70_000);
        match self.below(10) {
            0 => 0,
            1 => u64::MAX,
            2 => i64::MAX as u64,
            3 => i64::MIN as u64,
            4 => u32::MAX as u64,
            5 => 1 << self.below(64),
            6 => (MAX_MESSAGE as u64).wrapping_add(near),
            7 => self.below(300),
            _ => near,
        }
    }

    fn put_number(&mut self, bytes: &mut [u8], from: usize, to: usize) {
        let width = [1, 2, 4, 8][self.below(4) as usize];
        let at = from + self.below((to - from) as u64) as usize;
        let end = (at + width).min(to);
        let value = self.next_number().to_le_bytes();
        bytes[at..end].copy_from_slice(&value[..end - at]);
    }
}

type Files = Vec<(String, Vec<u8>)>;

fn sign_entry(entry: &mut [u8]) {
    let crc = crc32c::crc32c(&entry[4..ENTRY]);
    entry[..4].copy_from_slice(&crc.to_le_bytes());
}

/// Corrects a chunk's checksums as far as its own lengths allow.
fn sign_chunk(chunk: &mut [u8]) {
    let stored = (u32_at(chunk, 8) as usize).clamp(CHUNK_HEADER, chunk.len());
    let table = if chunk[18] == 0 { u32_at(chunk, 84) } else { 0 };
    let covered = (CHUNK_HEADER + table as usize).min(stored);
    let body = crc32c::crc32c(&chunk[covered..stored]);
    chunk[92..96].copy_from_slice(&body.to_le_bytes());
    let head = crc32c::crc32c(&chunk[8..covered]);
    chunk[4..8].copy_from_slice(&head.to_le_bytes());
}

/// Falsifies one chunk: its index entry, its header, both in the same way, its table, or its payload.
fn falsify_chunk(files: &mut Files, random: &mut Random) {
    let index = files.iter().position(|(n, _)| n == "index.situ").unwrap();
    let published = u64_at(&files[index].1, COMMITTED_AT);
    let at = INDEX_HEADER + random.below(published) as usize * ENTRY;
    let entry = Entry::decode(&files[index].1[at..]);
    let kind = random.below(5);
    if kind == 0 || entry.is_none() {
        random.put_number(&mut files[index].1[at..at + ENTRY], 4, ENTRY);
    } else if let Some(entry) = entry {
        let name = situ_store::extent::file_name(entry.lane, entry.extent);
        let Some(extent) = files.iter().position(|(n, _)| *n == name) else {
            return;
        };
        let length = files[extent].1.len();
        let (start, end) = (
            entry.offset as usize,
            entry.offset as usize + entry.length as usize,
        );
        if end > length || end < start + CHUNK_HEADER {
            return;
        }
        let chunk = &mut files[extent].1[start..];
        let table_end = CHUNK_HEADER + (u32_at(chunk, 84) as usize).min(end - start - CHUNK_HEADER);
        match kind {
            1 => random.put_number(chunk, 8, 92),
            2 => {
                // Entry and header agree on a false length, count, first or last time, or level.
                let fields = [
                    (24, 8, 4),
                    (28, 20, 4),
                    (40, 32, 8),
                    (48, 40, 8),
                    (8, 16, 1),
                ];
                let (there, here, width) = fields[random.below(5) as usize];
                let value = random.next_number().to_le_bytes();
                chunk[here..here + width].copy_from_slice(&value[..width]);
                sign_chunk(chunk);
                files[index].1[at + there..at + there + width].copy_from_slice(&value[..width]);
                return sign_entry(&mut files[index].1[at..]);
            }
            3 if table_end > CHUNK_HEADER => random.put_number(chunk, CHUNK_HEADER, table_end),
            _ if end - start > table_end => random.put_number(chunk, table_end, end - start),
            _ => random.put_number(chunk, 8, 92),
        }
        sign_chunk(chunk);
    }
    sign_entry(&mut files[index].1[at..]);
}

/// Calls every function of the reader and returns the number of messages it read.
fn read_everything(reader: &Reader, random: &mut Random) -> u64 {
    let mut seen = 0;
    for stream in reader.stream_numbers() {
        let mut ordinal = 0;
        while let Some(entry) = reader.entry_at(stream, ordinal).unwrap() {
            assert!(entry.ordinal <= ordinal);
            ordinal = entry.ordinal.checked_add(entry.count.into()).unwrap();
            if let Some(Ok(chunk)) = reader.quick_chunk(&entry) {
                assert!(chunk.messages().count() as u64 <= entry.count as u64);
            }
            let Ok(chunk) = reader.read_chunk(&entry) else {
                continue;
            };
            let mut last = None;
            for (got, value) in chunk.messages().flatten() {
                assert!(last < Some(got.time) && got.time >= entry.first && got.time <= entry.last);
                last = Some(got.time);
                if let Value::Bytes { start, length } = value {
                    assert_eq!(chunk.body()[start..start + length].len(), length);
                }
                let _ = chunk.numeric_value(&value);
                seen += 1;
            }
        }
        assert_eq!(ordinal, reader.message_count(stream));
        let _ = reader.read_statistics(stream);
        let _ = reader.find_gaps(stream, 1);
        for _ in 0..3 {
            let (a, b) = (random.next_number() as i64, random.next_number() as i64);
            let _ = reader.ordinal_from(stream, a);
            let level = pyramid::level_for(a.min(b), a.max(b), 1 + random.below(300) as u32);
            let _ = reader.read_summary(stream, a.min(b), a.max(b), level);
        }
        let _ = reader.read_summary(
            stream,
            0,
            MESSAGES as i64 * 1_000,
            8 + random.below(12) as u8,
        );
    }
    seen
}

#[test]
fn rejects_bins_at_the_level_of_messages() {
    let folder = Folder::new();
    let mut writer = Writer::create(&folder.0, small_extents()).unwrap();
    fill_store(&mut writer, 100, 50).unwrap();
    writer.close().unwrap();
    let reader = Reader::open(&folder.0).unwrap();
    let entry = reader.entry_at(1, 0).unwrap().unwrap();
    let path = folder
        .0
        .join(situ_store::extent::file_name(entry.lane, entry.extent));
    let mut bytes = std::fs::read(&path).unwrap();
    let chunk = &mut bytes[entry.offset as usize..];
    chunk[17] = Encoding::Bins as u8;
    sign_chunk(chunk);
    std::fs::write(&path, &bytes).unwrap();
    let reader = Reader::open(&folder.0).unwrap();
    let why = reader.read_chunk(&entry).err().unwrap();
    assert!(format!("{why:?}").contains("bins above it"), "{why:?}");
}

#[test]
fn reads_falsified_stores_without_panics() {
    let rounds: u64 = std::env::var("SITU_MUTATIONS")
        .ok()
        .and_then(|n| n.parse().ok())
        .unwrap_or(200);
    // A false number must not make the reader allocate as much memory.
    let limit = Rlimit {
        current: Some(4 << 30),
        maximum: None,
    };
    setrlimit(Resource::As, limit).unwrap();
    let origin = Folder::new();
    let mut writer = Writer::create(&origin.0, small_extents()).unwrap();
    fill_store(&mut writer, MESSAGES, 60).unwrap();
    writer.close().unwrap();
    let pristine = read_files(&origin.0);
    let target = Folder::new();
    let mut random = Random(0x1234_5678_9abc_def1);
    let (mut readable, mut seen) = (0, 0);
    for round in 0..rounds {
        let mut files = pristine.clone();
        for _ in 0..=random.below(4) {
            falsify_chunk(&mut files, &mut random);
        }
        for (name, bytes) in &files {
            std::fs::write(target.0.join(name), bytes).unwrap();
        }
        if let Ok(mut reader) = Reader::open(&target.0) {
            readable += 1;
            reader.verify_large = round % 3 != 0;
            seen += read_everything(&reader, &mut random);
            let _ = reader.verify_entries(0, u64::MAX);
        }
        if round % 8 == 0 && repair::repair_store(&target.0, false, |_, _| ()).is_ok() {
            let reader = Reader::open(&target.0).unwrap();
            read_everything(&reader, &mut random);
            std::fs::remove_file(target.0.join("index.situ.before-repair")).ok();
        }
    }
    println!("{readable} of {rounds} stores were readable, {seen} messages");
    assert!(readable > rounds / 2 && seen > 0);
}

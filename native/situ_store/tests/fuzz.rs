#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
//! Reads mutated files: no panic, and no message that was not written. `SITU_MUTATIONS` sets the number of mutated
//! stores (default 500).
mod common;

use common::*;
use situ_store::chunk::Value;
use situ_store::format::CATALOG;
use situ_store::{etf, repair, Reader, Writer};

fn mutate_files(files: &mut [(String, Vec<u8>)], random: &mut Random) {
    for _ in 0..=random.below(4) {
        let at = random.below(files.len() as u64) as usize;
        let other = random.below(files.len() as u64) as usize;
        let length = files[at].1.len() as u64;
        match random.below(7) {
            0 | 1 if length > 0 => {
                files[at].1[random.below(length) as usize] ^= 1 << random.below(8)
            }
            2 if length > 0 => {
                let start = random.below(length) as usize;
                let end = (start + random.below(200) as usize).min(length as usize);
                (start..end).for_each(|i| files[at].1[i] = random.below(256) as u8);
            }
            3 => files[at].1.truncate(random.below(length + 1) as usize),
            4 => {
                let bytes = files[at].1.clone();
                files[at].1 = std::mem::replace(&mut files[other].1, bytes);
            }
            5 if length > 128 => {
                // Swap entries or chunks without changing their checksums.
                let a = (random.below(length / 64) * 64) as usize;
                let b = (random.below(length / 64) * 64) as usize;
                for i in 0..64 {
                    if a + i < length as usize && b + i < length as usize {
                        files[at].1.swap(a + i, b + i);
                    }
                }
            }
            _ if length > 96 => {
                files[at].1[64 + random.below(32) as usize] = random.below(256) as u8
            }
            _ => {}
        }
    }
}

/// Generates the messages of the binary streams once, because generating them costs more than reading them.
fn all_payloads() -> Vec<Vec<Vec<u8>>> {
    let stream = |at| (0..MESSAGES).map(move |i| message_payload(i, size_of_message(at, i)));
    (0..4).map(|at| stream(at).collect()).collect()
}

/// Checks that every message equals the one written with its time. For large payloads that are not checked, only
/// the envelope must be equal.
fn check_messages(reader: &Reader, payloads: &[Vec<Vec<u8>>]) -> u64 {
    let mut seen = 0;
    for stream in reader
        .stream_numbers()
        .into_iter()
        .filter(|s| *s != CATALOG)
    {
        let mut ordinal = 0;
        while let Some(entry) = reader.entry_at(stream, ordinal).unwrap() {
            ordinal = entry.ordinal + entry.count as u64;
            if let Some(Ok(chunk)) = reader.quick_chunk(&entry) {
                seen += chunk.messages().flatten().count() as u64;
            }
            let Ok(chunk) = reader.read_chunk(&entry) else {
                continue;
            };
            let trusted = entry.lane == 0 || reader.verify_large;
            for (got, value) in chunk.messages().flatten() {
                let i = got.time as u64 / 1_000;
                assert_eq!(got, message_envelope(i));
                match value {
                    Value::Int(value) => assert_eq!(value, i as i64 - 5),
                    Value::Bytes { start, length } => {
                        let expected = &payloads[stream as usize - 1][i as usize];
                        let got = &chunk.body()[start..start + length];
                        assert_eq!(got.len(), expected.len());
                        assert!(!trusted || got == expected);
                    }
                    other => panic!("{other:?}"),
                }
                seen += 1;
            }
        }
        let _ = reader.ordinal_from(stream, 50_000);
        let _ = reader.read_statistics(stream);
        let _ = reader.read_summary(stream, 0, 500_000, 12);
    }
    seen
}

/// A folder with the mutated files. It writes only files that have changed.
struct Target {
    folder: Folder,
    written: Vec<(String, Vec<u8>)>,
}

impl Target {
    fn write_files(&mut self, files: Vec<(String, Vec<u8>)>) {
        for file in &files {
            if !self.written.contains(file) {
                std::fs::write(self.folder.0.join(&file.0), &file.1).unwrap();
            }
        }
        self.written = files;
    }

    /// Discards the cached state after a repair, which may have changed any file.
    fn forget_files(&mut self) {
        self.written.clear();
        let _ = std::fs::remove_file(self.folder.0.join("index.situ.before-repair"));
    }
}

const MESSAGES: u64 = 120;

#[test]
fn reads_mutated_stores_without_panics_or_invented_messages() {
    let rounds: u64 = std::env::var("SITU_MUTATIONS")
        .ok()
        .and_then(|n| n.parse().ok())
        .unwrap_or(500);
    let origin = Folder::new();
    let mut writer = Writer::create(&origin.0, small_extents()).unwrap();
    fill_store(&mut writer, MESSAGES, 20).unwrap();
    writer.close().unwrap();
    let pristine = read_files(&origin.0);
    let payloads = all_payloads();
    let mut target = Target {
        folder: Folder::new(),
        written: Vec::new(),
    };
    let mut random = Random(0x5eed_1234_9876_5432);
    let (mut readable, mut seen) = (0, 0);
    for round in 0..rounds {
        let mut mutated = pristine.clone();
        mutate_files(&mut mutated, &mut random);
        target.write_files(mutated);
        let dir = &target.folder.0;
        if let Ok(mut reader) = Reader::open(dir) {
            readable += 1;
            reader.verify_large = round % 4 != 0;
            seen += check_messages(&reader, &payloads);
            let _ = reader.verify_entries(0, u64::MAX);
        }
        if round % 10 == 0 {
            if repair::repair_store(dir, false, |_, _| ()).is_ok() {
                let reader = Reader::open(dir).unwrap();
                assert_eq!(reader.damage(), vec![], "round {round}");
                check_messages(&reader, &payloads);
            }
            target.forget_files();
        }
    }
    println!("{readable} of {rounds} stores were readable, {seen} messages");
    assert!(
        readable > rounds / 4 && seen > 0,
        "{readable} of {rounds} were readable"
    );
}

#[test]
fn checks_mutated_terms_without_panics() {
    let mut random = Random(77);
    let term = [
        131, 104, 2, 119, 2, b'o', b'k', 108, 0, 0, 0, 2, 97, 1, 116, 0, 0, 0, 1, 119, 1, b'a',
        110, 9, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 106,
    ];
    assert!(etf::check_term(&term).is_ok());
    for _ in 0..200_000 {
        let mut bytes = term.to_vec();
        for _ in 0..=random.below(3) {
            let at = random.below(bytes.len() as u64) as usize;
            bytes[at] = random.below(256) as u8;
        }
        bytes.truncate(random.below(bytes.len() as u64 + 1) as usize);
        let _ = etf::check_term(&bytes);
    }
}

//! Files are cut short at any byte: repair recovers every message that is still in the data, and its report is correct.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use std::collections::BTreeSet;
use std::path::Path;

use common::{files, Folder};
use situ_store::chunk::{Input, Value};
use situ_store::format::*;
use situ_store::repair::{self, Report};
use situ_store::{Compression, Encoding, Options, Reader, Writer};

/// Messages of the streams, by stream and time; the catalog's are not counted.
type Messages = BTreeSet<(u32, i64)>;

/// A store as it was written: its files, the entries of its index, and its messages.
struct Original {
    files: Vec<(String, Vec<u8>)>,
    entries: Vec<Entry>,
    all: Messages,
}

fn write(dir: &Path, close: bool) -> Original {
    let options = Options {
        first_extent: 8 << 10,
        max_extent: 8 << 10,
        ..Options::default()
    };
    let mut writer = Writer::create(dir, options).unwrap();
    let small = writer.add_stream(Compression::None, false);
    let large = writer.add_stream(Compression::None, true);
    let mut all = Messages::new();
    for i in 0..90 {
        let envelope = common::envelope(i);
        writer
            .push(small, envelope, Encoding::Int, 0, Input::Int(i as i64))
            .unwrap();
        all.insert((small, envelope.time));
        if i % 30 == 7 {
            let bytes = common::payload(i, 900);
            writer
                .push(large, envelope, Encoding::Bytes, 0, Input::Bytes(&bytes))
                .unwrap();
            all.insert((large, envelope.time));
        }
        writer.commit().unwrap();
    }
    if close {
        writer.close().unwrap();
    }
    drop(writer);
    let entries = Reader::open(dir).unwrap().all_entries();
    Original {
        files: files(dir),
        entries,
        all,
    }
}

fn read(dir: &Path) -> Messages {
    let mut told = Messages::new();
    let Ok(reader) = Reader::open(dir) else {
        return told;
    };
    for stream in reader.streams().into_iter().filter(|s| *s != CATALOG) {
        common::visit_messages(&reader, stream, |envelope, value, _| {
            if let Value::Int(value) = value {
                assert_eq!(envelope, common::envelope(value as u64));
            }
            told.insert((stream, envelope.time));
        });
    }
    told
}

/// The entries whose chunks are not whole in a file of this name cut to this length.
fn cut_entries(original: &Original, name: &str, length: u64) -> Vec<Entry> {
    let within = |entry: &&Entry| {
        situ_store::extent::name(entry.lane, entry.extent) == name
            && entry.offset + u64::from(entry.length) > length
    };
    original.entries.iter().filter(within).copied().collect()
}

fn check(original: &Original, dir: &Path, name: &str, length: usize) -> (Messages, Report) {
    for (name, bytes) in files(dir) {
        if !original
            .files
            .iter()
            .any(|(n, b)| *n == name && *b == bytes)
        {
            std::fs::remove_file(dir.join(name)).unwrap();
        }
    }
    for (file, bytes) in &original.files {
        let bytes = if file == name {
            &bytes[..length]
        } else {
            bytes
        };
        std::fs::write(dir.join(file), bytes).unwrap();
    }
    let before = read(dir);
    let report = repair::repair(dir, false, |_, _| ()).unwrap();
    let after = read(dir);
    let place = format!("{name} cut to {length}: {report:?}");
    assert!(before.is_subset(&after), "lost: {place}");
    assert!(after.is_subset(&original.all), "invented: {place}");
    // Messages that could not be read are said to be damage.
    if before != original.all {
        assert!(!report.damage.is_empty() && report.rebuilt, "{place}");
    }
    let reader = Reader::open(dir).unwrap();
    assert!(reader.is_closed() && reader.damage().is_empty(), "{place}");
    let (found, total) = reader.verify(0, u64::MAX).unwrap();
    assert!(found.is_empty(), "{place}: {found:?}");
    assert_eq!(reader.all_entries().len() as u64, report.kept, "{place}");
    assert!(total >= report.kept, "{place}");
    (after, report)
}

/// Every length around what begins or ends there, and some in between; all of them where there is time.
fn lengths(original: &Original, name: &str, size: usize) -> Vec<usize> {
    let all = std::env::var("SITU_MUTATIONS").is_ok();
    let ends = original
        .entries
        .iter()
        .filter(|e| situ_store::extent::name(e.lane, e.extent) == name);
    let ends = ends.map(|e| (e.offset + u64::from(e.length)) as usize);
    let entries = (0..=original.entries.len()).map(|n| INDEX_HEADER + n * ENTRY);
    let marks: Vec<usize> = match name {
        "index.situ" => entries
            .step_by(if all { 1 } else { 9 })
            .chain([64, INDEX_HEADER])
            .collect(),
        _ => ends
            .step_by(if all { 1 } else { 9 })
            .chain([EXTENT_HEADER])
            .collect(),
    };
    let near = marks
        .into_iter()
        .flat_map(|at| at.saturating_sub(1)..at + 2);
    let chosen: BTreeSet<usize> = near
        .chain((0..size).step_by(if all { 1 } else { 997 }))
        .chain([size - 3])
        .collect();
    chosen.into_iter().filter(|at| *at < size).collect()
}

fn cut_everywhere(close: bool) {
    let folder = Folder::new();
    let original = write(&folder.0, close);
    assert_eq!(read(&folder.0), original.all);
    let stores = original
        .files
        .iter()
        .filter(|(name, _)| name.ends_with(".situ"));
    for (name, bytes) in stores {
        for length in lengths(&original, name, bytes.len()) {
            let (after, report) = check(&original, &folder.0, name, length);
            let lost = cut_entries(&original, name, length as u64);
            let messages = lost.iter().filter(|e| e.level == 0 && e.stream != CATALOG);
            // Each commit has one chunk of one message of a stream.
            let mut gone: Messages = messages.map(|e| (e.stream, e.first)).collect();
            // Without the index's header nothing says that the last commit was acknowledged.
            let unconfirmed = !close && name == "index.situ" && length < INDEX_HEADER;
            if unconfirmed {
                gone.insert((1, common::envelope(89).time));
            }
            let expected: Messages = original.all.difference(&gone).copied().collect();
            let place = format!("{name} cut to {length}: {report:?}");
            assert_eq!(after, expected, "{place}");
            if name != "index.situ" {
                assert_eq!(report.dropped, lost.len() as u64, "{place}");
            }
            assert_eq!(report.unconfirmed, u64::from(unconfirmed), "{place}");
            assert_eq!(
                report.dropped + report.kept + report.unconfirmed,
                original.entries.len() as u64,
                "{place}"
            );
        }
    }
}

#[test]
fn repair_recovers_a_closed_store_that_was_cut_anywhere() {
    cut_everywhere(true);
}

#[test]
fn repair_recovers_a_store_whose_writer_was_killed() {
    cut_everywhere(false);
}

//! Files are truncated at any byte: repair recovers every message that is still in the data, and its report is
//! correct.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use std::collections::BTreeSet;
use std::path::Path;

use common::{read_files, Folder};
use situ_store::chunk::{Input, Value};
use situ_store::format::*;
use situ_store::repair::{self, Report};
use situ_store::{Compression, Encoding, Options, Reader, Writer};

/// Messages of the streams, by stream and time, without those of the catalog.
type Messages = BTreeSet<(u32, i64)>;

/// A store after writing: its files, the entries of its index, and its messages.
struct Original {
    files: Vec<(String, Vec<u8>)>,
    entries: Vec<Entry>,
    all: Messages,
}

fn write_store(dir: &Path, close: bool) -> Original {
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
        let envelope = common::message_envelope(i);
        writer
            .push(small, envelope, Encoding::Int, 0, Input::Int(i as i64))
            .unwrap();
        all.insert((small, envelope.time));
        if i % 30 == 7 {
            let bytes = common::message_payload(i, 900);
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
        files: read_files(dir),
        entries,
        all,
    }
}

fn read_messages(dir: &Path) -> Messages {
    let mut found = Messages::new();
    let Ok(reader) = Reader::open(dir) else {
        return found;
    };
    for stream in reader
        .stream_numbers()
        .into_iter()
        .filter(|s| *s != CATALOG)
    {
        common::visit_messages(&reader, stream, |envelope, value, _| {
            if let Value::Int(value) = value {
                assert_eq!(envelope, common::message_envelope(value as u64));
            }
            found.insert((stream, envelope.time));
        });
    }
    found
}

/// Returns the entries whose chunks are incomplete after the file with this name was cut to this length.
fn cut_entries(original: &Original, name: &str, length: u64) -> Vec<Entry> {
    let within = |entry: &&Entry| {
        situ_store::extent::file_name(entry.lane, entry.extent) == name
            && entry.offset + u64::from(entry.length) > length
    };
    original.entries.iter().filter(within).copied().collect()
}

fn check_repair(original: &Original, dir: &Path, name: &str, length: usize) -> (Messages, Report) {
    for (name, bytes) in read_files(dir) {
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
    let before = read_messages(dir);
    let report = repair::repair_store(dir, false, |_, _| ()).unwrap();
    let after = read_messages(dir);
    let case = format!("{name} cut to {length}: {report:?}");
    assert!(before.is_subset(&after), "lost: {case}");
    assert!(after.is_subset(&original.all), "invented: {case}");
    // Messages that could not be read must be reported as damage.
    if before != original.all {
        assert!(!report.damage.is_empty() && report.rebuilt, "{case}");
    }
    let reader = Reader::open(dir).unwrap();
    assert!(reader.is_closed() && reader.damage().is_empty(), "{case}");
    let (found, total) = reader.verify_entries(0, u64::MAX).unwrap();
    assert!(found.is_empty(), "{case}: {found:?}");
    assert_eq!(reader.all_entries().len() as u64, report.kept, "{case}");
    assert!(total >= report.kept, "{case}");
    (after, report)
}

/// Returns every length around the limits of chunks and entries, and some in between; with `SITU_MUTATIONS` all of
/// them.
fn cut_lengths(original: &Original, name: &str, size: usize) -> Vec<usize> {
    let all = std::env::var("SITU_MUTATIONS").is_ok();
    let ends = original
        .entries
        .iter()
        .filter(|e| situ_store::extent::file_name(e.lane, e.extent) == name);
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
    let original = write_store(&folder.0, close);
    assert_eq!(read_messages(&folder.0), original.all);
    let stores = original
        .files
        .iter()
        .filter(|(name, _)| name.ends_with(".situ"));
    for (name, bytes) in stores {
        for length in cut_lengths(&original, name, bytes.len()) {
            let (after, report) = check_repair(&original, &folder.0, name, length);
            let lost = cut_entries(&original, name, length as u64);
            let messages = lost.iter().filter(|e| e.level == 0 && e.stream != CATALOG);
            // Each commit has one chunk with one message for each stream.
            let mut lost_messages: Messages = messages.map(|e| (e.stream, e.first)).collect();
            // Without the index's header nothing proves that the last commit was acknowledged.
            let unconfirmed = !close && name == "index.situ" && length < INDEX_HEADER;
            if unconfirmed {
                lost_messages.insert((1, common::message_envelope(89).time));
            }
            let expected: Messages = original.all.difference(&lost_messages).copied().collect();
            let case = format!("{name} cut to {length}: {report:?}");
            assert_eq!(after, expected, "{case}");
            if name != "index.situ" {
                assert_eq!(report.dropped, lost.len() as u64, "{case}");
            }
            assert_eq!(report.unconfirmed, u64::from(unconfirmed), "{case}");
            assert_eq!(
                report.dropped + report.kept + report.unconfirmed,
                original.entries.len() as u64,
                "{case}"
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

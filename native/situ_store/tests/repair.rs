//! Repair never loses readable messages, and never adds unacknowledged ones.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use common::{read_files, Folder, Random};
use situ_store::chunk::{Envelope, Input, Value};
use situ_store::extent::Fault;
use situ_store::format::*;
use situ_store::{repair, Compression, Encoding, Error, Options, Reader, Writer};

/// A message as the reader returns it: its stream, time and bytes.
type StoredMessage = (u32, i64, Vec<u8>);

/// Reads all messages except those in damaged chunks.
fn read_messages(dir: &Path) -> BTreeSet<StoredMessage> {
    let mut found = BTreeSet::new();
    let Ok(reader) = Reader::open(dir) else {
        return found;
    };
    for stream in reader.stream_numbers() {
        common::visit_messages(&reader, stream, |envelope, value, body| {
            let bytes = match value {
                Value::Int(value) => value.to_le_bytes().to_vec(),
                Value::Bytes { start, length } => body[start..start + length].to_vec(),
                other => format!("{other:?}").into_bytes(),
            };
            found.insert((stream, envelope.time, bytes));
        });
    }
    found
}

/// Writes a store with a few streams and many commits, some of which are rolled back. Returns the acknowledged
/// messages.
fn write_store(dir: &Path, random: &mut Random) -> BTreeSet<StoredMessage> {
    let options = Options {
        first_extent: 8 << 10,
        max_extent: 64 << 10,
        fault: match random.below(3) {
            0 => Fault::after(20 + random.below(400) as i64, false),
            _ => Default::default(),
        },
        ..Options::default()
    };
    let mut acknowledged = BTreeSet::new();
    let Ok(mut writer) = Writer::create(dir, options) else {
        return acknowledged;
    };
    let kinds = [
        Compression::None,
        Compression::None,
        Compression::Zstd,
        Compression::Lz4,
    ];
    let ids: Vec<u32> = kinds
        .iter()
        .map(|kind| writer.add_stream(*kind, false))
        .collect();
    let mut next: BTreeMap<u32, i64> = BTreeMap::new();
    for _ in 0..10 + random.below(60) {
        let mut batch = Vec::new();
        let mut failed = false;
        let mut times = next.clone();
        for _ in 0..1 + random.below(3) {
            let id = ids[random.below(4) as usize];
            for _ in 0..1 + random.below(40) {
                let time = times.entry(id).or_insert(0);
                *time += 1 + random.below(1_000) as i64;
                let envelope = Envelope {
                    sequence: *time as u64,
                    time: *time,
                    creation: *time,
                };
                let size = [8, 100, 3_000, 40_000][(random.below(40) / 13) as usize];
                // Random bytes, because a message that was rolled back and one that was kept may have the same
                // time.
                let bytes: Vec<u8> = (0..size).map(|_| random.below(256) as u8).collect();
                let (encoding, input) = match id % 2 {
                    0 => (Encoding::Bytes, Input::Bytes(&bytes)),
                    _ => (Encoding::Int, Input::Int(random.below(u64::MAX) as i64)),
                };
                let kept = match input {
                    Input::Int(value) => value.to_le_bytes().to_vec(),
                    _ => bytes.clone(),
                };
                batch.push((id, *time, kept));
                if let Err(error) = writer.push(id, envelope, encoding, 0, input) {
                    assert_eq!(error, Error::Crash);
                    return acknowledged;
                }
            }
        }
        if random.below(4) == 0 {
            failed = true;
            writer.rollback();
        }
        if !failed {
            match writer.commit() {
                Ok(_) => {
                    acknowledged.extend(batch);
                    next = times;
                }
                // The commit may or may not have been published; reading the store shows which.
                Err(_) => {
                    drop(writer);
                    acknowledged.extend(read_messages(dir));
                    return acknowledged;
                }
            }
        }
    }
    if random.below(4) > 0 && writer.close().is_err() {
        drop(writer);
    }
    acknowledged
}

/// Damages the store: flips bits, zeroes ranges, truncates or removes files.
fn damage_files(dir: &Path, random: &mut Random) {
    for _ in 0..1 + random.below(3) {
        let all: Vec<_> = read_files(dir)
            .into_iter()
            .filter(|(name, bytes)| name.ends_with(".situ") && !bytes.is_empty())
            .collect();
        let index = all.iter().position(|(name, _)| name == "index.situ");
        let chosen = match index {
            Some(index) if random.below(2) == 0 => index,
            _ => random.below(all.len() as u64) as usize,
        };
        let (name, mut bytes) = all[chosen].clone();
        let path = dir.join(&name);
        // The index is empty after its entries, and most of the damage should hit data.
        let end = match name.as_str() {
            "index.situ" if bytes.len() >= INDEX_HEADER => {
                let n = u64_at(&bytes, COMMITTED_AT).min(1 << 16) as usize;
                (INDEX_HEADER + n * ENTRY).min(bytes.len())
            }
            _ => bytes.len(),
        };
        // One word holds the number of entries; another test covers its loss.
        let start = match name.as_str() {
            "index.situ" if random.below(8) > 0 => INDEX_HEADER.min(end - 1),
            "index.situ" => 8,
            _ => 0,
        };
        let mut at = start + random.below((end - start) as u64) as usize;
        if (COMMITTED_AT..STATE_AT + 4).contains(&at) {
            at = 16;
        }
        match random.below(8) {
            0 => {
                std::fs::remove_file(&path).unwrap();
                continue;
            }
            1 => bytes.truncate(at),
            2 => {
                let end = (at + 1 + random.below(300) as usize).min(bytes.len());
                let end = if at < COMMITTED_AT {
                    end.min(COMMITTED_AT)
                } else {
                    end
                };
                bytes[at..end].fill(0);
            }
            _ => bytes[at] ^= 1 << random.below(8),
        }
        std::fs::write(&path, bytes).unwrap();
    }
}

fn round_count() -> u64 {
    let asked = std::env::var("SITU_MUTATIONS").ok();
    asked.and_then(|n| n.parse().ok()).unwrap_or(120)
}

#[test]
fn repair_keeps_readable_messages_and_adds_no_unacknowledged_ones() {
    let mut random = Random(0x5eed_0001);
    let mut recovered = 0;
    for round in 0..round_count() {
        let folder = Folder::new();
        let acknowledged = write_store(&folder.0, &mut random);
        if !folder.0.join("data-000000.situ").exists() {
            continue;
        }
        assert!(read_messages(&folder.0)
            .iter()
            .all(|m| m.0 == 0 || acknowledged.contains(m)));
        damage_files(&folder.0, &mut random);
        let before = read_messages(&folder.0);
        let untouched = read_files(&folder.0);
        let planned = repair::repair_store(&folder.0, true, |_, _| ());
        let touched: Vec<_> = read_files(&folder.0);
        let same = |(name, bytes): &(String, Vec<u8>)| {
            name == "lock" || touched.iter().any(|(n, b)| n == name && b == bytes)
        };
        assert!(untouched.iter().all(same), "round {round}: a dry run wrote");
        match repair::repair_store(&folder.0, false, |_, _| ()) {
            Err(error) => {
                assert!(
                    before.is_empty(),
                    "round {round}: {error:?} for a readable store"
                );
                continue;
            }
            Ok(report) => assert_eq!(Ok(report), planned, "round {round}"),
        }
        let after = read_messages(&folder.0);
        let lost: Vec<_> = before.difference(&after).map(|m| (m.0, m.1)).collect();
        assert!(lost.is_empty(), "round {round}: lost {lost:?}");
        let added: Vec<_> = after
            .iter()
            .filter(|m| m.0 != 0 && !acknowledged.contains(*m))
            .map(|m| (m.0, m.1))
            .collect();
        assert!(
            added.is_empty(),
            "round {round}: never acknowledged {added:?}"
        );
        recovered += after.difference(&before).count();
        let reader = Reader::open(&folder.0).unwrap();
        assert!(
            reader.is_closed() && reader.damage().is_empty(),
            "round {round}"
        );
        let (found, _) = reader.verify_entries(0, u64::MAX).unwrap();
        assert!(found.is_empty(), "round {round}: {found:?}");
        let again = repair::repair_store(&folder.0, false, |_, _| ()).unwrap();
        assert!(
            !again.rebuilt && again.dropped == 0,
            "round {round}: {again:?}"
        );
    }
    assert!(recovered > 0);
}

/// A damaged entry of another stream loses no message: the sound index entries are kept, whatever the extents
/// contain.
#[test]
fn a_damaged_entry_does_not_affect_other_streams() {
    let folder = Folder::new();
    let mut writer = Writer::create(&folder.0, Options::default()).unwrap();
    let (one, other) = (
        writer.add_stream(Compression::None, false),
        writer.add_stream(Compression::None, false),
    );
    let text = |i: i64| format!("{i:100}").into_bytes();
    let message_envelope = |i: i64| Envelope {
        sequence: i as u64,
        time: i,
        creation: i,
    };
    // This happens when the last message of an append does not fit the encoding of the first one.
    for i in 1..=1_000 {
        let bytes = text(i);
        writer
            .push(
                one,
                message_envelope(i),
                Encoding::Bytes,
                0,
                Input::Bytes(&bytes),
            )
            .unwrap();
    }
    writer.rollback();
    for i in 1..=1_001 {
        let bytes = text(i + 10_000);
        writer
            .push(
                one,
                message_envelope(i),
                Encoding::Term,
                0,
                Input::Bytes(&bytes),
            )
            .unwrap();
    }
    writer.commit().unwrap();
    for i in 1..=10 {
        writer
            .push(other, message_envelope(i), Encoding::Int, 0, Input::Int(i))
            .unwrap();
    }
    writer.commit().unwrap();
    writer.close().unwrap();
    let before = read_messages(&folder.0);
    for damaged in ["other", "index"] {
        let path = folder.0.join("index.situ");
        let mut bytes = std::fs::read(&path).unwrap();
        let n = u64_at(&bytes, COMMITTED_AT) as usize;
        let at = (0..n)
            .map(|n| INDEX_HEADER + n * ENTRY)
            .find(|at| u32_at(&bytes, at + 4) == other)
            .unwrap();
        if damaged == "index" {
            std::fs::remove_file(&path).unwrap();
        } else {
            bytes[at + 40] ^= 1;
            std::fs::write(&path, bytes).unwrap();
        }
        let report = repair::repair_store(&folder.0, false, |_, _| ()).unwrap();
        assert_eq!(report.dropped, 0, "{damaged}: {report:?}");
        let after = read_messages(&folder.0);
        // Only the end record may be lost, if no later chunk proves that it was committed.
        let lost: Vec<_> = before.difference(&after).filter(|m| m.0 != 0).collect();
        assert!(lost.is_empty(), "{damaged}: {}", lost.len());
        assert!(after.is_subset(&before), "{damaged}");
    }
    assert!(folder.0.join("index.situ.before-repair").exists());
}

/// Files that another program truncates while they are open cause an error and do not end the process.
#[test]
fn a_file_truncated_while_it_is_open_is_an_error() {
    for cut in ["data-000000.situ", "index.situ"] {
        for length in [0, 4_096] {
            let folder = Folder::new();
            let mut writer = Writer::create(&folder.0, Options::default()).unwrap();
            common::fill_store(&mut writer, 2_000, 50).unwrap();
            let reader = Reader::open(&folder.0).unwrap();
            common::check_stream(&reader, 1);
            let file = std::fs::OpenOptions::new()
                .write(true)
                .open(folder.0.join(cut))
                .unwrap();
            file.set_len(length).unwrap();
            let mut failed = false;
            for ordinal in [0, 1_000, 1_999] {
                match reader.entry_at(1, ordinal) {
                    Ok(Some(entry)) => failed |= reader.read_chunk(&entry).is_err(),
                    Ok(None) => {}
                    Err(_) => failed = true,
                }
            }
            assert!(failed || reader.refresh().is_err(), "{cut} {length}");
            if cut == "index.situ" {
                // An acknowledged message must be readable, so a commit into a truncated index must fail.
                let envelope = common::message_envelope(5_000);
                let pushed = writer
                    .push(1, envelope, Encoding::Int, 0, Input::Int(1))
                    .and_then(|()| writer.commit());
                assert!(pushed.is_err(), "{length}");
            }
        }
    }
}

/// A writer that dies at any step leaves either empty files or valid extents, and a machine that goes down may
/// leave an extent of zeros. Neither is damage.
#[test]
fn an_unused_extent_is_not_damage() {
    for step in 1..120 {
        let folder = Folder::new();
        let options = Options {
            first_extent: 8 << 10,
            max_extent: 8 << 10,
            fault: Fault::after(step, false),
            ..Options::default()
        };
        let _ = write_commits(&folder.0, options);
        if Reader::open(&folder.0).is_err() {
            continue;
        }
        std::fs::write(folder.0.join("data-000099.situ"), vec![0; 8 << 10]).unwrap();
        let report = repair::repair_store(&folder.0, true, |_, _| ()).unwrap();
        assert_eq!((report.dropped, report.damage), (0, vec![]), "step {step}");
    }
}

fn write_commits(dir: &Path, options: Options) -> situ_store::Result<()> {
    let mut writer = Writer::create(dir, options)?;
    writer.add_stream(Compression::None, false);
    for i in 0..40 {
        let bytes = common::message_payload(i, 1_000);
        writer.push(
            1,
            common::message_envelope(i),
            Encoding::Bytes,
            0,
            Input::Bytes(&bytes),
        )?;
        writer.commit()?;
    }
    Ok(())
}

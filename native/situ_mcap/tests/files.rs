//! Reads files that are complete, truncated, or damaged in every way: intact messages are returned, and nothing
//! panics.

use std::fs;
use std::path::{Path, PathBuf};

use situ_mcap::{
    ChannelSpec, Compression, Copy, CopyReport, Options, Order, Query, Reader, Selection, Times,
    Writer,
};

fn temporary_path(name: &str) -> PathBuf {
    std::env::temp_dir().join(format!("situ-mcap-{}-{name}.mcap", std::process::id()))
}

fn create_writer(path: &Path, compression: Compression) -> Writer {
    let options = Options {
        profile: "",
        library: None,
        compression,
        chunk: Some(2_000),
    };
    Writer::create(path, &options).unwrap_or_else(|e| unreachable!("{e:?}"))
}

fn write_file(name: &str, compression: Compression, finish: bool) -> PathBuf {
    let path = temporary_path(name);
    let mut writer = create_writer(&path, compression);
    let spec = |topic| ChannelSpec {
        topic,
        encoding: "json",
        schema: Some(("S", "jsonschema", b"{}")),
        metadata: Default::default(),
    };
    let channels = [
        writer.add_channel(&spec("a")),
        writer.add_channel(&spec("b")),
    ];
    for i in 0..500u64 {
        if let Ok(channel) = channels[(i % 2) as usize] {
            let data = format!("{{\"value\":{i}}}");
            assert_eq!(
                writer.write_message(
                    channel,
                    i as u32,
                    1_000 + i * 10,
                    900 + i * 10,
                    data.as_bytes()
                ),
                Ok(())
            );
        }
    }
    assert_eq!(
        writer.write_attachment("note.txt", "text/plain", (5, 4), b"hello"),
        Ok(())
    );
    assert_eq!(writer.flush(), Ok(()));
    if finish {
        assert_eq!(writer.finish(), Ok(()));
    } else {
        // Simulates a kill: later writes never reach the disk.
        let bytes = fs::read(&path).unwrap_or_default();
        drop(writer);
        assert!(fs::write(&path, bytes).is_ok());
    }
    path
}

fn read_all(reader: &Reader, channel: u16, times: Times) -> Vec<(u64, Vec<u8>)> {
    let query = Query {
        channel,
        times,
        from: 0,
        to: i128::MAX,
        most: usize::MAX,
        bytes: usize::MAX,
        envelopes: false,
        skip_damage: true,
    };
    reader
        .read(&query)
        .map(|(m, _)| m.into_iter().map(|m| (m.time, m.data)).collect())
        .unwrap_or_default()
}

#[test]
fn reads_what_was_written_with_every_compression() {
    for (name, compression) in [
        ("none", Compression::None),
        ("lz4", Compression::Lz4),
        ("zstd", Compression::Zstd),
    ] {
        let path = write_file(name, compression, true);
        let Ok(reader) = Reader::open(&path) else {
            unreachable!()
        };
        let info = reader.info();
        assert_eq!(
            info.channels.iter().map(|(_, n)| *n).collect::<Vec<_>>(),
            [250, 250]
        );
        assert!(info.finished && info.damage.is_empty());
        for (channel, _) in &info.channels {
            let messages = read_all(&reader, channel.id, Times::Log);
            assert_eq!(messages.len(), 250);
            assert!(messages.windows(2).all(|w| w[0].0 < w[1].0));
            assert_eq!(
                reader.seek(channel.id, Times::Log, i128::from(messages[100].0)),
                Ok(100)
            );
        }
        assert_eq!(
            read_all(&reader, info.channels[0].0.id, Times::Publish)[0].0,
            900
        );
        let offset = info.attachments[0].offset;
        assert_eq!(reader.read_attachment(offset), Ok(b"hello".to_vec()));
        let _ = fs::remove_file(path);
    }
}

#[test]
fn an_unfinished_file_contains_all_flushed_messages() {
    let path = write_file("unfinished", Compression::Zstd, false);
    let Ok(reader) = Reader::open(&path) else {
        unreachable!()
    };
    let info = reader.info();
    assert!(!info.finished);
    assert_eq!(info.channels.iter().map(|(_, n)| *n).sum::<u64>(), 500);
    let _ = fs::remove_file(path);
}

#[test]
fn a_truncated_file_contains_a_prefix_of_its_messages() {
    for (name, compression) in [
        ("cut-none", Compression::None),
        ("cut-lz4", Compression::Lz4),
        ("cut-zstd", Compression::Zstd),
    ] {
        let path = write_file(name, compression, true);
        let bytes = fs::read(&path).unwrap_or_default();
        let Ok(reader) = Reader::open(&path) else {
            unreachable!()
        };
        let id = reader.info().channels[0].0.id;
        let want = read_all(&reader, id, Times::Log);
        let mut last = 0;
        for size in (8..bytes.len()).step_by(37) {
            assert!(fs::write(&path, &bytes[..size]).is_ok());
            let Ok(reader) = Reader::open(&path) else {
                unreachable!("at {size}")
            };
            let got = read_all(&reader, id, Times::Log);
            assert_eq!(got, want[..got.len()], "{name} at {size}");
            assert!(got.len() >= last);
            last = got.len();
        }
        assert_eq!(last, want.len());
        let _ = fs::remove_file(path);
    }
}

#[test]
fn reads_or_rejects_twenty_thousand_damaged_files() {
    let path = write_file("damaged", Compression::Lz4, true);
    let bytes = fs::read(&path).unwrap_or_default();
    let mut seed = 1u64;
    let mut next = |n: usize| {
        seed = seed
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (seed >> 33) as usize % n
    };
    let rounds = if cfg!(debug_assertions) {
        2_000
    } else {
        20_000
    };
    for round in 0..rounds {
        let mut damaged = bytes.clone();
        for _ in 0..=next(3) {
            let at = next(damaged.len());
            damaged[at] = [0, 1, 0x7F, 0x80, 0xFF, next(256) as u8][next(6)];
        }
        assert!(fs::write(&path, &damaged).is_ok());
        if let Ok(reader) = Reader::open(&path) {
            for (channel, _) in reader.info().channels.iter().take(4) {
                let _ = read_all(&reader, channel.id, Times::Log);
            }
            // Copies are written to disk, which takes longer.
            if round % 20 == 0 {
                let _ = copy_file(&reader, "damaged-copy", Order::File);
                let _ = copy_file(&reader, "damaged-copy", Order::LogTime);
            }
        }
    }
    let _ = fs::remove_file(path);
}

fn copy_file(reader: &Reader, name: &str, order: Order) -> Option<CopyReport> {
    let path = temporary_path(name);
    let mut writer = create_writer(&path, Compression::Zstd);
    let selection = Selection {
        channels: None,
        from: 0,
        to: i128::MAX,
        order,
        replaced: Default::default(),
        skip_damage: true,
    };
    let mut copy = Copy::begin(reader, &mut writer, selection).ok()?;
    while !copy.step(reader, &mut writer).ok()? {}
    assert_eq!(writer.finish(), Ok(()));
    let _ = fs::remove_file(path);
    Some(copy.report().clone())
}

/// Returns the offsets and lengths of a file's chunks.
fn chunk_ranges(path: &Path) -> Vec<(usize, usize)> {
    let Ok(reader) = Reader::open(path) else {
        unreachable!()
    };
    let chunks = reader.chunks();
    let chunks = chunks.iter();
    chunks
        .map(|c| (c.offset as usize, c.length as usize))
        .collect()
}

#[test]
fn finds_records_after_damage() {
    for (name, compression) in [
        ("behind-none", Compression::None),
        ("behind-lz4", Compression::Lz4),
    ] {
        let path = write_file(name, compression, true);
        let bytes = fs::read(&path).unwrap_or_default();
        let ranges = chunk_ranges(&path);
        let (at, length) = ranges[ranges.len() / 2];
        let summary = bytes.len() - 40;
        // The length of a chunk's record (too long for the file, too long but within it, too short), its kind, and
        // its contents.
        let damages: [(usize, &[u8]); 5] = [
            (at + 1, &[0xFF; 8]),
            (at + 1, &[0x70, 0x17]),
            (at + 1, &[3, 0]),
            (at, &[0]),
            (at + length / 2, &[0xAA; 20]),
        ];
        for (where_to, with) in damages {
            let mut damaged = bytes.clone();
            damaged[where_to..where_to + with.len()].copy_from_slice(with);
            // Also without the index, so that the chunks have to be searched for.
            for cut in [bytes.len(), summary] {
                assert!(fs::write(&path, &damaged[..cut]).is_ok());
                let Ok(reader) = Reader::open(&path) else {
                    unreachable!()
                };
                let info = reader.info();
                let ids = info.channels.iter().map(|(c, _)| c.id);
                let n: usize = ids.map(|id| read_all(&reader, id, Times::Log).len()).sum();
                let lost = 500 / ranges.len() + 40;
                assert!(
                    n + 2 * lost >= 500,
                    "{n} of 500 at {where_to} {with:?} {cut}"
                );
                let Some(copied) = copy_file(&reader, "behind-copy", Order::File) else {
                    unreachable!()
                };
                let kept = copied.messages as usize;
                assert!(
                    kept + 2 * lost >= 500,
                    "{kept} of 500 at {where_to} {with:?}"
                );
                assert!(!copied.left_out.is_empty());
                assert_eq!(copied.attachments, 1);
            }
        }
        let _ = fs::remove_file(path);
    }
}

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
mod common;

use std::sync::Arc;
use std::time::Duration;

use common::*;
use situ_store::chunk::{Input, Value};
use situ_store::extent::{self, Fault};
use situ_store::format::CHUNK_HEADER;
use situ_store::{pyramid, repair, watch, Compression, Encoding, Error, Options, Reader, Writer};

#[test]
fn reads_everything_that_was_written() {
    let folder = Folder::new();
    let mut writer = Writer::create(&folder.0, small_extents()).unwrap();
    fill_store(&mut writer, 3_000, 100).unwrap();
    let live = Reader::open(&folder.0).unwrap();
    assert!(live.is_live());
    (1..=4).for_each(|stream| assert_eq!(check_stream(&live, stream), 3_000));
    writer.close().unwrap();
    let reader = Reader::open(&folder.0).unwrap();
    assert!(reader.is_closed() && !reader.is_live());
    (1..=4).for_each(|stream| assert_eq!(check_stream(&reader, stream), 3_000));
    let statistics = reader.read_statistics(1).unwrap().unwrap();
    assert_eq!(
        (statistics.count, statistics.first, statistics.last),
        (3_000, 0, 2_999_000)
    );
    assert_eq!(statistics.last_creation, message_envelope(2_999).creation);
    let latency: f64 = (0..3_000)
        .map(|i| (message_envelope(i).creation - message_envelope(i).time) as f64)
        .sum();
    assert_eq!(statistics.latency_sum, latency);
    assert_eq!(reader.verify_entries(0, u64::MAX).unwrap().0, vec![]);
    assert_eq!(
        repair::repair_store(&folder.0, false, |_, _| ())
            .unwrap()
            .dropped,
        0
    );
}

#[test]
fn seeking_finds_every_time() {
    let folder = Folder::new();
    let mut writer = Writer::create(&folder.0, small_extents()).unwrap();
    fill_store(&mut writer, 2_500, 700).unwrap();
    let reader = Reader::open(&folder.0).unwrap();
    for stream in 1..=4 {
        for i in 0..2_500u64 {
            assert_eq!(reader.ordinal_from(stream, i as i64 * 1_000).unwrap(), i);
            assert_eq!(
                reader.ordinal_from(stream, i as i64 * 1_000 - 999).unwrap(),
                i
            );
        }
        assert_eq!(reader.ordinal_from(stream, i64::MAX).unwrap(), 2_500);
        assert_eq!(reader.ordinal_from(stream, i64::MIN).unwrap(), 0);
    }
}

#[test]
fn summaries_equal_the_messages_at_every_level_in_open_and_closed_stores() {
    let folder = Folder::new();
    let mut writer = Writer::create(&folder.0, Options::default()).unwrap();
    let id = writer.add_stream(Compression::None, false);
    let value = |i: u64| ((i * 7_919) % 10_007) as f64 - 5_000.0;
    let n = 200_000u64;
    for i in 0..n {
        writer
            .push(
                id,
                message_envelope(i),
                Encoding::Float,
                0,
                Input::Float(value(i)),
            )
            .unwrap();
        if i % 500 == 499 {
            writer.commit().unwrap();
        }
    }
    let check = |reader: &Reader| {
        for k in 0..=30u8 {
            for (from, to) in [(0, n as i64 * 1_000), (12_345_678, 55_555_555), (-5, 3_000)] {
                let from = if k < 10 { from.max(to - 300_000) } else { from };
                let mut folder = pyramid::Folder::new(k);
                let (low, high) = (
                    pyramid::bin_start(from, k),
                    pyramid::bin_start(to, k) + (1 << k) - 1,
                );
                for i in 0..n {
                    let time = message_envelope(i).time;
                    if time >= low && time <= high {
                        folder.add(pyramid::Bin::from_sample(time, value(i)));
                    }
                }
                assert_eq!(
                    reader.read_summary(id, from, to, k).unwrap(),
                    folder.bins,
                    "level {k} of {from}..{to}"
                );
            }
        }
    };
    check(&Reader::open(&folder.0).unwrap());
    writer.close().unwrap();
    check(&Reader::open(&folder.0).unwrap());
}

#[test]
fn misuse_is_an_error_and_loses_no_messages() {
    let folder = Folder::new();
    let mut writer = Writer::create(&folder.0, small_extents()).unwrap();
    assert_eq!(
        Writer::create(&folder.0, small_extents()).err(),
        Some(Error::Locked)
    );
    fill_store(&mut writer, 100, 10).unwrap();
    writer
        .push(1, message_envelope(100), Encoding::Int, 0, Input::Int(95))
        .unwrap();
    let again = writer.push(1, message_envelope(100), Encoding::Int, 0, Input::Int(0));
    assert_eq!(again, Err(Error::NotIncreasing(1, 100_000, 100_000)));
    writer.rollback();
    writer
        .push(1, message_envelope(100), Encoding::Int, 0, Input::Int(95))
        .unwrap();
    writer.commit().unwrap();
    let reader = Reader::open(&folder.0).unwrap();
    assert_eq!(check_stream(&reader, 1), 101);
    assert_eq!(check_stream(&reader, 3), 100);
    assert_eq!(
        writer.push(99, message_envelope(0), Encoding::Int, 0, Input::Int(0)),
        Err(Error::UnknownStream(99))
    );
    std::fs::remove_dir_all(&folder.0).unwrap();
    std::thread::sleep(Duration::from_millis(600));
    writer
        .push(1, message_envelope(101), Encoding::Int, 0, Input::Int(96))
        .unwrap();
    assert_eq!(writer.commit(), Err(Error::Deleted));
}

#[test]
fn a_crash_at_any_step_keeps_committed_messages() {
    let mut steps = 1;
    loop {
        let folder = Folder::new();
        let options = Options {
            fault: Fault::after(steps, false),
            ..small_extents()
        };
        let mut acknowledged = 0;
        let finished = Writer::create(&folder.0, options).and_then(|mut writer| {
            let id = writer.add_stream(Compression::None, false);
            let run = (|| {
                for i in 0..1_200u64 {
                    writer.push(
                        id,
                        message_envelope(i),
                        Encoding::Int,
                        0,
                        Input::Int(i as i64 - 5),
                    )?;
                    if i % 40 == 39 {
                        writer.commit()?;
                        acknowledged = i + 1;
                    }
                    if i % 400 == 0 {
                        let big = writer.add_stream(Compression::None, true);
                        writer.push(
                            big,
                            message_envelope(0),
                            Encoding::Bytes,
                            0,
                            Input::Bytes(&message_payload(0, 50_000)),
                        )?;
                    }
                }
                writer.close()
            })();
            // A crash: nothing is cleaned up, but the lock is released with the process.
            drop(writer);
            run
        });
        let reader = Reader::open(&folder.0);
        if acknowledged > 0 {
            let reader = reader.unwrap();
            assert!(
                check_stream(&reader, 1) >= acknowledged,
                "after {steps} steps"
            );
            assert_eq!(reader.verify_entries(0, u64::MAX).unwrap().0, vec![]);
            assert_eq!(reader.damage(), vec![]);
            let report = repair::repair_store(&folder.0, false, |_, _| ()).unwrap();
            assert_eq!(report.damage, vec![]);
            let repaired = Reader::open(&folder.0).unwrap();
            assert!(repaired.is_closed());
            assert!(check_stream(&repaired, 1) >= acknowledged);
        }
        if finished.is_ok() {
            break;
        }
        steps += 1;
    }
    assert!(steps > 150, "only {steps} steps were tried");
}

#[test]
fn a_lost_index_is_rebuilt_from_the_extents() {
    let folder = Folder::new();
    let mut writer = Writer::create(&folder.0, small_extents()).unwrap();
    fill_store(&mut writer, 1_000, 100).unwrap();
    writer.close().unwrap();
    std::fs::remove_file(folder.0.join("index.situ")).unwrap();
    assert_eq!(Reader::open(&folder.0).err(), Some(Error::NoStore));
    assert!(
        repair::repair_store(&folder.0, false, |_, _| ())
            .unwrap()
            .rebuilt
    );
    let reader = Reader::open(&folder.0).unwrap();
    (1..=4).for_each(|stream| assert_eq!(check_stream(&reader, stream), 1_000));
}

#[test]
fn a_commit_and_the_close_wake_a_waiting_reader() {
    let folder = Folder::new();
    let mut writer = Writer::create(&folder.0, small_extents()).unwrap();
    let id = writer.add_stream(Compression::None, false);
    let reader = Arc::new(Reader::open(&folder.0).unwrap());
    let (sender, receiver) = std::sync::mpsc::channel();
    let waiting = reader.clone();
    let thread = std::thread::spawn(move || {
        let mut known = 0;
        loop {
            match watch::wait_for_entries(&waiting, known, Duration::from_secs(20)) {
                watch::News::Published(n) => known = n,
                watch::News::Ended(_) => return known,
                watch::News::Nothing => {}
            }
            sender.send(known).unwrap();
        }
    });
    for i in 0..20 {
        writer
            .push(id, message_envelope(i), Encoding::Int, 0, Input::Int(0))
            .unwrap();
        let committed = writer.commit().unwrap();
        while receiver.recv_timeout(Duration::from_secs(5)).unwrap() < committed {}
    }
    writer.close().unwrap();
    drop(writer);
    assert!(thread.join().unwrap() >= 20);
}

/// Returns how much of the file is resident in this process, KiB.
fn resident_size(file: &std::path::Path) -> u64 {
    let maps = std::fs::read_to_string("/proc/self/smaps").unwrap();
    let mut inside = false;
    let mut sum = 0;
    for line in maps.lines() {
        // A mapping begins with a line of addresses, whether it maps a file or not. The lines after it begin with
        // names.
        if line
            .split_whitespace()
            .next()
            .is_some_and(|word| !word.ends_with(':'))
        {
            inside = line.ends_with(file.to_str().unwrap());
        } else if let (true, Some(rest)) = (inside, line.strip_prefix("Rss:")) {
            sum += rest.trim().trim_end_matches(" kB").parse::<u64>().unwrap();
        }
    }
    sum
}

#[test]
fn a_reader_releases_pages_it_has_read() {
    let folder = Folder::new();
    let mut writer = Writer::create(&folder.0, Options::default()).unwrap();
    let id = writer.add_stream(Compression::None, false);
    let frame = message_payload(7, 1 << 20);
    for i in 0..60 {
        let input = Input::Bytes(&frame);
        writer
            .push(id, message_envelope(i), Encoding::Bytes, 0, input)
            .unwrap();
        writer.commit().unwrap();
    }
    writer.close().unwrap();
    let reader = Reader::open(&folder.0).unwrap();
    let mut most = 0;
    for pass in 0..2 {
        for i in 0..60 {
            // Forwards, then backwards.
            let entry = reader
                .entry_at(id, if pass == 0 { i } else { 59 - i })
                .unwrap()
                .unwrap();
            let chunk = reader.read_chunk(&entry).unwrap();
            assert!(chunk.body().ends_with(&frame));
            most = most.max(
                (0..2)
                    .map(|n| resident_size(&folder.0.join(extent::file_name(1, n))))
                    .sum(),
            );
        }
    }
    // The test reads 60 MiB twice, and the window is 16 MiB.
    assert!(most > 4 * 1024 && most < 24 * 1024, "{most} KiB");
}

#[test]
fn a_reader_releases_distant_small_chunks_and_its_index() {
    let folder = Folder::new();
    let mut writer = Writer::create(&folder.0, Options::default()).unwrap();
    let small = writer.add_stream(Compression::None, false);
    let between = writer.add_stream(Compression::None, false);
    let bytes = message_payload(7, 20_000);
    for i in 0..1_000 {
        writer
            .push(small, message_envelope(i), Encoding::Int, 0, Input::Int(1))
            .unwrap();
        for k in 0..3 {
            let input = Input::Bytes(&bytes);
            writer
                .push(
                    between,
                    message_envelope(3 * i + k),
                    Encoding::Bytes,
                    0,
                    input,
                )
                .unwrap();
        }
        writer.commit().unwrap();
    }
    for i in 1_000..41_000 {
        writer
            .push(small, message_envelope(i), Encoding::Int, 0, Input::Int(1))
            .unwrap();
        writer.commit().unwrap();
    }
    writer.close().unwrap();
    let reader = Reader::open(&folder.0).unwrap();
    let index = resident_size(&folder.0.join("index.situ"));
    assert!(index < 2 * 1024, "{index} KiB of the index");
    let mut most = 0;
    for i in 0..1_000 {
        let entry = reader.entry_at(small, i).unwrap().unwrap();
        assert_eq!(reader.read_chunk(&entry).unwrap().messages().count(), 1);
        if i % 50 == 0 {
            let data = (0..9).map(|n| resident_size(&folder.0.join(extent::file_name(0, n))));
            most = most.max(data.sum());
        }
    }
    // The chunks are 60 KB apart in 60 MB, and the kernel maps 64 KiB around each.
    assert!(most > 4 * 1024 && most < 24 * 1024, "{most} KiB");
}

#[test]
fn unchecked_payloads_of_large_messages_are_not_read() {
    let folder = Folder::new();
    let mut writer = Writer::create(&folder.0, Options::default()).unwrap();
    let id = writer.add_stream(Compression::None, false);
    let packed = writer.add_stream(Compression::Lz4, false);
    let frame = vec![7; 1 << 20];
    for i in 0..8 {
        for stream in [id, packed] {
            let input = Input::Bytes(&frame);
            writer
                .push(stream, message_envelope(i), Encoding::Bytes, 0, input)
                .unwrap();
        }
        writer.commit().unwrap();
    }
    writer.close().unwrap();
    let mut reader = Reader::open(&folder.0).unwrap();
    reader.verify_large = false;
    let pages = || resident_size(&folder.0.join(extent::file_name(1, 0)));
    let chunk = |reader: &Reader, stream, i| {
        let entry = reader.entry_at(stream, i).unwrap().unwrap();
        match reader.quick_chunk(&entry) {
            Some(chunk) => chunk.unwrap(),
            None => reader.read_chunk(&entry).unwrap(),
        }
    };
    // This reads the page of the extent's header and the pages that the kernel maps around it.
    chunk(&reader, id, 0);
    let first = pages();
    for i in 0..8 {
        let chunk = chunk(&reader, id, i);
        let (got, value) = chunk.messages().next().unwrap().unwrap();
        assert_eq!(got, message_envelope(i));
        assert_eq!(
            value,
            Value::Bytes {
                start: chunk.header.table_length as usize,
                length: frame.len()
            }
        );
    }
    assert!(pages() <= first + 64, "{first}, then {} KiB", pages());
    let one = chunk(&reader, id, 5);
    assert!(one.body().ends_with(&frame));
    assert!(pages() >= first + 512, "{first}, then {} KiB", pages());

    // A compressed chunk has to be unpacked, so it is never read quickly.
    let entry = reader.entry_at(packed, 5).unwrap().unwrap();
    assert!(reader.quick_chunk(&entry).is_none());
    assert!(reader.read_chunk(&entry).unwrap().body().ends_with(&frame));

    // A changed payload is not noticed, but a changed table is.
    let entry = reader.entry_at(id, 6).unwrap().unwrap();
    let path = folder.0.join(extent::file_name(1, 0));
    let mut bytes = std::fs::read(&path).unwrap();
    bytes[entry.offset as usize + 5_000] ^= 1;
    std::fs::write(&path, &bytes).unwrap();
    assert!(Reader::open(&folder.0).unwrap().read_chunk(&entry).is_err());
    assert!(reader.read_chunk(&entry).is_ok());
    bytes[entry.offset as usize + CHUNK_HEADER] ^= 1;
    std::fs::write(&path, &bytes).unwrap();
    let fresh = Reader::open(&folder.0).unwrap();
    let why = fresh.read_checked_chunk(&entry, false).err().unwrap();
    assert!(format!("{why:?}").contains("header"), "{why:?}");
    assert!(fresh.quick_chunk(&entry).is_none());
}

#[test]
fn ordinals_continue_without_a_gap_after_a_lost_index_entry() {
    let folder = Folder::new();
    let mut writer = Writer::create(&folder.0, small_extents()).unwrap();
    fill_store(&mut writer, 1_000, 100).unwrap();
    writer.close().unwrap();
    let whole = Reader::open(&folder.0).unwrap();
    let (lost, entry) = (0..whole.entries_loaded() as usize)
        .zip(whole.all_entries())
        .find(|(_, entry)| entry.stream == 1 && entry.ordinal > 0)
        .unwrap();
    let path = folder.0.join("index.situ");
    let mut bytes = std::fs::read(&path).unwrap();
    bytes[4_096 + lost * 64 + 20] ^= 1;
    std::fs::write(&path, bytes).unwrap();

    let reader = Reader::open(&folder.0).unwrap();
    assert_eq!(reader.damage().len(), 1);
    let left = 1_000 - u64::from(entry.count);
    assert_eq!(reader.message_count(1), left);
    let mut next = 0;
    while let Some(entry) = reader.entry_at(1, next).unwrap() {
        assert_eq!(entry.ordinal, next);
        next += u64::from(entry.count);
    }
    assert_eq!(next, left);
    let next = reader.ordinal_from(1, entry.last + 1).unwrap();
    assert_eq!(next, entry.ordinal);
}

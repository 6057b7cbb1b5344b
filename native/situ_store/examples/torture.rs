//! Kills a writer with -9 at random moments and at chosen steps, and checks what its store then holds.
//!
//!     cargo run --release --example torture -- KILLS [SEED]
//!
//! Every message whose commit was acknowledged (the writer prints a line after each commit) must be in the store,
//! byte for byte and in order, and nothing may be damaged. The store is then repaired and copied into a new one.
//! Prints `N passed, N failed`.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

use situ_store::chunk::{Envelope, Input, Value};
use situ_store::extent::Fault;
use situ_store::writer::{Drafts, Durability};
use situ_store::{repair, Compression, Encoding, Options, Reader, Writer};

struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    fn below(&mut self, n: u64) -> u64 {
        self.next() % n.max(1)
    }
}

fn message_envelope(i: u64) -> Envelope {
    // Creation times sometimes step back, as they do when a clock is set.
    let creation = i as i64 * 1_000 + 300 - if i.is_multiple_of(50) { 1_000_000 } else { 0 };
    Envelope {
        sequence: i + 1,
        time: i as i64 * 1_000,
        creation,
    }
}

fn message_payload(i: u64, stream: u64) -> Vec<u8> {
    let mut random = Random((i + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (stream << 32) | 1);
    let size = if stream == 3 && i.is_multiple_of(8) {
        40_000 + random.below(30_000)
    } else {
        random.below(200)
    };
    (0..size).map(|_| random.next() as u8).collect()
}

/// Writes three streams: integers (with a pyramid), small compressed binaries, and binaries of which every eighth
/// is large.
fn write_store(dir: &Path, seed: u64, fault: i64) -> situ_store::Result<()> {
    let mut random = Random(seed | 1);
    let durability = match random.below(20) {
        0 => Durability::Each,
        1 | 2 => Durability::Interval(Duration::from_millis(5)),
        _ => Durability::None,
    };
    let fault = if fault > 0 {
        Fault::after(fault, true)
    } else {
        Default::default()
    };
    let options = Options {
        first_extent: 64 * 1024,
        max_extent: 512 * 1024,
        durability,
        fault,
        ..Options::default()
    };
    let mut writer = Writer::create(dir, options)?;
    for compression in [Compression::None, Compression::Lz4, Compression::None] {
        writer.add_stream(compression, false);
    }
    // Half of the writers collect the integers in a draft.
    let drafts = Arc::new(Drafts::default());
    let draft = (random.below(2) == 0).then(|| drafts.add_draft(1));
    let mut out = std::io::stdout();
    let mut next = 0;
    while next < 30_000 {
        let end = next + 1 + random.below(60);
        let integers = (next..end).map(|i| (message_envelope(i), Input::Int(i as i64 * 3)));
        if let Some(draft) = &draft {
            draft
                .add_messages(Encoding::Int, |addition| {
                    integers
                        .map(|(to, input)| addition.push(to, input))
                        .collect()
                })
                .unwrap();
        } else {
            for (envelope, input) in integers {
                writer.push(1, envelope, Encoding::Int, 0, input)?;
            }
        }
        for stream in [2, 3] {
            for i in next..end {
                let bytes = message_payload(i, stream);
                writer.push(
                    stream as u32,
                    message_envelope(i),
                    Encoding::Bytes,
                    0,
                    Input::Bytes(&bytes),
                )?;
            }
        }
        drafts.commit_all(&mut writer)?;
        next = end;
        let _ = writeln!(out, "{next}").and_then(|()| out.flush());
    }
    writer.close()
}

fn read_stream(reader: &Reader, stream: u32) -> u64 {
    let mut ordinal = 0;
    while let Some(entry) = reader.entry_at(stream, ordinal).unwrap() {
        let chunk = reader.read_chunk(&entry).unwrap();
        for message in chunk.messages() {
            let (got, value) = message.unwrap();
            assert_eq!(got, message_envelope(ordinal), "stream {stream}");
            match value {
                Value::Int(value) => assert_eq!(value, ordinal as i64 * 3),
                Value::Bytes { start, length } => {
                    assert_eq!(
                        &chunk.body()[start..start + length],
                        message_payload(ordinal, stream as u64)
                    )
                }
                other => panic!("{other:?}"),
            }
            ordinal += 1;
        }
    }
    ordinal
}

fn check_store(dir: &Path, acknowledged: u64) {
    let reader = match Reader::open(dir) {
        Ok(reader) => reader,
        // The writer was killed before there was a store, so nothing was acknowledged.
        Err(_) if acknowledged == 0 => return,
        Err(error) => panic!("{acknowledged} messages acknowledged, but: {error}"),
    };
    assert!(!reader.is_live(), "the dead writer's lock is held");
    assert_eq!(reader.damage(), vec![]);
    let counts: Vec<u64> = (1..=3).map(|stream| read_stream(&reader, stream)).collect();
    assert!(
        counts.iter().all(|count| *count >= acknowledged),
        "{counts:?} of {acknowledged} acknowledged"
    );
    assert!(
        counts.iter().all(|count| *count == counts[0]),
        "half a commit: {counts:?}"
    );
    let bins = reader.read_summary(1, 0, i64::MAX >> 8, 22).unwrap();
    assert_eq!(
        bins.iter().map(|bin| bin.count).sum::<u64>(),
        counts[0],
        "the pyramid"
    );
    let report = repair::repair_store(dir, false, |_, _| ()).unwrap();
    assert_eq!((report.dropped, report.damage), (0, vec![]));
    let repaired = Reader::open(dir).unwrap();
    assert!(repaired.is_closed());
    (1..=3).for_each(|stream| assert_eq!(read_stream(&repaired, stream), counts[0]));
    copy_store(&repaired, &dir.join("copy"), counts[0]);
}

/// Copies the messages of the repaired store into a new one.
fn copy_store(reader: &Reader, dir: &Path, count: u64) {
    std::fs::create_dir_all(dir).unwrap();
    let mut writer = Writer::create(
        dir,
        Options {
            first_extent: 64 * 1024,
            ..Options::default()
        },
    )
    .unwrap();
    for stream in 1..=3 {
        writer.add_stream(Compression::None, false);
        let mut ordinal = 0;
        while let Some(entry) = reader.entry_at(stream, ordinal).unwrap() {
            let chunk = reader.read_chunk(&entry).unwrap();
            for (envelope, value) in chunk.messages().flatten() {
                let (encoding, input) = match value {
                    Value::Int(value) => (Encoding::Int, Input::Int(value)),
                    Value::Bytes { start, length } => (
                        Encoding::Bytes,
                        Input::Bytes(&chunk.body()[start..start + length]),
                    ),
                    other => panic!("{other:?}"),
                };
                writer.push(stream, envelope, encoding, 0, input).unwrap();
            }
            writer.commit().unwrap();
            ordinal = entry.ordinal + entry.count as u64;
        }
    }
    writer.close().unwrap();
    let copied = Reader::open(dir).unwrap();
    (1..=3).for_each(|stream| assert_eq!(copied.message_count(stream), count));
}

fn kill_one(root: &Path, seed: u64) -> u64 {
    let dir = root.join(format!("store-{seed}"));
    std::fs::create_dir_all(&dir).unwrap();
    let mut random = Random(seed.wrapping_mul(0x2545_f491_4f6c_dd1d) | 1);
    // Half of the writers are killed at a chosen step: between extents, between entries, or while closing.
    let reach = if random.below(3) == 0 { 60 } else { 4_000 };
    let fault = if random.below(2) == 0 {
        1 + random.below(reach) as i64
    } else {
        0
    };
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args([
            "write",
            &dir.to_string_lossy(),
            &seed.to_string(),
            &fault.to_string(),
        ])
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let lines = BufReader::new(child.stdout.take().unwrap());
    let reading = std::thread::spawn(move || {
        lines
            .lines()
            .map_while(Result::ok)
            .filter_map(|l| l.parse().ok())
            .last()
    });
    if fault == 0 {
        std::thread::sleep(Duration::from_micros(random.below(60_000)));
        let _ = child.kill();
    }
    child.wait().unwrap();
    let acknowledged = reading.join().unwrap().unwrap_or(0u64);
    check_store(&dir, acknowledged);
    std::fs::remove_dir_all(&dir).unwrap();
    acknowledged
}

fn main() {
    let args: Vec<String> = std::env::args().collect();
    if args.get(1).map(String::as_str) == Some("write") {
        let (seed, fault) = (args[3].parse().unwrap(), args[4].parse().unwrap());
        if let Err(error) = write_store(Path::new(&args[2]), seed, fault) {
            eprintln!("{error}");
            std::process::exit(1);
        }
        return;
    }
    let kills: u64 = args.get(1).and_then(|n| n.parse().ok()).unwrap_or(200);
    let first: u64 = args.get(2).and_then(|n| n.parse().ok()).unwrap_or(1);
    // After a kill, the writes are in the page cache of any file system. A file system in memory avoids waiting for
    // a disk.
    let memory = Path::new("/dev/shm");
    let base = if memory.is_dir() {
        memory.to_path_buf()
    } else {
        std::env::temp_dir()
    };
    let root = base.join(format!("situ-torture-{}", std::process::id()));
    let (mut failed, mut early, mut messages) = (0, 0, 0);
    for seed in first..first + kills {
        match std::panic::catch_unwind(|| kill_one(&root, seed)) {
            Ok(0) => early += 1,
            Ok(acknowledged) => messages += acknowledged,
            Err(_) => {
                failed += 1;
                eprintln!("seed {seed} failed; its store stays in {}", root.display());
            }
        }
        if (seed - first + 1).is_multiple_of(500) {
            eprintln!("{} kills, {failed} failed", seed - first + 1);
        }
    }
    if failed == 0 {
        let _ = std::fs::remove_dir_all(&root);
    }
    eprintln!(
        "{kills} kills: {early} before the first commit, \
         {messages} acknowledged messages checked in each of 3 streams"
    );
    println!("{} passed, {failed} failed", kills - failed);
    std::process::exit(if failed == 0 { 0 } else { 1 });
}

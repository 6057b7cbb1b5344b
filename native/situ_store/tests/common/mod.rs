#![allow(dead_code, clippy::unwrap_used, clippy::expect_used)]
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use situ_store::chunk::{Envelope, Input, Value};
use situ_store::{Compression, Encoding, Options, Reader, Writer};

static NEXT: AtomicU32 = AtomicU32::new(0);

/// A temporary folder that is deleted when the test ends.
pub struct Folder(pub PathBuf);

impl Folder {
    pub fn new() -> Self {
        let n = NEXT.fetch_add(1, Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("situ-store-{}-{n}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).unwrap();
        Folder(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

pub struct Random(pub u64);

impl Random {
    pub fn below(&mut self, n: u64) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0 % n.max(1)
    }
}

/// Reads the files of a folder: (name, contents), by name.
pub fn read_files(dir: &Path) -> Vec<(String, Vec<u8>)> {
    let file = |file: std::io::Result<std::fs::DirEntry>| {
        let file = file.unwrap();
        let name = file.file_name().into_string().unwrap();
        (name, std::fs::read(file.path()).unwrap())
    };
    let mut found: Vec<_> = std::fs::read_dir(dir).unwrap().map(file).collect();
    found.sort();
    found
}

pub fn message_envelope(i: u64) -> Envelope {
    Envelope {
        sequence: i + 1,
        time: i as i64 * 1_000,
        creation: i as i64 * 1_000 + 250 + (i % 3) as i64,
    }
}

/// Visits the messages of a stream in order, except those in damaged chunks.
pub fn visit_messages(reader: &Reader, stream: u32, mut visit: impl FnMut(Envelope, Value, &[u8])) {
    let mut ordinal = 0;
    while let Some(entry) = reader.entry_at(stream, ordinal).unwrap() {
        ordinal = entry.ordinal + u64::from(entry.count);
        let Ok(chunk) = reader.read_chunk(&entry) else {
            continue;
        };
        for (envelope, value) in chunk.messages().map_while(|message| message.ok()) {
            visit(envelope, value, chunk.body());
        }
    }
}

/// Generates the bytes of message `i`, which depend only on `i`.
pub fn message_payload(i: u64, size: usize) -> Vec<u8> {
    let mut state = i.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    (0..size)
        .map(|_| {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            state as u8
        })
        .collect()
}

pub fn small_extents() -> Options {
    Options {
        first_extent: 16 * 1024,
        max_extent: 64 * 1024,
        ..Options::default()
    }
}

/// Writes `n` messages into each of four streams (1 integers, 2 small binaries, 3 large binaries, 4 compressed),
/// `batch` in each commit.
pub fn fill_store(writer: &mut Writer, n: u64, batch: u64) -> situ_store::Result<()> {
    let compressions = [
        Compression::None,
        Compression::None,
        Compression::None,
        Compression::Zstd,
    ];
    let ids: Vec<u32> = compressions
        .iter()
        .map(|c| writer.add_stream(*c, false))
        .collect();
    let mut from = 0;
    while from < n {
        for (at, id) in ids.iter().enumerate() {
            for i in from..(from + batch).min(n) {
                let bytes = message_payload(i, size_of_message(at, i));
                match at {
                    0 => writer.push(
                        *id,
                        message_envelope(i),
                        Encoding::Int,
                        0,
                        Input::Int(i as i64 - 5),
                    )?,
                    _ => writer.push(
                        *id,
                        message_envelope(i),
                        Encoding::Bytes,
                        0,
                        Input::Bytes(&bytes),
                    )?,
                }
            }
        }
        writer.commit()?;
        from += batch;
    }
    Ok(())
}

pub fn size_of_message(at: usize, i: u64) -> usize {
    match at {
        2 if i.is_multiple_of(16) => 40_000,
        _ => (i % 97) as usize,
    }
}

/// Reads every message of a stream in order, and panics if one differs from those of `fill_store`.
pub fn check_stream(reader: &Reader, stream: u32) -> u64 {
    let mut ordinal = 0;
    while let Some(entry) = reader.entry_at(stream, ordinal).unwrap() {
        assert_eq!(entry.ordinal, ordinal);
        let chunk = reader.read_chunk(&entry).unwrap();
        for message in chunk.messages() {
            let (got, value) = message.unwrap();
            assert_eq!(got, message_envelope(ordinal));
            match value {
                Value::Int(value) => assert_eq!(value, ordinal as i64 - 5),
                Value::Bytes { start, length } => assert_eq!(
                    &chunk.body()[start..start + length],
                    message_payload(ordinal, size_of_message(stream as usize - 1, ordinal))
                ),
                other => panic!("{other:?}"),
            }
            ordinal += 1;
        }
    }
    ordinal
}

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
//! The gaps of a stream are those between its messages, however the messages are distributed over chunks and bins.
mod common;

use common::*;
use situ_store::chunk::{Envelope, Input};
use situ_store::{Encoding, Reader, Writer};

/// Writes messages at these times in commits of `batch`, and returns the open writer.
fn write_times(folder: &Folder, times: &[i64], batch: usize) -> Writer {
    let mut writer = Writer::create(&folder.0, small_extents()).unwrap();
    let stream = writer.add_stream(situ_store::Compression::None, false);
    for batch in times.chunks(batch) {
        for time in batch {
            let envelope = Envelope {
                sequence: 1,
                time: *time,
                creation: *time,
            };
            let input = Input::Int(*time);
            writer
                .push(stream, envelope, Encoding::Int, 0, input)
                .unwrap();
        }
        writer.commit().unwrap();
    }
    writer
}

fn expected_gaps(times: &[i64], least: i64) -> Vec<(i64, i64)> {
    let pairs = times.windows(2).map(|pair| (pair[0], pair[1]));
    pairs.filter(|(a, b)| b - a >= least).collect()
}

#[test]
fn finds_gaps_within_chunks() {
    let mut random = Random(0x0dd_ba11);
    for round in 0..40 {
        let mut time = random.below(1 << 40) as i64 - (1 << 39);
        let n = [3, 200, 700, 5_000][round % 4];
        let times: Vec<i64> = (0..n)
            .map(|_| {
                let pause = random.below(200) == 0;
                time += 1 + random.below(if pause { 50_000_000 } else { 20_000 }) as i64;
                time
            })
            .collect();
        let folder = Folder::new();
        let batch = 1 + random.below(2_000) as usize;
        let mut writer = write_times(&folder, &times, batch);
        let live = Reader::open(&folder.0).unwrap();
        let leasts = [1, 3, 19_000, 500_000, 4_000_000, 30_000_000, i64::MAX];
        for least in leasts {
            assert_eq!(
                live.find_gaps(1, least),
                expected_gaps(&times, least),
                "{round}"
            );
        }
        writer.close().unwrap();
        let closed = Reader::open(&folder.0).unwrap();
        for least in leasts {
            assert_eq!(
                closed.find_gaps(1, least),
                expected_gaps(&times, least),
                "{round}"
            );
        }
        assert_eq!(closed.find_gaps(7, 1), vec![]);
    }
}

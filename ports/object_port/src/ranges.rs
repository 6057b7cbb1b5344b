//! Fetches ranges of an object into a local file.

use std::time::Duration;

use futures_util::stream::{self, StreamExt, TryStreamExt};
use object_store::aws::AmazonS3;
use object_store::path::Path;
use object_store::{GetOptions, GetRange, ObjectStore};

use crate::command::Fill;
use crate::fault::{Fault, Result};
use crate::local_file::Mirror;
use crate::{meter, settings};

/// The maximum number of bytes of a request.
const REQUEST: u64 = 8 << 20;
/// The number of requests at the same time.
const PARALLEL: usize = 4;
/// The code of a connection that does not continue.
const STALLED: &str = "stalled";
/// The number of attempts to fetch bytes with the right checksum.
const ATTEMPTS: usize = 3;

/// Splits the missing blocks of the ranges into requests: first block and number of blocks.
pub fn plan_requests(ranges: &[(u64, u64)], have: &[u8], block: u64) -> Vec<(u64, u64)> {
    let most = (REQUEST / block).max(1);
    let mut requests: Vec<(u64, u64)> = Vec::new();
    for at in ranges.iter().flat_map(|(first, last)| *first..=*last) {
        if have.get(at as usize).is_none_or(|mark| *mark != 0) {
            continue;
        }
        match requests.last_mut() {
            Some((first, count)) if *first + *count == at && *count < most => *count += 1,
            _ => requests.push((at, 1)),
        }
    }
    requests
}

/// Waits for bytes, but not forever: a connection may be lost without a sign.
async fn limit_waiting<T>(
    work: impl std::future::Future<Output = T>,
    seconds: Duration,
) -> Result<T> {
    let waited = tokio::time::timeout(seconds, work).await;
    waited.map_err(|_| {
        let why = format!("the service sent nothing for {} s", seconds.as_secs());
        Fault::new(STALLED, why)
    })
}

/// Reads the body of a reply.
pub async fn collect_body(result: object_store::GetResult) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let mut parts = result.into_stream();
    let seconds = settings::find_timeout();
    while let Some(part) = limit_waiting(parts.try_next(), seconds).await?? {
        meter::count_received(part.len());
        bytes.extend_from_slice(&part);
    }
    Ok(bytes)
}

async fn fetch_range(store: &AmazonS3, fill: &Fill, from: u64, to: u64) -> Result<Vec<u8>> {
    let options = GetOptions {
        range: Some(GetRange::Bounded(from..to)),
        if_match: fill.etag.clone(),
        ..GetOptions::default()
    };
    let key = Path::parse(&fill.key).map_err(object_store::Error::from)?;
    let result = store.get_opts(&key, options).await?;
    if fill.etag.is_some() && result.meta.e_tag != fill.etag {
        let why = format!("the object {} was replaced", fill.key);
        return Err(Fault::new("changed", why));
    }
    collect_body(result).await
}

/// Returns whether the bytes have the expected length and checksums.
fn matches_sums(bytes: &[u8], length: u64, sums: &[u8], block: u64) -> bool {
    bytes.len() as u64 == length
        && bytes
            .chunks(block as usize)
            .zip(sums.chunks(4))
            .all(|(part, sum)| crc32fast::hash(part).to_le_bytes() == sum)
}

async fn fill_request(
    store: &AmazonS3,
    fill: &Fill,
    (mirror, sums): (&Mirror, &[u8]),
    (first, count): (u64, u64),
) -> Result<u64> {
    let (from, to) = (
        first * fill.block,
        ((first + count) * fill.block).min(fill.size),
    );
    let expected = sums
        .get(first as usize * 4..(first + count) as usize * 4)
        .ok_or_else(|| Fault::new("invalid", format!("{} has too few checksums", fill.sums)))?;
    for attempt in 1..=ATTEMPTS {
        let bytes = match fetch_range(store, fill, from, to).await {
            Err(fault) if fault.code == STALLED && attempt < ATTEMPTS => continue,
            result => result?,
        };
        if matches_sums(&bytes, to - from, expected, fill.block) {
            mirror.write_blocks(from, bytes, first, count).await?;
            return Ok(to - from);
        }
    }
    let why = format!(
        "bytes {from} to {to} of {} have a wrong checksum, after {ATTEMPTS} attempts",
        fill.key
    );
    Err(Fault::new("checksum", why))
}

/// Fetches the missing blocks and passes the number of bytes of each request to `progress`.
pub async fn fill_blocks(store: &AmazonS3, fill: &Fill, progress: impl Fn(u64)) -> Result<()> {
    let sums = std::fs::read(&fill.sums).map_err(|e| Fault::local("read", &fill.sums, &e))?;
    let mirror = Mirror::open(&fill.path, fill.size)?;
    let marks = mirror.read_marks(fill.size.div_ceil(fill.block.max(1)))?;
    let requests = plan_requests(&fill.ranges, &marks, fill.block);
    let files = (&mirror, sums.as_slice());
    stream::iter(requests)
        .map(|request| fill_request(store, fill, files, request))
        .buffer_unordered(PARALLEL)
        .try_for_each(|bytes| {
            progress(bytes);
            std::future::ready(Ok(()))
        })
        .await
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_leave_out_marked_blocks_and_are_limited() {
        let block = REQUEST / 2;
        assert_eq!(
            plan_requests(&[(0, 1), (2, 6)], &[0, 0, 0, 1, 0, 0], block),
            [(0, 2), (2, 1), (4, 2)]
        );
    }

    #[test]
    fn sums_detect_changed_bytes_and_lengths() {
        let sums: Vec<u8> = [&b"abcd"[..], b"e"]
            .iter()
            .flat_map(|part| crc32fast::hash(part).to_le_bytes())
            .collect();
        assert!(matches_sums(b"abcde", 5, &sums, 4));
        assert!(!matches_sums(b"abcdf", 5, &sums, 4));
        assert!(!matches_sums(b"abcd", 5, &sums, 4));
    }
}

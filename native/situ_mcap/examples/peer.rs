//! Measures how fast the `mcap` crate writes and reads messages by itself, for `bin/bench mcap-beside`: `peer FILE
//! N BYTES` prints the processor time per message in ns for writing and reading, and both rates by the clock.
//! Chunks have the crate's default size and no compression, like our recordings. The file is read completely into
//! memory, which is the closest to a memory map without `unsafe`.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::error::Error;
use std::io::BufWriter;
use std::time::Instant;

use mcap::records::MessageHeader;

/// Returns the processor time of this thread, ns.
fn thread_time() -> Result<u64, Box<dyn Error>> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat")?;
    let first = text.split_whitespace().next().unwrap_or("0");
    Ok(first.parse()?)
}

fn print_result(what: &str, n: u64, since: Instant, before: u64) -> Result<(), Box<dyn Error>> {
    let used = thread_time()? - before;
    let rate = n as f64 / since.elapsed().as_secs_f64();
    println!("{what} {} {rate}", used as f64 / n as f64);
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, path, n, bytes] = arguments.as_slice() else {
        return Err("usage: peer FILE N BYTES".into());
    };
    let (n, bytes): (u64, usize) = (n.parse()?, bytes.parse()?);
    let mut payload: Vec<u8> = (0..bytes).map(|i| (i * 37 % 251) as u8).collect();

    let (since, before) = (Instant::now(), thread_time()?);
    let file = BufWriter::new(std::fs::File::create(path)?);
    let mut writer = mcap::WriteOptions::new()
        .compression(None)
        .compression_threads(0)
        .create(file)?;
    let channel = writer.add_channel(0, "s", "raw", &BTreeMap::new())?;
    for i in 0..n {
        payload[..8].copy_from_slice(&i.to_le_bytes());
        let header = MessageHeader {
            channel_id: channel,
            sequence: i as u32,
            log_time: i * 1_000,
            publish_time: i * 1_000 + 5,
        };
        writer.write_to_known_channel(&header, &payload)?;
    }
    writer.finish()?;
    print_result("write", n, since, before)?;

    let (since, before) = (Instant::now(), thread_time()?);
    let file = std::fs::read(path)?;
    let (mut count, mut sum) = (0, 0u64);
    for message in mcap::MessageStream::new(&file)? {
        let data: Cow<'_, [u8]> = message?.data;
        let mut number = [0; 8];
        number.copy_from_slice(data.get(..8).ok_or("a message is too short")?);
        sum = sum.wrapping_add(u64::from_le_bytes(number));
        count += 1;
    }
    if (count, sum) != (n, n * n.saturating_sub(1) / 2) {
        return Err(format!("read {count} of {n} messages, sum {sum}").into());
    }
    print_result("read", n, since, before)
}

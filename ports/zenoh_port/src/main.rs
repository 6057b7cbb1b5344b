//! A Zenoh session for a program without a Zenoh library. It reads commands from standard input and writes events to
//! standard output. As in Erlang's ports, every frame is preceded by its length in four bytes (big-endian).
//!
//! Commands: `1 id key` declares a publisher, `2 id attachment payload` puts a sample, `3 id key` subscribes, `4 id
//! key` declares a liveliness token, `5 id` undeclares any of these, and `6 id key` subscribes to tokens. `7 id depth
//! key` declares a publisher that keeps its last `depth` samples for late subscribers, and `8 id depth key` a
//! subscriber that requests them. `9 id key` declares a service, `10 id ms key attachment payload` calls one with a
//! timeout, and `11 id request attachment payload` and `12 id request text` reply to a request or reject it.
//!
//! Events: `1 zid` the session is open, `2 id key attachment payload` a sample, `3 id alive key` a token appeared or
//! disappeared, `4 id` a put was handed over, `5 id request attachment payload` a request, `6 id attachment payload` a
//! reply, `7 id text` a rejection, `8 id` no more replies will follow, `255 id text` an error.
//!
//! Ids, requests, depths and ms are four bytes. Keys and attachments are preceded by their length in two bytes if
//! something follows, and the last part extends to the end of the frame.
//!
//! Arguments: MODE (peer, client, router), then any number of `connect=ENDPOINT` and `listen=ENDPOINT`. The program
//! ends at the end of its input.

mod port;

use std::io::{self, BufWriter, Read, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{channel, sync_channel};
use std::sync::Arc;
use std::thread;

use port::{Any, Port};
use zenoh::{Config, Wait};

/// The maximum size of a frame.
const MAX_FRAME: usize = 256 << 20;
/// The number of frames that are read ahead of the current command.
const AHEAD: usize = 64;

fn parse_config() -> Result<Config, Any> {
    let mut config = Config::default();
    let mut arguments = std::env::args().skip(1);
    let mode = arguments
        .next()
        .ok_or("no mode given (peer, client or router)")?;
    let (mut connect, mut listen) = (Vec::new(), Vec::new());
    for argument in arguments {
        match argument.split_once('=') {
            Some(("connect", endpoint)) => connect.push(endpoint.to_owned()),
            Some(("listen", endpoint)) => listen.push(endpoint.to_owned()),
            _ => return Err(format!("unknown argument {argument}").into()),
        }
    }
    let list = |all: &[String]| {
        let quoted: Vec<String> = all.iter().map(|e| format!("{e:?}")).collect();
        format!("[{}]", quoted.join(","))
    };
    config.insert_json5("mode", &format!("{mode:?}"))?;
    config.insert_json5("scouting/multicast/enabled", "false")?;
    config.insert_json5("scouting/gossip/enabled", "false")?;
    config.insert_json5("connect/endpoints", &list(&connect))?;
    config.insert_json5("listen/endpoints", &list(&listen))?;
    // Samples that are kept for late subscribers are identified by their timestamps.
    config.insert_json5("timestamping/enabled", "true")?;
    // Keeps trying to connect to a router that is not running yet.
    config.insert_json5("connect/timeout_ms", "-1")?;
    config.insert_json5("connect/exit_on_failure", "false")?;
    Ok(config)
}

fn read_frame(input: &mut impl Read) -> io::Result<Option<Vec<u8>>> {
    let mut size = [0; 4];
    match input.read_exact(&mut size) {
        Err(e) if e.kind() == io::ErrorKind::UnexpectedEof => return Ok(None),
        other => other?,
    }
    let size = u32::from_be_bytes(size) as usize;
    if size > MAX_FRAME {
        return Err(io::Error::other("the frame is too large"));
    }
    let mut bytes = vec![0; size];
    input.read_exact(&mut bytes)?;
    Ok(Some(bytes))
}

fn write_frames(frames: std::sync::mpsc::Receiver<Vec<u8>>) -> io::Result<()> {
    let mut output = BufWriter::new(io::stdout().lock());
    while let Ok(first) = frames.recv() {
        for bytes in std::iter::once(first).chain(frames.try_iter().take(500)) {
            let size = u32::try_from(bytes.len()).map_err(io::Error::other)?;
            output.write_all(&size.to_be_bytes())?;
            output.write_all(&bytes)?;
        }
        output.flush()?;
    }
    Ok(())
}

fn run_port() -> Result<(), Any> {
    let (out, frames) = channel();
    let (commands, received) = sync_channel(AHEAD);
    let open = Arc::new(AtomicBool::new(false));
    let session_open = open.clone();
    thread::spawn(move || {
        let mut input = io::stdin().lock();
        while let Ok(Some(bytes)) = read_frame(&mut input) {
            if commands.send(bytes).is_err() {
                break;
            }
        }
        // The parent program has exited, and no router was found yet.
        if !session_open.load(Ordering::SeqCst) {
            std::process::exit(0);
        }
    });
    let session = zenoh::open(parse_config()?).wait()?;
    thread::spawn(move || {
        // The parent program has exited, so nothing reads the output.
        let _ = write_frames(frames);
        std::process::exit(0);
    });
    open.store(true, Ordering::SeqCst);
    let mut greeting = vec![1];
    greeting.extend(session.zid().to_string().as_bytes());
    out.send(greeting)?;
    let mut port = Port::new(session, out);
    for bytes in received {
        port.handle_frame(&bytes)?;
    }
    port.close()
}

fn main() {
    if let Err(why) = run_port() {
        eprintln!("zenoh_port: {why}");
        std::process::exit(1);
    }
}

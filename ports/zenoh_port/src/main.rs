//! A Zenoh session for a program that has none: what it is told on standard input it does, what it hears it says on
//! standard output. Frames have a length of four bytes (big-endian) before them; so Erlang's ports have them.
//!
//! In: `1 id key` declares a publisher, `2 id attachment payload` puts, `3 id key` subscribes, `4 id key` declares a
//! token of liveliness, `5 id` ends any of them, `6 id key` hears of tokens; `7 id depth key` and `8 id depth key` are
//! a publisher that keeps so many samples for those who come later, and a subscriber that gets them; `9 id key` offers
//! a service, `10 id ms key attachment payload` asks one and waits so long, `11 id request attachment payload` and `12
//! id request text` answer or refuse.
//!
//! Out: `1 zid` it is open, `2 id key attachment payload` a sample, `3 id alive key` a token came or went, `4 id` a put
//! was handed over, `5 id request attachment payload` somebody asks, `6 id attachment payload` an answer, `7 id text`
//! a refusal, `8 id` nobody answers any more, `255 id text` trouble.
//!
//! Ids, requests, depths and ms have four bytes; keys and attachments have a length of two before them where something
//! follows, the last part takes what is left.
//!
//! Arguments: MODE (peer, client, router), then `connect=ENDPOINT` and `listen=ENDPOINT` as often as needed. It ends
//! with its input.

mod port;

use std::io::{self, BufWriter, Read, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{channel, sync_channel};
use std::sync::Arc;
use std::thread;

use port::{Any, Port};
use zenoh::{Config, Wait};

const MOST: usize = 256 << 20;
/// Frames that are read ahead of what is being done.
const AHEAD: usize = 64;

fn config() -> Result<Config, Any> {
    let mut config = Config::default();
    let mut arguments = std::env::args().skip(1);
    let mode = arguments.next().ok_or("no mode is given")?;
    let (mut connect, mut listen) = (Vec::new(), Vec::new());
    for argument in arguments {
        match argument.split_once('=') {
            Some(("connect", endpoint)) => connect.push(endpoint.to_owned()),
            Some(("listen", endpoint)) => listen.push(endpoint.to_owned()),
            _ => return Err(format!("the argument {argument}").into()),
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
    // Samples that are kept for those who come later are told apart by their times.
    config.insert_json5("timestamping/enabled", "true")?;
    // A router that is not there yet is waited for.
    config.insert_json5("connect/timeout_ms", "-1")?;
    config.insert_json5("connect/exit_on_failure", "false")?;
    Ok(config)
}

fn frame(input: &mut impl Read) -> io::Result<Option<Vec<u8>>> {
    let mut size = [0; 4];
    match input.read_exact(&mut size) {
        Err(e) if e.kind() == io::ErrorKind::UnexpectedEof => return Ok(None),
        other => other?,
    }
    let size = u32::from_be_bytes(size) as usize;
    if size > MOST {
        return Err(io::Error::other("a frame that is too large"));
    }
    let mut bytes = vec![0; size];
    input.read_exact(&mut bytes)?;
    Ok(Some(bytes))
}

fn speak(said: std::sync::mpsc::Receiver<Vec<u8>>) -> io::Result<()> {
    let mut output = BufWriter::new(io::stdout().lock());
    while let Ok(first) = said.recv() {
        for bytes in std::iter::once(first).chain(said.try_iter().take(500)) {
            let size = u32::try_from(bytes.len()).map_err(io::Error::other)?;
            output.write_all(&size.to_be_bytes())?;
            output.write_all(&bytes)?;
        }
        output.flush()?;
    }
    Ok(())
}

fn run() -> Result<(), Any> {
    let (out, said) = channel();
    let (hear, obeyed) = sync_channel(AHEAD);
    let open = Arc::new(AtomicBool::new(false));
    let opened = open.clone();
    thread::spawn(move || {
        let mut input = io::stdin().lock();
        while let Ok(Some(bytes)) = frame(&mut input) {
            if hear.send(bytes).is_err() {
                break;
            }
        }
        // Whoever started this one is gone, and no router was found yet.
        if !opened.load(Ordering::SeqCst) {
            std::process::exit(0);
        }
    });
    let session = zenoh::open(config()?).wait()?;
    thread::spawn(move || {
        // Nobody listens any more: the program that started this one is gone.
        let _ = speak(said);
        std::process::exit(0);
    });
    open.store(true, Ordering::SeqCst);
    let mut hello = vec![1];
    hello.extend(session.zid().to_string().as_bytes());
    out.send(hello)?;
    let mut port = Port::new(session, out);
    for bytes in obeyed {
        port.hear(&bytes)?;
    }
    port.end()
}

fn main() {
    if let Err(why) = run() {
        eprintln!("zenoh_port: {why}");
        std::process::exit(1);
    }
}

//! A Zenoh session for a program that has none: what it is told on standard input it does, what it hears it says on
//! standard output. Frames have a length of four bytes (big-endian) before them; so Erlang's ports have them.
//!
//! In: `1 id key` declares a publisher, `2 id attachment payload` puts, `3 id key` subscribes, `4 id key` declares a
//! token of liveliness, `5 id` ends any of them, `6 id key` hears of tokens. Out: `1 zid` it is open, `2 id key
//! attachment payload` a sample, `3 id alive key` a token came or went, `4 id` a put was handed over, `255 id text`
//! trouble. An id has four bytes; keys and attachments have a length of two before them, the last part takes what is
//! left.
//!
//! Arguments: MODE (peer, client, router), then `connect=ENDPOINT` and `listen=ENDPOINT` as often as needed. It ends
//! with its input.

use std::collections::HashMap;
use std::io::{self, BufWriter, Read, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{channel, sync_channel, Sender};
use std::sync::Arc;
use std::thread;

use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::CongestionControl;
use zenoh::sample::{Sample, SampleKind};
use zenoh::{Config, Session, Wait};

const MOST: usize = 256 << 20;
/// Frames that are read ahead of what is being done.
const AHEAD: usize = 64;

type Any = Box<dyn std::error::Error + Send + Sync>;

enum Declared {
    Publisher(Publisher<'static>),
    Subscriber(#[allow(dead_code)] Subscriber<()>),
    Token(#[allow(dead_code)] LivelinessToken),
}

fn part(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let size = usize::from(u16::from_be_bytes(bytes.get(..2)?.try_into().ok()?));
    Some((bytes.get(2..2 + size)?, bytes.get(2 + size..)?))
}

fn sized(bytes: &[u8], out: &mut Vec<u8>) {
    let size = u16::try_from(bytes.len()).unwrap_or(u16::MAX);
    out.extend(size.to_be_bytes());
    out.extend(&bytes[..usize::from(size)]);
}

fn sample(id: u32, sample: &Sample) -> Vec<u8> {
    let mut out = vec![2];
    out.extend(id.to_be_bytes());
    sized(sample.key_expr().as_str().as_bytes(), &mut out);
    let attachment = sample.attachment().map(|a| a.to_bytes().into_owned());
    sized(&attachment.unwrap_or_default(), &mut out);
    out.extend(sample.payload().to_bytes().iter());
    out
}

fn token(id: u32, sample: &Sample) -> Vec<u8> {
    let mut out = vec![3];
    out.extend(id.to_be_bytes());
    out.push(u8::from(sample.kind() == SampleKind::Put));
    out.extend(sample.key_expr().as_str().as_bytes());
    out
}

struct Port {
    session: Session,
    declared: HashMap<u32, Declared>,
    out: Sender<Vec<u8>>,
}

impl Port {
    fn obey(&mut self, what: u8, id: u32, rest: &[u8]) -> Result<(), Any> {
        let text = || String::from_utf8(rest.to_vec());
        let out = self.out.clone();
        let new = match what {
            1 => {
                let publisher = self.session.declare_publisher(text()?);
                let publisher = publisher.congestion_control(CongestionControl::Block);
                Declared::Publisher(publisher.wait()?)
            }
            2 => return self.put(id, rest),
            3 => {
                let subscriber = self.session.declare_subscriber(text()?);
                let told = move |s: Sample| drop(out.send(sample(id, &s)));
                Declared::Subscriber(subscriber.callback(told).wait()?)
            }
            4 => Declared::Token(self.session.liveliness().declare_token(text()?).wait()?),
            5 => {
                self.declared.remove(&id);
                return Ok(());
            }
            6 => {
                let liveliness = self.session.liveliness();
                let subscriber = liveliness.declare_subscriber(text()?).history(true);
                let told = move |s: Sample| drop(out.send(token(id, &s)));
                Declared::Subscriber(subscriber.callback(told).wait()?)
            }
            _ => return Err("no such command".into()),
        };
        self.declared.insert(id, new);
        Ok(())
    }

    fn put(&mut self, id: u32, rest: &[u8]) -> Result<(), Any> {
        let (attachment, payload) = part(rest).ok_or("a put that is cut short")?;
        match self.declared.get(&id) {
            Some(Declared::Publisher(publisher)) => {
                let put = publisher.put(payload).attachment(attachment);
                put.wait()?;
                let mut done = vec![4];
                done.extend(id.to_be_bytes());
                drop(self.out.send(done));
                Ok(())
            }
            _ => Err("no such publisher".into()),
        }
    }
}

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

fn trouble(id: u32, why: &str) -> Vec<u8> {
    let mut out = vec![255];
    out.extend(id.to_be_bytes());
    out.extend(why.as_bytes());
    out
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
    let mut port = Port {
        session,
        declared: HashMap::new(),
        out,
    };
    for bytes in obeyed {
        let (what, rest) = bytes.split_first().ok_or("an empty frame")?;
        let id = rest.get(..4).ok_or("a frame without an id")?;
        let id = u32::from_be_bytes(id.try_into()?);
        if let Err(why) = port.obey(*what, id, &rest[4..]) {
            port.out.send(trouble(id, &why.to_string()))?;
        }
    }
    port.declared.clear();
    port.session.close().wait()?;
    Ok(())
}

fn main() {
    if let Err(why) = run() {
        eprintln!("zenoh_port: {why}");
        std::process::exit(1);
    }
}

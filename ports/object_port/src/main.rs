//! Reads and writes objects of S3-compatible services for a program without a library for them. It reads commands from
//! standard input and writes replies to standard output. As in Erlang's ports, every frame is preceded by its length in
//! four bytes (big-endian).
//!
//! A command is `id (8 bytes), length of the JSON text (4 bytes), JSON text, bytes`, and a reply is `id (8 bytes), kind
//! (1 byte), length of the JSON text (4 bytes), JSON text, bytes`. The kinds of replies are 0 (done), 1 (failed:
//! `{code, why}`) and 2 (progress: `{done}`, more replies follow). `command.rs` lists the commands. They run
//! concurrently, and the last reply of each contains its requests and bytes (`cost`).
//!
//! Credentials come from the environment or from the files of the AWS tools (`settings.rs`). They never appear in
//! commands or replies. The program ends at the end of its input.

mod command;
mod fault;
mod journal;
mod local_file;
mod meter;
mod port;
mod ranges;
mod settings;
mod upload;

use std::io::{self, BufWriter, Read, Write};
use std::sync::mpsc::{channel, Receiver};
use std::thread;

use port::Port;

/// The maximum size of a frame.
const MAX_FRAME: usize = 512 << 20;

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

fn write_frames(frames: &Receiver<Vec<u8>>) -> io::Result<()> {
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

fn run_port() -> io::Result<()> {
    let (out, frames) = channel();
    let (commands, mut received) = tokio::sync::mpsc::unbounded_channel();
    thread::spawn(move || {
        // The parent program has exited if nothing reads the output.
        let _ = write_frames(&frames);
        std::process::exit(0);
    });
    thread::spawn(move || {
        let mut input = io::stdin().lock();
        while let Ok(Some(bytes)) = read_frame(&mut input) {
            if commands.send(bytes).is_err() {
                break;
            }
        }
        std::process::exit(0);
    });
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()?;
    let port = Port::new(out);
    runtime.block_on(async {
        while let Some(bytes) = received.recv().await {
            tokio::spawn(port.clone().handle_frame(bytes));
        }
    });
    Ok(())
}

fn main() {
    if let Err(why) = run_port() {
        eprintln!("object_port: {why}");
        std::process::exit(1);
    }
}

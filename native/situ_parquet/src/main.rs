//! Reads and writes Parquet files for `Situ.Bridge.Parquet`, over standard input and output.
//!
//! It is a program of its own because the crate `parquet` may panic, recurse deeply or allocate much memory for a
//! hostile file, which must not end the VM. Requests and results are terms in packets with 4 bytes of size. One process
//! reads or writes one file, and ends with its input.

mod assemble;
mod error;
mod leaf;
mod meaning;
mod reader;
mod schema;
mod shred;
mod term;
mod writer;

use error::{malformed, Error, Result};
use std::io::{self, Read, Write};
use std::panic::{catch_unwind, AssertUnwindSafe};
use term::{Encoder, Term};

/// The limit of the process's memory. A page of a valid file has at most 2 GB.
const MAX_MEMORY: u64 = 6 << 30;

#[derive(Default)]
struct Session {
    reader: Option<reader::Reader>,
    writer: Option<writer::Writer>,
}

fn main() -> io::Result<()> {
    limit_memory();
    silence_errors();
    let mut session = Session::default();
    let (mut input, mut output) = (io::stdin().lock(), io::stdout().lock());
    while let Some(request) = read_packet(&mut input)? {
        let result = handle_request(&mut session, &request);
        output.write_all(&(result.len() as u32).to_be_bytes())?;
        output.write_all(&result)?;
        output.flush()?;
    }
    Ok(())
}

fn limit_memory() {
    use rustix::process::{getrlimit, setrlimit, Resource, Rlimit};
    let maximum = getrlimit(Resource::As).maximum;
    let current = Some(maximum.map_or(MAX_MEMORY, |maximum| maximum.min(MAX_MEMORY)));
    // Without the limit, the program still works.
    let _ = setrlimit(Resource::As, Rlimit { current, maximum });
}

// Failures are reported as results. Messages on standard error would disturb the terminal of the VM.
fn silence_errors() {
    if let Ok(null) = std::fs::File::options().write(true).open("/dev/null") {
        let _ = rustix::stdio::dup2_stderr(null);
    }
}

fn read_packet(input: &mut impl Read) -> io::Result<Option<Vec<u8>>> {
    let mut size = [0; 4];
    if let Err(error) = input.read_exact(&mut size) {
        return if error.kind() == io::ErrorKind::UnexpectedEof {
            Ok(None)
        } else {
            Err(error)
        };
    }
    let mut request = vec![0; u32::from_be_bytes(size) as usize];
    input.read_exact(&mut request)?;
    Ok(Some(request))
}

fn handle_request(session: &mut Session, request: &[u8]) -> Vec<u8> {
    let mut out = Encoder::new();
    let result = catch_unwind(AssertUnwindSafe(|| {
        answer_request(session, request, &mut out)
    }));
    match result.unwrap_or_else(|panic| {
        *session = Session::default();
        malformed(describe_panic(&*panic))
    }) {
        Ok(()) => out.0,
        Err(error) => encode_error(&error),
    }
}

fn describe_panic(panic: &(dyn std::any::Any + Send)) -> String {
    let why = panic
        .downcast_ref::<String>()
        .map(String::as_str)
        .or_else(|| panic.downcast_ref::<&str>().copied())
        .unwrap_or("unknown reason");
    format!("the crate parquet failed: {why}")
}

fn encode_error(error: &Error) -> Vec<u8> {
    let mut out = Encoder::new();
    out.tuple(2);
    out.atom("error");
    out.tuple(2);
    match error {
        Error::Io(error) if error.kind() == io::ErrorKind::StorageFull => {
            out.atom("disk_full");
            out.bytes(error.to_string().as_bytes());
        }
        Error::Io(error) => {
            out.atom("io");
            out.bytes(error.to_string().as_bytes());
        }
        Error::Malformed(why) => {
            out.atom("malformed");
            out.bytes(why.as_bytes());
        }
    }
    out.0
}

fn answer_request(session: &mut Session, request: &[u8], out: &mut Encoder) -> Result<()> {
    let Some(Term::Tuple(request)) = term::decode(request) else {
        return malformed("the request is not a tuple");
    };
    match (request.as_slice(), session) {
        ([Term::Atom("open"), Term::Bytes(path)], session) => {
            let reader = reader::Reader::open(path)?;
            reader.describe(out);
            session.reader = Some(reader);
        }
        (
            [Term::Atom("ranges"), Term::Int(column)],
            Session {
                reader: Some(reader),
                ..
            },
        ) => {
            reader.column_ranges(*column as usize, out)?;
        }
        (
            [Term::Atom("group"), Term::Int(group), Term::List(columns)],
            Session {
                reader: Some(reader),
                ..
            },
        ) => {
            reader.start_group(*group as usize, columns)?;
            out.atom("ok");
        }
        (
            [Term::Atom("rows")],
            Session {
                reader: Some(reader),
                ..
            },
        ) => {
            reader.next_rows(out)?;
        }
        (
            [Term::Atom("columns")],
            Session {
                reader: Some(reader),
                ..
            },
        ) => {
            reader.next_columns(out)?;
        }
        (
            [Term::Atom("create"), Term::Bytes(path), Term::List(columns), Term::Tuple(options)],
            session,
        ) => {
            session.writer = Some(writer::Writer::create(path, columns, options)?);
            out.atom("ok");
        }
        (
            [Term::Atom("write"), Term::Int(rows), values],
            Session {
                writer: Some(writer),
                ..
            },
        ) => {
            writer.write_rows(*rows as usize, values)?;
            out.atom("ok");
        }
        ([Term::Atom("finish")], session) => {
            if let Some(writer) = session.writer.take() {
                writer.finish()?;
            }
            out.atom("ok");
        }
        _ => return malformed("unknown request"),
    }
    Ok(())
}

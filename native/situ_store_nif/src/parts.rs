//! Returns the messages of a chunk as terms.

use std::sync::Arc;

use rustler::types::tuple::make_tuple;
use rustler::{Binary, Encoder, Env, NewBinary, ResourceArc, Term};
use situ_store::chunk::Value;
use situ_store::format::MAX_CHUNK_MESSAGES;
use situ_store::guard::Map;
use situ_store::reader::Chunk;
use situ_store::Encoding;

use crate::atoms;
use crate::terms::{decode_term, encode_binary, Decoded, COPY_UP_TO};

/// The memory that the binaries of messages refer to: a mapped extent or an unpacked chunk.
pub enum Bytes {
    Map(Arc<Map>, usize, usize),
    Unpacked(Arc<Vec<u8>>),
}

#[rustler::resource_impl]
impl rustler::Resource for Bytes {}

/// Encodes the messages of one chunk as `{sequence, originating, creation, data}`.
struct Run<'a> {
    env: Env<'a>,
    encoding: Encoding,
    whole: Option<Binary<'a>>,
    /// The memory size of the terms' structure, bytes.
    structure: u64,
}

impl<'a> Run<'a> {
    fn start(env: Env<'a>, chunk: &Chunk) -> Self {
        let encoding = chunk.header.encoding;
        let is_shared = matches!(encoding, Encoding::Bytes | Encoding::Codec)
            && chunk.body().len() > COPY_UP_TO;
        let whole = is_shared.then(|| {
            let bytes = match (chunk.unpacked_body(), chunk.body_offset()) {
                (Some(bytes), _) => Bytes::Unpacked(bytes),
                (None, at) => Bytes::Map(chunk.map.clone(), at.unwrap_or(0), chunk.body().len()),
            };
            ResourceArc::new(bytes).make_binary(env, |bytes| match bytes {
                Bytes::Map(map, at, length) => &map[*at..*at + *length],
                Bytes::Unpacked(bytes) => bytes,
            })
        });
        Run {
            env,
            encoding,
            whole,
            structure: 0,
        }
    }

    /// Returns the last elements of a message's tuple: its data or, for terms that are not plain, a tag and
    /// details.
    fn encode_data(&mut self, body: &[u8], value: Value) -> (Term<'a>, Option<Term<'a>>) {
        let env = self.env;
        if let (Encoding::Term, Value::Bytes { start, length }) = (self.encoding, value) {
            let bytes = &body[start..start + length];
            let (decoded, structure) = decode_term(env, bytes);
            self.structure += structure as u64;
            return match decoded {
                Decoded::Plain(term) => (term, None),
                Decoded::Refused(why) => (atoms::undecodable().encode(env), Some(why.encode(env))),
                Decoded::Unknown(modules, term) => (
                    atoms::unknown().encode(env),
                    Some((modules, encode_binary(env, bytes), term).encode(env)),
                ),
            };
        }
        (self.encode_value(body, value), None)
    }

    fn encode_value(&self, body: &[u8], value: Value) -> Term<'a> {
        let env = self.env;
        match value {
            Value::Int(value) => value.encode(env),
            Value::Float(value) if value.is_finite() => value.encode(env),
            // The BEAM has no such floats, but a writer in another language may have stored them.
            Value::Float(_) => atoms::nil().encode(env),
            Value::Bool(0) => atoms::r#false().encode(env),
            Value::Bool(1) => atoms::r#true().encode(env),
            Value::Bool(_) => atoms::nil().encode(env),
            Value::Bytes { start, length } => {
                let bytes = &body[start..start + length];
                match &self.whole {
                    Some(whole) if length > COPY_UP_TO => {
                        match whole.make_subbinary(start, length) {
                            Ok(part) => part.encode(env),
                            Err(_) => encode_binary(env, bytes),
                        }
                    }
                    _ => encode_binary(env, bytes),
                }
            }
        }
    }
}

/// The selected messages of one chunk.
pub struct Part<'a> {
    pub codec: u16,
    /// A list of tuples, or `{:integers, rows}`.
    pub messages: Term<'a>,
    pub count: u64,
    /// Whether these are the last selected messages or, in a damaged chunk, the last readable ones. In the latter
    /// case the next read returns the error.
    pub ended: bool,
    /// Its unpacked size in memory, including the structure of terms, bytes.
    pub size: u64,
}

impl<'a> Part<'a> {
    /// Reads the messages after the first `skip`, up to time `to`, at most `most`.
    pub fn read(
        env: Env<'a>,
        chunk: &Chunk,
        skip: u64,
        to: i64,
        most: u64,
    ) -> Result<Part<'a>, &'static str> {
        match chunk.header.encoding {
            Encoding::Int => Part::read_integers(env, chunk, skip, to, most),
            _ => Part::read_terms(env, chunk, skip, to, most),
        }
    }

    /// Reads integers as rows of four 64-bit values: sequence id, originating time, creation time, and integer, in the
    /// byte order that the BEAM decodes fastest. (It decodes floats slower than it receives them as terms.)
    fn read_integers(
        env: Env<'a>,
        chunk: &Chunk,
        skip: u64,
        to: i64,
        most: u64,
    ) -> Result<Part<'a>, &'static str> {
        let mut rows: Vec<[u64; 4]> = Vec::with_capacity(MAX_CHUNK_MESSAGES as usize);
        let mut ended = false;
        for (at, message) in (0u64..).zip(chunk.messages()) {
            let (envelope, value) = match message {
                Ok(message) => message,
                Err(why) if rows.is_empty() => return Err(why),
                Err(_) => {
                    ended = true;
                    break;
                }
            };
            if at < skip {
                continue;
            }
            if envelope.time > to || rows.len() as u64 >= most {
                ended = true;
                break;
            }
            let Value::Int(value) = value else {
                return Err("the chunk's values contradict its encoding");
            };
            let row = [
                envelope.sequence,
                envelope.time as u64,
                envelope.creation as u64,
                value as u64,
            ];
            rows.push(row.map(u64::to_be));
        }
        let mut bytes = NewBinary::new(env, rows.len() * 32);
        for (to, row) in bytes.as_mut_slice().chunks_exact_mut(32).zip(&rows) {
            for (to, value) in to.chunks_exact_mut(8).zip(row) {
                to.copy_from_slice(&value.to_ne_bytes());
            }
        }
        Ok(Part {
            codec: 0,
            messages: (atoms::integers(), Binary::from(bytes)).encode(env),
            count: rows.len() as u64,
            ended,
            size: chunk.body().len() as u64,
        })
    }

    fn read_terms(
        env: Env<'a>,
        chunk: &Chunk,
        skip: u64,
        to: i64,
        most: u64,
    ) -> Result<Part<'a>, &'static str> {
        let mut run = Run::start(env, chunk);
        let body = chunk.body();
        let mut list = Vec::with_capacity(chunk.header.count.min(MAX_CHUNK_MESSAGES) as usize);
        let mut ended = false;
        // Messages of one batch often have the same creation time, which is a big number, so its term is reused.
        let mut last_creation = (i64::MIN, i64::MIN.encode(env));
        for (at, message) in (0u64..).zip(chunk.messages()) {
            let (envelope, value) = match message {
                Ok(message) => message,
                Err(why) if list.is_empty() => return Err(why),
                Err(_) => {
                    ended = true;
                    break;
                }
            };
            if at < skip {
                continue;
            }
            if envelope.time > to || list.len() as u64 >= most {
                ended = true;
                break;
            }
            if envelope.creation != last_creation.0 {
                last_creation = (envelope.creation, envelope.creation.encode(env));
            }
            let (data, details) = run.encode_data(body, value);
            let terms = [
                envelope.sequence.encode(env),
                envelope.time.encode(env),
                last_creation.1,
                data,
                details.unwrap_or(data),
            ];
            let length = if details.is_some() { 5 } else { 4 };
            list.push(make_tuple(env, &terms[..length]));
        }
        Ok(Part {
            codec: chunk.header.codec,
            count: list.len() as u64,
            messages: list.encode(env),
            ended,
            size: body.len() as u64 + run.structure,
        })
    }
}

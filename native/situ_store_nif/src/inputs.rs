//! Passes terms to a writer.

use rustler::types::list::ListIterator;
use rustler::{Binary, Error as NifError, NifResult, Term, TermType};
use situ_store::chunk::{Envelope, Input};
use situ_store::format::LARGE_MESSAGE;
use situ_store::pyramid::Bin;
use situ_store::{etf, Encoding, Error, Writer};

use crate::atoms;

pub fn decode_envelope(message: Term<'_>) -> NifResult<Envelope> {
    Ok(Envelope {
        sequence: message.map_get(atoms::sequence_id())?.decode()?,
        time: message.map_get(atoms::originating_time())?.decode()?,
        creation: message.map_get(atoms::creation_time())?.decode()?,
    })
}

pub fn detect_encoding(data: Term<'_>) -> Encoding {
    match data.get_type() {
        TermType::Integer if data.decode::<i64>().is_ok() => Encoding::Int,
        TermType::Float => Encoding::Float,
        TermType::Binary if data.is_binary() => Encoding::Bytes,
        TermType::Atom if decode_boolean(data).is_some() => Encoding::Bool,
        _ => Encoding::Term,
    }
}

fn fits_encoding(encoding: Encoding, data: Term<'_>) -> bool {
    match encoding {
        Encoding::Int => data.decode::<i64>().is_ok(),
        Encoding::Float => data.is_float(),
        Encoding::Bytes => data.is_binary(),
        Encoding::Bool => decode_boolean(data).is_some(),
        _ => true,
    }
}

pub fn decode_boolean(data: Term<'_>) -> Option<u8> {
    if atoms::r#false() == data {
        Some(0)
    } else if atoms::r#true() == data {
        Some(1)
    } else if atoms::nil() == data {
        Some(2)
    } else {
        None
    }
}

pub enum AppendError {
    Store(Error),
    Argument(NifError),
}

impl From<Error> for AppendError {
    fn from(error: Error) -> Self {
        AppendError::Store(error)
    }
}

impl From<NifError> for AppendError {
    fn from(error: NifError) -> Self {
        AppendError::Argument(error)
    }
}

fn push_message(
    writer: &mut Writer,
    stream: u32,
    encoding: Encoding,
    envelope: Envelope,
    data: Term<'_>,
) -> Result<(), AppendError> {
    let bytes: Binary<'_>;
    let owned;
    let input = match encoding {
        Encoding::Int => Input::Int(data.decode()?),
        Encoding::Float => Input::Float(data.decode()?),
        Encoding::Bool => Input::Bool(decode_boolean(data).unwrap_or(2)),
        Encoding::Bytes => {
            bytes = data.decode()?;
            Input::Bytes(bytes.as_slice())
        }
        _ => {
            owned = data.to_binary();
            etf::check_term(owned.as_slice())
                .map_err(|refusal| Error::NotStorable(refusal.describe()))?;
            Input::Bytes(owned.as_slice())
        }
    };
    Ok(writer.push(stream, envelope, encoding, 0, input)?)
}

/// Pushes all messages of the batches in one encoding. Returns `false` if a message does not fit it.
fn push_all(
    writer: &mut Writer,
    stream: u32,
    encoding: Encoding,
    batches: ListIterator<'_>,
) -> Result<bool, AppendError> {
    for batch in batches {
        for message in batch.into_list_iterator()? {
            let data = message.map_get(atoms::data())?;
            if !fits_encoding(encoding, data) {
                return Ok(false);
            }
            push_message(writer, stream, encoding, decode_envelope(message)?, data)?;
        }
    }
    Ok(true)
}

fn all_fit(encoding: Encoding, batches: ListIterator<'_>) -> NifResult<bool> {
    for batch in batches {
        for message in batch.into_list_iterator()? {
            if !fits_encoding(encoding, message.map_get(atoms::data())?) {
                return Ok(false);
            }
        }
    }
    Ok(true)
}

/// Appends batches in the encoding of the first message. A mixture is stored as terms, so that chunks stay long.
pub fn append_batches(
    writer: &mut Writer,
    stream: u32,
    batches: Term<'_>,
) -> Result<u64, AppendError> {
    let first = batches
        .into_list_iterator()?
        .find_map(|batch| batch.into_list_iterator().ok()?.next());
    let data = match first {
        Some(message) => message.map_get(atoms::data())?,
        None => return Ok(writer.committed_entries()),
    };
    let encoding = detect_encoding(data);
    // Large messages are written as soon as they are pushed, so all messages are checked first.
    let large = |bytes: Binary<'_>| bytes.len() >= LARGE_MESSAGE;
    let fit = !(encoding == Encoding::Bytes && data.decode().is_ok_and(large))
        || all_fit(encoding, batches.into_list_iterator()?)?;
    if !fit || !push_all(writer, stream, encoding, batches.into_list_iterator()?)? {
        writer.rollback();
        push_all(
            writer,
            stream,
            Encoding::Term,
            batches.into_list_iterator()?,
        )?;
    }
    Ok(writer.commit()?)
}

/// Collects the binaries of an iolist without copying them. Single bytes are gathered.
fn collect_parts<'a>(term: Term<'a>, found: &mut Vec<Part<'a>>, depth: u32) -> NifResult<()> {
    if let Ok(binary) = term.decode::<Binary<'a>>() {
        found.push(Part::Binary(binary));
        return Ok(());
    }
    if depth > 64 {
        return Err(NifError::BadArg);
    }
    for element in term.into_list_iterator()? {
        if let Ok(byte) = element.decode::<u8>() {
            match found.last_mut() {
                Some(Part::Loose(bytes)) => bytes.push(byte),
                _ => found.push(Part::Loose(vec![byte])),
            }
        } else {
            collect_parts(element, found, depth + 1)?;
        }
    }
    Ok(())
}

enum Part<'a> {
    Binary(Binary<'a>),
    Loose(Vec<u8>),
}

/// Appends runs of messages of one kind, `{codec, messages, points}`, in one commit. Codec 0 means plain messages.
pub fn append_runs(
    writer: &mut Writer,
    stream: u32,
    runs: ListIterator<'_>,
) -> Result<u64, AppendError> {
    for run in runs {
        let (codec, messages, points): (u16, Term<'_>, ListIterator<'_>) = run.decode()?;
        if codec == 0 {
            push_plain(writer, stream, messages)?;
        } else {
            push_encoded(
                writer,
                stream,
                codec,
                messages.into_list_iterator()?,
                points,
            )?;
        }
    }
    Ok(writer.commit()?)
}

/// Pushes a list of plain messages. All of them are checked before the first one is written, so that messages
/// pushed earlier remain valid.
fn push_plain(writer: &mut Writer, stream: u32, messages: Term<'_>) -> Result<(), AppendError> {
    let list = || messages.into_list_iterator();
    let Some(first) = list()?.next() else {
        return Ok(());
    };
    let mut encoding = detect_encoding(first.map_get(atoms::data())?);
    for message in list()? {
        if !fits_encoding(encoding, message.map_get(atoms::data())?) {
            encoding = Encoding::Term;
            break;
        }
    }
    for message in list()? {
        let data = message.map_get(atoms::data())?;
        push_message(writer, stream, encoding, decode_envelope(message)?, data)?;
    }
    Ok(())
}

fn push_encoded(
    writer: &mut Writer,
    stream: u32,
    codec: u16,
    messages: ListIterator<'_>,
    points: ListIterator<'_>,
) -> Result<(), AppendError> {
    let mut found = Vec::new();
    for message in messages {
        let (sequence, time, creation, bytes): (u64, i64, i64, Term<'_>) = message.decode()?;
        found.clear();
        collect_parts(bytes, &mut found, 0)?;
        let slices: Vec<&[u8]> = found
            .iter()
            .map(|part| match part {
                Part::Binary(binary) => binary.as_slice(),
                Part::Loose(bytes) => bytes.as_slice(),
            })
            .collect();
        let envelope = Envelope {
            sequence,
            time,
            creation,
        };
        writer.push(
            stream,
            envelope,
            Encoding::Codec,
            codec,
            Input::Parts(&slices),
        )?;
    }
    for point in points {
        let (start, min, max, last, count): (i64, f64, f64, f64, u64) = point.decode()?;
        writer.push_point(
            stream,
            Bin {
                start,
                min,
                max,
                last,
                count,
            },
        )?;
    }
    Ok(())
}

//! Adds messages and columns to drafts.

use std::sync::Arc;

use rustler::{Binary, Term};
use situ_store::chunk::{Envelope, Input};
use situ_store::writer::{Draft, Size};
use situ_store::Encoding;

use crate::atoms;
use crate::inputs::{decode_boolean, decode_envelope, detect_encoding};

/// Adds messages to a draft. Returns their number and the size of the draft, or `None` if one does not fit.
pub fn add_to_draft(draft: &Arc<Draft>, messages: Term<'_>) -> Option<(usize, Size)> {
    let list = || messages.into_list_iterator().ok();
    let first = list()?.next()?.map_get(atoms::data()).ok()?;
    let encoding = detect_encoding(first);
    let mut added = 0;
    let size = draft.add_messages(encoding, |addition| {
        for message in list()? {
            let envelope = decode_envelope(message).ok()?;
            let data = message.map_get(atoms::data()).ok()?;
            let bytes: Binary<'_>;
            let input = match encoding {
                Encoding::Int => Input::Int(data.decode().ok()?),
                Encoding::Float => Input::Float(data.decode().ok().filter(|_| data.is_float())?),
                Encoding::Bool => Input::Bool(decode_boolean(data)?),
                Encoding::Bytes => {
                    bytes = data.decode().ok()?;
                    Input::Bytes(bytes.as_slice())
                }
                _ => return None,
            };
            addition.push(envelope, input)?;
            added += 1;
        }
        Some(())
    })?;
    Some((added, size))
}

/// The creation times of columns: one for all messages, or eight bytes for each.
#[derive(rustler::NifUntaggedEnum)]
pub enum CreationTimes<'a> {
    Shared(i64),
    Each(Binary<'a>),
}

/// Adds columns to a draft: times and values of eight bytes each (booleans: one byte), and the sequence id of the
/// first message. Returns as `add_to_draft` does; columns of different lengths do not fit either.
pub fn add_columns_to_draft(
    draft: &Arc<Draft>,
    encoding: Encoding,
    (times, values): (&[u8], &[u8]),
    creations: &CreationTimes<'_>,
    first_id: u64,
) -> Option<(usize, Size)> {
    let width = if encoding == Encoding::Bool { 1 } else { 8 };
    let count = times.len() / 8;
    let fits = times.len() % 8 == 0 && values.len() == count * width;
    let fits_creations = match creations {
        CreationTimes::Shared(_) => true,
        CreationTimes::Each(each) => each.len() == times.len(),
    };
    if !fits || !fits_creations {
        return None;
    }
    let size = draft.add_messages(encoding, |addition| {
        let rows = times.chunks_exact(8).zip(values.chunks_exact(width));
        for (index, (time, value)) in rows.enumerate() {
            let creation = match creations {
                CreationTimes::Shared(creation) => *creation,
                CreationTimes::Each(each) => read_i64(&each[index * 8..index * 8 + 8])?,
            };
            let envelope = Envelope {
                sequence: first_id.checked_add(index as u64)?,
                time: read_i64(time)?,
                creation,
            };
            let input = match encoding {
                Encoding::Bool => Input::Bool(value.first().copied().filter(|byte| *byte < 2)?),
                Encoding::Float => Input::Float(f64::from_bits(read_i64(value)? as u64)),
                _ => Input::Int(read_i64(value)?),
            };
            addition.push(envelope, input)?;
        }
        Some(())
    })?;
    Some((count, size))
}

fn read_i64(bytes: &[u8]) -> Option<i64> {
    Some(i64::from_le_bytes(bytes.try_into().ok()?))
}

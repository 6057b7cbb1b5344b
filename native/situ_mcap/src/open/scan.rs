//! Passing over a file without an index.

use std::collections::BTreeMap;

use mcap::records::{op, Record};

use super::{header, take, unpacked, Contents};
use crate::chunk::Records;
use crate::file::{parse, Bytes, Place};
use crate::track::{Entry, LOOSE};
use crate::{Error, Found, Result};

/// Passes over all records, up to the first that makes no sense.
pub fn scan(bytes: &Bytes) -> Result<Contents> {
    let mut contents = Contents::default();
    let mut entries = BTreeMap::new();
    let mut at = 8;
    loop {
        match bytes.place(at) {
            Ok(Some(place)) => match record(bytes, place, at, &mut contents, &mut entries) {
                Ok(true) => at = place.end(),
                Ok(false) => break,
                Err(Error::Damaged(fault, why)) => {
                    contents.damage.push(format!("at byte {fault}: {why}"));
                    // A chunk that cannot be unpacked still has a known end.
                    if place.opcode != op::CHUNK || place.end() > bytes.size {
                        break;
                    }
                    at = place.end();
                }
                Err(other) => return Err(other),
            },
            Ok(None) => {
                contents
                    .damage
                    .push(format!("the file is cut short at byte {}", bytes.size));
                break;
            }
            Err(other) => return Err(other),
        }
    }
    entries.retain(|id, _| contents.channels.contains_key(id));
    contents.counts = entries
        .iter()
        .map(|(id, e): (&u16, &Vec<Entry>)| (*id, e.len() as u64))
        .collect();
    contents.entries = Some(entries);
    Ok(contents)
}

type Entries = BTreeMap<u16, Vec<Entry>>;

/// Whether more may follow.
fn record(
    bytes: &Bytes,
    place: Place,
    at: u64,
    contents: &mut Contents,
    entries: &mut Entries,
) -> Result<bool> {
    match place.opcode {
        op::FOOTER | op::DATA_END => {
            contents.finished = true;
            Ok(false)
        }
        op::MESSAGE => {
            let head = bytes.read(place.body, 22.min(place.length))?;
            if place.end() > bytes.size || head.len() < 22 {
                return Err(Error::Damaged(
                    at,
                    "the file is cut short within a message".to_string(),
                ));
            }
            let Record::Message { header, .. } = parse(op::MESSAGE, &head, at)? else {
                return Ok(true);
            };
            let entry = Entry {
                time: header.log_time,
                chunk: LOOSE,
                offset: at,
            };
            entries.entry(header.channel_id).or_default().push(entry);
            Ok(true)
        }
        op::CHUNK => {
            chunk(bytes, place, at, contents, entries)?;
            Ok(place.end() <= bytes.size)
        }
        op::ATTACHMENT => {
            let body = bytes.body(place)?;
            if let Record::Attachment { header, data, .. } = parse(op::ATTACHMENT, &body, at)? {
                contents.attachments.push(Found {
                    name: header.name,
                    media_type: header.media_type,
                    log_time: header.log_time,
                    offset: at,
                    size: data.len() as u64,
                });
            }
            Ok(true)
        }
        op::HEADER | op::SCHEMA | op::CHANNEL | op::METADATA => {
            take(contents, place.opcode, &bytes.body(place)?, at)?;
            Ok(true)
        }
        0 => Err(Error::Damaged(at, "no record begins with 0".to_string())),
        _ if place.end() > bytes.size => {
            Err(Error::Damaged(at, "the file is cut short".to_string()))
        }
        _ => Ok(true),
    }
}

fn chunk(
    bytes: &Bytes,
    place: Place,
    at: u64,
    contents: &mut Contents,
    entries: &mut Entries,
) -> Result<()> {
    let (records, torn) = unpacked(bytes, place, at)?;
    let number = contents.chunks.len() as u32;
    for (opcode, offset, body) in Records::new(&records) {
        if opcode == op::MESSAGE {
            if let Record::Message { header, .. } = parse(opcode, body, at)? {
                let entry = Entry {
                    time: header.log_time,
                    chunk: number,
                    offset,
                };
                entries.entry(header.channel_id).or_default().push(entry);
            }
        } else {
            take(contents, opcode, body, at)?;
        }
    }
    contents.chunks.push(header(bytes, place, at)?);
    if torn {
        contents.damage.push(format!(
            "the file is cut short within the chunk at byte {at}"
        ));
    }
    Ok(())
}

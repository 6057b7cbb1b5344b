//! Passing over a file without an index.

use std::collections::BTreeMap;

use mcap::records::{op, Record};

use super::attachment::Attached;
use super::walk::Walk;
use super::{header, take, unpacked, Contents};
use crate::chunk::Records;
use crate::file::{parse, Bytes, Place};
use crate::track::{Entry, LOOSE};
use crate::{Error, Result};

/// Passes over all records. Those that make no sense are left out, and `damage` has a sentence about each.
pub fn scan(bytes: &Bytes) -> Result<Contents> {
    let mut contents = Contents::default();
    let mut entries = BTreeMap::new();
    let mut walk = Walk::new(8, bytes.size);
    loop {
        let Some(place) = walk.place(bytes)? else {
            contents.note_damage(format!("the file is cut short at byte {}", bytes.size));
            break;
        };
        match record(bytes, place, walk.at, &mut contents, &mut entries) {
            Ok(true) => walk.at = place.end(),
            Ok(false) => break,
            Err(Error::Damaged(fault, why)) => {
                let passed = walk.pass(bytes, place)?;
                contents.note_damage(left_out(fault, &why, passed));
                if passed.is_none() {
                    break;
                }
            }
            Err(other) => return Err(other),
        }
    }
    let unknown = entries
        .iter()
        .filter(|(id, _)| !contents.channels.contains_key(id))
        .map(|(_, e): (&u16, &Vec<Entry>)| e.len())
        .sum::<usize>();
    if unknown > 0 {
        contents.note_damage(format!(
            "{unknown} messages are of channels that the file does not describe"
        ));
    }
    entries.retain(|id, _| contents.channels.contains_key(id));
    contents.counts = entries
        .iter()
        .map(|(id, e): (&u16, &Vec<Entry>)| (*id, e.len() as u64))
        .collect();
    contents.entries = Some(entries);
    Ok(contents)
}

/// A sentence about damage, and how much could not be read for it.
pub fn left_out(fault: u64, why: &str, passed: Option<u64>) -> String {
    match passed {
        Some(n) => format!("at byte {fault}: {why} ({n} bytes are left out)"),
        None => format!("at byte {fault}: {why}; nothing after it can be read"),
    }
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
        op::CHUNK => chunk(bytes, place, at, contents, entries).map(|()| true),
        op::ATTACHMENT => {
            let attached = Attached::read(bytes, place, at)?;
            contents.attachments.push(attached.found(at));
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
        return Err(Error::Damaged(
            at,
            "the file is cut short within a chunk".to_string(),
        ));
    }
    Ok(())
}

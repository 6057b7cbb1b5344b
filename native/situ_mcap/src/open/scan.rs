//! Scans a file without an index.

use std::collections::BTreeMap;

use mcap::records::{op, Record};

use super::attachment::StoredAttachment;
use super::walk::Walk;
use super::{add_record, read_chunk_info, unpack_records, Contents};
use crate::chunk::Records;
use crate::file::{parse_record, FileBytes, RecordHead};
use crate::track::{Entry, LOOSE};
use crate::{Error, Result};

/// Scans all records. Invalid records are left out, and `damage` contains a sentence about each.
pub fn scan_records(bytes: &FileBytes) -> Result<Contents> {
    let mut contents = Contents::default();
    let mut entries = BTreeMap::new();
    let mut walk = Walk::new(8, bytes.size);
    loop {
        let Some(record) = walk.next_record(bytes)? else {
            contents.note_damage(format!("the file is cut short at byte {}", bytes.size));
            break;
        };
        match scan_record(bytes, record, walk.at, &mut contents, &mut entries) {
            Ok(true) => walk.at = record.end(),
            Ok(false) => break,
            Err(Error::Damaged(fault, why)) => {
                let passed = walk.skip_damage(bytes, record)?;
                contents.note_damage(describe_damage(fault, &why, passed));
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

/// Describes damage and the number of bytes that could not be read because of it.
pub fn describe_damage(fault: u64, why: &str, passed: Option<u64>) -> String {
    match passed {
        Some(n) => format!("at byte {fault}: {why} ({n} bytes are left out)"),
        None => format!("at byte {fault}: {why}; nothing after it can be read"),
    }
}

type Entries = BTreeMap<u16, Vec<Entry>>;

/// Scans a record. Returns whether more records may follow.
fn scan_record(
    bytes: &FileBytes,
    record: RecordHead,
    at: u64,
    contents: &mut Contents,
    entries: &mut Entries,
) -> Result<bool> {
    match record.opcode {
        op::FOOTER | op::DATA_END => {
            contents.finished = true;
            Ok(false)
        }
        op::MESSAGE => {
            let head = bytes.read(record.body, 22.min(record.length))?;
            if record.end() > bytes.size || head.len() < 22 {
                return Err(Error::Damaged(
                    at,
                    "the file is cut short within a message".to_string(),
                ));
            }
            let Record::Message { header, .. } = parse_record(op::MESSAGE, &head, at)? else {
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
        op::CHUNK => scan_chunk(bytes, record, at, contents, entries).map(|()| true),
        op::ATTACHMENT => {
            let attachment = StoredAttachment::read(bytes, record, at)?;
            contents.attachments.push(attachment.info(at));
            Ok(true)
        }
        op::HEADER | op::SCHEMA | op::CHANNEL | op::METADATA => {
            add_record(contents, record.opcode, &bytes.record_body(record)?, at)?;
            Ok(true)
        }
        0 => Err(Error::Damaged(at, "no record begins with 0".to_string())),
        _ if record.end() > bytes.size => {
            Err(Error::Damaged(at, "the file is cut short".to_string()))
        }
        _ => Ok(true),
    }
}

fn scan_chunk(
    bytes: &FileBytes,
    record: RecordHead,
    at: u64,
    contents: &mut Contents,
    entries: &mut Entries,
) -> Result<()> {
    let (records, torn) = unpack_records(bytes, record, at)?;
    let number = contents.chunks.len() as u32;
    for (opcode, offset, body) in Records::new(&records) {
        if opcode == op::MESSAGE {
            if let Record::Message { header, .. } = parse_record(opcode, body, at)? {
                let entry = Entry {
                    time: header.log_time,
                    chunk: number,
                    offset,
                };
                entries.entry(header.channel_id).or_default().push(entry);
            }
        } else {
            add_record(contents, opcode, body, at)?;
        }
    }
    contents.chunks.push(read_chunk_info(bytes, record, at)?);
    if torn {
        return Err(Error::Damaged(
            at,
            "the file is cut short within a chunk".to_string(),
        ));
    }
    Ok(())
}

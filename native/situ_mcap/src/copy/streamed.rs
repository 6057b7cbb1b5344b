//! Copies record by record in file order, without using the index.

use mcap::records::op;

use super::Copy;
use crate::chunk::Records;
use crate::file::RecordHead;
use crate::open::{describe_damage, unpack_records, Walk};
use crate::{Error, Reader, Result, Writer};

/// The approximate size of a step, bytes.
const STEP: u64 = 8 << 20;

pub struct Streamed {
    walk: Walk,
}

impl Streamed {
    pub fn new(reader: &Reader) -> Self {
        Streamed {
            walk: Walk::new(8, reader.bytes.size),
        }
    }

    pub fn step(&mut self, copy: &mut Copy, reader: &Reader, writer: &mut Writer) -> Result<bool> {
        let until = self.walk.at.saturating_add(STEP);
        while self.walk.at < until {
            let Some(record) = self.walk.next_record(&reader.bytes)? else {
                return self.cut_short(copy, reader);
            };
            if matches!(record.opcode, op::DATA_END | op::FOOTER) {
                return Ok(true);
            }
            match self.copy_record(copy, reader, writer, record) {
                Ok(()) => self.walk.at = record.end(),
                Err(Error::Damaged(at, why)) if copy.selection.skip_damage => {
                    let passed = self.walk.skip_damage(&reader.bytes, record)?;
                    copy.report.note_left_out(describe_damage(at, &why, passed));
                    if passed.is_none() {
                        return Ok(true);
                    }
                }
                Err(other) => return Err(other),
            }
        }
        Ok(false)
    }

    fn cut_short(&self, copy: &mut Copy, reader: &Reader) -> Result<bool> {
        // A complete file ends with a record that marks its end.
        let why = "the file is cut short".to_string();
        if !copy.selection.skip_damage {
            return Err(Error::Damaged(reader.bytes.size, why));
        }
        copy.report
            .note_left_out(format!("at byte {}: {why}", reader.bytes.size));
        Ok(true)
    }

    fn copy_record(
        &mut self,
        copy: &mut Copy,
        reader: &Reader,
        writer: &mut Writer,
        record: RecordHead,
    ) -> Result<()> {
        let at = self.walk.at;
        match record.opcode {
            0 => Err(Error::Damaged(at, "no record begins with 0".to_string())),
            op::CHUNK => copy_chunk(copy, reader, writer, (record, at)),
            _ if record.end() > reader.bytes.size => {
                Err(Error::Damaged(at, "the file is cut short".to_string()))
            }
            op::ATTACHMENT => copy.copy_attachment(reader, writer, at),
            op::MESSAGE | op::METADATA | op::SCHEMA | op::CHANNEL => {
                let body = reader.bytes.record_body(record)?;
                copy.copy_record(writer, (record.opcode, &body, at), false)
            }
            opcode if opcode > op::DATA_END => {
                let body = reader.bytes.record_body(record)?;
                copy.copy_record(writer, (opcode, &body, at), false)
            }
            // The header is written already, and indexes are rebuilt.
            _ => Ok(()),
        }
    }
}

fn copy_chunk(
    copy: &mut Copy,
    reader: &Reader,
    writer: &mut Writer,
    (record, at): (RecordHead, u64),
) -> Result<()> {
    let (records, torn) = unpack_records(&reader.bytes, record, at)?;
    let mut read = 0;
    for (opcode, offset, body) in Records::new(&records) {
        copy.copy_record(writer, (opcode, body, at), true)?;
        read = offset as usize + 9 + body.len();
    }
    if torn || read != records.len() {
        let why = "a chunk ends within a record".to_string();
        return Err(Error::Damaged(at, why));
    }
    Ok(())
}

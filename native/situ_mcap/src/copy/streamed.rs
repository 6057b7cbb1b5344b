//! Copies in the order of the file, record by record. The index is not used.

use mcap::records::op;

use super::Copy;
use crate::chunk::Records;
use crate::file::Place;
use crate::open::{left_out, unpacked, Walk};
use crate::{Error, Reader, Result, Writer};

/// Bytes of a step, about.
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
            let Some(place) = self.walk.place(&reader.bytes)? else {
                return self.cut_short(copy, reader);
            };
            if matches!(place.opcode, op::DATA_END | op::FOOTER) {
                return Ok(true);
            }
            match self.record(copy, reader, writer, place) {
                Ok(()) => self.walk.at = place.end(),
                Err(Error::Damaged(at, why)) if copy.selection.skip_damage => {
                    let passed = self.walk.pass(&reader.bytes, place)?;
                    copy.copied.note_left_out(left_out(at, &why, passed));
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
        // A whole file ends in a record that says so.
        let why = "the file is cut short".to_string();
        if !copy.selection.skip_damage {
            return Err(Error::Damaged(reader.bytes.size, why));
        }
        copy.copied
            .note_left_out(format!("at byte {}: {why}", reader.bytes.size));
        Ok(true)
    }

    fn record(
        &mut self,
        copy: &mut Copy,
        reader: &Reader,
        writer: &mut Writer,
        place: Place,
    ) -> Result<()> {
        let at = self.walk.at;
        match place.opcode {
            0 => Err(Error::Damaged(at, "no record begins with 0".to_string())),
            op::CHUNK => chunk(copy, reader, writer, (place, at)),
            _ if place.end() > reader.bytes.size => {
                Err(Error::Damaged(at, "the file is cut short".to_string()))
            }
            op::ATTACHMENT => copy.attachment(reader, writer, at),
            op::MESSAGE | op::METADATA | op::SCHEMA | op::CHANNEL => {
                let body = reader.bytes.body(place)?;
                copy.record(writer, (place.opcode, &body, at), false)
            }
            opcode if opcode > op::DATA_END => {
                let body = reader.bytes.body(place)?;
                copy.record(writer, (opcode, &body, at), false)
            }
            // The header is there already; indexes are made anew.
            _ => Ok(()),
        }
    }
}

fn chunk(
    copy: &mut Copy,
    reader: &Reader,
    writer: &mut Writer,
    (place, at): (Place, u64),
) -> Result<()> {
    let (records, torn) = unpacked(&reader.bytes, place, at)?;
    let mut read = 0;
    for (opcode, offset, body) in Records::new(&records) {
        copy.record(writer, (opcode, body, at), true)?;
        read = offset as usize + 9 + body.len();
    }
    if torn || read != records.len() {
        let why = "a chunk ends within a record".to_string();
        return Err(Error::Damaged(at, why));
    }
    Ok(())
}

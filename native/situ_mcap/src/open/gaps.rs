//! Records between those that an index names: an index may leave attachments and metadata out.

use mcap::records::op;

use super::attachment::Attached;
use super::walk::Walk;
use super::{take, Contents};
use crate::file::{Bytes, Place};
use crate::{Error, Result};

/// Adds the records that the index does not name. Returns `false` where messages are among them: then the index is
/// not complete. `indexed` are the offsets and lengths of the records that it names.
pub fn read_gaps(
    bytes: &Bytes,
    contents: &mut Contents,
    mut indexed: Vec<(u64, u64)>,
    summary: u64,
) -> Result<bool> {
    indexed.sort_unstable();
    indexed.push((summary, 0));
    let mut at = 8;
    for (offset, length) in indexed {
        match read_gap(bytes, contents, at, offset.min(summary))? {
            Gap::Others => {}
            Gap::Messages => return Ok(false),
            Gap::End => return Ok(true),
        }
        at = at.max(offset.saturating_add(length));
    }
    Ok(true)
}

enum Gap {
    Others,
    Messages,
    End,
}

fn read_gap(bytes: &Bytes, contents: &mut Contents, from: u64, until: u64) -> Result<Gap> {
    let mut walk = Walk::new(from, until);
    while let Some(place) = walk.place(bytes)? {
        let result = match place.opcode {
            op::MESSAGE | op::CHUNK => return Ok(Gap::Messages),
            op::DATA_END => return Ok(Gap::End),
            _ if place.opcode == 0 || place.end() > until => {
                let why = "no record of the file is there".to_string();
                Err(Error::Damaged(walk.at, why))
            }
            _ => record(bytes, contents, place, walk.at),
        };
        match result {
            Ok(()) => walk.at = place.end(),
            // The index says where the next record begins.
            Err(Error::Damaged(at, why)) => {
                let passed = until - walk.at;
                contents.note_damage(format!("at byte {at}: {why} ({passed} bytes are left out)"));
                return Ok(Gap::Others);
            }
            Err(other) => return Err(other),
        }
    }
    Ok(Gap::Others)
}

fn record(bytes: &Bytes, contents: &mut Contents, place: Place, at: u64) -> Result<()> {
    match place.opcode {
        // The header was read before.
        op::SCHEMA | op::CHANNEL | op::METADATA => {
            take(contents, place.opcode, &bytes.body(place)?, at)
        }
        op::ATTACHMENT => {
            let attached = Attached::read(bytes, place, at)?;
            contents.attachments.push(attached.found(at));
            Ok(())
        }
        _ => Ok(()),
    }
}

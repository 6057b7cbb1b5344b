//! Reads the records between those in the index, because an index may leave attachments and metadata out.

use mcap::records::op;

use super::attachment::StoredAttachment;
use super::walk::Walk;
use super::{add_record, Contents};
use crate::file::{FileBytes, RecordHead};
use crate::{Error, Result};

/// Adds the records that are not in the index. Returns `false` if there are messages among them, because then the
/// index is not complete. `indexed` are the offsets and lengths of the indexed records.
pub fn read_gaps(
    bytes: &FileBytes,
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

fn read_gap(bytes: &FileBytes, contents: &mut Contents, from: u64, until: u64) -> Result<Gap> {
    let mut walk = Walk::new(from, until);
    while let Some(record) = walk.next_record(bytes)? {
        let result = match record.opcode {
            op::MESSAGE | op::CHUNK => return Ok(Gap::Messages),
            op::DATA_END => return Ok(Gap::End),
            _ if record.opcode == 0 || record.end() > until => {
                let why = "there is no valid record".to_string();
                Err(Error::Damaged(walk.at, why))
            }
            _ => read_record(bytes, contents, record, walk.at),
        };
        match result {
            Ok(()) => walk.at = record.end(),
            // The index contains the offset of the next record.
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

fn read_record(
    bytes: &FileBytes,
    contents: &mut Contents,
    record: RecordHead,
    at: u64,
) -> Result<()> {
    match record.opcode {
        // The header was read before.
        op::SCHEMA | op::CHANNEL | op::METADATA => {
            add_record(contents, record.opcode, &bytes.record_body(record)?, at)
        }
        op::ATTACHMENT => {
            let attachment = StoredAttachment::read(bytes, record, at)?;
            contents.attachments.push(attachment.info(at));
            Ok(())
        }
        _ => Ok(()),
    }
}

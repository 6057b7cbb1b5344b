//! Closes a store: writes the rest of the pyramids and a last record, and truncates the files to their length.

use rustix::fs::{flock, FlockOperation};

use super::{system_time, Durability, Writer};
use crate::chunk::{Envelope, Input};
use crate::error::{Error, Result};
use crate::extent::Lane;
use crate::format::*;

impl Writer {
    /// Writes the rest of the pyramids, truncates the files and marks the store closed. Committed messages are safe
    /// whatever it returns.
    pub fn close(&mut self) -> Result<()> {
        if self.closed {
            return Ok(());
        }
        self.rollback();
        self.closed = true;
        let finished = self.finish_files();
        // Even after an error the lock must be released for others.
        let _ = flock(&self._lock, FlockOperation::Unlock);
        finished
    }

    /// Appends a record to the catalog and commits it. Its time is `now`, or later if the last record is not older.
    pub fn append_record(&mut self, record: &[u8], now: i64) -> Result<u64> {
        if self.closed {
            return Err(Error::Closed);
        }
        self.write_record(record, now)
    }

    fn write_record(&mut self, record: &[u8], now: i64) -> Result<u64> {
        let (last, n) = self.stream_position(CATALOG).unwrap_or_default();
        let time = last.map_or(now, |last| now.max(last.saturating_add(1)));
        let envelope = Envelope {
            sequence: n + 1,
            time,
            creation: time,
        };
        self.push_message(CATALOG, envelope, Encoding::Bytes, 0, Input::Bytes(record))?;
        self.commit()
    }

    /// Writes a last record. If the index is lost, the record proves that all chunks before it were committed.
    fn write_end_record(&mut self) -> Result<()> {
        match self.write_record(br#"{"kind":"end"}"#, system_time()) {
            Err(Error::Crash) => Err(Error::Crash),
            // The disk is full, but the store is complete without the record.
            Err(_) => {
                self.rollback();
                Ok(())
            }
            Ok(_) => Ok(()),
        }
    }

    fn finish_files(&mut self) -> Result<()> {
        self.fault.step()?;
        if !self.lanes[0].folder_has_index(&self.index.file) {
            return Err(Error::Deleted);
        }
        let pyramids = (0..self.streams.len()).try_for_each(|number| self.finish_pyramids(number));
        self.write_end_record()?;
        self.lanes.iter_mut().try_for_each(Lane::trim)?;
        if self.durability != Durability::None {
            self.sync()?;
        }
        self.index.finish()?;
        match pyramids {
            // If there was no space for the pyramids, the store is still complete: readers compute them from the
            // messages.
            Err(Error::Crash) => Err(Error::Crash),
            _ => Ok(()),
        }
    }
}

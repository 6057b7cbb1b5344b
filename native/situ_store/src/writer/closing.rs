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

    /// Writes a last record. If the index is lost, the record proves that all chunks before it were committed.
    fn write_end_record(&mut self) -> Result<()> {
        let (last, n) = self.stream_position(CATALOG).unwrap_or_default();
        let time = last.map_or_else(system_time, |last| {
            system_time().max(last.saturating_add(1))
        });
        let envelope = Envelope {
            sequence: n + 1,
            time,
            creation: time,
        };
        let input = Input::Bytes(br#"{"kind":"end"}"#);
        let written = self
            .push_message(CATALOG, envelope, Encoding::Bytes, 0, input)
            .and_then(|()| self.commit());
        match written {
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
        self.streams.iter_mut().for_each(|stream| {
            stream.pyramid.finish();
            stream.track_bins.finish();
        });
        let pyramids =
            (0..self.streams.len()).try_for_each(|number| self.write_pyramids(number, 1));
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

//! Closing: the rest of the pyramids, a last record, the files cut to their length.

use rustix::fs::{flock, FlockOperation};

use super::{now, Durability, Writer};
use crate::chunk::{Envelope, Input};
use crate::error::{Error, Result};
use crate::extent::Lane;
use crate::format::*;

impl Writer {
    /// Writes the rest of the pyramids, cuts the files, marks the store closed. Committed messages are safe whatever
    /// it answers.
    pub fn close(&mut self) -> Result<()> {
        if self.closed {
            return Ok(());
        }
        self.rollback();
        self.closed = true;
        let finished = self.finish();
        // Also after an error the lock must not keep others out.
        let _ = flock(&self._lock, FlockOperation::Unlock);
        finished
    }

    /// A last record: it says of all chunks before it that they were committed, should the index be lost.
    fn write_end(&mut self) -> Result<()> {
        let (last, n) = self.position(CATALOG).unwrap_or_default();
        let time = last.map_or_else(now, |last| now().max(last.saturating_add(1)));
        let envelope = Envelope {
            sequence: n + 1,
            time,
            creation: time,
        };
        let input = Input::Bytes(br#"{"kind":"end"}"#);
        let written = self
            .push_open(CATALOG, envelope, Encoding::Bytes, 0, input)
            .and_then(|()| self.commit());
        match written {
            Err(Error::Crash) => Err(Error::Crash),
            // A full disk: the store is whole without it.
            Err(_) => {
                self.rollback();
                Ok(())
            }
            Ok(_) => Ok(()),
        }
    }

    fn finish(&mut self) -> Result<()> {
        self.fault.step()?;
        if !self.lanes[0].folder_lives(&self.index.file) {
            return Err(Error::Deleted);
        }
        self.streams.iter_mut().for_each(|stream| {
            stream.pyramid.finish();
            stream.tallies.finish();
        });
        let pyramids =
            (0..self.streams.len()).try_for_each(|number| self.write_pyramids(number, 1));
        self.write_end()?;
        self.lanes.iter_mut().try_for_each(Lane::trim)?;
        if self.durability != Durability::None {
            self.sync()?;
        }
        self.index.finish()?;
        match pyramids {
            // Without room for the pyramids the store is still complete: readers compute them from the messages.
            Err(Error::Crash) => Err(Error::Crash),
            _ => Ok(()),
        }
    }
}

//! Appends a column of values: many messages of one stream and one kind.

use super::Writer;
use crate::chunk::{Envelope, Input};
use crate::error::Result;
use crate::format::Encoding;

/// Messages whose creation times equal their originating times, with consecutive sequence ids.
#[derive(Debug, Clone, Copy)]
pub struct Column<'a> {
    /// The sequence id of the first message.
    pub sequence: u64,
    /// The originating times.
    pub times: &'a [i64],
    /// One value for each time.
    pub values: ColumnValues<'a>,
}

/// Values of one kind.
#[derive(Debug, Clone, Copy)]
pub enum ColumnValues<'a> {
    /// Integers.
    Ints(&'a [i64]),
    /// Floats.
    Floats(&'a [f64]),
    /// Concatenated strings, and the end of each.
    Texts(&'a [u8], &'a [usize]),
}

impl Writer {
    /// Adds the messages of a column to the current commit. After an error, call `rollback`.
    pub fn push_column(&mut self, stream: u32, column: Column<'_>) -> Result<()> {
        match column.values {
            ColumnValues::Ints(values) => {
                let inputs = values.iter().map(|value| Input::Int(*value));
                self.push_each(stream, column, Encoding::Int, inputs)
            }
            ColumnValues::Floats(values) => {
                let inputs = values.iter().map(|value| Input::Float(*value));
                self.push_each(stream, column, Encoding::Float, inputs)
            }
            ColumnValues::Texts(bytes, ends) => {
                let inputs = ends.iter().scan(0, |start, end| {
                    let text = bytes.get(*start..*end);
                    *start = *end;
                    text.map(Input::Bytes)
                });
                self.push_each(stream, column, Encoding::Bytes, inputs)
            }
        }
    }

    fn push_each<'a>(
        &mut self,
        stream: u32,
        column: Column<'_>,
        encoding: Encoding,
        inputs: impl Iterator<Item = Input<'a>>,
    ) -> Result<()> {
        for ((sequence, time), input) in (column.sequence..).zip(column.times).zip(inputs) {
            let envelope = Envelope {
                sequence,
                time: *time,
                creation: *time,
            };
            self.push(stream, envelope, encoding, 0, input)?;
        }
        Ok(())
    }
}

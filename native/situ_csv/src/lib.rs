//! Rows of a CSV file, a few at a time: bounded memory however long the file, quoted line breaks and all. Also
//! writes numbers as such rows.

#![deny(missing_docs)]

mod columns;
mod fields;
mod lines;
mod parts;

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

pub use columns::{columns, CellValues, Cells, Wanted};
pub use fields::{Kind, Unit};
pub use lines::{lines, Values};
pub use parts::{scan, values, Column, Layout, Part, Refusal, Start, Value, Why};

use csv::{ByteRecord, Position, ReaderBuilder, StringRecord, Terminator};

/// Why there are no rows.
#[derive(Debug, Clone, PartialEq)]
pub enum Error {
    /// The file cannot be read: the error's number, and its text.
    Io(i32, String),
    /// A line that cannot be read: its number, and the reason.
    Damaged(u64, &'static str),
}

impl std::fmt::Display for Error {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Error::Io(_, why) => write!(f, "cannot read the file: {why}"),
            Error::Damaged(line, why) => write!(f, "line {line}: {why}"),
        }
    }
}

impl std::error::Error for Error {}

impl From<io::Error> for Error {
    fn from(error: io::Error) -> Self {
        Error::Io(error.raw_os_error().unwrap_or(0), error.to_string())
    }
}

/// The rows, or the reason why there are none.
pub type Result<T> = std::result::Result<T, Error>;

/// A longer row is an error: most likely a quote is not closed.
const MAX_ROW: u64 = 16 << 20;
const BUFFER: usize = 64 << 10;

/// A place in a file: byte and line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// Bytes before it.
    pub byte: u64,
    /// Its line, 1 being the first.
    pub line: u64,
}

/// A row: the line it begins in, and its fields without their quotes.
#[derive(Debug, PartialEq)]
pub struct Row {
    /// The line it begins in.
    pub line: u64,
    /// Its fields.
    pub fields: Vec<String>,
}

/// Stops a row that does not end.
struct Bounded {
    file: File,
    left: u64,
}

impl Read for Bounded {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.left == 0 {
            return Err(io::ErrorKind::FileTooLarge.into());
        }
        let n = self.file.read(buffer)?;
        self.left = self.left.saturating_sub(n as u64);
        Ok(n)
    }
}

impl Seek for Bounded {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}

/// A file that is read row by row. Empty lines are no rows.
struct Rows {
    reader: csv::Reader<Bounded>,
    record: StringRecord,
    /// The file's length, and whether its last line has an end.
    length: u64,
    whole: bool,
}

impl Rows {
    fn open(path: &Path, separator: u8, from: Place) -> Result<Rows> {
        let file = File::open(path)?;
        let (length, whole) = ending(&file)?;
        let bounded = Bounded {
            file,
            left: MAX_ROW,
        };
        let mut reader = ReaderBuilder::new()
            .delimiter(separator)
            .has_headers(false)
            .flexible(true)
            .terminator(Terminator::Any(b'\n'))
            .buffer_capacity(BUFFER)
            .from_reader(bounded);
        let mut start = Position::new();
        start.set_byte(from.byte).set_line(from.line);
        reader.seek(start).map_err(io::Error::from)?;
        Ok(Rows {
            reader,
            record: StringRecord::new(),
            length,
            whole,
        })
    }

    fn place(&self) -> Place {
        Place {
            byte: self.reader.position().byte(),
            line: self.reader.position().line(),
        }
    }

    /// The line of the next row, and its fields. The last one may end in CR.
    fn next(&mut self) -> Result<Option<(u64, &StringRecord)>> {
        let mut record = std::mem::take(&mut self.record).into_byte_record();
        loop {
            self.reader.get_mut().left = MAX_ROW;
            let at = self.reader.position().line();
            match self.reader.read_byte_record(&mut record) {
                Ok(true) if record.len() > 1 || !blank(&record) => break,
                Ok(true) => continue,
                Ok(false) => return Ok(None),
                Err(error) => return Err(refused(error, at)),
            }
        }
        let end = self.reader.position();
        let open = !self.whole && end.byte() >= self.length;
        let behind = breaks(&record) + u64::from(!open);
        let line = end.line().saturating_sub(behind);
        self.record = StringRecord::from_byte_record(record)
            .map_err(|_| Error::Damaged(line, "it is not UTF-8 text"))?;
        Ok(Some((line, &self.record)))
    }
}

/// Up to `most` rows (or `bytes` bytes) from a place on, and the place behind them. Empty lines are no rows; no rows
/// is the end.
pub fn rows(
    path: &Path,
    separator: u8,
    from: Place,
    most: usize,
    bytes: u64,
) -> Result<(Vec<Row>, Place)> {
    let mut reader = Rows::open(path, separator, from)?;
    let mut rows = Vec::new();
    while rows.len() < most && reader.place().byte - from.byte < bytes {
        let Some((line, fields)) = reader.next()? else {
            break;
        };
        let mut fields: Vec<String> = fields.iter().map(str::to_owned).collect();
        // A line may end in CR LF.
        if let Some(last) = fields.last_mut() {
            if last.ends_with('\r') {
                last.pop();
            }
        }
        rows.push(Row { line, fields });
    }
    Ok((rows, reader.place()))
}

/// The file's length, and whether its last line has an end.
fn ending(mut file: &File) -> io::Result<(u64, bool)> {
    let length = file.seek(SeekFrom::End(0))?;
    let mut last = [b'\n'];
    if length > 0 {
        file.seek(SeekFrom::End(-1))?;
        file.read_exact(&mut last)?;
        file.rewind()?;
    }
    Ok((length, last == [b'\n']))
}

/// Line breaks within quotes.
fn breaks(record: &ByteRecord) -> u64 {
    let breaks = record.as_slice().iter().filter(|byte| **byte == b'\n');
    breaks.count() as u64
}

fn blank(record: &ByteRecord) -> bool {
    let spaces = |field: &[u8]| std::str::from_utf8(field).is_ok_and(|text| text.trim().is_empty());
    record.iter().all(spaces)
}

fn refused(error: csv::Error, line: u64) -> Error {
    match error.into_kind() {
        csv::ErrorKind::Io(error) if error.kind() == io::ErrorKind::FileTooLarge => Error::Damaged(
            line,
            "a row of more than 16 MiB begins here: is a quote not closed?",
        ),
        csv::ErrorKind::Io(error) => error.into(),
        _ => Error::Damaged(line, "it cannot be read"),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    const START: Place = Place { byte: 0, line: 1 };

    fn file(name: &str, text: &[u8]) -> std::path::PathBuf {
        let path = std::env::temp_dir().join(format!("situ-rows-{}-{name}", std::process::id()));
        std::fs::write(&path, text).unwrap();
        path
    }

    fn fields(rows: &[Row]) -> Vec<(u64, Vec<&str>)> {
        rows.iter()
            .map(|row| (row.line, row.fields.iter().map(String::as_str).collect()))
            .collect()
    }

    #[test]
    fn goes_on_where_it_stopped() {
        let path = file(
            "on",
            b"a,b\r\n1,\"two\r\nlines, \"\"here\"\"\"\r\n\n\r\n3,4",
        );
        let (head, place) = rows(&path, b',', START, 1, u64::MAX).unwrap();
        assert_eq!(fields(&head), [(1, vec!["a", "b"])]);
        let (rest, end) = rows(&path, b',', place, 10, u64::MAX).unwrap();
        assert_eq!(
            fields(&rest),
            [
                (2, vec!["1", "two\r\nlines, \"here\""]),
                (6, vec!["3", "4"])
            ]
        );
        assert_eq!(rows(&path, b',', end, 10, u64::MAX).unwrap().0, vec![]);
        std::fs::remove_file(path).unwrap();
    }

    #[test]
    fn refuses_what_is_no_text_and_what_does_not_end() {
        let path = file("bad", b"a,b\n1,\xff\n");
        let refused = rows(&path, b',', START, 10, u64::MAX);
        assert_eq!(refused, Err(Error::Damaged(2, "it is not UTF-8 text")));
        let mut long = b"a,b\n1,\"".to_vec();
        long.resize(40 << 20, b'x');
        std::fs::write(&path, long).unwrap();
        let refused = rows(&path, b',', START, 10, u64::MAX);
        assert!(matches!(refused, Err(Error::Damaged(2, _))), "{refused:?}");
        std::fs::remove_file(path).unwrap();
    }
}

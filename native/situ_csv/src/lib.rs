//! Reads rows of a CSV file in small batches. Memory use is bounded however long the file is, and quoted fields may
//! contain line breaks. Also formats numbers as such rows.

#![deny(missing_docs)]

mod columns;
mod fields;
mod lines;
mod parts;

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

pub use columns::{read_columns, CellValues, Cells, ColumnQuery};
pub use fields::{Kind, Unit};
pub use lines::{format_lines, Values};
pub use parts::{read_values, scan_parts, Column, Layout, Part, Refusal, RowFault, Start, Value};

use csv::{ByteRecord, Position, ReaderBuilder, StringRecord, Terminator};

/// The reason why rows cannot be read.
#[derive(Debug, Clone, PartialEq)]
pub enum Error {
    /// The file cannot be read: errno and message.
    Io(i32, String),
    /// A line cannot be read: its number and the reason.
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

/// The result type of functions that read rows.
pub type Result<T> = std::result::Result<T, Error>;

/// The maximum length of a row. A longer row most likely has an unclosed quote.
const MAX_ROW: u64 = 16 << 20;
const BUFFER: usize = 64 << 10;

/// A position in a file: byte and line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FilePosition {
    /// The number of bytes before it.
    pub byte: u64,
    /// Its line; the first line is 1.
    pub line: u64,
}

/// A row: the line it begins in, and its unquoted fields.
#[derive(Debug, PartialEq)]
pub struct Row {
    /// The line it begins in.
    pub line: u64,
    /// Its fields.
    pub fields: Vec<String>,
}

/// A file that stops rows without an end.
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

/// A file that is read row by row. Empty lines are skipped.
struct Rows {
    reader: csv::Reader<Bounded>,
    record: StringRecord,
    /// The file's length, and whether its last line ends with a line break.
    length: u64,
    ends_with_break: bool,
}

impl Rows {
    fn open(path: &Path, separator: u8, from: FilePosition) -> Result<Rows> {
        let file = File::open(path)?;
        let (length, ends_with_break) = read_ending(&file)?;
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
            ends_with_break,
        })
    }

    fn position(&self) -> FilePosition {
        FilePosition {
            byte: self.reader.position().byte(),
            line: self.reader.position().line(),
        }
    }

    /// Reads the next row: its line and its fields. The last field may end in CR.
    fn next_row(&mut self) -> Result<Option<(u64, &StringRecord)>> {
        let mut record = std::mem::take(&mut self.record).into_byte_record();
        loop {
            self.reader.get_mut().left = MAX_ROW;
            let at = self.reader.position().line();
            match self.reader.read_byte_record(&mut record) {
                Ok(true) if record.len() > 1 || !is_blank(&record) => break,
                Ok(true) => continue,
                Ok(false) => return Ok(None),
                Err(error) => return Err(convert_error(error, at)),
            }
        }
        let end = self.reader.position();
        let open = !self.ends_with_break && end.byte() >= self.length;
        let breaks_after_start = count_line_breaks(&record) + u64::from(!open);
        let line = end.line().saturating_sub(breaks_after_start);
        self.record = StringRecord::from_byte_record(record)
            .map_err(|_| Error::Damaged(line, "it is not UTF-8 text"))?;
        Ok(Some((line, &self.record)))
    }
}

/// Reads up to `most` rows (or `bytes` bytes) from a position on. Returns them with the position after them. Empty
/// lines are skipped, and no rows mean the end of the file.
pub fn read_rows(
    path: &Path,
    separator: u8,
    from: FilePosition,
    most: usize,
    bytes: u64,
) -> Result<(Vec<Row>, FilePosition)> {
    let mut reader = Rows::open(path, separator, from)?;
    let mut rows = Vec::new();
    while rows.len() < most && reader.position().byte - from.byte < bytes {
        let Some((line, fields)) = reader.next_row()? else {
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
    Ok((rows, reader.position()))
}

/// Returns the file's length, and whether its last line ends with a line break.
fn read_ending(mut file: &File) -> io::Result<(u64, bool)> {
    let length = file.seek(SeekFrom::End(0))?;
    let mut last = [b'\n'];
    if length > 0 {
        file.seek(SeekFrom::End(-1))?;
        file.read_exact(&mut last)?;
        file.rewind()?;
    }
    Ok((length, last == [b'\n']))
}

/// Counts line breaks within quotes.
fn count_line_breaks(record: &ByteRecord) -> u64 {
    let breaks = record.as_slice().iter().filter(|byte| **byte == b'\n');
    breaks.count() as u64
}

fn is_blank(record: &ByteRecord) -> bool {
    let spaces = |field: &[u8]| std::str::from_utf8(field).is_ok_and(|text| text.trim().is_empty());
    record.iter().all(spaces)
}

fn convert_error(error: csv::Error, line: u64) -> Error {
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

    const START: FilePosition = FilePosition { byte: 0, line: 1 };

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
    fn continues_at_the_returned_position() {
        let path = file(
            "on",
            b"a,b\r\n1,\"two\r\nlines, \"\"here\"\"\"\r\n\n\r\n3,4",
        );
        let (head, position) = read_rows(&path, b',', START, 1, u64::MAX).unwrap();
        assert_eq!(fields(&head), [(1, vec!["a", "b"])]);
        let (rest, end) = read_rows(&path, b',', position, 10, u64::MAX).unwrap();
        assert_eq!(
            fields(&rest),
            [
                (2, vec!["1", "two\r\nlines, \"here\""]),
                (6, vec!["3", "4"])
            ]
        );
        assert_eq!(read_rows(&path, b',', end, 10, u64::MAX).unwrap().0, vec![]);
        std::fs::remove_file(path).unwrap();
    }

    #[test]
    fn rejects_invalid_utf8_and_unclosed_quotes() {
        let path = file("bad", b"a,b\n1,\xff\n");
        let result = read_rows(&path, b',', START, 10, u64::MAX);
        assert_eq!(result, Err(Error::Damaged(2, "it is not UTF-8 text")));
        let mut long = b"a,b\n1,\"".to_vec();
        long.resize(40 << 20, b'x');
        std::fs::write(&path, long).unwrap();
        let result = read_rows(&path, b',', START, 10, u64::MAX);
        assert!(matches!(result, Err(Error::Damaged(2, _))), "{result:?}");
        std::fs::remove_file(path).unwrap();
    }
}

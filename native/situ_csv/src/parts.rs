//! Scans parts of a CSV file for the kinds of their fields, and reads the values of one column.

use std::path::Path;

use csv::StringRecord;

use crate::fields::{Kind, Time, Unit};
use crate::{Error, FilePosition, Rows};

/// The layout of a file's rows.
#[derive(Debug, Clone, Copy)]
pub struct Layout {
    /// The separator between fields.
    pub separator: u8,
    /// The number of fields in a row.
    pub width: usize,
    /// The column of times, and their unit.
    pub time: (usize, Unit),
    /// An offset that is added to every time, ns.
    pub start: i64,
    /// The maximum number of rows in a part.
    pub rows: usize,
    /// The number of bytes after which a part ends.
    pub bytes: u64,
}

/// The position where a part begins, and the last time before it.
#[derive(Debug, Clone, Copy)]
pub struct Start {
    /// The position of its first row.
    pub position: FilePosition,
    /// The time of the last row before it that was kept.
    pub last: Option<i64>,
}

/// The nonempty fields of a column.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Column {
    /// Their kind.
    pub kind: Option<Kind>,
    /// Their number.
    pub count: u64,
    /// The time of the first field.
    pub first: Option<i64>,
    /// The time of the last field.
    pub last: Option<i64>,
}

/// The reason why a row is left out.
#[derive(Debug, PartialEq)]
pub enum RowFault {
    /// It has this many fields, which is not the width of the layout.
    Width(usize),
    /// Its time cannot be parsed.
    Time(String),
    /// Its time is not after the one before.
    Backward,
}

/// The content of a part.
#[derive(Debug)]
pub struct Part {
    /// The columns, including the column of times (which is empty).
    pub columns: Vec<Column>,
    /// The lines of rows that are left out, with the reasons.
    pub damage: Vec<(u64, RowFault)>,
    /// The start of the next part.
    pub next: Start,
    /// The number of rows, including those that are left out.
    pub rows: usize,
}

/// A value of a column.
#[derive(Debug, PartialEq)]
pub enum Value<'a> {
    /// An integer.
    Integer(i64),
    /// A float.
    Float(f64),
    /// A string, or a number that is too large for the other kinds.
    Text(&'a str),
}

/// The reason why a part cannot be read here.
#[derive(Debug, PartialEq)]
pub enum Refusal {
    /// A time is in a notation that this code cannot parse.
    Unsure,
    /// The file is not readable, or is not CSV.
    Failed(Error),
}

impl From<Error> for Refusal {
    fn from(error: Error) -> Self {
        Refusal::Failed(error)
    }
}

/// Visits the rows of the next part. Calls `kept` with the time and the fields of a row, or `left_out` with its
/// line and the reason. Returns the number of rows.
pub(crate) fn visit_rows(
    rows: &mut Rows,
    layout: &Layout,
    last: &mut Option<i64>,
    mut kept: impl FnMut(i64, &StringRecord),
    mut left_out: impl FnMut(u64, RowFault),
) -> Result<usize, Refusal> {
    let (column, unit) = layout.time;
    let begin = rows.position().byte;
    let mut n = 0;
    while n < layout.rows && rows.position().byte - begin < layout.bytes {
        let Some((line, fields)) = rows.next_row()? else {
            break;
        };
        n += 1;
        if fields.len() != layout.width {
            left_out(line, RowFault::Width(fields.len()));
            continue;
        }
        let Some(text) = fields.get(column) else {
            return Err(Refusal::Unsure);
        };
        let time = match unit.parse_time(text) {
            Time::At(time) => time.checked_add(layout.start).ok_or(Refusal::Unsure)?,
            Time::None => {
                let text = text.strip_suffix('\r').unwrap_or(text);
                left_out(line, RowFault::Time(text.to_owned()));
                continue;
            }
            Time::Unsure => return Err(Refusal::Unsure),
        };
        if last.is_some_and(|last| time <= last) {
            left_out(line, RowFault::Backward);
            continue;
        }
        *last = Some(time);
        kept(time, fields);
    }
    Ok(n)
}

/// Scans up to `parts` parts from a position on. Fewer parts mean the end of the file.
pub fn scan_parts(
    path: &Path,
    layout: &Layout,
    start: Start,
    parts: usize,
) -> Result<Vec<Part>, Refusal> {
    let mut rows = Rows::open(path, layout.separator, start.position)?;
    let mut last = start.last;
    let mut found = Vec::new();
    while found.len() < parts {
        let mut columns = vec![Column::default(); layout.width];
        let mut damage = Vec::new();
        let n = visit_rows(
            &mut rows,
            layout,
            &mut last,
            |time, fields| {
                for (at, (column, field)) in columns.iter_mut().zip(fields).enumerate() {
                    let field = field.trim();
                    if at != layout.time.0 && !field.is_empty() {
                        count_field(column, field, time);
                    }
                }
            },
            |line, why| damage.push((line, why)),
        )?;
        let next = Start {
            position: rows.position(),
            last,
        };
        if n == 0 {
            break;
        }
        found.push(Part {
            columns,
            damage,
            next,
            rows: n,
        });
    }
    Ok(found)
}

fn count_field(column: &mut Column, field: &str, time: i64) {
    column.kind = match column.kind {
        Some(Kind::Text) => Some(Kind::Text),
        Some(kind) => Some(kind.unify(Kind::detect(field))),
        None => Some(Kind::detect(field)),
    };
    column.count += 1;
    column.first = column.first.or(Some(time));
    column.last = Some(time);
}

/// Calls `found` with the time and value of each nonempty field of one column in a part.
pub fn read_values(
    path: &Path,
    layout: &Layout,
    start: Start,
    (column, kind): (usize, Kind),
    mut found: impl FnMut(i64, Value),
) -> Result<(), Refusal> {
    let mut rows = Rows::open(path, layout.separator, start.position)?;
    let mut last = start.last;
    visit_rows(
        &mut rows,
        layout,
        &mut last,
        |time, fields| {
            if let Some(field) = fields.get(column).map(|field| field.trim()) {
                if !field.is_empty() {
                    found(time, parse_value(field, kind));
                }
            }
        },
        |_line, _why| (),
    )?;
    Ok(())
}

pub(crate) fn parse_value(field: &str, kind: Kind) -> Value<'_> {
    match kind {
        Kind::Integer => field.parse().map(Value::Integer).ok(),
        Kind::Float => field
            .parse()
            .ok()
            .filter(|x: &f64| x.is_finite())
            .map(Value::Float),
        Kind::Text => None,
    }
    .unwrap_or(Value::Text(field))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    const LAYOUT: Layout = Layout {
        separator: b',',
        width: 3,
        time: (0, Unit::Nanoseconds(1)),
        start: 100,
        rows: 4,
        bytes: 1_000,
    };
    const START: Start = Start {
        position: FilePosition { byte: 0, line: 1 },
        last: None,
    };

    #[test]
    fn scans_kinds_counts_and_rows_that_are_left_out() {
        let path = std::env::temp_dir().join(format!("situ-parts-{}", std::process::id()));
        std::fs::write(&path, "1,5,a\n2,, \n2,6,b\n3,7\nx,8,c\n4,0.5,\"d\"\n").unwrap();
        let parts = scan_parts(&path, &LAYOUT, START, 9).unwrap();
        assert_eq!(
            parts.iter().map(|part| part.rows).collect::<Vec<_>>(),
            [4, 2]
        );
        assert_eq!(
            parts[0].damage,
            [(3, RowFault::Backward), (4, RowFault::Width(2))]
        );
        assert_eq!(parts[1].damage, [(5, RowFault::Time("x".to_owned()))]);
        let column = Column {
            kind: Some(Kind::Integer),
            count: 1,
            first: Some(101),
            last: Some(101),
        };
        assert_eq!(parts[0].columns[1], column);
        assert_eq!(parts[1].columns[1].kind, Some(Kind::Float));
        assert_eq!(parts[1].next.last, Some(104));
        let mut found = Vec::new();
        let all = Layout { rows: 9, ..LAYOUT };
        read_values(&path, &all, START, (1, Kind::Float), |time, value| {
            if let Value::Float(x) = value {
                found.push((time, x));
            }
        })
        .unwrap();
        assert_eq!(found, [(101, 5.0), (104, 0.5)]);
        let small = Layout { bytes: 1, ..LAYOUT };
        assert_eq!(scan_parts(&path, &small, START, 9).unwrap().len(), 6);
        std::fs::write(&path, "2020-01-31,5,a\n").unwrap();
        let dates = Layout {
            time: (0, Unit::Iso8601),
            ..LAYOUT
        };
        assert_eq!(
            scan_parts(&path, &dates, START, 9).unwrap_err(),
            Refusal::Unsure
        );
        std::fs::remove_file(path).unwrap();
    }
}

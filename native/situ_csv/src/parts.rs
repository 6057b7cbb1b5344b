//! Reads parts of a CSV file as columns: the kinds of their fields, and the values of one of them.

use std::path::Path;

use csv::StringRecord;

use crate::fields::{Kind, Time, Unit};
use crate::{Error, Place, Rows};

/// How the rows of a file are read.
#[derive(Debug, Clone, Copy)]
pub struct Layout {
    /// Between fields.
    pub separator: u8,
    /// The fields of a row.
    pub width: usize,
    /// The column of times, and what it counts.
    pub time: (usize, Unit),
    /// Nanoseconds that are added to every time.
    pub start: i64,
    /// The most rows of a part.
    pub rows: usize,
    /// A part with so many bytes has no more rows.
    pub bytes: u64,
}

/// Where a part begins, and the last time before it.
#[derive(Debug, Clone, Copy)]
pub struct Start {
    /// Its first row.
    pub place: Place,
    /// The time of the last row that was kept.
    pub last: Option<i64>,
}

/// The fields of a column that are not empty.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Column {
    /// Their kind.
    pub kind: Option<Kind>,
    /// How many there are.
    pub count: u64,
    /// The first one's time.
    pub first: Option<i64>,
    /// The last one's time.
    pub last: Option<i64>,
}

/// Why a row is left out.
#[derive(Debug, PartialEq)]
pub enum Why {
    /// It has so many fields.
    Width(usize),
    /// Its time cannot be read.
    Time(String),
    /// Its time is not after the one before.
    Backward,
}

/// The content of a part.
#[derive(Debug)]
pub struct Part {
    /// The columns, that of times among them (and empty).
    pub columns: Vec<Column>,
    /// Lines of rows that are left out.
    pub damage: Vec<(u64, Why)>,
    /// Where the next part begins.
    pub next: Start,
    /// How many rows it has, kept or not.
    pub rows: usize,
}

/// A value of a column.
#[derive(Debug, PartialEq)]
pub enum Value<'a> {
    /// A whole number.
    Integer(i64),
    /// Another number.
    Float(f64),
    /// A text, or a number that is larger than these.
    Text(&'a str),
}

/// Why a part cannot be read here.
#[derive(Debug, PartialEq)]
pub enum Refusal {
    /// A time takes more than this code to read.
    Unsure,
    /// The file is not readable, or no CSV.
    Failed(Error),
}

impl From<Error> for Refusal {
    fn from(error: Error) -> Self {
        Refusal::Failed(error)
    }
}

/// Goes through the rows of the next part. Calls `kept` with the time and the fields of a row, or `left_out`.
pub(crate) fn each_row(
    rows: &mut Rows,
    layout: &Layout,
    last: &mut Option<i64>,
    mut kept: impl FnMut(i64, &StringRecord),
    mut left_out: impl FnMut(u64, Why),
) -> Result<usize, Refusal> {
    let (column, unit) = layout.time;
    let begin = rows.place().byte;
    let mut n = 0;
    while n < layout.rows && rows.place().byte - begin < layout.bytes {
        let Some((line, fields)) = rows.next()? else {
            break;
        };
        n += 1;
        if fields.len() != layout.width {
            left_out(line, Why::Width(fields.len()));
            continue;
        }
        let Some(text) = fields.get(column) else {
            return Err(Refusal::Unsure);
        };
        let time = match unit.time(text) {
            Time::At(time) => time.checked_add(layout.start).ok_or(Refusal::Unsure)?,
            Time::None => {
                let text = text.strip_suffix('\r').unwrap_or(text);
                left_out(line, Why::Time(text.to_owned()));
                continue;
            }
            Time::Unsure => return Err(Refusal::Unsure),
        };
        if last.is_some_and(|last| time <= last) {
            left_out(line, Why::Backward);
            continue;
        }
        *last = Some(time);
        kept(time, fields);
    }
    Ok(n)
}

/// Scans up to `parts` parts from a place on. Fewer are the end of the file.
pub fn scan(
    path: &Path,
    layout: &Layout,
    start: Start,
    parts: usize,
) -> Result<Vec<Part>, Refusal> {
    let mut rows = Rows::open(path, layout.separator, start.place)?;
    let mut last = start.last;
    let mut found = Vec::new();
    while found.len() < parts {
        let mut columns = vec![Column::default(); layout.width];
        let mut damage = Vec::new();
        let n = each_row(
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
            place: rows.place(),
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
        Some(kind) => Some(kind.unify(Kind::of(field))),
        None => Some(Kind::of(field)),
    };
    column.count += 1;
    column.first = column.first.or(Some(time));
    column.last = Some(time);
}

/// Calls `found` with each value of one column in a part, and its time. Empty fields have none.
pub fn values(
    path: &Path,
    layout: &Layout,
    start: Start,
    (column, kind): (usize, Kind),
    mut found: impl FnMut(i64, Value),
) -> Result<(), Refusal> {
    let mut rows = Rows::open(path, layout.separator, start.place)?;
    let mut last = start.last;
    each_row(
        &mut rows,
        layout,
        &mut last,
        |time, fields| {
            if let Some(field) = fields.get(column).map(|field| field.trim()) {
                if !field.is_empty() {
                    found(time, value(field, kind));
                }
            }
        },
        |_line, _why| (),
    )?;
    Ok(())
}

pub(crate) fn value(field: &str, kind: Kind) -> Value<'_> {
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
        place: Place { byte: 0, line: 1 },
        last: None,
    };

    #[test]
    fn parts_have_kinds_counts_and_rows_that_are_left_out() {
        let path = std::env::temp_dir().join(format!("situ-parts-{}", std::process::id()));
        std::fs::write(&path, "1,5,a\n2,, \n2,6,b\n3,7\nx,8,c\n4,0.5,\"d\"\n").unwrap();
        let parts = scan(&path, &LAYOUT, START, 9).unwrap();
        assert_eq!(
            parts.iter().map(|part| part.rows).collect::<Vec<_>>(),
            [4, 2]
        );
        assert_eq!(parts[0].damage, [(3, Why::Backward), (4, Why::Width(2))]);
        assert_eq!(parts[1].damage, [(5, Why::Time("x".to_owned()))]);
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
        values(&path, &all, START, (1, Kind::Float), |time, value| {
            if let Value::Float(x) = value {
                found.push((time, x));
            }
        })
        .unwrap();
        assert_eq!(found, [(101, 5.0), (104, 0.5)]);
        let small = Layout { bytes: 1, ..LAYOUT };
        assert_eq!(scan(&path, &small, START, 9).unwrap().len(), 6);
        std::fs::write(&path, "2020-01-31,5,a\n").unwrap();
        let dates = Layout {
            time: (0, Unit::Iso8601),
            ..LAYOUT
        };
        assert_eq!(scan(&path, &dates, START, 9).unwrap_err(), Refusal::Unsure);
        std::fs::remove_file(path).unwrap();
    }
}

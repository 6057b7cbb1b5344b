//! Reads many rows of a CSV file as columns in a single pass.

use std::path::Path;

use crate::fields::Kind;
use crate::parts::{parse_value, visit_rows, Layout, Refusal, Start, Value};
use crate::Rows;

/// Selects columns and rows.
#[derive(Debug, Clone, Copy)]
pub struct ColumnQuery<'a> {
    /// The columns and the kinds of their fields.
    pub columns: &'a [(usize, Kind)],
    /// The earliest and the latest time.
    pub interval: (i64, i64),
    /// The maximum number of parts. Fewer are read if they are long.
    pub parts: usize,
}

/// The values of a column within the interval.
#[derive(Debug, PartialEq)]
pub struct Cells {
    /// The number of nonempty fields in these parts.
    pub fields: u64,
    /// The number of these fields before the interval.
    pub before: u64,
    /// The times of the values.
    pub times: Vec<i64>,
    /// The values.
    pub values: CellValues,
}

/// Values of one kind.
#[derive(Debug, PartialEq)]
pub enum CellValues {
    /// Integers.
    Integers(Vec<i64>),
    /// Floats.
    Floats(Vec<f64>),
    /// Concatenated strings, and the end of each.
    Texts(Vec<u8>, Vec<usize>),
}

impl Cells {
    fn new(kind: Kind) -> Cells {
        Cells {
            fields: 0,
            before: 0,
            times: Vec::new(),
            values: match kind {
                Kind::Integer => CellValues::Integers(Vec::new()),
                Kind::Float => CellValues::Floats(Vec::new()),
                Kind::Text => CellValues::Texts(Vec::new(), Vec::new()),
            },
        }
    }

    /// Adds a field. Returns `false` if its value does not fit into the column.
    fn push(&mut self, field: &str, kind: Kind, time: i64, (from, to): (i64, i64)) -> bool {
        self.fields += 1;
        if time < from {
            self.before += 1;
        }
        if time < from || time > to {
            return true;
        }
        match (&mut self.values, parse_value(field, kind)) {
            (CellValues::Integers(values), Value::Integer(n)) => values.push(n),
            (CellValues::Floats(values), Value::Float(x)) => values.push(x),
            (CellValues::Texts(bytes, ends), Value::Text(text)) => {
                bytes.extend_from_slice(text.as_bytes());
                ends.push(bytes.len());
            }
            _ => return false,
        }
        self.times.push(time);
        true
    }

    fn sizes(&self) -> (u64, u64, usize) {
        (self.fields, self.before, self.times.len())
    }

    fn truncate_to(&mut self, (fields, before, length): (u64, u64, usize)) {
        self.fields = fields;
        self.before = before;
        self.times.truncate(length);
        match &mut self.values {
            CellValues::Integers(values) => values.truncate(length),
            CellValues::Floats(values) => values.truncate(length),
            CellValues::Texts(bytes, ends) => {
                ends.truncate(length);
                bytes.truncate(ends.last().copied().unwrap_or(0));
            }
        }
    }
}

/// Reads the selected columns from a position on. Returns the number of parts and the columns. Ends before a part
/// that this code cannot parse; if it is the first part, the refusal is returned.
pub fn read_columns(
    path: &Path,
    layout: &Layout,
    start: Start,
    query: &ColumnQuery<'_>,
) -> Result<(usize, Vec<Cells>), Refusal> {
    let mut rows = Rows::open(path, layout.separator, start.position)?;
    let mut last = start.last;
    let mut found: Vec<Cells> = query
        .columns
        .iter()
        .map(|(_, kind)| Cells::new(*kind))
        .collect();
    let mut parts = 0;
    while parts < query.parts && rows.position().byte - start.position.byte < layout.bytes {
        let before: Vec<_> = found.iter().map(Cells::sizes).collect();
        let mut fit = true;
        let read = visit_rows(
            &mut rows,
            layout,
            &mut last,
            |time, fields| {
                for ((at, kind), cells) in query.columns.iter().zip(&mut found) {
                    let field = fields.get(*at).map_or("", |field| field.trim());
                    if !field.is_empty() {
                        fit &= cells.push(field, *kind, time, query.interval);
                    }
                }
            },
            |_line, _why| (),
        );
        let refusal = match read {
            Ok(0) => break,
            Ok(_) if fit => {
                parts += 1;
                continue;
            }
            Ok(_) => Refusal::Unsure,
            Err(refusal) => refusal,
        };
        if parts == 0 {
            return Err(refusal);
        }
        for (cells, counts) in found.iter_mut().zip(before) {
            cells.truncate_to(counts);
        }
        break;
    }
    Ok((parts, found))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::{FilePosition, Unit};

    #[test]
    fn columns_end_before_a_part_with_a_number_that_does_not_fit() {
        let path = std::env::temp_dir().join(format!("situ-columns-{}", std::process::id()));
        let text = "1,5,a\n2,,\"b,\nb\"\n3,7, \n4,8,c\n5,123456789012345678901,d\n6,9,e\n";
        std::fs::write(&path, text).unwrap();
        let layout = Layout {
            separator: b',',
            width: 3,
            time: (0, Unit::Nanoseconds(1)),
            start: 0,
            rows: 2,
            bytes: 1_000,
        };
        let start = |byte, line, last| Start {
            position: FilePosition { byte, line },
            last,
        };
        let query = ColumnQuery {
            columns: &[(2, Kind::Text), (1, Kind::Integer)],
            interval: (2, 9),
            parts: 8,
        };
        let (parts, found) = read_columns(&path, &layout, start(0, 1, None), &query).unwrap();
        assert_eq!(parts, 2);
        let texts = Cells {
            fields: 3,
            before: 1,
            times: vec![2, 4],
            values: CellValues::Texts(b"b,\nbc".to_vec(), vec![4, 5]),
        };
        let integers = Cells {
            fields: 3,
            before: 1,
            times: vec![3, 4],
            values: CellValues::Integers(vec![7, 8]),
        };
        assert_eq!(found, [texts, integers]);
        let last = text.find("5,123").unwrap() as u64;
        let refused = read_columns(&path, &layout, start(last, 6, Some(4)), &query).unwrap_err();
        assert_eq!(refused, Refusal::Unsure);
        let small = Layout { bytes: 1, ..layout };
        let found = read_columns(&path, &small, start(0, 1, None), &query).unwrap();
        assert_eq!(found.0, 1);
        std::fs::remove_file(path).unwrap();
    }
}

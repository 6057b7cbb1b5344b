//! Reads a file: its columns, the ranges of its row groups, and their rows.

use crate::assemble::{encode_row, Leaves};
use crate::error::{malformed, Error, Result};
use crate::leaf::Leaf;
use crate::meaning::{convert_int, Meaning};
use crate::schema::{build_columns, Kind, Node};
use crate::term::{Encoder, Term};
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::file::statistics::Statistics;
use std::ffi::OsStr;
use std::fs::File;
use std::os::unix::ffi::OsStrExt;

/// The size of a result that the reader aims for, and the size at which it gives up.
const WANTED_BYTES: usize = 1 << 20;
const MAX_BYTES: usize = 1 << 30;
const FIRST_ROWS: usize = 64;
const MAX_ROWS: usize = 65_536;

pub struct Reader {
    file: SerializedFileReader<File>,
    columns: Vec<Node>,
    /// The numbers and the leaves of the selected columns of the current group.
    selected: Vec<(usize, Vec<Leaf>)>,
    remaining: usize,
    batch: usize,
}

impl Reader {
    pub fn open(path: &[u8]) -> Result<Self> {
        let file = File::open(OsStr::from_bytes(path))?;
        if file.metadata()?.is_dir() {
            return Err(Error::Io(std::io::Error::from_raw_os_error(21)));
        }
        let file = SerializedFileReader::new(file)?;
        let columns = build_columns(file.metadata().file_metadata().schema())?;
        Ok(Self {
            file,
            columns,
            selected: Vec::new(),
            remaining: 0,
            batch: FIRST_ROWS,
        })
    }

    /// Encodes `{:ok, [{name, time?}], [rows of each group]}`.
    pub fn describe(&self, out: &mut Encoder) {
        out.tuple(3);
        out.atom("ok");
        let start = out.begin_list(0);
        for column in &self.columns {
            out.tuple(2);
            out.bytes(column.name.as_bytes());
            out.boolean(column.is_time());
        }
        out.end_list(start, self.columns.len());
        let groups = self.file.metadata().row_groups();
        let start = out.begin_list(0);
        groups
            .iter()
            .for_each(|group| out.int(group.num_rows().into()));
        out.end_list(start, groups.len());
    }

    /// Encodes `{minimum, maximum}` of a column of integers for each row group, or `nil` if unknown.
    pub fn column_ranges(&self, column: usize, out: &mut Encoder) -> Result<()> {
        let node = self.columns.get(column);
        let meaning = match node.map(|node| (node, &node.kind)) {
            Some((node, Kind::Leaf(meaning, _))) if node.is_flat() => {
                Some((node.leaves.start, *meaning))
            }
            _ => None,
        };
        let groups = self.file.metadata().row_groups();
        let start = out.begin_list(0);
        for group in groups {
            let column =
                meaning.and_then(|(leaf, meaning)| Some((group.columns().get(leaf)?, meaning)));
            let range =
                column.and_then(|(column, meaning)| integer_range(column.statistics()?, meaning));
            match range {
                Some((low, high)) => {
                    out.tuple(2);
                    out.int(low);
                    out.int(high);
                }
                None => out.nil(),
            }
        }
        out.end_list(start, groups.len());
        Ok(())
    }

    /// Starts to read some columns of a row group.
    pub fn start_group(&mut self, group: usize, columns: &[Term]) -> Result<()> {
        if group >= self.file.num_row_groups() {
            return malformed("it has fewer row groups");
        }
        let reader = self.file.get_row_group(group)?;
        let rows = reader.metadata().num_rows();
        self.remaining =
            usize::try_from(rows).or_else(|_| malformed("a row group is malformed"))?;
        self.batch = FIRST_ROWS;
        self.selected.clear();
        for column in columns {
            let Term::Int(number) = column else {
                return malformed("unknown column");
            };
            let Some(node) = self.columns.get(*number as usize) else {
                return malformed("unknown column");
            };
            let mut leaves = Vec::new();
            let mut nodes = Vec::new();
            collect_leaves(node, &mut nodes);
            for (number, meaning, def) in nodes {
                if number >= reader.metadata().num_columns() {
                    return malformed(format!("the chunk of {:?} is missing", node.name));
                }
                leaves.push(Leaf::new(reader.get_column_reader(number)?, meaning, def));
            }
            self.selected.push((*number as usize, leaves));
        }
        Ok(())
    }

    /// Encodes `{rows, list of rows}`, or `:done`. A row is a list of its values.
    pub fn next_rows(&mut self, out: &mut Encoder) -> Result<()> {
        let rows = self.read_batch(out)?;
        let size = self.selected.len();
        let mut columns: Vec<(&Node, Leaves)> = Vec::with_capacity(size);
        for (number, leaves) in &mut self.selected {
            let node = &self.columns[*number];
            columns.push((
                node,
                Leaves {
                    first: node.leaves.start,
                    leaves,
                },
            ));
        }
        let start = out.begin_list(rows);
        for _ in 0..rows {
            let start = out.begin_list(size);
            for (node, leaves) in &mut columns {
                encode_row(node, leaves, out)?;
            }
            out.end_list(start, size);
            check_size(rows, out)?;
        }
        out.end_list(start, rows);
        self.end_batch(rows, out);
        Ok(())
    }

    /// Encodes `{rows, [values of each column]}`, or `:done`. Values are `{kind, bytes}` if they can be packed, and
    /// otherwise a list.
    pub fn next_columns(&mut self, out: &mut Encoder) -> Result<()> {
        let rows = self.read_batch(out)?;
        let start = out.begin_list(0);
        for (number, leaves) in &mut self.selected {
            let node = &self.columns[*number];
            let packed = if node.is_flat() {
                leaves[0].pack_values(rows)
            } else {
                None
            };
            if let Some((kind, bytes)) = packed {
                out.tuple(2);
                out.atom(kind);
                out.bytes(&bytes);
                continue;
            }
            let start = out.begin_list(rows);
            let mut leaves = Leaves {
                first: node.leaves.start,
                leaves,
            };
            for _ in 0..rows {
                encode_row(node, &mut leaves, out)?;
                check_size(rows, out)?;
            }
            out.end_list(start, rows);
        }
        out.end_list(start, self.selected.len());
        self.end_batch(rows, out);
        Ok(())
    }

    fn read_batch(&mut self, out: &mut Encoder) -> Result<usize> {
        let rows = self.batch.min(self.remaining);
        for (number, leaves) in &mut self.selected {
            let node = &self.columns[*number];
            for leaf in leaves {
                leaf.read_rows(rows)
                    .map_err(|error| name_column(error, node))?;
            }
        }
        out.tuple(2);
        out.int(rows as i128);
        Ok(rows)
    }

    // Batches grow until their results have about the wanted size.
    fn end_batch(&mut self, rows: usize, out: &Encoder) {
        self.remaining -= rows;
        let wanted = rows * WANTED_BYTES / out.0.len().max(1);
        self.batch = wanted.clamp(1, rows.max(1) * 16).min(MAX_ROWS);
    }
}

fn check_size(rows: usize, out: &Encoder) -> Result<()> {
    if out.0.len() > MAX_BYTES {
        return malformed(format!(
            "{rows} rows of it have more than {MAX_BYTES} bytes"
        ));
    }
    Ok(())
}

fn name_column(error: Error, node: &Node) -> Error {
    match error {
        Error::Malformed(why) => Error::Malformed(format!("column {:?}: {why}", node.name)),
        error => error,
    }
}

fn collect_leaves(node: &Node, leaves: &mut Vec<(usize, Meaning, i16)>) {
    if let Kind::Leaf(meaning, _) = node.kind {
        leaves.push((node.leaves.start, meaning, node.def));
    }
    node.children
        .iter()
        .for_each(|child| collect_leaves(child, leaves));
}

fn integer_range(statistics: &Statistics, meaning: Meaning) -> Option<(i128, i128)> {
    let (low, high) = match statistics {
        Statistics::Int32(range) => (i64::from(*range.min_opt()?), i64::from(*range.max_opt()?)),
        Statistics::Int64(range) => (*range.min_opt()?, *range.max_opt()?),
        _ => return None,
    };
    // Old writers compared numbers without a sign as numbers with a sign.
    match meaning {
        Meaning::Plain | Meaning::Times(_) => {
            Some((convert_int(low, meaning)?, convert_int(high, meaning)?))
        }
        _ => None,
    }
}

//! Writes a file: row groups of columns that may be nested, with dictionaries and statistics.

use crate::error::{malformed, Result};
use crate::shred::{push_packed, push_value, Buffer, Column, Kind, Node};
use crate::term::Term;
use parquet::basic::{
    Compression, Encoding, GzipLevel, LogicalType, Repetition, TimeUnit, Type as Physical,
    ZstdLevel,
};
use parquet::column::writer::ColumnWriter;
use parquet::file::properties::{WriterProperties, WriterPropertiesBuilder};
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::{ColumnPath, Type, TypePtr};
use std::ffi::OsStr;
use std::fs::File;
use std::os::unix::ffi::OsStrExt;
use std::sync::Arc;

pub struct Writer {
    file: SerializedFileWriter<File>,
    columns: Vec<Node>,
    /// The values of the current row group, for each leaf of each column.
    buffers: Vec<Vec<Buffer>>,
    rows: usize,
    max_rows: usize,
}

impl Writer {
    /// `columns` are `{name, type, optional?}`. A type is `:time`, `:integer`, `:float`, `:boolean`, `:text`, `:bytes`,
    /// `{:list, type}` or `{:struct, [{name, type}]}`. `options` are the compression and the rows of a group.
    pub fn create(path: &[u8], columns: &[Term], options: &[Term]) -> Result<Self> {
        let [Term::Atom(codec), Term::Int(max_rows)] = options else {
            return malformed("unknown options");
        };
        let mut properties = WriterProperties::builder()
            .set_created_by("situ".to_string())
            .set_compression(compression(codec)?);
        let (mut fields, mut nodes, mut buffers) = (Vec::new(), Vec::new(), Vec::new());
        for column in columns {
            let Term::Tuple(column) = column else {
                return malformed("a column is not a tuple");
            };
            let [name, kind, optional] = column.as_slice() else {
                return malformed("a column is not complete");
            };
            let name = text(name)?;
            let mut leaves = Vec::new();
            let optional = *optional == Term::Atom("true");
            let (field, node) = build_type(name, kind, optional, (0, 0), &mut leaves)?;
            if *kind == Term::Atom("time") {
                properties = encode_deltas(properties, name);
            }
            fields.push(field);
            nodes.push(node);
            buffers.push(leaves.into_iter().map(new_buffer).collect());
        }
        let root = Type::group_type_builder("situ").with_fields(fields);
        let root = Arc::new(root.build()?);
        let file = File::create(OsStr::from_bytes(path))?;
        let file = SerializedFileWriter::new(file, root, Arc::new(properties.build()))?;
        let max_rows = *max_rows as usize;
        Ok(Self {
            file,
            columns: nodes,
            buffers,
            rows: 0,
            max_rows,
        })
    }

    /// Adds rows: `{:rows, rows}`, or the values of each column, which are a list or packed bytes.
    pub fn write_rows(&mut self, rows: usize, values: &Term) -> Result<()> {
        if self.rows > 0 && self.rows + rows > self.max_rows {
            self.flush_group()?;
        }
        match values {
            Term::List(columns) if columns.len() == self.columns.len() => {
                for ((node, values), buffers) in
                    self.columns.iter().zip(columns).zip(&mut self.buffers)
                {
                    push_column(node, values, buffers)?;
                }
            }
            Term::Tuple(tagged) => match tagged.as_slice() {
                [Term::Atom("rows"), Term::List(rows)] => {
                    rows.iter().try_for_each(|row| self.push_row(row))?
                }
                _ => return malformed("unknown values of a row group"),
            },
            _ => return malformed("a row group does not have all columns"),
        }
        self.rows += rows;
        if self.rows >= self.max_rows {
            self.flush_group()?;
        }
        Ok(())
    }

    fn flush_group(&mut self) -> Result<()> {
        let mut group = self.file.next_row_group()?;
        for buffer in self.buffers.iter_mut().flatten() {
            write_buffer(&mut group, buffer)?;
            buffer.clear();
        }
        group.close()?;
        self.rows = 0;
        Ok(())
    }

    fn push_row(&mut self, row: &Term) -> Result<()> {
        match row {
            Term::List(values) if values.len() == self.columns.len() => {
                for ((node, value), buffers) in
                    self.columns.iter().zip(values).zip(&mut self.buffers)
                {
                    push_value(node, value, (0, 0), buffers)?;
                }
                Ok(())
            }
            _ => malformed("a row does not have all columns"),
        }
    }

    pub fn finish(mut self) -> Result<()> {
        if self.rows > 0 {
            self.flush_group()?;
        }
        self.file.finish()?;
        Ok(self.file.inner().sync_data()?)
    }
}

fn push_column(node: &Node, values: &Term, buffers: &mut [Buffer]) -> Result<()> {
    match values {
        Term::Bytes(bytes) => push_packed(node, bytes, buffers),
        Term::List(values) => values
            .iter()
            .try_for_each(|value| push_value(node, value, (0, 0), buffers)),
        _ => malformed("the values of a column are not a list"),
    }
}

fn compression(codec: &str) -> Result<Compression> {
    Ok(match codec {
        "none" => Compression::UNCOMPRESSED,
        "snappy" => Compression::SNAPPY,
        "gzip" => Compression::GZIP(GzipLevel::default()),
        "zstd" => Compression::ZSTD(ZstdLevel::try_new(1)?),
        _ => return malformed(format!("unknown compression {codec}")),
    })
}

// Times increase, so their differences are much smaller than a dictionary.
fn encode_deltas(properties: WriterPropertiesBuilder, name: &str) -> WriterPropertiesBuilder {
    let path = ColumnPath::from(name);
    properties
        .set_column_dictionary_enabled(path.clone(), false)
        .set_column_encoding(path, Encoding::DELTA_BINARY_PACKED)
}

fn text<'a>(term: &Term<'a>) -> Result<&'a str> {
    match term {
        Term::Bytes(bytes) => {
            std::str::from_utf8(bytes).or_else(|_| malformed("a name is not UTF-8"))
        }
        _ => malformed("a name is not a string"),
    }
}

type Levels = (i16, i16);
/// The kind of a leaf, and whether it is below a list.
type Leaf = (String, bool);

fn build_type(
    name: &str,
    kind: &Term,
    optional: bool,
    (def, rep): Levels,
    leaves: &mut Vec<Leaf>,
) -> Result<(TypePtr, Node)> {
    let repetition = if optional {
        Repetition::OPTIONAL
    } else {
        Repetition::REQUIRED
    };
    let def = def + i16::from(optional);
    let first = leaves.len();
    let (field, kind) = match kind {
        Term::Atom(kind) => {
            leaves.push(((*kind).to_string(), rep > 0));
            (leaf_type(name, kind, repetition)?, Kind::Leaf)
        }
        Term::Tuple(kind) => match kind.as_slice() {
            [Term::Atom("list"), element] => {
                let (field, node) =
                    build_type("element", element, true, (def + 1, rep + 1), leaves)?;
                (
                    list_type(name, field, repetition)?,
                    Kind::List(Box::new(node), rep + 1),
                )
            }
            [Term::Atom("struct"), Term::List(members)] if !members.is_empty() => {
                let mut built = Vec::new();
                for member in members {
                    let Term::Tuple(member) = member else {
                        return malformed("a member is not a tuple");
                    };
                    let [name, kind] = member.as_slice() else {
                        return malformed("a member is not a pair");
                    };
                    built.push(build_type(text(name)?, kind, true, (def, rep), leaves)?);
                }
                let (fields, nodes) = built.into_iter().unzip();
                let field = Type::group_type_builder(name)
                    .with_repetition(repetition)
                    .with_fields(fields);
                (field.build()?, Kind::Struct(nodes))
            }
            _ => return malformed("unknown type of a column"),
        },
        _ => return malformed("unknown type of a column"),
    };
    Ok((
        Arc::new(field),
        Node {
            kind,
            def,
            leaves: first..leaves.len(),
        },
    ))
}

fn leaf_type(name: &str, kind: &str, repetition: Repetition) -> Result<Type> {
    let (physical, logical) = match kind {
        "time" => (
            Physical::INT64,
            Some(LogicalType::timestamp(true, TimeUnit::NANOS)),
        ),
        "integer" => (Physical::INT64, None),
        "float" => (Physical::DOUBLE, None),
        "boolean" => (Physical::BOOLEAN, None),
        "text" => (Physical::BYTE_ARRAY, Some(LogicalType::String)),
        "bytes" => (Physical::BYTE_ARRAY, None),
        _ => return malformed(format!("unknown type {kind} of a column")),
    };
    let leaf = Type::primitive_type_builder(name, physical);
    Ok(leaf
        .with_repetition(repetition)
        .with_logical_type(logical)
        .build()?)
}

fn list_type(name: &str, element: TypePtr, repetition: Repetition) -> Result<Type> {
    let repeated = Type::group_type_builder("list")
        .with_repetition(Repetition::REPEATED)
        .with_fields(vec![element])
        .build()?;
    let list = Type::group_type_builder(name)
        .with_repetition(repetition)
        .with_logical_type(Some(LogicalType::List))
        .with_fields(vec![Arc::new(repeated)]);
    Ok(list.build()?)
}

fn new_buffer((kind, repeated): Leaf) -> Buffer {
    let column = match kind.as_str() {
        "time" | "integer" => Column::Int(Vec::new()),
        "float" => Column::Float(Vec::new()),
        "boolean" => Column::Bool(Vec::new()),
        _ => Column::Bytes(Vec::new()),
    };
    Buffer {
        column,
        defs: Vec::new(),
        reps: repeated.then(Vec::new),
    }
}

fn write_buffer(group: &mut SerializedRowGroupWriter<File>, buffer: &Buffer) -> Result<()> {
    let Some(mut writer) = group.next_column()? else {
        return malformed("a row group has too many columns");
    };
    let reps = buffer.reps.as_deref();
    let defs = Some(buffer.defs.as_slice());
    match (writer.untyped(), &buffer.column) {
        (ColumnWriter::Int64ColumnWriter(writer), Column::Int(values)) => {
            writer.write_batch(values, defs, reps)
        }
        (ColumnWriter::DoubleColumnWriter(writer), Column::Float(values)) => {
            writer.write_batch(values, defs, reps)
        }
        (ColumnWriter::BoolColumnWriter(writer), Column::Bool(values)) => {
            writer.write_batch(values, defs, reps)
        }
        (ColumnWriter::ByteArrayColumnWriter(writer), Column::Bytes(values)) => {
            writer.write_batch(values, defs, reps)
        }
        _ => return malformed("a column has another type"),
    }?;
    Ok(writer.close()?)
}

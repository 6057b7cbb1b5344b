//! Reads the values of one leaf of a row group, some rows at a time.

use crate::error::{malformed, Result};
use crate::meaning::{convert_int, encode_bytes, encode_int, Meaning};
use crate::term::Encoder;
use parquet::column::reader::{ColumnReader, ColumnReaderImpl};
use parquet::data_type::{
    AsBytes, BoolType, ByteArrayType, DataType, DoubleType, FixedLenByteArrayType, FloatType,
    Int32Type, Int64Type, Int96, Int96Type,
};

/// A reader, and the values that it has read.
struct Source<T: DataType>(ColumnReaderImpl<T>, Vec<T::T>);

enum Values {
    Bool(Source<BoolType>),
    Int32(Source<Int32Type>),
    Int64(Source<Int64Type>),
    Int96(Source<Int96Type>),
    Float(Source<FloatType>),
    Double(Source<DoubleType>),
    Bytes(Source<ByteArrayType>),
    Fixed(Source<FixedLenByteArrayType>),
}

/// The levels and the present values of some rows. `at` and `value` are the positions of the next entry.
pub struct Leaf {
    meaning: Meaning,
    max_def: i16,
    defs: Vec<i16>,
    reps: Vec<i16>,
    values: Values,
    at: usize,
    value: usize,
}

impl<T: DataType> Source<T> {
    fn read(
        &mut self,
        rows: usize,
        defs: &mut Vec<i16>,
        reps: &mut Vec<i16>,
    ) -> Result<(usize, usize)> {
        self.1.clear();
        let (records, values, _levels) =
            self.0
                .read_records(rows, Some(defs), Some(reps), &mut self.1)?;
        Ok((records, values))
    }
}

macro_rules! each_source {
    ($values:expr, $source:ident => $body:expr) => {
        match $values {
            Values::Bool($source) => $body,
            Values::Int32($source) => $body,
            Values::Int64($source) => $body,
            Values::Int96($source) => $body,
            Values::Float($source) => $body,
            Values::Double($source) => $body,
            Values::Bytes($source) => $body,
            Values::Fixed($source) => $body,
        }
    };
}

impl Leaf {
    pub fn new(reader: ColumnReader, meaning: Meaning, max_def: i16) -> Self {
        let values = match reader {
            ColumnReader::BoolColumnReader(reader) => Values::Bool(Source(reader, Vec::new())),
            ColumnReader::Int32ColumnReader(reader) => Values::Int32(Source(reader, Vec::new())),
            ColumnReader::Int64ColumnReader(reader) => Values::Int64(Source(reader, Vec::new())),
            ColumnReader::Int96ColumnReader(reader) => Values::Int96(Source(reader, Vec::new())),
            ColumnReader::FloatColumnReader(reader) => Values::Float(Source(reader, Vec::new())),
            ColumnReader::DoubleColumnReader(reader) => Values::Double(Source(reader, Vec::new())),
            ColumnReader::ByteArrayColumnReader(reader) => {
                Values::Bytes(Source(reader, Vec::new()))
            }
            ColumnReader::FixedLenByteArrayColumnReader(reader) => {
                Values::Fixed(Source(reader, Vec::new()))
            }
        };
        let (defs, reps) = (Vec::new(), Vec::new());
        Self {
            meaning,
            max_def,
            defs,
            reps,
            values,
            at: 0,
            value: 0,
        }
    }

    /// Replaces the values by those of the next rows.
    pub fn read_rows(&mut self, rows: usize) -> Result<()> {
        (self.at, self.value) = (0, 0);
        self.defs.clear();
        self.reps.clear();
        let (defs, reps) = (&mut self.defs, &mut self.reps);
        let (records, present) =
            each_source!(&mut self.values, source => source.read(rows, defs, reps))?;
        let expected = match self.max_def {
            0 => rows,
            max => self.defs.iter().filter(|&&def| def == max).count(),
        };
        if self.reps.first().is_some_and(|&rep| rep != 0) {
            return malformed("a row group begins in the middle of a row");
        }
        if records != rows {
            return malformed("a column does not have as many rows as its group");
        }
        if present != expected {
            return malformed("a column has fewer values than it declares");
        }
        Ok(())
    }

    /// Returns the definition level of the next entry.
    pub fn next_def(&self) -> Result<i16> {
        match self.defs.get(self.at) {
            Some(&def) => Ok(def),
            None if self.max_def == 0 => Ok(0),
            None => malformed("a column ends within a row"),
        }
    }

    /// Returns the repetition level of the next entry, which is 0 at the end.
    pub fn next_rep(&self) -> i16 {
        self.reps.get(self.at).copied().unwrap_or(0)
    }

    /// Skips an entry without a value.
    pub fn skip_entry(&mut self) {
        self.at += 1;
    }

    /// Encodes the next entry, which has a value.
    pub fn encode_entry(&mut self, out: &mut Encoder) -> Result<()> {
        if self.next_def()? != self.max_def {
            return malformed("a value is missing in a column that requires it");
        }
        self.encode_value(self.value, out);
        self.at += 1;
        self.value += 1;
        Ok(())
    }

    /// Encodes the next entry, or `nil` if it has no value.
    pub fn encode_next(&mut self, out: &mut Encoder) -> Result<()> {
        if self.next_def()? == self.max_def {
            return self.encode_entry(out);
        }
        self.skip_entry();
        out.nil();
        Ok(())
    }

    fn present(&self) -> usize {
        each_source!(&self.values, source => source.1.len())
    }

    // `value` is less than the number of values, because the levels were counted when they were read.
    fn encode_value(&self, value: usize, out: &mut Encoder) {
        match &self.values {
            Values::Bool(source) => out.boolean(source.1[value]),
            Values::Int32(source) => encode_int(source.1[value].into(), self.meaning, out),
            Values::Int64(source) => encode_int(source.1[value], self.meaning, out),
            Values::Int96(source) => out.int(int96_time(&source.1[value])),
            Values::Float(source) => out.float(source.1[value].into()),
            Values::Double(source) => out.float(source.1[value]),
            Values::Bytes(source) => encode_bytes(source.1[value].as_bytes(), self.meaning, out),
            Values::Fixed(source) => encode_bytes(source.1[value].as_bytes(), self.meaning, out),
        }
    }

    /// Returns the kind and the packed values of a flat column, or `None` if it has missing values, or values that are
    /// not booleans, floats or integers of 64 bits.
    pub fn pack_values(&self, rows: usize) -> Option<(&'static str, Vec<u8>)> {
        if self.present() != rows {
            return None;
        }
        let int = |n: i64| i64::try_from(convert_int(n, self.meaning)?).ok();
        Some(match &self.values {
            Values::Bool(source) => ("boolean", source.1.iter().map(|&b| u8::from(b)).collect()),
            Values::Int32(source) => (
                "integer",
                pack_ints(source.1.iter().map(|&n| int(n.into())))?,
            ),
            Values::Int64(source) if matches!(self.meaning, Meaning::Plain | Meaning::Times(1)) => {
                (
                    "integer",
                    source.1.iter().flat_map(|n| n.to_le_bytes()).collect(),
                )
            }
            Values::Int64(source) => ("integer", pack_ints(source.1.iter().map(|&n| int(n)))?),
            Values::Int96(source) => (
                "integer",
                pack_ints(source.1.iter().map(|n| i64::try_from(int96_time(n)).ok()))?,
            ),
            Values::Float(source) => (
                "float",
                source
                    .1
                    .iter()
                    .flat_map(|&x| f64::from(x).to_le_bytes())
                    .collect(),
            ),
            Values::Double(source) => (
                "float",
                source.1.iter().flat_map(|x| x.to_le_bytes()).collect(),
            ),
            Values::Bytes(_) | Values::Fixed(_) => return None,
        })
    }
}

fn pack_ints(numbers: impl ExactSizeIterator<Item = Option<i64>>) -> Option<Vec<u8>> {
    let mut bytes = Vec::with_capacity(numbers.len() * 8);
    for n in numbers {
        bytes.extend(n?.to_le_bytes());
    }
    Some(bytes)
}

/// Nanoseconds since 1970 of a time stamp with a Julian day.
fn int96_time(time: &Int96) -> i128 {
    let [low, high, day] = *time.data() else {
        return 0;
    };
    let nanoseconds = i128::from(u64::from(high) << 32 | u64::from(low));
    (i128::from(day) - 2_440_588) * 86_400_000_000_000 + nanoseconds
}

//! A column of a table that is built row by row.

use std::collections::HashMap;

use crate::array::Numbers;

/// The value of a field. A text or another value is an external term without its version byte.
pub enum Cell<'a> {
    Nil,
    Int(i64),
    Float(f64),
    Bool(bool),
    /// An immutable value: a string or an atom.
    Text(&'a [u8]),
    /// A list or tuple.
    Other(&'a [u8]),
}

/// Values and the number of each row's value. The first value is nil.
pub struct Objects {
    codes: Vec<u32>,
    terms: Vec<Vec<u8>>,
    known: HashMap<Vec<u8>, u32>,
}

enum Data {
    /// Only nil so far.
    Nothing(usize),
    Ints(Vec<i64>),
    /// NaN where there is no number, as in the frames of Python.
    Floats(Vec<f64>),
    /// 0 false, 1 true, 2 nil.
    Bools(Vec<u8>),
    Objects(Objects),
}

pub struct Column {
    /// The names of the fields that lead to the value, joined by dots.
    pub name: Vec<u8>,
    data: Data,
}

/// A finished column: numbers, or the number of each row's value and the values as external terms.
pub enum Finished {
    Numbers(Numbers),
    Objects(Vec<u32>, Vec<Vec<u8>>),
}

const NIL: &[u8] = &[119, 3, b'n', b'i', b'l'];
const FALSE: &[u8] = &[119, 5, b'f', b'a', b'l', b's', b'e'];
const TRUE: &[u8] = &[119, 4, b't', b'r', b'u', b'e'];

impl Objects {
    fn new(missing: usize) -> Self {
        Objects {
            codes: vec![0; missing],
            terms: vec![NIL.to_vec()],
            known: HashMap::new(),
        }
    }

    fn push_text(&mut self, term: &[u8]) {
        let code = match self.known.get(term) {
            Some(code) => *code,
            None => {
                let code = self.terms.len() as u32;
                self.terms.push(term.to_vec());
                self.known.insert(term.to_vec(), code);
                code
            }
        };
        self.codes.push(code);
    }

    /// Adds a value that Python can change, so that rows must not share it.
    fn push_other(&mut self, term: &[u8]) {
        self.codes.push(self.terms.len() as u32);
        self.terms.push(term.to_vec());
    }
}

impl Column {
    /// Creates a column that is nil in the first rows.
    pub fn new(name: Vec<u8>, missing: usize) -> Self {
        let data = Data::Nothing(missing);
        Column { name, data }
    }

    pub fn len(&self) -> usize {
        match &self.data {
            Data::Nothing(count) => *count,
            Data::Ints(values) => values.len(),
            Data::Floats(values) => values.len(),
            Data::Bools(values) => values.len(),
            Data::Objects(objects) => objects.codes.len(),
        }
    }

    /// Adds a value. Returns `None` if it does not fit to the values before it.
    pub fn push(&mut self, cell: Cell<'_>) -> Option<()> {
        match (&mut self.data, cell) {
            (Data::Nothing(count), Cell::Nil) => *count += 1,
            (Data::Nothing(count), cell) => {
                let missing = *count;
                self.data = match &cell {
                    Cell::Int(_) if missing == 0 => Data::Ints(Vec::new()),
                    Cell::Int(_) | Cell::Float(_) => Data::Floats(vec![f64::NAN; missing]),
                    Cell::Bool(_) => Data::Bools(vec![2; missing]),
                    _ => Data::Objects(Objects::new(missing)),
                };
                return self.push(cell);
            }
            (Data::Ints(values), Cell::Int(value)) => values.push(value),
            (Data::Ints(values), cell @ (Cell::Float(_) | Cell::Nil)) => {
                self.data = Data::Floats(values.iter().map(|value| *value as f64).collect());
                return self.push(cell);
            }
            (Data::Floats(values), Cell::Float(value)) => values.push(value),
            (Data::Floats(values), Cell::Int(value)) => values.push(value as f64),
            (Data::Floats(values), Cell::Nil) => values.push(f64::NAN),
            (Data::Bools(values), Cell::Bool(value)) => values.push(value.into()),
            (Data::Bools(values), Cell::Nil) => values.push(2),
            (Data::Objects(objects), Cell::Text(term)) => objects.push_text(term),
            (Data::Objects(objects), Cell::Other(term)) => objects.push_other(term),
            (Data::Objects(objects), Cell::Nil) => objects.codes.push(0),
            _ => return None,
        }
        Some(())
    }

    pub fn finish(self) -> Finished {
        match self.data {
            Data::Nothing(count) => Finished::Numbers(Numbers::Floats(vec![f64::NAN; count])),
            Data::Ints(values) => Finished::Numbers(Numbers::Ints(values)),
            Data::Floats(values) => Finished::Numbers(Numbers::Floats(values)),
            Data::Bools(values) if !values.contains(&2) => {
                Finished::Numbers(Numbers::Booleans(values))
            }
            Data::Bools(values) => {
                let terms = [FALSE, TRUE, NIL].map(<[u8]>::to_vec).to_vec();
                Finished::Objects(values.into_iter().map(u32::from).collect(), terms)
            }
            Data::Objects(objects) => Finished::Objects(objects.codes, objects.terms),
        }
    }
}

//! Splits values into the levels and values of leaves (Dremel encoding).

use crate::error::{malformed, Result};
use crate::term::Term;
use parquet::data_type::ByteArray;
use std::ops::Range;

#[derive(Debug)]
pub enum Column {
    Int(Vec<i64>),
    Float(Vec<f64>),
    Bool(Vec<bool>),
    Bytes(Vec<ByteArray>),
}

/// The values and levels of a leaf. It has repetition levels only if it is below a list.
#[derive(Debug)]
pub struct Buffer {
    pub column: Column,
    pub defs: Vec<i16>,
    pub reps: Option<Vec<i16>>,
}

impl Buffer {
    pub fn clear(&mut self) {
        match &mut self.column {
            Column::Int(values) => values.clear(),
            Column::Float(values) => values.clear(),
            Column::Bool(values) => values.clear(),
            Column::Bytes(values) => values.clear(),
        }
        self.defs.clear();
        if let Some(reps) = &mut self.reps {
            reps.clear();
        }
    }

    fn push_levels(&mut self, def: i16, rep: i16) {
        self.defs.push(def);
        if let Some(reps) = &mut self.reps {
            reps.push(rep);
        }
    }
}

#[derive(Debug)]
pub enum Kind {
    Leaf,
    /// A list of elements, whose first repetition has this level.
    List(Box<Node>, i16),
    Struct(Vec<Node>),
}

/// The type of a value. It is present from the definition level `def`.
#[derive(Debug)]
pub struct Node {
    pub kind: Kind,
    pub def: i16,
    pub leaves: Range<usize>,
}

/// Appends a value. `levels` are the repetition level, and the definition level of a missing value.
pub fn push_value(
    node: &Node,
    value: &Term,
    levels: (i16, i16),
    buffers: &mut [Buffer],
) -> Result<()> {
    let (rep, _) = levels;
    match (&node.kind, value) {
        (_, Term::Atom("nil")) => push_missing(node, levels, buffers),
        (Kind::Leaf, value) => {
            let buffer = &mut buffers[node.leaves.start];
            buffer.push_levels(node.def, rep);
            push_leaf(&mut buffer.column, value)?;
        }
        (Kind::Struct(children), Term::Tuple(values)) if children.len() == values.len() => {
            for (child, value) in children.iter().zip(values) {
                push_value(child, value, (rep, node.def), buffers)?;
            }
        }
        (Kind::List(..), Term::List(values)) if values.is_empty() => {
            push_missing(node, (rep, node.def), buffers)
        }
        (Kind::List(element, level), Term::List(values)) => {
            for (i, value) in values.iter().enumerate() {
                let rep = if i == 0 { rep } else { *level };
                push_value(element, value, (rep, node.def + 1), buffers)?;
            }
        }
        _ => return malformed("a value does not have the type of its column"),
    }
    Ok(())
}

fn push_missing(node: &Node, (rep, def): (i16, i16), buffers: &mut [Buffer]) {
    for buffer in &mut buffers[node.leaves.clone()] {
        buffer.push_levels(def, rep);
    }
}

fn push_leaf(column: &mut Column, value: &Term) -> Result<()> {
    match (column, value) {
        (Column::Int(numbers), Term::Int(n)) => match i64::try_from(*n) {
            Ok(n) => numbers.push(n),
            Err(_) => return malformed("an integer has more than 64 bits"),
        },
        (Column::Float(numbers), Term::Float(x)) => numbers.push(*x),
        (Column::Float(numbers), Term::Int(n)) => numbers.push(*n as f64),
        (Column::Float(numbers), Term::Atom("nan")) => numbers.push(f64::NAN),
        (Column::Float(numbers), Term::Atom("infinity")) => numbers.push(f64::INFINITY),
        (Column::Float(numbers), Term::Atom("neg_infinity")) => numbers.push(f64::NEG_INFINITY),
        (Column::Bool(truths), Term::Atom("true")) => truths.push(true),
        (Column::Bool(truths), Term::Atom("false")) => truths.push(false),
        (Column::Bytes(texts), Term::Bytes(bytes)) => texts.push(ByteArray::from(bytes.to_vec())),
        _ => return malformed("a value does not have the type of its column"),
    }
    Ok(())
}

/// Appends packed numbers of 8 bytes, or booleans of one byte, none of them missing.
pub fn push_packed(node: &Node, bytes: &[u8], buffers: &mut [Buffer]) -> Result<()> {
    let Buffer { column, defs, .. } = &mut buffers[node.leaves.start];
    let (words, rest) = bytes.as_chunks::<8>();
    let n = match column {
        Column::Int(numbers) if rest.is_empty() => {
            numbers.extend(words.iter().map(|word| i64::from_le_bytes(*word)));
            words.len()
        }
        Column::Float(numbers) if rest.is_empty() => {
            numbers.extend(words.iter().map(|word| f64::from_le_bytes(*word)));
            words.len()
        }
        Column::Bool(truths) => {
            truths.extend(bytes.iter().map(|&byte| byte != 0));
            bytes.len()
        }
        _ => return malformed("packed values do not have the type of their column"),
    };
    defs.resize(defs.len() + n, node.def);
    Ok(())
}

//! Building and reading chunks: one or more messages of one stream, checked as one.

mod body;
mod builder;
mod messages;

use crate::varint;

pub use body::{compress, open, Body};
pub use builder::Builder;
pub use messages::Messages;

/// A message's payload as it is handed in.
#[derive(Debug, Clone, Copy)]
pub enum Input<'a> {
    /// An integer.
    Int(i64),
    /// A float.
    Float(f64),
    /// 0 false, 1 true, 2 nil.
    Bool(u8),
    /// Bytes in one piece.
    Bytes(&'a [u8]),
    /// Bytes in several pieces, stored one behind the other.
    Parts(&'a [&'a [u8]]),
}

impl Input<'_> {
    /// The size of the payload as it is stored, bytes.
    pub fn byte_size(&self) -> usize {
        match self {
            Input::Int(value) => (64 - varint::zigzag(*value).leading_zeros() as usize)
                .div_ceil(7)
                .max(1),
            Input::Float(_) => 8,
            Input::Bool(_) => 1,
            Input::Bytes(bytes) => bytes.len(),
            Input::Parts(parts) => parts.iter().map(|part| part.len()).sum(),
        }
    }

    /// The number drawn for it, where there is one.
    pub fn number(&self) -> Option<f64> {
        match self {
            Input::Int(value) => Some(*value as f64),
            Input::Float(value) => Some(*value),
            Input::Bool(value) if *value < 2 => Some(*value as f64),
            _ => None,
        }
    }
}

/// The number that an external term is, if it is one (numbers and truths among other terms of a stream).
pub fn term_number(bytes: &[u8]) -> Option<f64> {
    match *bytes {
        // Atoms as older and as newer systems write them.
        [131, 100, 0, 4, b't', b'r', b'u', b'e'] | [131, 119, 4, b't', b'r', b'u', b'e'] => {
            Some(1.0)
        }
        [131, 100, 0, 5, b'f', b'a', b'l', b's', b'e']
        | [131, 119, 5, b'f', b'a', b'l', b's', b'e'] => Some(0.0),
        [131, 97, n] => Some(n as f64),
        [131, 98, a, b, c, d] => Some(i32::from_be_bytes([a, b, c, d]) as f64),
        [131, 70, a, b, c, d, e, f, g, h] => Some(f64::from_be_bytes([a, b, c, d, e, f, g, h])),
        [131, 110, n @ 1..=8, sign, ref digits @ ..] if digits.len() == n as usize => {
            let size = digits
                .iter()
                .rev()
                .fold(0.0, |sum, digit| sum * 256.0 + *digit as f64);
            Some(if sign == 0 { size } else { -size })
        }
        _ => None,
    }
}

/// The parts of a message other than its payload.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Envelope {
    /// The sequence id.
    pub sequence: u64,
    /// The originating time, ns.
    pub time: i64,
    /// The creation time, ns.
    pub creation: i64,
}

/// A message's payload as it is read: where it lies in the raw body, or the value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Value {
    /// An integer.
    Int(i64),
    /// A float.
    Float(f64),
    /// 0 false, 1 true, 2 nil.
    Bool(u8),
    /// Bytes of the raw body.
    Bytes {
        /// Where they begin.
        start: usize,
        /// How many there are.
        length: usize,
    },
}

impl Value {
    /// The number drawn for it, where there is one.
    pub fn number(&self) -> Option<f64> {
        match self {
            Value::Int(value) => Some(*value as f64),
            Value::Float(value) => Some(*value),
            Value::Bool(value) if *value < 2 => Some(*value as f64),
            _ => None,
        }
    }
}

//! Builds and reads chunks: one or more messages of one stream that share a checksum.

mod body;
mod builder;
mod messages;

use crate::varint;

pub use body::{compress_body, open_body, Body};
pub use builder::Builder;
pub use messages::Messages;

/// The payload of a message to write.
#[derive(Debug, Clone, Copy)]
pub enum Input<'a> {
    /// An integer.
    Int(i64),
    /// A float.
    Float(f64),
    /// 0 false, 1 true, 2 nil.
    Bool(u8),
    /// Contiguous bytes.
    Bytes(&'a [u8]),
    /// Bytes in several slices, stored one after the other.
    Parts(&'a [&'a [u8]]),
}

impl Input<'_> {
    /// Returns the stored size of the payload in bytes.
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

    /// Returns the number that a plot shows for the payload, if any.
    pub fn numeric_value(&self) -> Option<f64> {
        match self {
            Input::Int(value) => Some(*value as f64),
            Input::Float(value) => Some(*value),
            Input::Bool(value) if *value < 2 => Some(*value as f64),
            _ => None,
        }
    }
}

/// Returns the number in an external term, if it is a number or a boolean. Streams of terms may contain them.
pub fn term_number(bytes: &[u8]) -> Option<f64> {
    match *bytes {
        // Older systems write atoms differently from newer ones.
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

/// The payload of a message that was read: a value, or a range of the raw body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Value {
    /// An integer.
    Int(i64),
    /// A float.
    Float(f64),
    /// 0 false, 1 true, 2 nil.
    Bool(u8),
    /// A range of the raw body.
    Bytes {
        /// The offset of the first byte.
        start: usize,
        /// The number of bytes.
        length: usize,
    },
}

impl Value {
    /// Returns the number that a plot shows for the payload, if any.
    pub fn numeric_value(&self) -> Option<f64> {
        match self {
            Value::Int(value) => Some(*value as f64),
            Value::Float(value) => Some(*value),
            Value::Bool(value) if *value < 2 => Some(*value as f64),
            _ => None,
        }
    }
}

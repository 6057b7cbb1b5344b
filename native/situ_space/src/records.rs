//! Reads numbers from consecutive records of fixed size, as in point cloud files.

use crate::error::{fail, Code, Result};

/// The type of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A float of 4 or 8 bytes.
    Float(usize),
    /// A signed integer of 1, 2, 4 or 8 bytes.
    Signed(usize),
    /// An unsigned integer of 1, 2, 4 or 8 bytes.
    Unsigned(usize),
}

/// The offset of a number in its record, and its type.
pub type Field = (usize, Kind);

impl Kind {
    fn byte_size(self) -> usize {
        match self {
            Kind::Float(n) | Kind::Signed(n) | Kind::Unsigned(n) => n,
        }
    }

    fn is_supported(self) -> bool {
        match self {
            Kind::Float(n) => n == 4 || n == 8,
            Kind::Signed(n) | Kind::Unsigned(n) => matches!(n, 1 | 2 | 4 | 8),
        }
    }

    fn read_number(self, bytes: &[u8], big: bool) -> f64 {
        let mut bits = 0u64;
        for i in 0..bytes.len() {
            let at = if big { i } else { bytes.len() - 1 - i };
            bits = bits << 8 | u64::from(bytes[at]);
        }
        match self {
            Kind::Float(4) => f64::from(f32::from_bits(bits as u32)),
            Kind::Float(_) => f64::from_bits(bits),
            Kind::Signed(n) => ((bits << (64 - 8 * n)) as i64 >> (64 - 8 * n)) as f64,
            Kind::Unsigned(_) => bits as f64,
        }
    }
}

fn check_fields(records: &[u8], row: usize, fields: &[Field]) -> Result<()> {
    let fits = |&(at, kind): &Field| {
        kind.is_supported()
            && at
                .checked_add(kind.byte_size())
                .is_some_and(|end| end <= row)
    };
    if row > 0 && records.len().is_multiple_of(row) && fields.iter().all(fits) {
        Ok(())
    } else {
        fail(
            Code::BadCloud,
            format!(
                "{} bytes are not records of {row} bytes with these fields",
                records.len()
            ),
        )
    }
}

/// Returns these numbers of every record as consecutive 32-bit floats. Numbers that are not finite become NaN.
pub fn read_floats(records: &[u8], row: usize, fields: &[Field], big: bool) -> Result<Vec<u8>> {
    check_fields(records, row, fields)?;
    let mut out = Vec::with_capacity(records.len() / row * fields.len() * 4);
    for record in records.chunks_exact(row) {
        for &(at, kind) in fields {
            let value = kind.read_number(&record[at..at + kind.byte_size()], big) as f32;
            let value = if value.is_finite() { value } else { f32::NAN };
            out.extend_from_slice(&value.to_le_bytes());
        }
    }
    Ok(out)
}

/// Returns these numbers of every record as bytes. Integers range from 0 to 255, floats from 0 to 1.
pub fn read_colors(records: &[u8], row: usize, fields: &[Field], big: bool) -> Result<Vec<u8>> {
    check_fields(records, row, fields)?;
    let mut out = Vec::with_capacity(records.len() / row * fields.len());
    for record in records.chunks_exact(row) {
        for &(at, kind) in fields {
            let value = kind.read_number(&record[at..at + kind.byte_size()], big);
            let scale = if matches!(kind, Kind::Float(_)) {
                255.0
            } else {
                1.0
            };
            // The cast saturates, and NaN becomes 0.
            out.push((value * scale).round() as u8);
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_every_type_are_read_in_both_byte_orders() -> Result<()> {
        let mut little = Vec::new();
        little.extend_from_slice(&1.5f32.to_le_bytes());
        little.extend_from_slice(&(-2i16).to_le_bytes());
        little.extend_from_slice(&f64::MAX.to_le_bytes());
        little.push(200);
        let fields = [
            (0, Kind::Float(4)),
            (4, Kind::Signed(2)),
            (6, Kind::Float(8)),
            (14, Kind::Unsigned(1)),
        ];
        let read = |bytes: Vec<u8>| -> Vec<f32> {
            let words = bytes.chunks_exact(4);
            words
                .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
                .collect()
        };
        let found = read(read_floats(&little, 15, &fields, false)?);
        assert_eq!((found[0], found[1], found[3]), (1.5, -2.0, 200.0));
        assert!(found[2].is_nan());
        let mut big = Vec::new();
        big.extend_from_slice(&1.5f32.to_be_bytes());
        big.extend_from_slice(&(-2i16).to_be_bytes());
        assert_eq!(read(read_floats(&big, 6, &fields[..2], true)?), [1.5, -2.0]);
        assert_eq!(
            read_colors(&little, 15, &[fields[3], fields[1], fields[0]], false)?,
            [200, 0, 255]
        );
        Ok(())
    }

    #[test]
    fn records_with_invalid_fields_are_rejected() {
        for (row, field) in [
            (4, (1, Kind::Float(4))),
            (3, (0, Kind::Unsigned(1))),
            (4, (0, Kind::Float(2))),
            (0, (0, Kind::Signed(1))),
        ] {
            assert!(read_floats(&[0; 8], row, &[field], false).is_err());
            assert!(read_colors(&[0; 8], row, &[(usize::MAX, field.1)], false).is_err());
        }
    }
}

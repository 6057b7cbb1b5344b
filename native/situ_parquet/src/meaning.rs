//! The meaning of a column's values: how its numbers and bytes become terms.

use crate::term::Encoder;
use parquet::basic::{ConvertedType, LogicalType, TimeUnit, Type as Physical};
use parquet::schema::types::Type;

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Meaning {
    Plain,
    /// Multiplied by a factor to get nanoseconds.
    Times(i128),
    /// A number without a sign, of so many bits.
    Unsigned(u32),
    /// A decimal with so many digits after the point.
    Decimal(u32),
    Uuid,
    Half,
}

const DAY: i128 = 86_400_000_000_000;
const MAX_DIGITS: i32 = 76;

/// Returns the meaning of a leaf of the schema, and whether it is a time stamp.
pub fn leaf_meaning(leaf: &Type) -> (Meaning, bool) {
    let info = leaf.get_basic_info();
    let (logical, converted) = (info.logical_type_ref(), info.converted_type());
    let physical = leaf.get_physical_type();
    let time = matches!(logical, Some(LogicalType::Timestamp(_)))
        || matches!(
            converted,
            ConvertedType::TIMESTAMP_MILLIS | ConvertedType::TIMESTAMP_MICROS
        )
        || physical == Physical::INT96;
    let meaning = match physical {
        Physical::BYTE_ARRAY | Physical::FIXED_LEN_BYTE_ARRAY => {
            bytes_meaning(leaf, logical, converted)
        }
        Physical::INT32 | Physical::INT64 => number_meaning(leaf, logical, converted),
        _ => Meaning::Plain,
    };
    (meaning, time)
}

fn bytes_meaning(leaf: &Type, logical: Option<&LogicalType>, converted: ConvertedType) -> Meaning {
    match logical {
        Some(LogicalType::Decimal(decimal)) => decimal_meaning(decimal.scale),
        Some(LogicalType::Uuid) => Meaning::Uuid,
        Some(LogicalType::Float16) => Meaning::Half,
        None if converted == ConvertedType::DECIMAL => decimal_meaning(leaf_scale(leaf)),
        _ => Meaning::Plain,
    }
}

fn number_meaning(leaf: &Type, logical: Option<&LogicalType>, converted: ConvertedType) -> Meaning {
    match logical {
        Some(LogicalType::Timestamp(time)) => time_meaning(&time.unit),
        Some(LogicalType::Time(time)) => time_meaning(&time.unit),
        Some(LogicalType::Date) => Meaning::Times(DAY),
        Some(LogicalType::Decimal(decimal)) => decimal_meaning(decimal.scale),
        Some(LogicalType::Integer(int)) if !int.is_signed => {
            Meaning::Unsigned(int.bit_width as u32)
        }
        Some(LogicalType::Integer(_)) => Meaning::Plain,
        _ => match converted {
            ConvertedType::DECIMAL => decimal_meaning(leaf_scale(leaf)),
            ConvertedType::DATE => Meaning::Times(DAY),
            ConvertedType::TIME_MILLIS | ConvertedType::TIMESTAMP_MILLIS => {
                Meaning::Times(1_000_000)
            }
            ConvertedType::TIME_MICROS | ConvertedType::TIMESTAMP_MICROS => Meaning::Times(1_000),
            ConvertedType::UINT_8 => Meaning::Unsigned(8),
            ConvertedType::UINT_16 => Meaning::Unsigned(16),
            ConvertedType::UINT_32 => Meaning::Unsigned(32),
            ConvertedType::UINT_64 => Meaning::Unsigned(64),
            _ => Meaning::Plain,
        },
    }
}

fn leaf_scale(leaf: &Type) -> i32 {
    match leaf {
        Type::PrimitiveType { scale, .. } => *scale,
        Type::GroupType { .. } => 0,
    }
}

fn decimal_meaning(scale: i32) -> Meaning {
    // Some writers leave out the scale 0.
    Meaning::Decimal(scale.clamp(0, MAX_DIGITS) as u32)
}

fn time_meaning(unit: &TimeUnit) -> Meaning {
    Meaning::Times(match unit {
        TimeUnit::MILLIS => 1_000_000,
        TimeUnit::MICROS => 1_000,
        TimeUnit::NANOS => 1,
    })
}

/// Returns the integer that a number means, or `None` for decimals.
pub fn convert_int(n: i64, meaning: Meaning) -> Option<i128> {
    let wide = i128::from(n);
    match meaning {
        Meaning::Times(factor) => Some(wide * factor),
        Meaning::Unsigned(bits) if n < 0 => Some(wide & ((1i128 << bits.min(64)) - 1)),
        Meaning::Decimal(_) => None,
        _ => Some(wide),
    }
}

pub fn encode_int(n: i64, meaning: Meaning, out: &mut Encoder) {
    match (convert_int(n, meaning), meaning) {
        (Some(n), _) => out.int(n),
        (None, Meaning::Decimal(scale)) => out.float(n as f64 / power_of_ten(scale)),
        (None, _) => out.nil(),
    }
}

pub fn encode_bytes(bytes: &[u8], meaning: Meaning, out: &mut Encoder) {
    match (meaning, bytes.len()) {
        (Meaning::Decimal(scale), 1..=32) => out.float(big_float(bytes) / power_of_ten(scale)),
        (Meaning::Uuid, 16) => out.bytes(uuid_text(bytes).as_bytes()),
        (Meaning::Half, 2) => out.float(half_float(u16::from_le_bytes([bytes[0], bytes[1]]))),
        _ => out.bytes(bytes),
    }
}

// Parsing rounds correctly; repeated multiplication does not.
fn power_of_ten(scale: u32) -> f64 {
    format!("1e{scale}").parse().unwrap_or(1.0)
}

/// A big-endian number with a sign, of up to 32 bytes.
fn big_float(bytes: &[u8]) -> f64 {
    let negative = bytes[0] >= 128;
    if bytes.len() <= 16 {
        let start = if negative { -1 } else { 0i128 };
        return bytes.iter().fold(start, |n, &b| (n << 8) | i128::from(b)) as f64;
    }
    // The magnitude in two halves of 16 bytes.
    let mut wide = [if negative { 255 } else { 0u8 }; 32];
    wide[32 - bytes.len()..].copy_from_slice(bytes);
    let half = |bytes: &[u8]| bytes.iter().fold(0u128, |n, &b| (n << 8) | u128::from(b));
    let (mut high, mut low) = (half(&wide[..16]), half(&wide[16..]));
    if negative {
        low = (!low).wrapping_add(1);
        high = if low == 0 {
            (!high).wrapping_add(1)
        } else {
            !high
        };
    }
    let magnitude = high as f64 * 2f64.powi(128) + low as f64;
    if negative {
        -magnitude
    } else {
        magnitude
    }
}

fn uuid_text(bytes: &[u8]) -> String {
    let mut text = String::with_capacity(36);
    for (i, byte) in bytes.iter().enumerate() {
        if matches!(i, 4 | 6 | 8 | 10) {
            text.push('-');
        }
        text.push_str(&format!("{byte:02x}"));
    }
    text
}

/// A float of 16 bits (IEEE 754 binary16).
fn half_float(bits: u16) -> f64 {
    let sign = if bits & 0x8000 == 0 { 1.0 } else { -1.0 };
    let (exponent, fraction) = (i32::from(bits >> 10 & 31), f64::from(bits & 1023));
    match (exponent, fraction) {
        (31, 0.0) => sign * f64::INFINITY,
        (31, _) => f64::NAN,
        (0, fraction) => sign * fraction * 2f64.powi(-24),
        (exponent, fraction) => sign * (1.0 + fraction / 1024.0) * 2f64.powi(exponent - 15),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn converts_numbers_of_many_bytes() {
        assert_eq!(big_float(&[255, 6]), -250.0);
        assert_eq!(big_float(&[255; 20]), -1.0);
        let mut bytes = [0; 17];
        bytes[0] = 1;
        assert_eq!(big_float(&bytes), 2f64.powi(128));
    }

    #[test]
    fn converts_halves_and_unsigned_numbers() {
        assert_eq!(half_float(0x3E00), 1.5);
        assert_eq!(half_float(0xC000), -2.0);
        assert_eq!(half_float(1), 2f64.powi(-24));
        assert_eq!(
            convert_int(-1, Meaning::Unsigned(64)),
            Some(i128::from(u64::MAX))
        );
        assert_eq!(convert_int(-1, Meaning::Unsigned(8)), Some(255));
    }
}

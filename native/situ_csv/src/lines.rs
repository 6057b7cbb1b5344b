//! Formats numbers and their times as lines of a CSV file, in the layout of \psi:
//! `2020-01-31T12:34:56.1234567Z,0.5\r\n`.

/// The values of a column as bytes: eight each (little-endian), or one each for booleans.
#[derive(Debug, Clone, Copy)]
pub enum Values<'a> {
    /// `i64`.
    Integers(&'a [u8]),
    /// `f64`.
    Floats(&'a [u8]),
    /// 0 or 1.
    Booleans(&'a [u8]),
}

impl Values<'_> {
    fn count(&self) -> usize {
        match self {
            Values::Integers(bytes) | Values::Floats(bytes) => bytes.len() / 8,
            Values::Booleans(bytes) => bytes.len(),
        }
    }
}

/// Formats a line for each time (`i64` nanoseconds since 1970, little-endian) and value. Stops when either runs
/// out.
pub fn format_lines(times: &[u8], values: Values<'_>) -> Vec<u8> {
    let mut out = Vec::with_capacity(values.count() * 40);
    let mut cache = SecondCache::default();
    for (time, at) in times.chunks_exact(8).zip(0..values.count()) {
        cache.push_time(&mut out, i64::from_le_bytes(eight_bytes(time)));
        out.push(b',');
        match values {
            Values::Integers(bytes) => {
                let value = i64::from_le_bytes(eight_bytes(&bytes[at * 8..]));
                out.extend_from_slice(itoa::Buffer::new().format(value).as_bytes());
            }
            Values::Floats(bytes) => {
                push_float(&mut out, f64::from_le_bytes(eight_bytes(&bytes[at * 8..])))
            }
            Values::Booleans(bytes) if bytes[at] == 0 => out.extend_from_slice(b"False"),
            Values::Booleans(_) => out.extend_from_slice(b"True"),
        }
        out.extend_from_slice(b"\r\n");
    }
    out
}

fn eight_bytes(bytes: &[u8]) -> [u8; 8] {
    let mut eight = [0; 8];
    for (to, from) in eight.iter_mut().zip(bytes) {
        *to = *from;
    }
    eight
}

/// Appends a float with the fewest digits that identify it, without ".0", and with an exponent from 1E+15 on and
/// below 0.0001, like .NET.
fn push_float(out: &mut Vec<u8>, value: f64) {
    if !value.is_finite() {
        let name = match value {
            _ if value.is_nan() => "NaN",
            _ if value > 0.0 => "Infinity",
            _ => "-Infinity",
        };
        return out.extend_from_slice(name.as_bytes());
    }
    if value.is_sign_negative() {
        out.push(b'-');
    }
    let mut buffer = ryu::Buffer::new();
    let text = buffer.format_finite(value.abs());
    let (mantissa, exponent) = text.split_once('e').unwrap_or((text, "0"));
    let (whole, fraction) = mantissa.split_once('.').unwrap_or((mantissa, ""));
    let mut digits = [0u8; 64];
    let mut n = 0;
    for digit in whole.bytes().chain(fraction.bytes()) {
        if n < digits.len() {
            digits[n] = digit;
            n += 1;
        }
    }
    let zeros = digits[..n]
        .iter()
        .take_while(|digit| **digit == b'0')
        .count();
    let mut digits = &digits[zeros..n];
    while let [rest @ .., b'0'] = digits {
        digits = rest;
    }
    // The number is 0.digits times ten to the power of `point`.
    let point = exponent.parse::<i32>().unwrap_or(0) + whole.len() as i32 - zeros as i32;
    match (digits, point) {
        ([], _) => out.push(b'0'),
        (digits, point) if !(-3..=15).contains(&point) => push_scientific(out, digits, point - 1),
        (digits, point) if point <= 0 => {
            out.extend_from_slice(b"0.");
            out.resize(out.len() + point.unsigned_abs() as usize, b'0');
            out.extend_from_slice(digits);
        }
        (digits, point) => {
            let point = point.unsigned_abs() as usize;
            let (whole, fraction) = digits.split_at(point.min(digits.len()));
            out.extend_from_slice(whole);
            out.resize(out.len() + point - whole.len(), b'0');
            if !fraction.is_empty() {
                out.push(b'.');
                out.extend_from_slice(fraction);
            }
        }
    }
}

fn push_scientific(out: &mut Vec<u8>, digits: &[u8], power: i32) {
    out.extend_from_slice(&digits[..1]);
    if digits.len() > 1 {
        out.push(b'.');
        out.extend_from_slice(&digits[1..]);
    }
    out.push(b'E');
    out.push(if power < 0 { b'-' } else { b'+' });
    if power.abs() < 10 {
        out.push(b'0');
    }
    out.extend_from_slice(itoa::Buffer::new().format(power.abs()).as_bytes());
}

const SECOND: i64 = 1_000_000_000;

/// Caches the formatted text of the last second, because consecutive times often share it.
#[derive(Default)]
struct SecondCache {
    second: Option<i64>,
    text: Vec<u8>,
}

impl SecondCache {
    /// Appends a time in ISO 8601 with seven decimals, or nine if it is not a multiple of 100 ns.
    fn push_time(&mut self, out: &mut Vec<u8>, time: i64) {
        let second = time.div_euclid(SECOND);
        if self.second != Some(second) {
            self.text.clear();
            push_date(&mut self.text, second);
            self.second = Some(second);
        }
        out.extend_from_slice(&self.text);
        out.push(b'.');
        let fraction = time.rem_euclid(SECOND) as u64;
        if fraction.is_multiple_of(100) {
            push_padded(out, fraction / 100, 7);
        } else {
            push_padded(out, fraction, 9);
        }
        out.push(b'Z');
    }
}

/// Appends `2020-01-31T12:34:56` (proleptic Gregorian calendar; an `i64` of nanoseconds is between the years 1677
/// and 2262).
fn push_date(out: &mut Vec<u8>, second: i64) {
    let (days, second) = (second.div_euclid(86_400), second.rem_euclid(86_400));
    // Years are counted from March on, in eras of 400 years.
    let days = days + 719_468;
    let (era, day) = (days.div_euclid(146_097), days.rem_euclid(146_097));
    let year = (day - day / 1_460 + day / 36_524 - day / 146_096) / 365;
    let of_year = day - (365 * year + year / 4 - year / 100);
    let month = (5 * of_year + 2) / 153;
    let of_month = of_year - (153 * month + 2) / 5 + 1;
    let (month, carry) = if month < 10 {
        (month + 3, 0)
    } else {
        (month - 9, 1)
    };
    let year = year + era * 400 + carry;
    for (value, width, separator) in [
        (year, 4, b'-'),
        (month, 2, b'-'),
        (of_month, 2, b'T'),
        (second / 3_600, 2, b':'),
        (second / 60 % 60, 2, b':'),
    ] {
        push_padded(out, value.unsigned_abs(), width);
        out.push(separator);
    }
    push_padded(out, (second % 60).unsigned_abs(), 2);
}

fn push_padded(out: &mut Vec<u8>, mut value: u64, width: usize) {
    let start = out.len();
    out.resize(start + width, b'0');
    for digit in out[start..].iter_mut().rev() {
        *digit = b'0' + (value % 10) as u8;
        value /= 10;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(time: i64, value: f64) -> String {
        let bytes = format_lines(&time.to_le_bytes(), Values::Floats(&value.to_le_bytes()));
        String::from_utf8_lossy(&bytes).into_owned()
    }

    #[test]
    fn formats_floats_like_dot_net() {
        let cases = [
            (1.0, "1"),
            (0.1, "0.1"),
            (-0.0, "-0"),
            (1.5e20, "1.5E+20"),
            (2.0e-7, "2E-07"),
            (1.0e14, "100000000000000"),
            (1.0e15, "1E+15"),
            (1.0e-5, "1E-05"),
            (0.00012, "0.00012"),
            (123_456.789, "123456.789"),
            (f64::MAX, "1.7976931348623157E+308"),
            (5.0e-324, "5E-324"),
            (f64::NAN, "NaN"),
            (f64::NEG_INFINITY, "-Infinity"),
        ];
        for (value, wanted) in cases {
            assert_eq!(
                text(0, value),
                format!("1970-01-01T00:00:00.0000000Z,{wanted}\r\n")
            );
        }
    }

    #[test]
    fn formats_times_before_and_after_1970() {
        assert!(text(-1, 0.0).starts_with("1969-12-31T23:59:59.999999999Z,"));
        assert!(text(1_234_567_800, 0.0).starts_with("1970-01-01T00:00:01.2345678Z,"));
        assert!(text(1_580_474_096_123_456_700, 0.0).starts_with("2020-01-31T12:34:56.1234567Z,"));
        assert!(text(951_827_696_000_000_000, 0.0).starts_with("2000-02-29T12:34:56.0000000Z,"));
        assert!(text(i64::MIN, 0.0).starts_with("1677-09-21T00:12:43.145224192Z,"));
        assert!(text(i64::MAX, 0.0).starts_with("2262-04-11T23:47:16.854775807Z,"));
    }

    #[test]
    fn formats_integers_and_booleans() {
        let times = [0i64.to_le_bytes(), 100i64.to_le_bytes()].concat();
        let values = [i64::MIN.to_le_bytes(), 7i64.to_le_bytes()].concat();
        let wanted = "1970-01-01T00:00:00.0000000Z,-9223372036854775808\r\n1970-01-01T00:00:00.0000001Z,7\r\n";
        assert_eq!(
            format_lines(&times, Values::Integers(&values)),
            wanted.as_bytes()
        );
        let booleans = format_lines(&times, Values::Booleans(&[1, 0]));
        assert!(booleans.starts_with(b"1970-01-01T00:00:00.0000000Z,True\r\n"));
        assert!(booleans.ends_with(b",False\r\n"));
    }

    #[test]
    fn leaves_out_truncated_times_and_values() {
        assert_eq!(format_lines(&[0; 7], Values::Booleans(&[1])), b"");
        assert_eq!(format_lines(&[0; 16], Values::Floats(&[0; 15])).len(), 32);
    }
}

//! Parses fields of a CSV file as values and as times.

use std::num::FpCategory;

const MOST_DIGITS: usize = 300;

/// The kind of a field, or of all fields of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Digits with an optional sign.
    Integer,
    /// A decimal number with an optional exponent.
    Float,
    /// Anything else.
    Text,
}

impl Kind {
    /// Returns the kind of a field. The field must not have spaces around it.
    pub fn detect(text: &str) -> Kind {
        match number_kind(text.as_bytes()) {
            // A number without an exponent and with few digits is always finite.
            Some(Kind::Float)
                if (text.len() > MOST_DIGITS || text.contains(['e', 'E']))
                    && !is_finite_number(text) =>
            {
                Kind::Text
            }
            // A longer integer could not be a float, if the column becomes one.
            Some(Kind::Integer) if text.len() > MOST_DIGITS => Kind::Text,
            Some(kind) => kind,
            None => Kind::Text,
        }
    }

    /// Returns the kind of a column with fields of both kinds.
    pub fn unify(self, other: Kind) -> Kind {
        match (self, other) {
            (a, b) if a == b => a,
            (Kind::Text, _) | (_, Kind::Text) => Kind::Text,
            _ => Kind::Float,
        }
    }
}

fn is_finite_number(text: &str) -> bool {
    text.parse::<f64>().is_ok_and(f64::is_finite)
}

fn count_digits(bytes: &[u8]) -> usize {
    bytes
        .iter()
        .take_while(|byte| byte.is_ascii_digit())
        .count()
}

fn strip_sign(bytes: &[u8]) -> &[u8] {
    match bytes {
        [b'+' | b'-', rest @ ..] => rest,
        _ => bytes,
    }
}

/// Returns the kind of a number, which has digits before and after a point and after an exponent mark.
fn number_kind(bytes: &[u8]) -> Option<Kind> {
    let bytes = strip_sign(bytes);
    let whole = count_digits(bytes);
    let mut rest = &bytes[whole..];
    if whole == 0 {
        return None;
    }
    if rest.is_empty() {
        return Some(Kind::Integer);
    }
    if let [b'.', fraction @ ..] = rest {
        let n = count_digits(fraction);
        if n == 0 {
            return None;
        }
        rest = &fraction[n..];
    }
    if let [b'e' | b'E', exponent @ ..] = rest {
        let exponent = strip_sign(exponent);
        let n = count_digits(exponent);
        if n == 0 {
            return None;
        }
        rest = &exponent[n..];
    }
    rest.is_empty().then_some(Kind::Float)
}

/// The unit of the numbers in a time column.
#[derive(Debug, Clone, Copy)]
pub enum Unit {
    /// Multiples of this many nanoseconds.
    Nanoseconds(i64),
    /// Dates and times in ISO 8601.
    Iso8601,
}

/// The result of parsing a time.
#[derive(Debug, PartialEq)]
pub enum Time {
    /// A time in nanoseconds.
    At(i64),
    /// The field is not a number, or does not fit into 64 bits.
    None,
    /// The field is an unusual notation of a date that this code cannot decide on.
    Unsure,
}

impl Unit {
    /// Parses the time in a field.
    pub fn parse_time(self, text: &str) -> Time {
        let text = text.trim();
        match self {
            Unit::Iso8601 => parse_iso8601(text.as_bytes()).map_or(Time::Unsure, Time::At),
            Unit::Nanoseconds(factor) => match Kind::detect(text) {
                Kind::Integer => text
                    .parse::<i64>()
                    .ok()
                    .and_then(|n| n.checked_mul(factor))
                    .map_or(Time::None, Time::At),
                Kind::Float => text
                    .parse::<f64>()
                    .map_or(Time::None, |x| scale_time(x, factor)),
                Kind::Text => Time::None,
            },
        }
    }
}

/// Multiplies and rounds a number to nanoseconds. Halves are rounded away from zero.
fn scale_time(x: f64, factor: i64) -> Time {
    let time = (x * factor as f64).round();
    match time.classify() {
        FpCategory::Nan | FpCategory::Infinite => Time::None,
        _ if time.abs() >= 9.2e18 => Time::None,
        _ => Time::At(time as i64),
    }
}

fn parse_digits(bytes: &[u8]) -> Option<i64> {
    (count_digits(bytes) == bytes.len()).then(|| {
        bytes
            .iter()
            .fold(0, |n, byte| n * 10 + i64::from(byte - b'0'))
    })
}

/// Parses `2020-01-31T12:34:56.123456789+01:00`. The T may be a space, and fraction and zone may be missing.
fn parse_iso8601(bytes: &[u8]) -> Option<i64> {
    let (head, rest) = bytes.split_at_checked(19)?;
    let marks = [(4, b'-'), (7, b'-'), (13, b':'), (16, b':')];
    if marks.iter().any(|(at, mark)| head[*at] != *mark) || !matches!(head[10], b'T' | b' ') {
        return None;
    }
    let (year, month, day) = (
        parse_digits(&head[..4])?,
        parse_digits(&head[5..7])?,
        parse_digits(&head[8..10])?,
    );
    let (hour, minute, second) = (
        parse_digits(&head[11..13])?,
        parse_digits(&head[14..16])?,
        parse_digits(&head[17..19])?,
    );
    if !(1..=12).contains(&month) || !(1..=month_days(year, month)).contains(&day) {
        return None;
    }
    if hour > 23 || minute > 59 || second > 59 {
        return None;
    }
    let (fraction, zone) = match rest {
        [b'.', rest @ ..] => rest.split_at(count_digits(rest)),
        _ => (&[][..], rest),
    };
    if rest.first() == Some(&b'.') && fraction.is_empty() {
        return None;
    }
    let seconds = days_since_1970(year, month, day) * 86_400 + hour * 3_600 + minute * 60 + second
        - zone_offset(zone)?;
    let nanoseconds = (0..9).fold(0, |n, at| {
        n * 10 + fraction.get(at).map_or(0, |b| i64::from(b - b'0'))
    });
    seconds.checked_mul(1_000_000_000)?.checked_add(nanoseconds)
}

fn month_days(year: i64, month: i64) -> i64 {
    match month {
        2 if year % 4 == 0 && (year % 100 != 0 || year % 400 == 0) => 29,
        2 => 28,
        4 | 6 | 9 | 11 => 30,
        _ => 31,
    }
}

/// Returns the number of seconds that a zone is ahead of UTC.
fn zone_offset(zone: &[u8]) -> Option<i64> {
    let (sign, hours, minutes) = match zone {
        [] | [b'Z'] => return Some(0),
        [sign, a, b, b':', c, d] | [sign, a, b, c, d] => (sign, [*a, *b], [*c, *d]),
        _ => return None,
    };
    let (hours, minutes) = (parse_digits(&hours)?, parse_digits(&minutes)?);
    if hours > 13 || minutes > 59 {
        return None;
    }
    match sign {
        b'+' => Some(hours * 3_600 + minutes * 60),
        // ISO 8601 does not allow -00:00.
        b'-' if hours + minutes > 0 => Some(-(hours * 3_600 + minutes * 60)),
        _ => None,
    }
}

/// Returns the days since 1970 (proleptic Gregorian calendar), counting years from March on.
fn days_since_1970(year: i64, month: i64, day: i64) -> i64 {
    let year = year - i64::from(month <= 2);
    let era = year.div_euclid(400);
    let of_era = year.rem_euclid(400);
    let of_year = (153 * ((month + 9) % 12) + 2) / 5 + day - 1;
    era * 146_097 + of_era * 365 + of_era / 4 - of_era / 100 + of_year - 719_468
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_agree_with_elixirs_parsers() {
        for text in ["0", "+5", "-007", "123456789012345678901234567890"] {
            assert_eq!(Kind::detect(text), Kind::Integer, "{text}");
        }
        for text in ["0.5", "-1.5e10", "+1E-5", "2e3", "1e-400"] {
            assert_eq!(Kind::detect(text), Kind::Float, "{text}");
        }
        for text in [
            "", ".5", "5.", "1e", "1e+", "--1", "1_000", "1e400", "nan", "inf", "0x1", "1.5.2", "٣",
        ] {
            assert_eq!(Kind::detect(text), Kind::Text, "{text}");
        }
    }

    #[test]
    fn parses_times_in_every_unit() {
        let (s, iso) = (Unit::Nanoseconds(1_000_000_000), Unit::Iso8601);
        assert_eq!(s.parse_time(" 5 "), Time::At(5_000_000_000));
        assert_eq!(s.parse_time("-0.25"), Time::At(-250_000_000));
        assert_eq!(s.parse_time("x"), Time::None);
        assert_eq!(s.parse_time("99999999999"), Time::None);
        assert_eq!(s.parse_time("1e300"), Time::None);
        assert_eq!(
            iso.parse_time("1970-01-01T00:00:01.5Z"),
            Time::At(1_500_000_000)
        );
        assert_eq!(
            iso.parse_time("2000-02-29 12:34:56"),
            Time::At(951_827_696_000_000_000)
        );
        assert_eq!(
            iso.parse_time("1969-12-31T23:59:59.1234567890Z"),
            Time::At(-876_543_211)
        );
        assert_eq!(
            iso.parse_time("2020-01-31T12:34:56+0130"),
            iso.parse_time("2020-01-31T11:04:56Z")
        );
        for text in [
            "",
            "2020",
            "2021-02-29T00:00:00Z",
            "2020-01-31T24:00:00Z",
            "2020-01-31T12:34:56.Z",
            "2020-01-31T12:34:56-00:00",
            "9999-01-01T00:00:00Z",
        ] {
            assert_eq!(iso.parse_time(text), Time::Unsure, "{text}");
        }
    }
}

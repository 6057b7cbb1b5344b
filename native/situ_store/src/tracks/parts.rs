//! Splits a message into the parts that belong to each track.

use crate::chunk::{term_number, Value};
use crate::etf;
use crate::format::{Encoding, LARGE_MESSAGE};

/// The maximum length of a string that counts as a state.
const MAX_STATE_LENGTH: usize = 64;
/// The maximum number of keys of a map with tracks.
const MOST_KEYS: usize = 64;

/// A number, or the external term of a state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Part<'a> {
    Number(f64),
    State(&'a [u8]),
}

const BOOLEANS: [&[u8]; 3] = [
    &[131, 119, 5, b'f', b'a', b'l', b's', b'e'],
    &[131, 119, 4, b't', b'r', b'u', b'e'],
    &[131, 119, 3, b'n', b'i', b'l'],
];

/// Calls `each` with the key's external term (empty for the message itself) and the part. Messages that are numbers
/// have their own pyramid and no part here.
pub fn visit_parts(
    encoding: Encoding,
    value: &Value,
    body: &[u8],
    mut each: impl FnMut(&[u8], Part<'_>),
) {
    let bytes = match *value {
        Value::Bytes { start, length } => body.get(start..start + length),
        Value::Bool(value) => BOOLEANS.get(value as usize).copied(),
        _ => None,
    };
    // Large messages are only counted.
    let Some(bytes) = bytes.filter(|bytes| bytes.len() < LARGE_MESSAGE) else {
        return;
    };
    match encoding {
        Encoding::Bool => each(&[], Part::State(bytes)),
        Encoding::Bytes if bytes.len() <= MAX_STATE_LENGTH => {
            let mut text = [0; MAX_STATE_LENGTH + 6];
            text[..2].copy_from_slice(&[131, 109]);
            text[2..6].copy_from_slice(&(bytes.len() as u32).to_be_bytes());
            text[6..6 + bytes.len()].copy_from_slice(bytes);
            each(&[], Part::State(&text[..6 + bytes.len()]));
        }
        Encoding::Term if bytes.get(1) == Some(&116) => {
            let _ = visit_fields(bytes, &mut each);
        }
        Encoding::Term if is_state(bytes) => each(&[], Part::State(bytes)),
        _ => {}
    }
}

/// Returns whether an external term is an atom or a short string.
fn is_state(term: &[u8]) -> bool {
    match term.get(1) {
        Some(115 | 119 | 100 | 118) => true,
        Some(109) => term.len() <= 6 + MAX_STATE_LENGTH,
        _ => false,
    }
}

fn visit_fields(map: &[u8], each: &mut impl FnMut(&[u8], Part<'_>)) -> Option<()> {
    let n = u32::from_be_bytes(map.get(2..6)?.try_into().ok()?) as usize;
    if n > MOST_KEYS + 1 {
        return None;
    }
    let mut at = 6;
    let mut found = Vec::with_capacity(n);
    for _ in 0..n {
        let value = etf::term_end(map, at)?;
        let end = etf::term_end(map, value)?;
        found.push((&map[at..value], &map[value..end]));
        at = end;
    }
    // The key `__struct__` is not a field.
    found.retain(|(key, _)| !key.ends_with(b"__struct__"));
    if found.len() > MOST_KEYS {
        return None;
    }
    let (mut key_term, mut term) = (vec![131], vec![131]);
    for (key, value) in found {
        key_term.truncate(1);
        key_term.extend_from_slice(key);
        if !is_state(&key_term) && !matches!(key[0], 97 | 98) {
            continue;
        }
        term.truncate(1);
        // A longer value is neither a state nor a number.
        term.extend_from_slice(&value[..value.len().min(MAX_STATE_LENGTH + 300)]);
        if is_state(&term) {
            each(&key_term, Part::State(&term));
        } else if let Some(number) = term_number(&term) {
            each(&key_term, Part::Number(number));
        }
    }
    Some(())
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn collect_parts(encoding: Encoding, body: &[u8]) -> Vec<(Vec<u8>, String)> {
        let value = Value::Bytes {
            start: 0,
            length: body.len(),
        };
        let mut found = Vec::new();
        visit_parts(encoding, &value, body, |key, part| {
            found.push((key.to_vec(), format!("{part:?}")));
        });
        found
    }

    #[test]
    fn maps_have_a_part_for_each_key() {
        // %{a: 5, b: "x", c: [1]}
        let map = [
            131, 116, 0, 0, 0, 3, 119, 1, b'a', 97, 5, 119, 1, b'b', 109, 0, 0, 0, 1, b'x', 119, 1,
            b'c', 107, 0, 1, 1,
        ];
        let parts = collect_parts(Encoding::Term, &map);
        assert_eq!(parts.len(), 2);
        assert_eq!(
            parts[0],
            (vec![131, 119, 1, b'a'], "Number(5.0)".to_string())
        );
        assert_eq!(parts[1].0, vec![131, 119, 1, b'b']);
        // A truncated map has no parts and does not panic.
        for end in 0..map.len() {
            assert!(collect_parts(Encoding::Term, &map[..end]).is_empty());
        }
    }

    #[test]
    fn long_strings_are_not_states() {
        assert_eq!(collect_parts(Encoding::Bytes, &[b'x'; 64]).len(), 1);
        assert!(collect_parts(Encoding::Bytes, &[b'x'; 65]).is_empty());
        assert!(collect_parts(Encoding::Codec, b"x").is_empty());
    }
}

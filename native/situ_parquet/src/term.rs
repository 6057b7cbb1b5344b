//! Terms of the BEAM in the external term format, in which requests and results are sent.

/// A decoded term, which borrows its bytes from the request.
#[derive(Debug, Clone, PartialEq)]
pub enum Term<'a> {
    Int(i128),
    Float(f64),
    Atom(&'a str),
    Bytes(&'a [u8]),
    Tuple(Vec<Term<'a>>),
    List(Vec<Term<'a>>),
}

const MAX_DEPTH: usize = 64;

/// Decodes a term, or returns `None` if the bytes are not a term of the types above.
pub fn decode(bytes: &[u8]) -> Option<Term<'_>> {
    let (131, rest) = bytes.split_first().map(|(&b, rest)| (b, rest))? else {
        return None;
    };
    let mut rest = rest;
    decode_next(&mut rest, 0)
}

fn take<'a>(bytes: &mut &'a [u8], n: usize) -> Option<&'a [u8]> {
    let (head, tail) = bytes.split_at_checked(n)?;
    *bytes = tail;
    Some(head)
}

fn take_array<const N: usize>(bytes: &mut &[u8]) -> Option<[u8; N]> {
    take(bytes, N)?.try_into().ok()
}

fn take_byte(bytes: &mut &[u8]) -> Option<u8> {
    take_array::<1>(bytes).map(|[byte]| byte)
}

fn take_size(bytes: &mut &[u8]) -> Option<usize> {
    take_array(bytes).map(|size| u32::from_be_bytes(size) as usize)
}

fn decode_next<'a>(bytes: &mut &'a [u8], depth: usize) -> Option<Term<'a>> {
    if depth > MAX_DEPTH {
        return None;
    }
    Some(match take_byte(bytes)? {
        97 => Term::Int(take_byte(bytes)?.into()),
        98 => Term::Int(i32::from_be_bytes(take_array(bytes)?).into()),
        110 => decode_big(bytes)?,
        70 => Term::Float(f64::from_be_bytes(take_array(bytes)?)),
        119 => {
            let size = take_byte(bytes)?.into();
            decode_atom(bytes, size)?
        }
        100 | 118 => {
            let size = u16::from_be_bytes(take_array(bytes)?).into();
            decode_atom(bytes, size)?
        }
        109 => {
            let size = take_size(bytes)?;
            Term::Bytes(take(bytes, size)?)
        }
        104 => {
            let size = take_byte(bytes)?.into();
            Term::Tuple(decode_many(bytes, size, depth)?)
        }
        106 => Term::List(Vec::new()),
        107 => {
            let size = u16::from_be_bytes(take_array(bytes)?).into();
            let bytes = take(bytes, size)?;
            Term::List(bytes.iter().map(|&b| Term::Int(b.into())).collect())
        }
        108 => {
            let size = take_size(bytes)?;
            let list = decode_many(bytes, size, depth)?;
            (take_byte(bytes)? == 106).then_some(Term::List(list))?
        }
        _ => return None,
    })
}

fn decode_many<'a>(bytes: &mut &'a [u8], n: usize, depth: usize) -> Option<Vec<Term<'a>>> {
    // Each term takes at least one byte, so a wrong size cannot reserve more memory than the request.
    let mut terms = Vec::with_capacity(n.min(bytes.len()));
    for _ in 0..n {
        terms.push(decode_next(bytes, depth + 1)?);
    }
    Some(terms)
}

fn decode_atom<'a>(bytes: &mut &'a [u8], size: usize) -> Option<Term<'a>> {
    std::str::from_utf8(take(bytes, size)?).ok().map(Term::Atom)
}

fn decode_big<'a>(bytes: &mut &'a [u8]) -> Option<Term<'a>> {
    let (size, sign) = (take_byte(bytes)?.into(), take_byte(bytes)?);
    let digits = take(bytes, size)?;
    if size > 15 {
        return None;
    }
    let n = digits
        .iter()
        .rev()
        .fold(0i128, |n, &digit| (n << 8) | i128::from(digit));
    Some(Term::Int(if sign == 0 { n } else { -n }))
}

/// Encodes terms, one after the other.
#[derive(Default)]
pub struct Encoder(pub Vec<u8>);

impl Encoder {
    pub fn new() -> Self {
        Self(vec![131])
    }

    pub fn atom(&mut self, name: &str) {
        self.0.extend([119, name.len() as u8]);
        self.0.extend(name.as_bytes());
    }

    pub fn nil(&mut self) {
        self.0.extend(b"w\x03nil");
    }

    pub fn boolean(&mut self, value: bool) {
        self.atom(if value { "true" } else { "false" });
    }

    pub fn int(&mut self, n: i128) {
        if let Ok(byte) = u8::try_from(n) {
            self.0.extend([97, byte]);
        } else if let Ok(n) = i32::try_from(n) {
            self.0.push(98);
            self.0.extend(n.to_be_bytes());
        } else {
            let digits = n.unsigned_abs().to_le_bytes();
            let size = digits.len() - digits.iter().rev().take_while(|&&d| d == 0).count();
            self.0.extend([110, size as u8, u8::from(n < 0)]);
            self.0.extend(&digits[..size]);
        }
    }

    /// Encodes a float. The BEAM has no floats for NaN and infinity, so they are atoms.
    pub fn float(&mut self, x: f64) {
        if x.is_finite() {
            self.0.push(70);
            self.0.extend(x.to_be_bytes());
        } else if x.is_nan() {
            self.atom("nan");
        } else {
            self.atom(if x > 0.0 { "infinity" } else { "neg_infinity" });
        }
    }

    pub fn bytes(&mut self, bytes: &[u8]) {
        self.0.push(109);
        self.0.extend((bytes.len() as u32).to_be_bytes());
        self.0.extend(bytes);
    }

    pub fn tuple(&mut self, size: u8) {
        self.0.extend([104, size]);
    }

    pub fn map(&mut self, size: usize) {
        self.0.push(116);
        self.0.extend((size as u32).to_be_bytes());
    }

    /// Begins a list of `n` elements; `end_list` follows its elements.
    pub fn begin_list(&mut self, n: usize) -> usize {
        self.0.push(108);
        self.0.extend((n as u32).to_be_bytes());
        self.0.len() - 4
    }

    /// Ends a list that began at `at`, and sets its number of elements.
    pub fn end_list(&mut self, at: usize, n: usize) {
        if n == 0 {
            self.0.truncate(at - 1);
        } else {
            self.0[at..at + 4].copy_from_slice(&(n as u32).to_be_bytes());
        }
        self.0.push(106);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decodes_encoded_terms() {
        for n in [0, 255, 256, -1, i128::from(i32::MIN), 1 << 63, -(1 << 70)] {
            let mut out = Encoder::new();
            out.int(n);
            assert_eq!(decode(&out.0), Some(Term::Int(n)));
        }
        let mut out = Encoder::new();
        let at = out.begin_list(0);
        out.float(1.5);
        out.bytes(b"x");
        out.float(f64::NAN);
        out.end_list(at, 3);
        let terms = vec![Term::Float(1.5), Term::Bytes(b"x"), Term::Atom("nan")];
        assert_eq!(decode(&out.0), Some(Term::List(terms)));
    }

    #[test]
    fn refuses_truncated_terms() {
        assert_eq!(decode(&[131, 108, 255, 255, 255, 255, 97]), None);
        assert_eq!(decode(&[131, 109, 0, 0, 0, 9, 1]), None);
        assert_eq!(decode(&[]), None);
    }
}

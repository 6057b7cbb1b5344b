//! Erlang's external term format: checks whether bytes from a file may be decoded, and decodes them without
//! creating atoms.
//! See docs/adr/0033-terms-from-files-are-checked-before-decoding.md.

/// The maximum nesting depth of a term.
pub const MAX_DEPTH: u32 = 512;
/// The maximum memory size of a term's lists, tuples, maps and numbers; one byte in a file can become sixteen in
/// memory. Binaries do not count, because they have the same size in both.
pub const MAX_STRUCTURE: usize = 64 << 20;

/// The reason why a term must not be decoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refusal {
    /// The bytes are not exactly one external term.
    Malformed,
    /// The term is nested deeper than [`MAX_DEPTH`].
    TooDeep,
    /// The term's structure would take more than [`MAX_STRUCTURE`] bytes.
    TooLarge,
    /// A compressed term.
    Compressed,
    /// A function.
    Function,
    /// A process id.
    Pid,
    /// A port.
    Port,
    /// A reference.
    Reference,
}

impl Refusal {
    /// Returns a description for error texts.
    pub fn describe(self) -> &'static str {
        match self {
            Refusal::Malformed => "malformed term",
            Refusal::TooDeep => "a term nested deeper than 512 levels",
            Refusal::TooLarge => "a term that takes more than 64 MiB in memory",
            Refusal::Compressed => "a compressed term",
            Refusal::Function => "a function",
            Refusal::Pid => "a process id",
            Refusal::Port => "a port",
            Refusal::Reference => "a reference",
        }
    }
}

struct TermReader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> TermReader<'a> {
    fn take(&mut self, n: usize) -> Result<&'a [u8], Refusal> {
        let end = self.at.checked_add(n).ok_or(Refusal::Malformed)?;
        let slice = self.bytes.get(self.at..end).ok_or(Refusal::Malformed)?;
        self.at = end;
        Ok(slice)
    }

    fn u8(&mut self) -> Result<usize, Refusal> {
        Ok(self.take(1)?[0] as usize)
    }

    fn u16(&mut self) -> Result<usize, Refusal> {
        let b = self.take(2)?;
        Ok(u16::from_be_bytes([b[0], b[1]]) as usize)
    }

    fn u32(&mut self) -> Result<usize, Refusal> {
        let b = self.take(4)?;
        Ok(u32::from_be_bytes([b[0], b[1], b[2], b[3]]) as usize)
    }
}

/// Checks that `bytes` are exactly one external term of plain data, within the limits of depth and size. Returns
/// the number of bytes that its structure takes in memory.
pub fn check_term(bytes: &[u8]) -> Result<usize, Refusal> {
    let mut reader = TermReader { bytes, at: 0 };
    if reader.u8()? != 131 {
        return Err(Refusal::Malformed);
    }
    let size = skip_term(&mut reader)?;
    if reader.at == bytes.len() {
        Ok(size)
    } else {
        Err(Refusal::Malformed)
    }
}

/// Returns the end of the term that begins at `at` (without a version byte).
pub fn term_end(bytes: &[u8], at: usize) -> Option<usize> {
    let mut reader = TermReader { bytes, at };
    skip_term(&mut reader).ok()?;
    Some(reader.at)
}

/// Skips one term and returns the number of bytes that its structure takes in memory.
fn skip_term(reader: &mut TermReader<'_>) -> Result<usize, Refusal> {
    // The number of remaining elements at each open level.
    let mut open: Vec<usize> = vec![1];
    let mut size = 0usize;
    while let Some(left) = open.last_mut() {
        if *left == 0 {
            open.pop();
            continue;
        }
        *left -= 1;
        let tag = reader.u8()?;
        let start = reader.at;
        let children = match tag {
            97 => reader.take(1).map(|_| 0)?,
            98 => reader.take(4).map(|_| 0)?,
            70 => reader.take(8).map(|_| 0)?,
            99 => reader.take(31).map(|_| 0)?,
            104 => reader.u8()?,
            105 => reader.u32()?,
            106 => 0,
            107 => {
                let n = reader.u16()?;
                reader.take(n).map(|_| 0)?
            }
            108 => reader.u32()?.checked_add(1).ok_or(Refusal::Malformed)?,
            109 => {
                let n = reader.u32()?;
                reader.take(n).map(|_| 0)?
            }
            77 => {
                let n = reader.u32()?;
                let bits = reader.u8()?;
                if bits > 8 || (n == 0) != (bits == 0) {
                    return Err(Refusal::Malformed);
                }
                reader.take(n).map(|_| 0)?
            }
            110 => {
                let n = reader.u8()?;
                reader.take(n + 1).map(|_| 0)?
            }
            111 => {
                let n = reader.u32()?;
                // Real data does not contain numbers with a megabyte of digits.
                if n > 1 << 20 {
                    return Err(Refusal::Malformed);
                }
                reader.take(n + 1).map(|_| 0)?
            }
            116 => reader.u32()?.checked_mul(2).ok_or(Refusal::Malformed)?,
            100 | 118 => {
                let n = reader.u16()?;
                if n > 1020 {
                    return Err(Refusal::Malformed);
                }
                reader.take(n).map(|_| 0)?
            }
            115 | 119 => {
                let n = reader.u8()?;
                reader.take(n).map(|_| 0)?
            }
            80 => return Err(Refusal::Compressed),
            112 | 113 | 117 => return Err(Refusal::Function),
            88 | 103 => return Err(Refusal::Pid),
            89 | 102 | 120 => return Err(Refusal::Port),
            90 | 101 | 114 => return Err(Refusal::Reference),
            _ => return Err(Refusal::Malformed),
        };
        size = size.saturating_add(match tag {
            70 | 99 => 16,
            107 => (reader.at - start) * 16,
            104 | 105 => (children + 1) * 8,
            108 => children * 16,
            // The pairs, and the nodes of a large map.
            116 => children * 16 + 40,
            110 | 111 => reader.at - start + 8,
            109 | 77 => 48,
            // An atom that does not exist here becomes a string.
            100 | 118 | 115 | 119 => 24,
            _ => 0,
        });
        if size > MAX_STRUCTURE {
            return Err(Refusal::TooLarge);
        }
        if children > 0 {
            // Every element takes at least one byte.
            if children > reader.bytes.len() - reader.at {
                return Err(Refusal::Malformed);
            }
            if open.len() as u32 >= MAX_DEPTH {
                return Err(Refusal::TooDeep);
            }
            open.push(children);
        }
    }
    Ok(size)
}

/// Builds the terms of a runtime, and decides what to do with atoms that do not exist there.
pub trait TermBuilder {
    /// The type of the runtime's terms.
    type Term: Clone;
    /// Builds the atom with this name, in UTF-8.
    fn atom(&mut self, name: &[u8]) -> Self::Term;
    /// Builds a 64-bit integer.
    fn integer(&mut self, value: i64) -> Self::Term;
    /// Builds a float. Returns `None` if the runtime does not support its value (NaN, infinities).
    fn float(&mut self, value: f64) -> Option<Self::Term>;
    /// Builds a binary.
    fn binary(&mut self, bytes: &[u8]) -> Self::Term;
    /// Builds a term without atoms (big number, bit string) from external format without a version byte.
    fn plain(&mut self, bytes: &[u8]) -> Option<Self::Term>;
    /// Builds a tuple of these elements.
    fn tuple(&mut self, elements: &[Self::Term]) -> Self::Term;
    /// Builds a list of these elements; with a `tail` it is improper.
    fn list(&mut self, elements: &[Self::Term], tail: Option<Self::Term>) -> Self::Term;
    /// Builds a map. Returns `None` if the runtime rejects it (equal keys).
    fn map(&mut self, keys: &[Self::Term], values: &[Self::Term]) -> Option<Self::Term>;
}

/// Decodes a term that passes `check_term`.
pub fn decode_term<B: TermBuilder>(bytes: &[u8], build: &mut B) -> Option<B::Term> {
    check_term(bytes).ok()?;
    let mut reader = TermReader { bytes, at: 1 };
    build_term(&mut reader, build).ok().flatten()
}

// `check_term` limits the recursion to 512 levels.
fn build_term<B: TermBuilder>(
    reader: &mut TermReader<'_>,
    build: &mut B,
) -> Result<Option<B::Term>, Refusal> {
    let start = reader.at;
    let tag = reader.u8()?;
    Ok(Some(match tag {
        97 => {
            let value = reader.u8()?;
            build.integer(value as i64)
        }
        98 => {
            let value = reader.u32()? as u32 as i32;
            build.integer(value as i64)
        }
        70 => {
            let b = reader.take(8)?;
            let mut raw = [0; 8];
            raw.copy_from_slice(b);
            match build.float(f64::from_be_bytes(raw)) {
                Some(term) => term,
                None => return Ok(None),
            }
        }
        100 | 118 => {
            let n = reader.u16()?;
            build.atom(reader.take(n)?)
        }
        115 | 119 => {
            let n = reader.u8()?;
            build.atom(reader.take(n)?)
        }
        104 | 105 => {
            let n = if tag == 104 {
                reader.u8()?
            } else {
                reader.u32()?
            };
            match build_terms(reader, build, n)? {
                Some(elements) => build.tuple(&elements),
                None => return Ok(None),
            }
        }
        106 => build.list(&[], None),
        107 => {
            let n = reader.u16()?;
            let elements: Vec<B::Term> = reader
                .take(n)?
                .iter()
                .map(|b| build.integer(*b as i64))
                .collect();
            build.list(&elements, None)
        }
        108 => {
            let n = reader.u32()?;
            let Some(elements) = build_terms(reader, build, n)? else {
                return Ok(None);
            };
            let proper = reader.bytes.get(reader.at) == Some(&106);
            let Some(tail) = build_term(reader, build)? else {
                return Ok(None);
            };
            build.list(&elements, (!proper).then_some(tail))
        }
        109 => {
            let n = reader.u32()?;
            build.binary(reader.take(n)?)
        }
        116 => {
            let n = reader.u32()?;
            let Some(both) = build_terms(reader, build, n * 2)? else {
                return Ok(None);
            };
            let keys: Vec<B::Term> = both.iter().step_by(2).cloned().collect();
            let values: Vec<B::Term> = both.iter().skip(1).step_by(2).cloned().collect();
            return Ok(build.map(&keys, &values));
        }
        _ => {
            match tag {
                99 => reader.take(31)?,
                77 => {
                    let n = reader.u32()?;
                    reader.take(n + 1)?
                }
                110 => {
                    let n = reader.u8()?;
                    reader.take(n + 1)?
                }
                111 => {
                    let n = reader.u32()?;
                    reader.take(n + 1)?
                }
                _ => return Err(Refusal::Malformed),
            };
            return Ok(build.plain(&reader.bytes[start..reader.at]));
        }
    }))
}

fn build_terms<B: TermBuilder>(
    reader: &mut TermReader<'_>,
    build: &mut B,
    n: usize,
) -> Result<Option<Vec<B::Term>>, Refusal> {
    let mut elements = Vec::with_capacity(n.min(reader.bytes.len() - reader.at));
    for _ in 0..n {
        match build_term(reader, build)? {
            Some(element) => elements.push(element),
            None => return Ok(None),
        }
    }
    Ok(Some(elements))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn accepts_plain_terms() {
        // {ok, [1, 2.0, <<"x">>], #{a => 5}}
        let bytes = [
            131, 104, 3, 119, 2, b'o', b'k', 108, 0, 0, 0, 3, 97, 1, 70, 64, 0, 0, 0, 0, 0, 0, 0,
            109, 0, 0, 0, 1, b'x', 106, 116, 0, 0, 0, 1, 119, 1, b'a', 97, 5,
        ];
        assert_eq!(check_term(&bytes), Ok(24 + 48 + 48 + 16 + 48 + 72 + 24));
        for end in 0..bytes.len() {
            assert!(check_term(&bytes[..end]).is_err());
        }
    }

    #[test]
    fn rejects_oversized_terms_and_runtime_values() {
        assert_eq!(
            check_term(&[131, 80, 0, 0, 0, 255, 1, 2]),
            Err(Refusal::Compressed)
        );
        assert_eq!(check_term(&[131, 113, 100]), Err(Refusal::Function));
        assert_eq!(
            check_term(&[131, 105, 255, 255, 255, 255]),
            Err(Refusal::TooLarge)
        );
        let mut deep = vec![131];
        for _ in 0..1000 {
            deep.extend_from_slice(&[104, 1]);
        }
        deep.push(106);
        assert_eq!(check_term(&deep), Err(Refusal::TooDeep));
    }
}

//! Erlang's external term format: whether bytes from a file may be decoded at all, and a decoder that makes no atoms.

/// Terms are not nested deeper.
pub const MAX_DEPTH: u32 = 512;
/// Lists, tuples, maps and numbers of a term do not take more bytes in memory; a byte of a file can become sixteen.
/// Binaries do not count: they are as long there as here.
pub const MAX_STRUCTURE: usize = 64 << 20;

/// Why a term may not be decoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refusal {
    /// The bytes are no external term, or more than one.
    Malformed,
    /// Nested deeper than [`MAX_DEPTH`].
    TooDeep,
    /// Its structure would take more than [`MAX_STRUCTURE`] bytes.
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
    /// The refusal in words, for an error text.
    pub fn text(self) -> &'static str {
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

struct Walk<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Walk<'a> {
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

/// How many bytes the structure of a term takes in memory, if `bytes` are one whole external term of plain data:
/// bounded, shallow, nothing alive in it.
pub fn check(bytes: &[u8]) -> Result<usize, Refusal> {
    let mut walk = Walk { bytes, at: 0 };
    if walk.u8()? != 131 {
        return Err(Refusal::Malformed);
    }
    let size = pass(&mut walk)?;
    if walk.at == bytes.len() {
        Ok(size)
    } else {
        Err(Refusal::Malformed)
    }
}

/// Where the term that begins at `at` (without a version byte) ends.
pub fn end_of(bytes: &[u8], at: usize) -> Option<usize> {
    let mut walk = Walk { bytes, at };
    pass(&mut walk).ok()?;
    Some(walk.at)
}

/// Passes over one term; the bytes its structure takes.
fn pass(walk: &mut Walk<'_>) -> Result<usize, Refusal> {
    // Elements still to come at each level that is open.
    let mut open: Vec<usize> = vec![1];
    let mut size = 0usize;
    while let Some(left) = open.last_mut() {
        if *left == 0 {
            open.pop();
            continue;
        }
        *left -= 1;
        let tag = walk.u8()?;
        let start = walk.at;
        let children = match tag {
            97 => walk.take(1).map(|_| 0)?,
            98 => walk.take(4).map(|_| 0)?,
            70 => walk.take(8).map(|_| 0)?,
            99 => walk.take(31).map(|_| 0)?,
            104 => walk.u8()?,
            105 => walk.u32()?,
            106 => 0,
            107 => {
                let n = walk.u16()?;
                walk.take(n).map(|_| 0)?
            }
            108 => walk.u32()?.checked_add(1).ok_or(Refusal::Malformed)?,
            109 => {
                let n = walk.u32()?;
                walk.take(n).map(|_| 0)?
            }
            77 => {
                let n = walk.u32()?;
                let bits = walk.u8()?;
                if bits > 8 || (n == 0) != (bits == 0) {
                    return Err(Refusal::Malformed);
                }
                walk.take(n).map(|_| 0)?
            }
            110 => {
                let n = walk.u8()?;
                walk.take(n + 1).map(|_| 0)?
            }
            111 => {
                let n = walk.u32()?;
                // No real number has a megabyte of digits.
                if n > 1 << 20 {
                    return Err(Refusal::Malformed);
                }
                walk.take(n + 1).map(|_| 0)?
            }
            116 => walk.u32()?.checked_mul(2).ok_or(Refusal::Malformed)?,
            100 | 118 => {
                let n = walk.u16()?;
                if n > 1020 {
                    return Err(Refusal::Malformed);
                }
                walk.take(n).map(|_| 0)?
            }
            115 | 119 => {
                let n = walk.u8()?;
                walk.take(n).map(|_| 0)?
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
            107 => (walk.at - start) * 16,
            104 | 105 => (children + 1) * 8,
            108 => children * 16,
            // Pairs, and the nodes of a large map.
            116 => children * 16 + 40,
            110 | 111 => walk.at - start + 8,
            109 | 77 => 48,
            // An atom that does not exist here becomes a text.
            100 | 118 | 115 | 119 => 24,
            _ => 0,
        });
        if size > MAX_STRUCTURE {
            return Err(Refusal::TooLarge);
        }
        if children > 0 {
            // Every element takes a byte at least.
            if children > walk.bytes.len() - walk.at {
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

/// Builds terms of some runtime; atoms that do not exist there are the builder's affair.
pub trait Build {
    /// A term of the runtime.
    type Term: Clone;
    /// The atom with this name, in UTF-8.
    fn atom(&mut self, name: &[u8]) -> Self::Term;
    /// An integer of 64 bits.
    fn integer(&mut self, value: i64) -> Self::Term;
    /// A float; `None` if the runtime has none such (NaN, infinities).
    fn float(&mut self, value: f64) -> Option<Self::Term>;
    /// A binary.
    fn binary(&mut self, bytes: &[u8]) -> Self::Term;
    /// Anything without atoms in it (big numbers, bit strings), as external format without its version byte.
    fn plain(&mut self, bytes: &[u8]) -> Option<Self::Term>;
    /// A tuple of these elements.
    fn tuple(&mut self, elements: &[Self::Term]) -> Self::Term;
    /// A list of these elements, improper if there is a `tail`.
    fn list(&mut self, elements: &[Self::Term], tail: Option<Self::Term>) -> Self::Term;
    /// A map; `None` if the runtime refuses it (equal keys).
    fn map(&mut self, keys: &[Self::Term], values: &[Self::Term]) -> Option<Self::Term>;
}

/// Decodes a term that `check` allowed.
pub fn decode<B: Build>(bytes: &[u8], build: &mut B) -> Option<B::Term> {
    check(bytes).ok()?;
    let mut walk = Walk { bytes, at: 1 };
    term(&mut walk, build).ok().flatten()
}

// Recursion is bounded by `check`: 512 levels.
fn term<B: Build>(walk: &mut Walk<'_>, build: &mut B) -> Result<Option<B::Term>, Refusal> {
    let start = walk.at;
    let tag = walk.u8()?;
    Ok(Some(match tag {
        97 => {
            let value = walk.u8()?;
            build.integer(value as i64)
        }
        98 => {
            let value = walk.u32()? as u32 as i32;
            build.integer(value as i64)
        }
        70 => {
            let b = walk.take(8)?;
            let mut raw = [0; 8];
            raw.copy_from_slice(b);
            match build.float(f64::from_be_bytes(raw)) {
                Some(term) => term,
                None => return Ok(None),
            }
        }
        100 | 118 => {
            let n = walk.u16()?;
            build.atom(walk.take(n)?)
        }
        115 | 119 => {
            let n = walk.u8()?;
            build.atom(walk.take(n)?)
        }
        104 | 105 => {
            let n = if tag == 104 { walk.u8()? } else { walk.u32()? };
            match several(walk, build, n)? {
                Some(elements) => build.tuple(&elements),
                None => return Ok(None),
            }
        }
        106 => build.list(&[], None),
        107 => {
            let n = walk.u16()?;
            let elements: Vec<B::Term> = walk
                .take(n)?
                .iter()
                .map(|b| build.integer(*b as i64))
                .collect();
            build.list(&elements, None)
        }
        108 => {
            let n = walk.u32()?;
            let Some(elements) = several(walk, build, n)? else {
                return Ok(None);
            };
            let proper = walk.bytes.get(walk.at) == Some(&106);
            let Some(tail) = term(walk, build)? else {
                return Ok(None);
            };
            build.list(&elements, (!proper).then_some(tail))
        }
        109 => {
            let n = walk.u32()?;
            build.binary(walk.take(n)?)
        }
        116 => {
            let n = walk.u32()?;
            let Some(both) = several(walk, build, n * 2)? else {
                return Ok(None);
            };
            let keys: Vec<B::Term> = both.iter().step_by(2).cloned().collect();
            let values: Vec<B::Term> = both.iter().skip(1).step_by(2).cloned().collect();
            return Ok(build.map(&keys, &values));
        }
        _ => {
            match tag {
                99 => walk.take(31)?,
                77 => {
                    let n = walk.u32()?;
                    walk.take(n + 1)?
                }
                110 => {
                    let n = walk.u8()?;
                    walk.take(n + 1)?
                }
                111 => {
                    let n = walk.u32()?;
                    walk.take(n + 1)?
                }
                _ => return Err(Refusal::Malformed),
            };
            return Ok(build.plain(&walk.bytes[start..walk.at]));
        }
    }))
}

fn several<B: Build>(
    walk: &mut Walk<'_>,
    build: &mut B,
    n: usize,
) -> Result<Option<Vec<B::Term>>, Refusal> {
    let mut elements = Vec::with_capacity(n.min(walk.bytes.len() - walk.at));
    for _ in 0..n {
        match term(walk, build)? {
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
    fn plain_terms_pass() {
        // {ok, [1, 2.0, <<"x">>], #{a => 5}}
        let bytes = [
            131, 104, 3, 119, 2, b'o', b'k', 108, 0, 0, 0, 3, 97, 1, 70, 64, 0, 0, 0, 0, 0, 0, 0,
            109, 0, 0, 0, 1, b'x', 106, 116, 0, 0, 0, 1, 119, 1, b'a', 97, 5,
        ];
        assert_eq!(check(&bytes), Ok(24 + 48 + 48 + 16 + 48 + 72 + 24));
        for end in 0..bytes.len() {
            assert!(check(&bytes[..end]).is_err());
        }
    }

    #[test]
    fn bombs_and_living_things_are_refused() {
        assert_eq!(
            check(&[131, 80, 0, 0, 0, 255, 1, 2]),
            Err(Refusal::Compressed)
        );
        assert_eq!(check(&[131, 113, 100]), Err(Refusal::Function));
        assert_eq!(
            check(&[131, 105, 255, 255, 255, 255]),
            Err(Refusal::TooLarge)
        );
        let mut deep = vec![131];
        for _ in 0..1000 {
            deep.extend_from_slice(&[104, 1]);
        }
        deep.push(106);
        assert_eq!(check(&deep), Err(Refusal::TooDeep));
    }
}

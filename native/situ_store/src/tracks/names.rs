//! Keys and states by number, each known by its external term.

use std::collections::HashMap;

/// The number of all states beyond the most that are told apart.
pub const OTHER: u32 = 0;

/// At most so many keys of a stream have tracks, and so many states of a key have numbers of their own.
const MOST_KEYS: usize = 256;
const MOST_STATES: u32 = 256;

/// Numbers of keys (from 1 on; 0 is the message itself) and of states (from 1 on; 0 are all others).
#[derive(Debug, Default)]
pub struct Names {
    keys: Vec<Vec<u8>>,
    states: Vec<Vec<u8>>,
    key_numbers: HashMap<Vec<u8>, u32>,
    state_numbers: HashMap<Vec<u8>, u32>,
    /// Which states which key has had.
    known: HashMap<(u32, u32), ()>,
    per_key: HashMap<u32, u32>,
    /// Per key its latest two states: most change rarely, or to and fro. `OTHER` where there was none.
    latest: Vec<[u32; 2]>,
}

impl Names {
    /// The number of a key; `None` when there are too many.
    pub fn key(&mut self, term: &[u8]) -> Option<u32> {
        if let Some(number) = self.key_numbers.get(term) {
            return Some(*number);
        }
        if self.keys.len() >= MOST_KEYS {
            return None;
        }
        self.keys.push(term.to_vec());
        let number = self.keys.len() as u32;
        self.key_numbers.insert(term.to_vec(), number);
        Some(number)
    }

    /// The number of a state of a key.
    pub fn state(&mut self, key: u32, term: &[u8]) -> u32 {
        let at = key as usize;
        if self.latest.len() <= at {
            self.latest.resize(at + 1, [OTHER; 2]);
        }
        let [last, before] = self.latest[at];
        if self.state_term(last) == Some(term) {
            return last;
        }
        if self.state_term(before) == Some(term) {
            self.latest[at] = [before, last];
            return before;
        }
        let number = match self.state_numbers.get(term) {
            Some(number) => *number,
            None => {
                if self.full(key) {
                    return OTHER;
                }
                self.states.push(term.to_vec());
                let number = self.states.len() as u32;
                self.state_numbers.insert(term.to_vec(), number);
                number
            }
        };
        if !self.known.contains_key(&(key, number)) {
            if self.full(key) {
                return OTHER;
            }
            self.known.insert((key, number), ());
            *self.per_key.entry(key).or_default() += 1;
        }
        self.latest[at] = [number, last];
        number
    }

    fn full(&self, key: u32) -> bool {
        self.per_key.get(&key).copied().unwrap_or(0) >= MOST_STATES
    }

    /// The external term of a key; none of the message itself.
    pub fn key_term(&self, number: u32) -> Option<&[u8]> {
        let at = (number as usize).checked_sub(1)?;
        self.keys.get(at).map(Vec::as_slice)
    }

    /// The external term of a state; none of the others.
    pub fn state_term(&self, number: u32) -> Option<&[u8]> {
        let at = (number as usize).checked_sub(1)?;
        self.states.get(at).map(Vec::as_slice)
    }
}

//! Numbers keys and states. Each is identified by its external term.

use std::collections::HashMap;

/// The number shared by all states beyond the limit of distinguished ones.
pub const OTHER_STATES: u32 = 0;

/// The maximum number of keys of a stream with tracks, and of distinguished states of a key.
const MOST_KEYS: usize = 256;
const MOST_STATES: u32 = 256;

/// Numbers of keys (from 1 on; 0 is the message itself) and of states (from 1 on; 0 is all other states).
#[derive(Debug, Default)]
pub struct Names {
    keys: Vec<Vec<u8>>,
    states: Vec<Vec<u8>>,
    key_numbers: HashMap<Vec<u8>, u32>,
    state_numbers: HashMap<Vec<u8>, u32>,
    /// The states that each key has had.
    seen_states: HashMap<(u32, u32), ()>,
    per_key: HashMap<u32, u32>,
    /// The latest two states of each key, because most states change rarely or alternate. `OTHER_STATES` if there
    /// was none.
    latest: Vec<[u32; 2]>,
}

impl Names {
    /// Returns the number of a key, or `None` if there are too many keys.
    pub fn key_number(&mut self, term: &[u8]) -> Option<u32> {
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

    /// Returns the number of a state of a key.
    pub fn state_number(&mut self, key: u32, term: &[u8]) -> u32 {
        let at = key as usize;
        if self.latest.len() <= at {
            self.latest.resize(at + 1, [OTHER_STATES; 2]);
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
                if self.is_full(key) {
                    return OTHER_STATES;
                }
                self.states.push(term.to_vec());
                let number = self.states.len() as u32;
                self.state_numbers.insert(term.to_vec(), number);
                number
            }
        };
        if !self.seen_states.contains_key(&(key, number)) {
            if self.is_full(key) {
                return OTHER_STATES;
            }
            self.seen_states.insert((key, number), ());
            *self.per_key.entry(key).or_default() += 1;
        }
        self.latest[at] = [number, last];
        number
    }

    fn is_full(&self, key: u32) -> bool {
        self.per_key.get(&key).copied().unwrap_or(0) >= MOST_STATES
    }

    /// Returns the external term of a key, or `None` for the message itself.
    pub fn key_term(&self, number: u32) -> Option<&[u8]> {
        let at = (number as usize).checked_sub(1)?;
        self.keys.get(at).map(Vec::as_slice)
    }

    /// Returns the external term of a state, or `None` for the other states.
    pub fn state_term(&self, number: u32) -> Option<&[u8]> {
        let at = (number as usize).checked_sub(1)?;
        self.states.get(at).map(Vec::as_slice)
    }
}

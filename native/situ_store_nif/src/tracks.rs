//! Returns counts and tracks of a reader as terms.

use std::collections::HashMap;

use rustler::{Encoder, Env, Term};
use situ_store::reader::{lock_mutex, Line};
use situ_store::tracks::{Names, MESSAGE_KEY};
use situ_store::Reader;

use crate::atoms;
use crate::errors::encode_error;
use crate::reading::{encode_bins, Handle};
use crate::residency::with_bytes;
use crate::terms::{decode_term, Decoded};

/// Returns counts and tracks in bins of 2^level ns: `{:ok, [{start, n}], [{key, track}]}`. A track is `{:numbers,
/// bins}`, `{:changes, [{time, state}]}` or `{:states, [{start, last, [{state, n}]}]}`. The key of the message
/// itself is `nil`.
#[rustler::nif(schedule = "DirtyCpu")]
fn reader_tracks<'a>(
    env: Env<'a>,
    handle: Handle,
    stream: u32,
    from: i64,
    to: i64,
    level: u8,
    most: usize,
) -> Term<'a> {
    if let Err(error) = handle.store().refresh() {
        return encode_error(env, &error);
    }
    let span = (from, to);
    with_bytes(env, handle.store(), || {
        encode_tracks(env, handle.store(), stream, span, level, most)
    })
}

fn encode_tracks<'a>(
    env: Env<'a>,
    reader: &Reader,
    stream: u32,
    (from, to): (i64, i64),
    level: u8,
    most: usize,
) -> Term<'a> {
    let cache = reader.track_cache(stream);
    let mut cache = lock_mutex(&cache);
    let data = match reader.read_tracks(stream, from, to, level, most, &mut cache) {
        Ok(data) => data,
        Err(error) => return encode_error(env, &error),
    };
    let mut states = States {
        env,
        names: &cache.names,
        terms: HashMap::new(),
    };
    let tracks: Vec<Term<'a>> = data
        .tracks
        .iter()
        .map(|(key, line)| (states.encode_key(*key), states.encode_line(line)).encode(env))
        .collect();
    (atoms::ok(), data.counts, tracks).encode(env)
}

/// Encodes states as terms, each only once.
struct States<'a, 'b> {
    env: Env<'a>,
    names: &'b Names,
    terms: HashMap<u32, Term<'a>>,
}

impl<'a> States<'a, '_> {
    fn encode_key(&self, number: u32) -> Term<'a> {
        match self.names.key_term(number) {
            Some(term) if number != MESSAGE_KEY => self.encode_term(term),
            _ => atoms::nil().encode(self.env),
        }
    }

    fn encode_term(&self, bytes: &[u8]) -> Term<'a> {
        match decode_term(self.env, bytes).0 {
            Decoded::Plain(term) | Decoded::Unknown(_, term) => term,
            Decoded::Refused(_) => atoms::other().encode(self.env),
        }
    }

    fn encode_state(&mut self, number: u32) -> Term<'a> {
        if let Some(term) = self.terms.get(&number) {
            return *term;
        }
        let term = match self.names.state_term(number) {
            Some(term) => self.encode_term(term),
            None => atoms::other().encode(self.env),
        };
        self.terms.insert(number, term);
        term
    }

    fn encode_line(&mut self, line: &Line) -> Term<'a> {
        let env = self.env;
        match line {
            Line::Numbers(numbers) => (atoms::numbers(), encode_bins(env, numbers)).encode(env),
            Line::Changes(changes) => {
                let changes: Vec<_> = changes
                    .iter()
                    .map(|(time, state)| (*time, self.encode_state(*state)))
                    .collect();
                (atoms::changes(), changes).encode(env)
            }
            Line::States(states) => {
                let states: Vec<_> = states
                    .iter()
                    .map(|(start, last, counts)| {
                        let counts: Vec<_> = counts
                            .iter()
                            .map(|(state, n)| (self.encode_state(*state), *n))
                            .collect();
                        (*start, self.encode_state(*last), counts)
                    })
                    .collect();
                (atoms::states(), states).encode(env)
            }
        }
    }
}

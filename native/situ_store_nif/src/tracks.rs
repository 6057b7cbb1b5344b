//! Counts and tracks of a reader as terms.

use std::collections::HashMap;

use rustler::{Encoder, Env, Term};
use situ_store::reader::{lock, Line};
use situ_store::tracks::{Names, ITSELF};

use crate::reading::{bins, failed, Handle};
use crate::terms::{decode, Decoded};
use crate::{atoms, errors};

/// Counts and tracks in bins of 2^level ns: `{:ok, [{start, n}], [{key, track}]}`, a track being `{:numbers, bins}`,
/// `{:changes, [{time, state}]}` or `{:states, [{start, last, [{state, n}]}]}`. The message itself has the key `nil`.
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
    let reader = handle.store();
    if let Err(error) = reader.refresh() {
        return errors::term(env, &error);
    }
    let known = reader.known(stream);
    let mut known = lock(&known);
    let told = match reader.tracks(stream, from, to, level, most, &mut known) {
        Ok(told) => told,
        Err(error) => return failed(env, &error),
    };
    let mut states = States {
        env,
        names: &known.names,
        made: HashMap::new(),
    };
    let tracks: Vec<Term<'a>> = told
        .tracks
        .iter()
        .map(|(key, line)| (states.key(*key), states.line(line)).encode(env))
        .collect();
    (atoms::ok(), told.counts, tracks).encode(env)
}

/// States as terms, each made once.
struct States<'a, 'b> {
    env: Env<'a>,
    names: &'b Names,
    made: HashMap<u32, Term<'a>>,
}

impl<'a> States<'a, '_> {
    fn key(&self, number: u32) -> Term<'a> {
        match self.names.key_term(number) {
            Some(term) if number != ITSELF => self.term(term),
            _ => atoms::nil().encode(self.env),
        }
    }

    fn term(&self, bytes: &[u8]) -> Term<'a> {
        match decode(self.env, bytes).0 {
            Decoded::Plain(term) | Decoded::Unknown(_, term) => term,
            Decoded::Refused(_) => atoms::other().encode(self.env),
        }
    }

    fn state(&mut self, number: u32) -> Term<'a> {
        if let Some(term) = self.made.get(&number) {
            return *term;
        }
        let term = match self.names.state_term(number) {
            Some(term) => self.term(term),
            None => atoms::other().encode(self.env),
        };
        self.made.insert(number, term);
        term
    }

    fn line(&mut self, line: &Line) -> Term<'a> {
        let env = self.env;
        match line {
            Line::Numbers(numbers) => (atoms::numbers(), bins(env, numbers)).encode(env),
            Line::Changes(changes) => {
                let changes: Vec<_> = changes
                    .iter()
                    .map(|(time, state)| (*time, self.state(*state)))
                    .collect();
                (atoms::changes(), changes).encode(env)
            }
            Line::States(states) => {
                let states: Vec<_> = states
                    .iter()
                    .map(|(start, last, counts)| {
                        let counts: Vec<_> = counts
                            .iter()
                            .map(|(state, n)| (self.state(*state), *n))
                            .collect();
                        (*start, self.state(*last), counts)
                    })
                    .collect();
                (atoms::states(), states).encode(env)
            }
        }
    }
}

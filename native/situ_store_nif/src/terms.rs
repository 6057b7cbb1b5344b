//! Terms from stored bytes: no atoms or functions are made from a file.

use rustler::{Atom, Binary, Encoder, Env, NewBinary, Term};
use situ_store::etf::{self, Build};

use crate::atoms;

/// Smaller binaries are copied: a sub-binary would keep a whole extent mapped for the sake of a few bytes.
pub const COPY_UP_TO: usize = 64;

pub fn copied<'a>(env: Env<'a>, bytes: &[u8]) -> Term<'a> {
    let mut binary = NewBinary::new(env, bytes.len());
    binary.as_mut_slice().copy_from_slice(bytes);
    let binary: Binary<'a> = binary.into();
    binary.encode(env)
}

/// A term from external format. Atoms that do not exist here become strings (and a struct of theirs a plain map).
pub fn decode<'a>(env: Env<'a>, bytes: &[u8]) -> Term<'a> {
    if let Err(refusal) = etf::check(bytes) {
        return (atoms::undecodable(), refusal.text()).encode(env);
    }
    if let Some((term, _)) = env.binary_to_term(bytes) {
        return term;
    }
    match etf::decode(bytes, &mut Builder { env }) {
        Some(term) => term,
        None => (atoms::undecodable(), etf::Refusal::Malformed.text()).encode(env),
    }
}

struct Builder<'a> {
    env: Env<'a>,
}

impl<'a> Build for Builder<'a> {
    type Term = Term<'a>;

    fn atom(&mut self, name: &[u8]) -> Term<'a> {
        match Atom::existing_from_utf8_bytes(self.env, name) {
            Ok(atom) => atom.encode(self.env),
            Err(_) => copied(self.env, name),
        }
    }

    fn integer(&mut self, value: i64) -> Term<'a> {
        value.encode(self.env)
    }

    fn float(&mut self, value: f64) -> Option<Term<'a>> {
        value.is_finite().then(|| value.encode(self.env))
    }

    fn binary(&mut self, bytes: &[u8]) -> Term<'a> {
        copied(self.env, bytes)
    }

    fn plain(&mut self, bytes: &[u8]) -> Option<Term<'a>> {
        let mut whole = Vec::with_capacity(bytes.len() + 1);
        whole.push(131);
        whole.extend_from_slice(bytes);
        self.env.binary_to_term(&whole).map(|(term, _)| term)
    }

    fn tuple(&mut self, elements: &[Term<'a>]) -> Term<'a> {
        rustler::types::tuple::make_tuple(self.env, elements)
    }

    fn list(&mut self, elements: &[Term<'a>], tail: Option<Term<'a>>) -> Term<'a> {
        let start = tail.unwrap_or_else(|| Vec::<Term<'a>>::new().encode(self.env));
        elements
            .iter()
            .rev()
            .fold(start, |list, element| list.list_prepend(*element))
    }

    fn map(&mut self, keys: &[Term<'a>], values: &[Term<'a>]) -> Option<Term<'a>> {
        let tag = atoms::struct_key().encode(self.env);
        let keys: Vec<Term<'a>> = keys
            .iter()
            .zip(values)
            // A struct nobody here knows is a map that says so.
            .map(|(key, value)| {
                if *key == tag && !value.is_atom() {
                    "__struct__".encode(self.env)
                } else {
                    *key
                }
            })
            .collect();
        Term::map_from_term_arrays(self.env, &keys, values).ok()
    }
}

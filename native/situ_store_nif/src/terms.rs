//! Decodes terms from stored bytes without creating atoms or functions.

use rustler::{Atom, Binary, Encoder, Env, NewBinary, Term};
use situ_store::etf::{self, TermBuilder};

use crate::atoms;

/// Binaries up to this size are copied, because a sub-binary would keep a whole extent mapped for a few bytes.
pub const COPY_UP_TO: usize = 64;

pub fn encode_binary<'a>(env: Env<'a>, bytes: &[u8]) -> Term<'a> {
    let mut binary = NewBinary::new(env, bytes.len());
    binary.as_mut_slice().copy_from_slice(bytes);
    let binary: Binary<'a> = binary.into();
    binary.encode(env)
}

/// A decoded term of this system. Only terms that decode completely are `Plain`, whatever values a file contains.
pub enum Decoded<'a> {
    /// The term. It contains strings for atoms that do not exist here.
    Plain(Term<'a>),
    /// A term with structs that do not exist here, which are maps with string keys: `[module]` and the term. The
    /// caller decodes the bytes again once it has loaded the modules.
    Unknown(Vec<Term<'a>>, Term<'a>),
    /// The reason why the bytes were not decoded.
    Refused(&'static str),
}

/// Decodes a term. Returns it with the number of bytes that its structure takes in memory.
pub fn decode_term<'a>(env: Env<'a>, bytes: &[u8]) -> (Decoded<'a>, usize) {
    match etf::check_term(bytes) {
        Ok(size) => (build_term(env, bytes), size),
        Err(refusal) => (Decoded::Refused(refusal.describe()), 0),
    }
}

fn build_term<'a>(env: Env<'a>, bytes: &[u8]) -> Decoded<'a> {
    if let Some((term, _)) = env.binary_to_term(bytes) {
        return Decoded::Plain(term);
    }
    let mut builder = Terms {
        env,
        unknown: Vec::new(),
    };
    match etf::decode_term(bytes, &mut builder) {
        Some(term) if builder.unknown.is_empty() => Decoded::Plain(term),
        Some(term) => Decoded::Unknown(builder.unknown, term),
        None => Decoded::Refused(etf::Refusal::Malformed.describe()),
    }
}

struct Terms<'a> {
    env: Env<'a>,
    /// The module names of structs that cannot be built.
    unknown: Vec<Term<'a>>,
}

/// Encodes a key of a struct that cannot be built: a string, whether or not the atom exists here.
fn encode_struct_key<'a>(env: Env<'a>, term: Term<'a>) -> Term<'a> {
    match term.atom_to_string() {
        Ok(text) => encode_binary(env, text.as_bytes()),
        Err(_) => term,
    }
}

impl<'a> TermBuilder for Terms<'a> {
    type Term = Term<'a>;

    fn atom(&mut self, name: &[u8]) -> Term<'a> {
        match Atom::existing_from_utf8_bytes(self.env, name) {
            Ok(atom) => atom.encode(self.env),
            Err(_) => encode_binary(self.env, name),
        }
    }

    fn integer(&mut self, value: i64) -> Term<'a> {
        value.encode(self.env)
    }

    fn float(&mut self, value: f64) -> Option<Term<'a>> {
        value.is_finite().then(|| value.encode(self.env))
    }

    fn binary(&mut self, bytes: &[u8]) -> Term<'a> {
        encode_binary(self.env, bytes)
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
        let module = keys.iter().position(|key| *key == tag).map(|at| values[at]);
        let Some(module) =
            module.filter(|module| !module.is_atom() || keys.iter().any(|key| !key.is_atom()))
        else {
            return Term::map_from_term_arrays(self.env, keys, values).ok();
        };
        // A struct of an unknown module becomes a map with the module's name.
        let module = encode_struct_key(self.env, module);
        self.unknown.push(module);
        let names: Vec<Term<'a>> = keys
            .iter()
            .map(|key| encode_struct_key(self.env, *key))
            .collect();
        let values: Vec<Term<'a>> = keys
            .iter()
            .zip(values)
            .map(|(key, value)| if *key == tag { module } else { *value })
            .collect();
        Term::map_from_term_arrays(self.env, &names, &values).ok()
    }
}

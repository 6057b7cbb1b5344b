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

/// Bytes in external format as a term of this system. No value of a file can pass for another kind than `Plain`.
pub enum Decoded<'a> {
    /// The term. Atoms that do not exist here are strings in it.
    Plain(Term<'a>),
    /// A term with structs that do not exist here, which are maps with strings for keys: `[module]` and the term.
    /// The caller decodes the bytes again once it has loaded the modules.
    Unknown(Vec<Term<'a>>, Term<'a>),
    /// Why there is no term.
    Refused(&'static str),
}

/// The term, and how many bytes its structure takes.
pub fn decode<'a>(env: Env<'a>, bytes: &[u8]) -> (Decoded<'a>, usize) {
    match etf::check(bytes) {
        Ok(size) => (build(env, bytes), size),
        Err(refusal) => (Decoded::Refused(refusal.text()), 0),
    }
}

fn build<'a>(env: Env<'a>, bytes: &[u8]) -> Decoded<'a> {
    if let Some((term, _)) = env.binary_to_term(bytes) {
        return Decoded::Plain(term);
    }
    let mut builder = Builder {
        env,
        unknown: Vec::new(),
    };
    match etf::decode(bytes, &mut builder) {
        Some(term) if builder.unknown.is_empty() => Decoded::Plain(term),
        Some(term) => Decoded::Unknown(builder.unknown, term),
        None => Decoded::Refused(etf::Refusal::Malformed.text()),
    }
}

struct Builder<'a> {
    env: Env<'a>,
    /// The names of structs that cannot be made.
    unknown: Vec<Term<'a>>,
}

/// A key of a struct that cannot be made: a string, whether or not the atom exists here.
fn name<'a>(env: Env<'a>, term: Term<'a>) -> Term<'a> {
    match term.atom_to_string() {
        Ok(text) => copied(env, text.as_bytes()),
        Err(_) => term,
    }
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
        let module = keys.iter().position(|key| *key == tag).map(|at| values[at]);
        let Some(module) =
            module.filter(|module| !module.is_atom() || keys.iter().any(|key| !key.is_atom()))
        else {
            return Term::map_from_term_arrays(self.env, keys, values).ok();
        };
        // A struct of an unknown module becomes a map with the module's name.
        let module = name(self.env, module);
        self.unknown.push(module);
        let named: Vec<Term<'a>> = keys.iter().map(|key| name(self.env, *key)).collect();
        let values: Vec<Term<'a>> = keys
            .iter()
            .zip(values)
            .map(|(key, value)| if *key == tag { module } else { *value })
            .collect();
        Term::map_from_term_arrays(self.env, &named, &values).ok()
    }
}

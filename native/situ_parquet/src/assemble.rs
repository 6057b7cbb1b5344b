//! Assembles nested values from the levels of their leaves (Dremel encoding).

use crate::error::{malformed, Result};
use crate::leaf::Leaf;
use crate::schema::{Kind, Node};
use crate::term::Encoder;
use std::collections::HashMap;

/// The leaves of a column; `first` is the number of the first of them.
pub struct Leaves<'a> {
    pub first: usize,
    pub leaves: &'a mut [Leaf],
}

impl Leaves<'_> {
    fn of(&mut self, node: &Node) -> &mut [Leaf] {
        &mut self.leaves[node.leaves.start - self.first..node.leaves.end - self.first]
    }

    fn is_present(&mut self, node: &Node) -> Result<bool> {
        Ok(self.of(node)[0].next_def()? >= node.def)
    }

    fn skip_entries(&mut self, node: &Node) {
        self.of(node).iter_mut().for_each(Leaf::skip_entry);
    }

    /// Returns whether another element of a repeated node follows. All leaves below must agree.
    fn continues(&mut self, node: &Node) -> Result<bool> {
        let leaves = self.of(node);
        let rep = leaves[0].next_rep();
        if rep > node.rep || leaves.iter().any(|leaf| leaf.next_rep() != rep) {
            return malformed(format!(
                "the lists of {:?} have different lengths",
                node.name
            ));
        }
        Ok(rep == node.rep)
    }
}

/// Encodes the value of the next row.
pub fn encode_row(node: &Node, leaves: &mut Leaves, out: &mut Encoder) -> Result<()> {
    if node.is_flat() {
        return leaves.leaves[0].encode_next(out);
    }
    encode_node(node, leaves, out)?;
    if leaves.of(node).iter().any(|leaf| leaf.next_rep() != 0) {
        return malformed(format!(
            "the rows of {:?} have different lengths",
            node.name
        ));
    }
    Ok(())
}

fn encode_node(node: &Node, leaves: &mut Leaves, out: &mut Encoder) -> Result<()> {
    if node.repeated {
        encode_elements(node, leaves, out, encode_content)
    } else if leaves.is_present(node)? {
        encode_content(node, leaves, out)
    } else {
        leaves.skip_entries(node);
        out.nil();
        Ok(())
    }
}

type EncodeElement = fn(&Node, &mut Leaves, &mut Encoder) -> Result<()>;

fn encode_elements(
    node: &Node,
    leaves: &mut Leaves,
    out: &mut Encoder,
    encode: EncodeElement,
) -> Result<()> {
    let start = out.begin_list(0);
    let mut n = 0;
    if leaves.is_present(node)? {
        loop {
            encode(node, leaves, out)?;
            n += 1;
            if !leaves.continues(node)? {
                break;
            }
        }
    } else {
        leaves.skip_entries(node);
    }
    out.end_list(start, n);
    Ok(())
}

fn encode_content(node: &Node, leaves: &mut Leaves, out: &mut Encoder) -> Result<()> {
    match (&node.kind, node.children.as_slice()) {
        (Kind::Leaf(..), _) => leaves.of(node)[0].encode_entry(out),
        (Kind::List, [repeated]) => {
            let element = if is_wrapper(repeated, &node.name) {
                encode_wrapped
            } else {
                encode_content
            };
            encode_elements(repeated, leaves, out, element)
        }
        (Kind::Map, [pairs]) if pairs.children.len() == 2 => encode_map(pairs, leaves, out),
        (Kind::Map, [pairs]) => encode_elements(pairs, leaves, out, encode_content),
        (_, children) => {
            out.map(children.len());
            for child in children {
                out.bytes(child.name.as_bytes());
                encode_node(child, leaves, out)?;
            }
            Ok(())
        }
    }
}

/// Returns whether a repeated group is only a wrapper of the elements. Old writers leave it out.
fn is_wrapper(repeated: &Node, list: &str) -> bool {
    repeated.kind == Kind::Struct
        && repeated.children.len() == 1
        && repeated.name != "array"
        && repeated.name.strip_suffix("_tuple") != Some(list)
}

fn encode_wrapped(repeated: &Node, leaves: &mut Leaves, out: &mut Encoder) -> Result<()> {
    encode_node(&repeated.children[0], leaves, out)
}

// A map of the BEAM has each key once: the last one counts.
fn encode_map(pairs: &Node, leaves: &mut Leaves, out: &mut Encoder) -> Result<()> {
    let mut values: Vec<(Vec<u8>, Vec<u8>)> = Vec::new();
    let mut places: HashMap<Vec<u8>, usize> = HashMap::new();
    if leaves.is_present(pairs)? {
        loop {
            let (mut key, mut value) = (Encoder::default(), Encoder::default());
            encode_node(&pairs.children[0], leaves, &mut key)?;
            encode_node(&pairs.children[1], leaves, &mut value)?;
            // The BEAM does not tell 0.0 from -0.0.
            if key.0 == [70, 128, 0, 0, 0, 0, 0, 0, 0] {
                key.0[1] = 0;
            }
            match places.get(&key.0) {
                Some(&place) => values[place].1 = value.0,
                None => {
                    places.insert(key.0.clone(), values.len());
                    values.push((key.0, value.0));
                }
            }
            if !leaves.continues(pairs)? {
                break;
            }
        }
    } else {
        leaves.skip_entries(pairs);
    }
    out.map(values.len());
    for (key, value) in values {
        out.0.extend(key);
        out.0.extend(value);
    }
    Ok(())
}

//! The columns of a file as trees of lists, maps, structs and leaves.

use crate::error::{malformed, Result};
use crate::meaning::{leaf_meaning, Meaning};
use parquet::basic::{ConvertedType, LogicalType, Repetition};
use parquet::schema::types::Type;
use std::collections::HashSet;
use std::ops::Range;

const MAX_DEPTH: usize = 64;

#[derive(Debug, PartialEq)]
pub enum Kind {
    Leaf(Meaning, bool),
    Struct,
    List,
    Map,
}

/// A node is present from the definition level `def`. If it repeats, its elements begin at repetition level `rep`.
#[derive(Debug)]
pub struct Node {
    pub name: String,
    pub kind: Kind,
    pub repeated: bool,
    pub def: i16,
    pub rep: i16,
    pub children: Vec<Node>,
    /// The leaves below, by their numbers in the file.
    pub leaves: Range<usize>,
}

impl Node {
    /// Returns whether a row has exactly one value or none.
    pub fn is_flat(&self) -> bool {
        matches!(self.kind, Kind::Leaf(..)) && !self.repeated
    }

    pub fn is_time(&self) -> bool {
        self.is_flat() && matches!(self.kind, Kind::Leaf(_, true))
    }
}

/// Builds the columns from the root of the schema.
pub fn build_columns(root: &Type) -> Result<Vec<Node>> {
    let mut next_leaf = 0;
    let fields = root.get_fields().iter();
    fields
        .map(|field| build_node(field, (0, 0), &mut next_leaf, 0))
        .collect()
}

fn build_node(
    field: &Type,
    levels: (i16, i16),
    next_leaf: &mut usize,
    depth: usize,
) -> Result<Node> {
    if depth > MAX_DEPTH {
        return malformed("its columns are nested too deeply");
    }
    let info = field.get_basic_info();
    let repetition = info.has_repetition().then(|| info.repetition());
    let repeated = repetition == Some(Repetition::REPEATED);
    let optional = repetition == Some(Repetition::OPTIONAL);
    let def = levels.0 + i16::from(repeated || optional);
    let rep = levels.1 + i16::from(repeated);
    let first = *next_leaf;
    let (kind, children) = if field.is_group() {
        let mut children = Vec::new();
        for child in field.get_fields() {
            children.push(build_node(child, (def, rep), next_leaf, depth + 1)?);
        }
        if *next_leaf == first {
            return malformed(format!("the group {:?} has no columns", info.name()));
        }
        number_duplicates(&mut children);
        (group_kind(field, &children), children)
    } else {
        *next_leaf += 1;
        let (meaning, time) = leaf_meaning(field);
        (Kind::Leaf(meaning, time), Vec::new())
    };
    Ok(Node {
        name: info.name().to_string(),
        kind,
        repeated,
        def,
        rep,
        children,
        leaves: first..*next_leaf,
    })
}

// Lists and maps are groups whose only child is repeated.
fn group_kind(group: &Type, children: &[Node]) -> Kind {
    let info = group.get_basic_info();
    if !matches!(children, [only] if only.repeated) {
        return Kind::Struct;
    }
    match (info.logical_type_ref(), info.converted_type()) {
        (Some(LogicalType::List), _) | (_, ConvertedType::LIST) => Kind::List,
        (Some(LogicalType::Map), _) | (_, ConvertedType::MAP | ConvertedType::MAP_KEY_VALUE) => {
            Kind::Map
        }
        _ => Kind::Struct,
    }
}

/// Numbers duplicate names, because a struct becomes a map, which can hold only one of them.
fn number_duplicates(nodes: &mut [Node]) {
    let mut names: HashSet<String> = nodes.iter().map(|node| node.name.clone()).collect();
    let mut previous = HashSet::new();
    for node in nodes {
        if !previous.insert(node.name.clone()) {
            let free = (1..)
                .map(|n| format!("{}_{n}", node.name))
                .find(|name| !names.contains(name));
            node.name = free.unwrap_or_default();
            names.insert(node.name.clone());
        }
    }
}

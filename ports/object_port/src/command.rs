//! The commands.

use serde::Deserialize;

/// A command, as JSON `{"op": "list", ...}`. Its keys are names of the fields.
#[derive(Debug, Deserialize)]
#[serde(tag = "op", rename_all = "snake_case")]
pub enum Command {
    /// Returns the endpoint: `{endpoint}`.
    Endpoint,
    /// Lists objects whose keys begin with `prefix`, and with `folders` the next `/` ends a name:
    /// `{objects: [{key, size, etag}], folders: [key]}`.
    List {
        bucket: String,
        prefix: String,
        folders: bool,
    },
    /// Returns a small object: `{etag}` and its bytes. An object larger than `most` is an error.
    Get {
        bucket: String,
        key: String,
        most: u64,
    },
    /// Returns the size of an object: `{size, etag}`.
    Head { bucket: String, key: String },
    /// Writes the command's bytes as an object: `{etag}`.
    Put { bucket: String, key: String },
    /// Deletes objects. A missing object is not an error.
    Delete { bucket: String, keys: Vec<String> },
    /// Fetches blocks of an object into a local mirror of it.
    Fill(Fill),
    /// Returns the checksums of a local file's blocks: CRC-32, four bytes each (little-endian).
    Sums { path: String, block: u64 },
    /// Writes a local file as an object in parts: `{etag, size}`. The journal makes it possible to continue later.
    Upload {
        bucket: String,
        key: String,
        path: String,
        journal: String,
        part: u64,
    },
}

/// Fetches the blocks of `ranges` (first and last block of each) that `path` does not mark, checks them, writes them to
/// `path` and marks them. `path` has the object's bytes, and from the next multiple of 4,096 on, a mark for each block
/// (one byte: 1 if it was fetched).
#[derive(Debug, Clone, Deserialize)]
pub struct Fill {
    pub bucket: String,
    pub key: String,
    /// The expected version of the object.
    pub etag: Option<String>,
    pub path: String,
    /// A file with the checksums of the blocks, as `Sums` returns them.
    pub sums: String,
    pub size: u64,
    pub block: u64,
    pub ranges: Vec<(u64, u64)>,
}

//! The pure Rust part of situ_store: the file format of `priv/schema/store.md`, its writer and reader, pyramids,
//! and repair. No BEAM types.

#![deny(missing_docs)]

pub mod chunk;
pub mod columns;
pub mod error;
pub mod etf;
pub mod extent;
pub mod file_lock;
pub mod format;
pub mod guard;
pub mod index;
pub mod limits;

pub mod pyramid;
pub mod reader;
pub mod rename;
pub mod repair;
pub mod shared;
pub mod tracks;
pub mod transfer;
pub mod varint;
pub mod watch;
pub mod writer;

pub use error::{Error, Result};
pub use format::{Compression, Encoding};
pub use reader::Reader;
pub use writer::{Options, Writer};

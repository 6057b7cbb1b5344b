//! Limits of a store that do not depend on its layout. Error messages name them, too.

/// The format version of new stores. Lower versions are readable, too.
pub const VERSION: u32 = 2;
/// The maximum size of a message. A file with a larger length is damaged, and a reader never allocates more.
pub const MAX_MESSAGE: usize = 1 << 30;

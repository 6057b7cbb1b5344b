//! Numbers that a store is bound by, apart from how it is laid out: errors name them too.

/// The version of new stores; lower ones are read too.
pub const VERSION: u32 = 2;
/// No message is larger: a file with a larger length is damaged, and a reader never allocates more.
pub const MAX_MESSAGE: usize = 1 << 30;

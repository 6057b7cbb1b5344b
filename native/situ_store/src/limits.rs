//! Numbers that a store is bound by, apart from how it is laid out: errors name them too.

/// The version of new stores; lower ones are read too.
pub const VERSION: u32 = 2;
/// No message is larger, so a file that says otherwise is damaged, and nobody is made to allocate more.
pub const MAX_MESSAGE: usize = 1 << 30;

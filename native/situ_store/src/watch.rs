//! Waiting for a writer in any process, without polling.

use std::sync::Arc;
use std::time::Duration;

use rustix::thread::futex;

use crate::index::futex_word;
use crate::reader::Reader;

/// The answer of [`wait`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum News {
    /// This many entries are published now.
    Published(u64),
    /// The writer has closed the store, or died; nothing more will come.
    Ended(u64),
    /// Nothing new within the time.
    Nothing,
}

/// Waits until more than `known` entries are published, the writer is gone, or `patience` is over.
pub fn wait(reader: &Arc<Reader>, known: u64, patience: Duration) -> News {
    let word = futex_word(reader.head());
    let value = word.load(std::sync::atomic::Ordering::Acquire);
    if reader.published() > known {
        return News::Published(reader.published());
    }
    if !reader.is_live() {
        // It may have published and closed since.
        let published = reader.published();
        return if published > known {
            News::Published(published)
        } else {
            News::Ended(published)
        };
    }
    let timeout = futex::Timespec {
        tv_sec: patience.as_secs() as i64,
        tv_nsec: patience.subsec_nanos().into(),
    };
    let _ = futex::wait(word, futex::Flags::empty(), value, Some(&timeout));
    let published = reader.published();
    if published > known {
        News::Published(published)
    } else {
        News::Nothing
    }
}

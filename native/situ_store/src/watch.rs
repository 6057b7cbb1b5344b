//! Waits for a writer in any process without polling.

use std::sync::Arc;
use std::time::Duration;

use rustix::thread::futex;

use crate::index::futex_word;
use crate::reader::Reader;

/// The result of [`wait_for_entries`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum News {
    /// The number of published entries has grown to this.
    Published(u64),
    /// The writer has closed the store or died, with this many entries published. There will be no more.
    Ended(u64),
    /// Nothing was published within the timeout.
    Nothing,
}

/// Waits until more than `known` entries are published, the writer has ended, or `patience` is over.
pub fn wait_for_entries(reader: &Arc<Reader>, known: u64, patience: Duration) -> News {
    let word = futex_word(reader.header_map());
    let value = word.load(std::sync::atomic::Ordering::Acquire);
    if reader.published_entries() > known {
        return News::Published(reader.published_entries());
    }
    if !reader.is_live() {
        // The writer may have published and closed between the two checks.
        let published = reader.published_entries();
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
    let published = reader.published_entries();
    if published > known {
        News::Published(published)
    } else {
        News::Nothing
    }
}

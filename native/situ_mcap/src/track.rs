//! The messages of one channel in time order.

/// The time of a message that orders the channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Times {
    /// The time when it was recorded, from the index.
    Log,
    /// The time when it was sent.
    Publish,
    /// The stamp of a ROS 1 message that begins with a header, otherwise the log time.
    Ros1Header,
    /// The stamp of a CDR message that begins with a header, otherwise the log time.
    CdrHeader,
}

impl Times {
    /// Returns whether the time is in the messages and not in the index.
    pub fn is_in_messages(self) -> bool {
        self != Times::Log
    }

    /// Returns the time of a message, ns.
    pub fn message_time(self, header: &mcap::records::MessageHeader, data: &[u8]) -> u64 {
        match self {
            Times::Log => header.log_time,
            Times::Publish => header.publish_time,
            Times::Ros1Header => read_stamp(data, 4, true).unwrap_or(header.log_time),
            Times::CdrHeader => {
                let little = data.get(1).is_some_and(|b| b & 1 == 1);
                read_stamp(data, 4, little).unwrap_or(header.log_time)
            }
        }
    }
}

/// Reads seconds and nanoseconds at `at`. A stamp of zero means that it was not set.
fn read_stamp(data: &[u8], at: usize, little: bool) -> Option<u64> {
    let word = |at: usize| -> Option<u32> {
        let bytes = data.get(at..at + 4)?.try_into().ok()?;
        Some(if little {
            u32::from_le_bytes(bytes)
        } else {
            u32::from_be_bytes(bytes)
        })
    };
    let (seconds, nanos) = (word(at)?, word(at + 4)?);
    if seconds == 0 && nanos == 0 || nanos >= 1_000_000_000 {
        return None;
    }
    Some(u64::from(seconds) * 1_000_000_000 + u64::from(nanos))
}

/// The position of a message. `chunk` is the chunk's number, or `LOOSE` for a message outside of chunks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Entry {
    pub time: u64,
    pub chunk: u32,
    pub offset: u64,
}

pub const LOOSE: u32 = u32::MAX;

/// Messages by time. Messages with equal times keep the file's order and are moved apart by a nanosecond.
#[derive(Debug, Default)]
pub struct Track {
    pub entries: Vec<Entry>,
}

impl Track {
    pub fn new(mut entries: Vec<Entry>) -> Self {
        entries.sort_by_key(|e| (e.time, e.chunk, e.offset));
        let mut last = None;
        for entry in &mut entries {
            if let Some(last) = last {
                if entry.time <= last {
                    entry.time = last + 1;
                }
            }
            last = Some(entry.time);
        }
        Track { entries }
    }

    /// Returns the number of the first message at or after `time`.
    pub fn seek(&self, time: i128) -> usize {
        self.entries.partition_point(|e| i128::from(e.time) < time)
    }
}

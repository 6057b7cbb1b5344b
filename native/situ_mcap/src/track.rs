//! One channel's messages in order of time.

/// Which of a message's times orders the channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Times {
    /// When it was recorded; the index has it.
    Log,
    /// When it was sent.
    Publish,
    /// The stamp of a ROS 1 message that begins with a header; else the log time.
    Ros1Header,
    /// The stamp of a CDR message that begins with a header; else the log time.
    CdrHeader,
    /// The timestamp that is the first field of a Protobuf message; else the log time.
    ProtobufStamp,
}

impl Times {
    /// Whether the messages have to be looked at.
    pub fn in_messages(self) -> bool {
        self != Times::Log
    }

    /// The time of a message, ns.
    pub fn of(self, header: &mcap::records::MessageHeader, data: &[u8]) -> u64 {
        match self {
            Times::Log => header.log_time,
            Times::Publish => header.publish_time,
            Times::Ros1Header => stamp(data, 4, true).unwrap_or(header.log_time),
            Times::CdrHeader => {
                let little = data.get(1).is_some_and(|b| b & 1 == 1);
                stamp(data, 4, little).unwrap_or(header.log_time)
            }
            Times::ProtobufStamp => timestamp(data).unwrap_or(header.log_time),
        }
    }
}

/// Seconds and nanoseconds at `at`; a stamp of zero means that it was not set.
fn stamp(data: &[u8], at: usize, little: bool) -> Option<u64> {
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

/// A `google.protobuf.Timestamp` that is written first, as field 1; one of zero means that nobody set it.
fn timestamp(data: &[u8]) -> Option<u64> {
    let rest = data.strip_prefix(&[0x0A])?;
    let (size, rest) = varint(rest)?;
    let mut fields = rest.get(..usize::try_from(size).ok()?)?;
    let (mut seconds, mut nanos) = (0, 0);
    while let Some((key, rest)) = varint(fields) {
        let (value, rest) = varint(rest)?;
        match key {
            0x08 => seconds = value,
            0x10 => nanos = value,
            _ => return None,
        }
        fields = rest;
    }
    if !fields.is_empty() || nanos >= 1_000_000_000 || (seconds == 0 && nanos == 0) {
        return None;
    }
    seconds.checked_mul(1_000_000_000)?.checked_add(nanos)
}

fn varint(data: &[u8]) -> Option<(u64, &[u8])> {
    let mut sum = 0u64;
    for (i, byte) in data.iter().take(10).enumerate() {
        sum |= u64::from(byte & 0x7F).checked_shl(7 * i as u32)?;
        if byte & 0x80 == 0 {
            return Some((sum, data.get(i + 1..)?));
        }
    }
    None
}

/// Where a message lies. `chunk` is the chunk's number, or `LOOSE` for one outside of chunks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Entry {
    pub time: u64,
    pub chunk: u32,
    pub offset: u64,
}

pub const LOOSE: u32 = u32::MAX;

/// Messages by time, and those of one time in the order of the file, a nanosecond apart.
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

    /// The number of the first message at or after `time`.
    pub fn seek(&self, time: i128) -> usize {
        self.entries.partition_point(|e| i128::from(e.time) < time)
    }
}

#[cfg(test)]
mod tests {
    use super::timestamp;

    #[test]
    fn timestamps_of_protobuf_messages() {
        // seconds = 300, nanos = 7, then another field.
        let written = [0x0A, 5, 0x08, 0xAC, 0x02, 0x10, 7, 0x12, 0];
        assert_eq!(timestamp(&written), Some(300_000_000_007));
        assert_eq!(timestamp(&[0x0A, 2, 0x10, 7]), Some(7));
        for wrong in [
            &[][..],
            &[0x0A, 0],
            &[0x0A, 9, 0x08, 1],
            &[0x12, 0],
            &[0x0A, 2, 0x1A, 0],
        ] {
            assert_eq!(timestamp(wrong), None);
        }
        // Before 1970, as two's complement: no time that a file has.
        let mut early = vec![0x0A, 11, 0x08];
        early.extend([0xFF; 9]);
        early.push(1);
        assert_eq!(timestamp(&early), None);
    }
}

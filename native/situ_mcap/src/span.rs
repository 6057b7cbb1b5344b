//! Finds the first and the last message of a channel.

use crate::{Reader, Result, Times};

impl Reader {
    /// Returns the first and the last time of a channel and its message count.
    pub fn channel_span(&self, channel: u16, times: Times) -> Result<Option<(u64, u64, u64)>> {
        if self.contents.entries.is_none() && !times.is_in_messages() {
            return self.indexed_span(channel);
        }
        let track = self.channel_track(channel, times)?;
        let ends = track.entries.first().zip(track.entries.last());
        Ok(ends.map(|(first, last)| (first.time, last.time, track.entries.len() as u64)))
    }

    /// Finds them by the message indexes of only those chunks that can contain the first or the last message.
    fn indexed_span(&self, channel: u16) -> Result<Option<(u64, u64, u64)>> {
        let mut chunks: Vec<(u64, u64, u64)> = Vec::new();
        for chunk in &self.contents.chunks {
            if let Some(&at) = chunk.indexes.get(&channel) {
                chunks.push((chunk.start, chunk.end, at));
            }
        }
        chunks.sort_unstable();
        let mut first: Option<u64> = None;
        for (start, _, at) in &chunks {
            if first.is_some_and(|first| *start > first) {
                break;
            }
            let found = self
                .message_index(channel, *at)?
                .iter()
                .map(|e| e.log_time)
                .min();
            first = [first, found].into_iter().flatten().min();
        }
        chunks.sort_unstable_by_key(|(_, end, _)| std::cmp::Reverse(*end));
        let mut last: Option<u64> = None;
        for (_, end, at) in &chunks {
            if last.is_some_and(|last| *end < last) {
                break;
            }
            let found = self
                .message_index(channel, *at)?
                .iter()
                .map(|e| e.log_time)
                .max();
            last = [last, found].into_iter().flatten().max();
        }
        let count = self.contents.counts.get(&channel).copied().unwrap_or(0);
        Ok(first.zip(last).map(|(first, last)| (first, last, count)))
    }
}

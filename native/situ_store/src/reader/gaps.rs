//! Where a stream paused.

use super::levels::Span;
use super::tracks::Known;
use super::{lock, Reader};
use crate::format::*;

impl Reader {
    /// The pauses of at least `least` ns between one message of a stream and the next: `(from, to)`, in order.
    /// Between chunks the index shows them; within a chunk its messages do, which are read only where the stored
    /// counts leave room for such a pause: where they are fine enough, a recording without pauses is not read.
    pub fn gaps(&self, stream: u32, least: i64) -> Vec<(i64, i64)> {
        let least = least.max(1);
        let rooms = self.rooms(stream, least);
        let mut gaps = Vec::new();
        let mut last = None;
        let mut see = |from: Option<i64>, to: i64| {
            if let Some(from) = from.filter(|from| to.saturating_sub(*from) >= least) {
                gaps.push((from, to));
            }
        };
        for entry in self.entries_between(stream, 0, Span::EVER) {
            see(last, entry.first);
            last = Some(entry.first);
            if entry.last.saturating_sub(entry.first) >= least && open(&rooms, &entry) {
                // The payloads do not matter here; damage ends the chunk.
                if let Ok(chunk) = self.chunk_checked(&entry, false) {
                    for (envelope, _) in chunk.messages().map_while(|message| message.ok()) {
                        see(last, envelope.time);
                        last = Some(envelope.time);
                    }
                }
            }
            last = Some(entry.last);
        }
        gaps
    }

    /// The times, in order, outside of which no pause can be by the counts of bins at most half as wide; no
    /// answer where no such counts are stored.
    fn rooms(&self, stream: u32, least: i64) -> Option<Vec<Span>> {
        let widest = (least / 2).checked_ilog2()? as u8;
        let level = *self.levels::<Known>(stream, widest).last()?;
        let width = 1i64 << level;
        let known = self.known(stream);
        let mut known = lock(&known);
        let mut rooms = Vec::new();
        let mut last: Option<i64> = None;
        self.stored(stream, level, Span::EVER, &mut *known, |bin| {
            // A pause of two widths has a whole bin in it, which is empty and therefore left out.
            if let Some(last) = last.filter(|last| bin.start > last.saturating_add(width)) {
                rooms.push(Span {
                    from: last,
                    to: bin.start.saturating_add(width - 1),
                });
            }
            last = Some(bin.start);
        });
        // The messages behind the last bin are not counted yet.
        rooms.push(Span {
            from: last.unwrap_or(i64::MIN),
            to: i64::MAX,
        });
        Some(rooms)
    }
}

/// Whether a pause may lie within the chunk of an entry.
fn open(rooms: &Option<Vec<Span>>, entry: &Entry) -> bool {
    let Some(rooms) = rooms else { return true };
    let at = rooms.partition_point(|room| room.to < entry.first);
    rooms.get(at).is_some_and(|room| room.from <= entry.last)
}

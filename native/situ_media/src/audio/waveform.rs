//! Extremes of short spans of audio, for drawing.

use super::mix::Layout;

/// Returns the minimum, the maximum, the last value and the frame count of each span of `span` frames, over all
/// channels, scaled to 1.0.
pub fn span_extremes(data: &[u8], layout: Layout, span: usize) -> Vec<(f64, f64, f64, usize)> {
    let size = layout.sample.byte_size();
    data.chunks(layout.frame_bytes() * span.max(1))
        .filter(|c| c.len() >= layout.frame_bytes())
        .map(|chunk| {
            let (mut min, mut max, mut last) = (f64::INFINITY, f64::NEG_INFINITY, 0.0);
            for b in chunk.chunks_exact(size) {
                last = layout.sample.read_value(b);
                // A NaN would spread to every aggregated span.
                if last.is_nan() {
                    last = 0.0;
                }
                min = f64::min(min, last);
                max = f64::max(max, last);
            }
            (min, max, last, chunk.len() / layout.frame_bytes())
        })
        .collect()
}

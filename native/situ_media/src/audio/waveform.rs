//! Extremes of short spans, for drawing.

use super::mix::Layout;

/// min, max, last and frames of each span of `span` frames, over all channels, full scale 1.0.
pub fn points(data: &[u8], layout: Layout, span: usize) -> Vec<(f64, f64, f64, usize)> {
    let size = layout.sample.bytes();
    data.chunks(layout.frame() * span.max(1))
        .filter(|c| c.len() >= layout.frame())
        .map(|chunk| {
            let (mut min, mut max, mut last) = (f64::INFINITY, f64::NEG_INFINITY, 0.0);
            for b in chunk.chunks_exact(size) {
                last = layout.sample.load(b);
                // A NaN would spoil every span above it.
                if last.is_nan() {
                    last = 0.0;
                }
                min = f64::min(min, last);
                max = f64::max(max, last);
            }
            (min, max, last, chunk.len() / layout.frame())
        })
        .collect()
}

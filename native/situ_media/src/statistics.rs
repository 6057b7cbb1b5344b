//! Statistics of an image for each channel, in memory order.

use crate::image::View;

/// The statistics of a channel's values as stored (0..255 or 0..65,535).
#[derive(Clone, Copy, Debug, Default)]
pub struct Channel {
    /// The minimum.
    pub min: u32,
    /// The maximum.
    pub max: u32,
    /// The mean.
    pub mean: f64,
    /// The standard deviation of the population.
    pub deviation: f64,
}

/// Calls `f` with every (channel, value).
fn for_each_value(src: &View, mut f: impl FnMut(usize, u32)) {
    let channels = src.shape.format.channel_count();
    if src.shape.format.bytes_per_channel() == 2 {
        for row in src.rows() {
            for (i, p) in row.chunks_exact(2).enumerate() {
                f(i % channels, u16::from_le_bytes([p[0], p[1]]) as u32);
            }
        }
    } else {
        for row in src.rows() {
            for p in row.chunks_exact(channels) {
                p.iter().enumerate().for_each(|(c, v)| f(c, *v as u32));
            }
        }
    }
}

/// Returns the minimum, maximum, mean and standard deviation of each channel.
pub fn channel_statistics(src: &View) -> Vec<Channel> {
    let n = src.shape.format.channel_count();
    let mut min = [u32::MAX; 4];
    let (mut max, mut sum, mut squares) = ([0u32; 4], [0u64; 4], [0u64; 4]);
    for_each_value(src, |c, v| {
        min[c] = min[c].min(v);
        max[c] = max[c].max(v);
        sum[c] += v as u64;
        squares[c] += v as u64 * v as u64;
    });
    let count = (src.shape.width * src.shape.height) as f64;
    (0..n)
        .map(|c| {
            let mean = sum[c] as f64 / count;
            let variance = (squares[c] as f64 / count - mean * mean).max(0.0);
            Channel {
                min: min[c],
                max: max[c],
                mean,
                deviation: variance.sqrt(),
            }
        })
        .collect()
}

/// Returns 256 bins for each channel; 16-bit values are binned by their high byte.
pub fn channel_histograms(src: &View) -> Vec<Vec<u32>> {
    let shift = if src.shape.format.bytes_per_channel() == 2 {
        8
    } else {
        0
    };
    let mut bins = vec![vec![0u32; 256]; src.shape.format.channel_count()];
    for_each_value(src, |c, v| bins[c][(v >> shift) as usize] += 1);
    bins
}

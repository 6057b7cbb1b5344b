//! Converts channels, gains and sample types in one pass: every output channel is a weighted sum of the input
//! channels.

use super::sample::Sample;
use crate::error::{fail, Code, Result};

/// The memory layout of audio: frames with one sample per channel, interleaved.
#[derive(Clone, Copy, Debug)]
pub struct Layout {
    /// The type of every sample.
    pub sample: Sample,
    /// The number of channels, 1 to 1,024.
    pub channels: usize,
}

impl Layout {
    /// Returns the bytes of a frame: one sample of every channel.
    pub fn frame_bytes(&self) -> usize {
        self.sample.byte_size() * self.channels
    }
}

/// Checks the arguments of a mix and returns the size of the result in bytes. `gains[o * input channels + i]` is the
/// gain from input channel `i` to output channel `o`.
pub fn mixed_size(data: &[u8], from: Layout, to: Layout, gains: &[f64]) -> Result<usize> {
    let frame = from.frame_bytes();
    if frame == 0 || to.channels == 0 || from.channels > 1024 || to.channels > 1024 {
        return fail(Code::BadAudio, "audio must have 1 to 1024 channels");
    }
    if !data.len().is_multiple_of(frame) {
        return fail(
            Code::BadAudio,
            format!(
                "{} bytes are not a multiple of the frame size of {frame} bytes",
                data.len()
            ),
        );
    }
    if gains.len() != from.channels * to.channels || gains.iter().any(|g| !g.is_finite()) {
        return fail(
            Code::BadOption,
            format!(
                "mixing needs {} finite gains for {} input and {} output channels",
                from.channels * to.channels,
                from.channels,
                to.channels
            ),
        );
    }
    let bytes = (data.len() / frame).checked_mul(to.frame_bytes());
    match bytes {
        Some(n) if n <= crate::image::MAX_BYTES => Ok(n),
        _ => fail(Code::TooLarge, "the result would need more than 1 GiB"),
    }
}

/// Mixes `data` into `out`, which must have the size that `mixed_size` returned.
pub fn mix(data: &[u8], from: Layout, to: Layout, gains: &[f64], out: &mut [u8]) {
    let (size, target) = (from.sample.byte_size(), to.sample.byte_size());
    if from.channels == 1 && to.channels == 1 {
        let gain = gains[0];
        for (b, o) in data.chunks_exact(size).zip(out.chunks_exact_mut(target)) {
            to.sample.write_value(from.sample.read_value(b) * gain, o);
        }
        return;
    }
    let mut frame = vec![0.0; from.channels];
    for (bytes, out) in data
        .chunks_exact(from.frame_bytes())
        .zip(out.chunks_exact_mut(to.frame_bytes()))
    {
        for (b, v) in bytes.chunks_exact(size).zip(frame.iter_mut()) {
            *v = from.sample.read_value(b);
        }
        for (row, o) in gains
            .chunks_exact(from.channels)
            .zip(out.chunks_exact_mut(target))
        {
            // A gain of 0 omits a channel even if it contains NaN.
            let sum = row
                .iter()
                .zip(&frame)
                .filter(|(g, _)| **g != 0.0)
                .map(|(g, v)| g * v)
                .sum();
            to.sample.write_value(sum, o);
        }
    }
}

/// Adds `other * gain` to `data`; both have the same layout. The rest of the longer one is copied.
pub fn add_scaled(data: &[u8], other: &[u8], layout: Layout, gain: f64, out: &mut [u8]) {
    let size = layout.sample.byte_size();
    let value_or_zero = |bytes: &[u8], at: usize| {
        bytes
            .get(at..at + size)
            .map_or(0.0, |b| layout.sample.read_value(b))
    };
    for (i, o) in out.chunks_exact_mut(size).enumerate() {
        let value = value_or_zero(data, i * size) + value_or_zero(other, i * size) * gain;
        layout.sample.write_value(value, o);
    }
}

/// Returns the peak and the root mean square of each channel, scaled to 1.0.
pub fn channel_levels(data: &[u8], layout: Layout) -> Vec<(f64, f64)> {
    let mut all = vec![(0.0f64, 0.0f64); layout.channels];
    let size = layout.sample.byte_size();
    for frame in data.chunks_exact(layout.frame_bytes()) {
        for (b, (peak, sum)) in frame.chunks_exact(size).zip(all.iter_mut()) {
            let v = layout.sample.read_value(b);
            *peak = peak.max(v.abs());
            *sum += v * v;
        }
    }
    let frames = (data.len() / layout.frame_bytes()).max(1) as f64;
    all.into_iter()
        .map(|(peak, sum)| (peak, (sum / frames).sqrt()))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_type_survives_a_round_trip_through_f64() {
        for sample in [Sample::U8, Sample::S16, Sample::S24, Sample::S32] {
            let mono = Layout {
                sample,
                channels: 1,
            };
            let wide = Layout {
                sample: Sample::F64,
                channels: 1,
            };
            let data: Vec<u8> = (0..240u32).map(|i| (i * 37 % 256) as u8).collect();
            let mut middle = vec![0; data.len() / sample.byte_size() * 8];
            mix(&data, mono, wide, &[1.0], &mut middle);
            let mut back = vec![0; data.len()];
            mix(&middle, wide, mono, &[1.0], &mut back);
            assert_eq!(data, back, "{sample:?}");
        }
    }

    #[test]
    fn clips_instead_of_wrapping() {
        let mono = Layout {
            sample: Sample::S16,
            channels: 1,
        };
        let mut out = [0; 4];
        mix(&[255, 127, 0, 128], mono, mono, &[2.0], &mut out);
        assert_eq!(out, [255, 127, 0, 128]);
    }
}

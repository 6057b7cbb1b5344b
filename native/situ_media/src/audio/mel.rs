//! Mel filter bank and cepstrum: the HTK mel scale (2595 log10(1 + f/700)), triangles of height 1, orthonormal
//! DCT-II.

/// Triangular filters over the bins of a spectrum, of equal width on the mel scale.
pub struct MelBank {
    /// The first bin and the weights of each triangle.
    filters: Vec<(usize, Vec<f64>)>,
}

fn hz_to_mel(hz: f64) -> f64 {
    2595.0 * (1.0 + hz / 700.0).log10()
}

fn mel_to_hz(mel: f64) -> f64 {
    700.0 * (10f64.powf(mel / 2595.0) - 1.0)
}

impl MelBank {
    /// Builds `bands` triangles from `low` to `high` Hz over the bins of a DFT of `fft_size` points, for audio at
    /// `rate` Hz.
    pub fn new(rate: f64, fft_size: usize, bands: usize, low: f64, high: f64) -> MelBank {
        let (from, to) = (hz_to_mel(low), hz_to_mel(high));
        let edge = |i: usize| mel_to_hz(from + (to - from) * i as f64 / (bands + 1) as f64);
        let bins = fft_size / 2 + 1;
        let filters = (0..bands)
            .map(|b| {
                let (left, mid, right) = (edge(b), edge(b + 1), edge(b + 2));
                let weight = |k: usize| {
                    let f = k as f64 * rate / fft_size as f64;
                    ((f - left) / (mid - left))
                        .min((right - f) / (right - mid))
                        .max(0.0)
                };
                let weights: Vec<f64> = (0..bins).map(weight).collect();
                let first = weights.iter().position(|w| *w > 0.0).unwrap_or(0);
                let last = weights.iter().rposition(|w| *w > 0.0).unwrap_or(0);
                (first, weights[first..=last].to_vec())
            })
            .collect();
        MelBank { filters }
    }

    /// Returns the natural logarithm of each band's power, at least ln(1e-10). `power` may omit the Nyquist bin.
    pub fn log_mel(&self, power: &[f64]) -> Vec<f64> {
        self.filters
            .iter()
            .map(|(first, weights)| {
                let bins = power.get(*first..).unwrap_or(&[]);
                let sum: f64 = weights.iter().zip(bins).map(|(w, p)| w * p).sum();
                sum.max(1e-10).ln()
            })
            .collect()
    }
}

/// Returns the first `count` coefficients of the orthonormal DCT-II.
pub fn cepstrum(log_mel: &[f64], count: usize) -> Vec<f64> {
    let n = log_mel.len() as f64;
    (0..count)
        .map(|k| {
            let scale = if k == 0 {
                (1.0 / n).sqrt()
            } else {
                (2.0 / n).sqrt()
            };
            let angle = std::f64::consts::PI * k as f64 / n;
            let sum: f64 = log_mel
                .iter()
                .enumerate()
                .map(|(i, v)| v * (angle * (i as f64 + 0.5)).cos())
                .sum();
            sum * scale
        })
        .collect()
}

//! Acoustic features of short frames of audio, as defined by \psi (with fixes, see `spectral_entropy`).

use super::mel::{cepstrum, MelBank};
use super::sample::Sample;
use crate::error::{fail, Code, Result};
use realfft::num_complex::Complex;
use realfft::{RealFftPlanner, RealToComplex};
use std::sync::Arc;

/// The audio format and the parameters of the analysis. Frequencies are in Hz and below half the sample rate.
#[derive(Clone, Copy, Debug)]
pub struct Config {
    /// The sample rate in Hz.
    pub rate: u32,
    /// The number of interleaved channels; the first one is analyzed.
    pub channels: usize,
    /// The sample type.
    pub sample: Sample,
    /// The number of samples in a frame.
    pub frame: usize,
    /// The number of samples between the starts of two frames, 1 to `frame`.
    pub shift: usize,
    /// The amplitude of the dither, or 0 for none.
    pub dither_scale: f64,
    /// The lower end of the band for energy and entropy.
    pub start_hz: f64,
    /// The upper end of the band for energy.
    pub end_hz: f64,
    /// The upper end of the low band, which begins at `start_hz`.
    pub low_end_hz: f64,
    /// The lower end of the high band, which ends at `end_hz`.
    pub high_start_hz: f64,
    /// The width of the band for entropy, which begins at `start_hz`.
    pub entropy_bandwidth_hz: f64,
    /// The number of mel bands, or 0 for none.
    pub mel_bands: usize,
    /// The number of cepstral coefficients, at most `mel_bands`.
    pub cepstra: usize,
    /// The lower end of the lowest mel band.
    pub mel_low_hz: f64,
    /// The upper end of the highest mel band.
    pub mel_high_hz: f64,
}

/// The features of one frame.
pub struct Frame {
    /// The natural logarithm of the mean square of the windowed samples, scaled to 16-bit integers; -92.1 for
    /// silence.
    pub log_energy: f64,
    /// Sign changes per sample, 0..1.
    pub zero_crossing_rate: f64,
    /// The power in the band from `start_hz` to `end_hz`.
    pub energy: f64,
    /// The power in the low band.
    pub low_energy: f64,
    /// The power in the high band.
    pub high_energy: f64,
    /// The spectral entropy, from 0 (a single frequency, or silence) to 1 (noise).
    pub entropy: f64,
    /// The bins 0 .. fft size / 2 - 1 of the textbook DFT of the windowed, zero-padded frame, without scaling.
    pub spectrum: Vec<Complex<f64>>,
    /// |X|² of the same bins.
    pub power: Vec<f64>,
    /// The natural logarithm of each mel band's power, lowest band first; empty without bands.
    pub log_mel: Vec<f64>,
    /// The first `cepstra` coefficients of the DCT-II of `log_mel`.
    pub cepstrum: Vec<f64>,
}

/// The window, transform and filter bank of a configuration. An analyzer is not tied to one stream.
pub struct Analyzer {
    config: Config,
    fft: Arc<dyn RealToComplex<f64>>,
    window: Vec<f64>,
    bank: Option<MelBank>,
    padded: Vec<f64>,
    spectrum: Vec<Complex<f64>>,
}

impl Analyzer {
    /// Builds an analyzer. Returns [`Code::BadOption`] for frames of more than 2^20 samples, a shift greater than the
    /// frame, more cepstral coefficients than mel bands, or more than 1,024 mel bands.
    pub fn new(config: Config) -> Result<Analyzer> {
        let sizes_fit =
            (1..=1 << 20).contains(&config.frame) && (1..=config.frame).contains(&config.shift);
        if !sizes_fit || config.channels == 0 || config.rate == 0 {
            return fail(
                Code::BadOption,
                format!(
                    "a frame of {} samples with a shift of {} samples is invalid: the frame must have 1 to 1048576 \
                     samples, and the shift must be 1 to the frame size",
                    config.frame, config.shift
                ),
            );
        }
        if config.cepstra > config.mel_bands || config.mel_bands > 1024 {
            return fail(
                Code::BadOption,
                "there must be at most 1024 mel bands, and no more cepstral coefficients than bands",
            );
        }
        let size = config.frame.next_power_of_two();
        let fft = RealFftPlanner::<f64>::new().plan_fft_forward(size);
        let n = config.frame as f64;
        let hann = |i: usize| 0.5 * (1.0 - (2.0 * std::f64::consts::PI * i as f64 / n).cos());
        let bank = (config.mel_bands > 0).then(|| {
            MelBank::new(
                config.rate as f64,
                size,
                config.mel_bands,
                config.mel_low_hz,
                config.mel_high_hz,
            )
        });
        Ok(Analyzer {
            window: (0..config.frame).map(hann).collect(),
            padded: vec![0.0; size],
            spectrum: fft.make_output_vec(),
            bank,
            fft,
            config,
        })
    }

    /// Returns the bytes of one sample of all channels.
    fn block_bytes(&self) -> usize {
        self.config.channels * self.config.sample.byte_size()
    }

    /// Analyzes every complete frame in `data`, at multiples of the shift. `index` counts frames since the start of
    /// the stream. It seeds the dither, so the result does not depend on the size of the audio chunks.
    pub fn analyze_frames(&mut self, data: &[u8], index: u64) -> Result<Vec<Frame>> {
        let block = self.block_bytes();
        if !data.len().is_multiple_of(block) {
            return fail(
                Code::BadAudio,
                format!(
                    "{} bytes are not a multiple of the frame size of {block} bytes",
                    data.len()
                ),
            );
        }
        let samples = data.len() / block;
        let mut frames = Vec::new();
        let mut start = 0;
        while start + self.config.frame <= samples {
            let bytes = &data[start * block..(start + self.config.frame) * block];
            frames.push(self.analyze_frame(bytes, index + frames.len() as u64)?);
            start += self.config.shift;
        }
        Ok(frames)
    }

    fn analyze_frame(&mut self, bytes: &[u8], index: u64) -> Result<Frame> {
        let Config { sample, frame, .. } = self.config;
        let float = matches!(sample, Sample::F32 | Sample::F64);
        // Integers are used as they are. Floats are scaled to 16 bits, so that the same thresholds apply.
        let scale = if float { 32_768.0 } else { 1.0 };
        let mut noise = Noise::new(index);
        for (i, block) in bytes.chunks_exact(self.block_bytes()).enumerate() {
            let dither = noise.next_value() * self.config.dither_scale;
            self.padded[i] = (sample.raw_value(block) * scale + dither) * self.window[i];
        }
        self.padded[frame..].fill(0.0);
        let windowed = &self.padded[..frame];
        let log_energy = log_energy(windowed);
        let zero_crossing_rate = zero_crossing_rate(windowed);
        if self
            .fft
            .process(&mut self.padded, &mut self.spectrum)
            .is_err()
        {
            return fail(Code::Failed, "the Fourier transform rejected its buffers");
        }
        // The Nyquist bin is omitted.
        let bins = self.spectrum.len().saturating_sub(1).max(1);
        let spectrum = self.spectrum[..bins].to_vec();
        let power: Vec<f64> = spectrum.iter().map(|c| c.norm_sqr()).collect();
        let full = if float { 32_768.0 } else { sample.full_scale() };
        let (log_mel, cepstrum) = self.mel_features(full * full);
        Ok(Frame {
            log_energy,
            zero_crossing_rate,
            energy: self.band_power(&power, self.config.start_hz, self.config.end_hz),
            low_energy: self.band_power(&power, self.config.start_hz, self.config.low_end_hz),
            high_energy: self.band_power(&power, self.config.high_start_hz, self.config.end_hz),
            entropy: self.spectral_entropy(&power),
            spectrum,
            power,
            log_mel,
            cepstrum,
        })
    }

    /// Computes the mel features of samples scaled to -1..1.
    fn mel_features(&self, full_power: f64) -> (Vec<f64>, Vec<f64>) {
        let Some(bank) = &self.bank else {
            return (vec![], vec![]);
        };
        let power: Vec<f64> = self
            .spectrum
            .iter()
            .map(|c| c.norm_sqr() / full_power)
            .collect();
        let log_mel = bank.log_mel(&power);
        let cepstrum = cepstrum(&log_mel, self.config.cepstra);
        (log_mel, cepstrum)
    }

    fn bin_width(&self) -> f64 {
        self.config.rate as f64 / self.padded.len() as f64
    }

    /// Sums the power of a band, with the first bin rounded down, the last bin rounded to the nearest, both included.
    fn band_power(&self, power: &[f64], from: f64, to: f64) -> f64 {
        let a = (from / self.bin_width()) as usize;
        let b = (to / self.bin_width() + 0.5) as usize;
        power_range(power, a, b).iter().sum()
    }

    /// Computes the entropy of the band from the start frequency on, with both ends rounded down, 0..1. Bins without
    /// power are skipped and silence has 0, where \psi returns NaN.
    fn spectral_entropy(&self, power: &[f64]) -> f64 {
        let a = (self.config.start_hz / self.bin_width()) as usize;
        let b =
            ((self.config.start_hz + self.config.entropy_bandwidth_hz) / self.bin_width()) as usize;
        let band = power_range(power, a, b);
        let sum: f64 = band.iter().sum();
        if sum <= 0.0 || band.len() < 2 {
            return 0.0;
        }
        let bits: f64 = band
            .iter()
            .filter(|p| **p > 0.0)
            .map(|p| -(p / sum) * (p / sum).log10())
            .sum();
        // Rounding errors may slightly exceed the range.
        (bits / (band.len() as f64).log10()).clamp(0.0, 1.0)
    }
}

fn power_range(power: &[f64], a: usize, b: usize) -> &[f64] {
    power
        .get(a..=b.min(power.len().saturating_sub(1)))
        .unwrap_or(&[])
}

fn log_energy(windowed: &[f64]) -> f64 {
    let energy = windowed.iter().map(|v| v * v).sum::<f64>() / windowed.len() as f64;
    if energy < 1e-40 {
        -92.1
    } else {
        energy.ln()
    }
}

/// Counts sign changes. A sample of exactly 0 interrupts a crossing, which is then not counted.
fn zero_crossing_rate(windowed: &[f64]) -> f64 {
    let crossings = windowed.windows(2).filter(|w| w[0] * w[1] < 0.0).count();
    crossings as f64 / windowed.len() as f64
}

/// A splitmix64 generator of uniform numbers in -1..1.
struct Noise(u64);

impl Noise {
    fn new(seed: u64) -> Noise {
        Noise(seed.wrapping_mul(0xD1B5_4A32_D192_ED03))
    }

    fn next_value(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
}

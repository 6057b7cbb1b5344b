//! Acoustic features of short frames of sound, as \psi defines them (its defects mended, see `entropy`).

use super::mel::{cepstrum, MelBank};
use super::sample::Sample;
use crate::error::{fail, Code, Result};
use realfft::num_complex::Complex;
use realfft::{RealFftPlanner, RealToComplex};
use std::sync::Arc;

/// The sound to analyse, and the parameters. Frequencies are in Hz, below half the rate.
#[derive(Clone, Copy, Debug)]
pub struct Config {
    /// Samples a second, of one channel.
    pub rate: u32,
    /// Channels, interleaved; the first one is analysed.
    pub channels: usize,
    /// The type of the samples.
    pub sample: Sample,
    /// Samples of a frame, and from one frame to the next.
    pub frame: usize,
    /// 1 to `frame`.
    pub shift: usize,
    /// 0 for none.
    pub dither_scale: f64,
    /// Where the band begins that energy and entropy are taken of.
    pub start_hz: f64,
    /// Where it ends.
    pub end_hz: f64,
    /// Where the low band ends; it begins at `start_hz`.
    pub low_end_hz: f64,
    /// Where the high band begins; it ends at `end_hz`.
    pub high_start_hz: f64,
    /// How wide the band is, from `start_hz` on, that entropy is taken of.
    pub entropy_bandwidth_hz: f64,
    /// 0 for none.
    pub mel_bands: usize,
    /// Coefficients of the cepstrum, at most `mel_bands`.
    pub cepstra: usize,
    /// Where the lowest mel band begins.
    pub mel_low_hz: f64,
    /// Where the highest ends.
    pub mel_high_hz: f64,
}

/// The features of one frame.
pub struct Frame {
    /// Natural logarithm of the mean square of the windowed samples, counted as 16-bit integers; -92.1 for silence.
    pub log_energy: f64,
    /// Changes of sign a sample, 0..1.
    pub zero_crossing_rate: f64,
    /// Power in the band from `start_hz` to `end_hz`.
    pub energy: f64,
    /// Power in the low band.
    pub low_energy: f64,
    /// Power in the high band.
    pub high_energy: f64,
    /// Spectral entropy, 0 (one frequency, or silence) to 1 (noise).
    pub entropy: f64,
    /// Bins 0 .. fft size / 2 - 1; the textbook DFT of the windowed, zero-padded frame, not scaled.
    pub spectrum: Vec<Complex<f64>>,
    /// |X|² of the same bins.
    pub power: Vec<f64>,
    /// Natural logarithm of each mel band's power, the lowest first; empty without bands.
    pub log_mel: Vec<f64>,
    /// The first `cepstra` coefficients of the DCT-II of `log_mel`.
    pub cepstrum: Vec<f64>,
}

/// Window, transform and filter bank for one configuration, made once; not tied to one stream.
pub struct Analyzer {
    config: Config,
    fft: Arc<dyn RealToComplex<f64>>,
    window: Vec<f64>,
    bank: Option<MelBank>,
    padded: Vec<f64>,
    spectrum: Vec<Complex<f64>>,
}

impl Analyzer {
    /// Refuses ([`Code::BadOption`]) frames of more than 2^20 samples, a shift beyond the frame, and more
    /// cepstra than mel
    /// bands or more than 1,024 of those.
    pub fn new(config: Config) -> Result<Analyzer> {
        let sizes_fit =
            (1..=1 << 20).contains(&config.frame) && (1..=config.frame).contains(&config.shift);
        if !sizes_fit || config.channels == 0 || config.rate == 0 {
            return fail(
                Code::BadOption,
                format!(
                    "a frame of {} samples every {} samples is impossible (1 to 1048576, shift <= frame)",
                    config.frame, config.shift
                ),
            );
        }
        if config.cepstra > config.mel_bands || config.mel_bands > 1024 {
            return fail(
                Code::BadOption,
                "there are at most 1024 mel bands, and no more cepstra than bands",
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

    /// Bytes of one audio frame (all channels).
    fn block(&self) -> usize {
        self.config.channels * self.config.sample.bytes()
    }

    /// Every whole frame in `data`, at multiples of the shift; `index` counts frames since the start of the stream and
    /// seeds the dither, so the result does not depend on how the sound was cut into pieces.
    pub fn frames(&mut self, data: &[u8], index: u64) -> Result<Vec<Frame>> {
        let block = self.block();
        if !data.len().is_multiple_of(block) {
            return fail(
                Code::BadAudio,
                format!("{} bytes are not whole frames of {block} bytes", data.len()),
            );
        }
        let samples = data.len() / block;
        let mut frames = Vec::new();
        let mut start = 0;
        while start + self.config.frame <= samples {
            let bytes = &data[start * block..(start + self.config.frame) * block];
            frames.push(self.frame(bytes, index + frames.len() as u64)?);
            start += self.config.shift;
        }
        Ok(frames)
    }

    fn frame(&mut self, bytes: &[u8], index: u64) -> Result<Frame> {
        let Config { sample, frame, .. } = self.config;
        let float = matches!(sample, Sample::F32 | Sample::F64);
        // Integers count as they are; floats as if they were 16 bit, so that thresholds carry over.
        let scale = if float { 32_768.0 } else { 1.0 };
        let mut noise = Noise::new(index);
        for (i, block) in bytes.chunks_exact(self.block()).enumerate() {
            let dither = noise.next() * self.config.dither_scale;
            self.padded[i] = (sample.raw(block) * scale + dither) * self.window[i];
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
            return fail(Code::Failed, "the Fourier transform refused its buffers");
        }
        // The Nyquist bin is left out.
        let bins = self.spectrum.len().saturating_sub(1).max(1);
        let spectrum = self.spectrum[..bins].to_vec();
        let power: Vec<f64> = spectrum.iter().map(|c| c.norm_sqr()).collect();
        let full = if float { 32_768.0 } else { sample.full_scale() };
        let (log_mel, cepstrum) = self.mel(full * full);
        Ok(Frame {
            log_energy,
            zero_crossing_rate,
            energy: self.band(&power, self.config.start_hz, self.config.end_hz),
            low_energy: self.band(&power, self.config.start_hz, self.config.low_end_hz),
            high_energy: self.band(&power, self.config.high_start_hz, self.config.end_hz),
            entropy: self.entropy(&power),
            spectrum,
            power,
            log_mel,
            cepstrum,
        })
    }

    /// Mel features of samples scaled to -1..1.
    fn mel(&self, full_power: f64) -> (Vec<f64>, Vec<f64>) {
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

    /// First bin floored, last bin rounded, both included.
    fn band(&self, power: &[f64], from: f64, to: f64) -> f64 {
        let a = (from / self.bin_width()) as usize;
        let b = (to / self.bin_width() + 0.5) as usize;
        slice(power, a, b).iter().sum()
    }

    /// Of the band from the start frequency on, both ends floored, 0..1. Bins without power count for nothing and
    /// silence has 0, where \psi gives NaN.
    fn entropy(&self, power: &[f64]) -> f64 {
        let a = (self.config.start_hz / self.bin_width()) as usize;
        let b =
            ((self.config.start_hz + self.config.entropy_bandwidth_hz) / self.bin_width()) as usize;
        let band = slice(power, a, b);
        let sum: f64 = band.iter().sum();
        if sum <= 0.0 || band.len() < 2 {
            return 0.0;
        }
        let bits: f64 = band
            .iter()
            .filter(|p| **p > 0.0)
            .map(|p| -(p / sum) * (p / sum).log10())
            .sum();
        // Rounding may go a hair beyond the ends.
        (bits / (band.len() as f64).log10()).clamp(0.0, 1.0)
    }
}

fn slice(power: &[f64], a: usize, b: usize) -> &[f64] {
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

/// A sample of exactly 0 breaks a crossing: it is not counted.
fn zero_crossing_rate(windowed: &[f64]) -> f64 {
    let crossings = windowed.windows(2).filter(|w| w[0] * w[1] < 0.0).count();
    crossings as f64 / windowed.len() as f64
}

/// splitmix64 as uniform numbers in -1..1.
struct Noise(u64);

impl Noise {
    fn new(seed: u64) -> Noise {
        Noise(seed.wrapping_mul(0xD1B5_4A32_D192_ED03))
    }

    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
}

//! Streaming sample rate conversion with libsoxr. The filter has linear phase and its delay is compensated, so output
//! frame k is at time k / rate.
#![allow(unsafe_code)]

use super::sample::Sample;
use super::soxr;
use crate::error::{fail, Code, Error, Result};
use std::ffi::{c_char, c_void, CStr};

/// The quality recipes of soxr, from fast to exact.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quality {
    /// Cubic interpolation without an anti-aliasing filter.
    Quick,
    /// 16 bits with a gentle rolloff.
    Low,
    /// 16 bits with a steeper rolloff.
    Medium,
    /// 20 bits: sufficient for 16-bit audio.
    High,
    /// 28 bits: for 24-bit audio.
    VeryHigh,
}

/// The number of frames fed at a time, so that the state of soxr stays in the cache.
const PORTION: usize = 16 * 1024;

/// Extra output frames beyond the estimate from rates and delay, and space for soxr to see that nothing more follows.
const MARGIN: usize = 64;

/// The maximum ratio of the two rates.
const MAX_RATIO: u64 = 1000;

/// A rate conversion in progress, with the audio that it still holds.
pub struct Resampler {
    handle: *mut soxr::Handle,
    frame: usize,
    align: usize,
    ratio: f64,
    finished: bool,
}

// SAFETY: a soxr handle is not tied to the thread that created it, and &mut self serializes its use.
unsafe impl Send for Resampler {}

impl Resampler {
    /// Builds a resampler. Input and output have the same sample type: :s16, :s32, :f32 or :f64.
    pub fn new(
        from: u32,
        to: u32,
        channels: usize,
        sample: Sample,
        quality: Quality,
    ) -> Result<Resampler> {
        let kind = match sample {
            Sample::S16 => soxr::INT16,
            Sample::S32 => soxr::INT32,
            Sample::F32 => soxr::FLOAT32,
            Sample::F64 => soxr::FLOAT64,
            Sample::U8 | Sample::S24 => {
                return fail(
                    Code::BadAudio,
                    "resampling supports :s16, :s32, :f32 and :f64",
                )
            }
        };
        let rates_fit = (1..=16_000_000).contains(&from) && (1..=16_000_000).contains(&to);
        if !rates_fit || !(1..=1024).contains(&channels) {
            return fail(
                Code::BadOption,
                format!("cannot resample {channels} channels from {from} Hz to {to} Hz"),
            );
        }
        // Beyond this ratio, flushing libsoxr takes seconds, and its quick recipe never returns at ratios of 8,000
        // and more.
        if u64::from(from.max(to)) > u64::from(from.min(to)) * MAX_RATIO {
            return fail(
                Code::BadOption,
                format!(
                    "cannot resample from {from} Hz to {to} Hz: the ratio is more than {MAX_RATIO}"
                ),
            );
        }
        let io = soxr::IoSpec {
            itype: kind,
            otype: kind,
            scale: 1.0,
            e: std::ptr::null_mut(),
            // Without dither, the same input always produces the same bytes.
            flags: soxr::NO_DITHER,
        };
        let recipe = match quality {
            Quality::Quick => 0,
            Quality::Low => 1,
            Quality::Medium => 2,
            Quality::High => 4,
            Quality::VeryHigh => 6,
        };
        let mut error: *const c_char = std::ptr::null();
        // SAFETY: all pointers refer to live local variables, and soxr copies the specs.
        let handle = unsafe {
            let spec = soxr::soxr_quality_spec(recipe, 0);
            soxr::soxr_create(
                from.into(),
                to.into(),
                channels as u32,
                &mut error,
                &io,
                &spec,
                std::ptr::null(),
            )
        };
        if handle.is_null() || !error.is_null() {
            return Err(soxr_error(error));
        }
        Ok(Resampler {
            handle,
            frame: channels * sample.byte_size(),
            align: sample.byte_size(),
            ratio: to as f64 / from as f64,
            finished: false,
        })
    }

    /// Returns the maximum number of bytes that `process` writes for this much input.
    pub fn output_capacity(&self, bytes: usize) -> Result<usize> {
        let frames = bytes / self.frame;
        // SAFETY: the handle lives as long as self.
        let inside = unsafe { soxr::soxr_delay(self.handle) }.max(0.0);
        let frames = (frames as f64 * self.ratio + inside).ceil() as usize + MARGIN;
        match frames.checked_mul(self.frame) {
            Some(room) if room <= crate::image::MAX_BYTES => Ok(room),
            _ => fail(Code::TooLarge, "the result would need more than 1 GiB"),
        }
    }

    /// Feeds complete frames, writes the available output to the start of `out`, and returns the number of written
    /// bytes. If `last` is set, all buffered audio is flushed, too. `out` must have `output_capacity` bytes.
    pub fn process(&mut self, data: &[u8], last: bool, out: &mut [u8]) -> Result<usize> {
        if self.finished {
            return fail(Code::Failed, "the resampler was already flushed");
        }
        if !data.len().is_multiple_of(self.frame) {
            return fail(
                Code::BadAudio,
                format!(
                    "{} bytes are not a multiple of the frame size of {} bytes",
                    data.len(),
                    self.frame
                ),
            );
        }
        let frames = data.len() / self.frame;
        let copy;
        let aligned = if (data.as_ptr() as usize).is_multiple_of(self.align) {
            data.as_ptr()
        } else {
            copy = aligned_copy(data);
            copy.as_ptr() as *const u8
        };
        let (mut done, mut written) = (0, 0);
        while done < frames {
            // SAFETY: `done` of `frames` frames were consumed, so the rest is inside the input.
            let from = unsafe { aligned.add(done * self.frame) };
            let rest = &mut out[written..];
            let portion = (frames - done).min(PORTION);
            let (used, made) = self.process_portion(from as *const c_void, portion, rest)?;
            done += used;
            written += made * self.frame;
            if used == 0 && made == 0 {
                return fail(Code::Failed, "the resampler made no progress");
            }
        }
        if last {
            self.finished = true;
            loop {
                let (_, made) = self.process_portion(std::ptr::null(), 0, &mut out[written..])?;
                if made == 0 {
                    break;
                }
                written += made * self.frame;
            }
        }
        Ok(written)
    }

    fn process_portion(
        &mut self,
        from: *const c_void,
        frames: usize,
        out: &mut [u8],
    ) -> Result<(usize, usize)> {
        let room = out.len() / self.frame;
        if room == 0 {
            return fail(
                Code::Failed,
                "the resampler produced more output than estimated",
            );
        }
        if !(out.as_ptr() as usize).is_multiple_of(self.align) {
            return fail(Code::Failed, "the output buffer is not aligned");
        }
        let (mut used, mut made) = (0, 0);
        // SAFETY: `from` has `frames` frames (or is null at the end of the input). `out` has `room` frames and is
        // aligned for its samples, and soxr writes no more than `made` frames.
        let error = unsafe {
            let to = out.as_mut_ptr() as *mut c_void;
            soxr::soxr_process(self.handle, from, frames, &mut used, to, room, &mut made)
        };
        if error.is_null() {
            Ok((used, made.min(room)))
        } else {
            Err(soxr_error(error))
        }
    }
}

impl Drop for Resampler {
    fn drop(&mut self) {
        // SAFETY: the handle was created by soxr_create and is deleted once.
        unsafe { soxr::soxr_delete(self.handle) }
    }
}

fn aligned_copy(data: &[u8]) -> Vec<u64> {
    let word = |chunk: &[u8]| {
        let mut bytes = [0; 8];
        bytes[..chunk.len()].copy_from_slice(chunk);
        u64::from_ne_bytes(bytes)
    };
    data.chunks(8).map(word).collect()
}

fn soxr_error(message: *const c_char) -> Error {
    let text = if message.is_null() {
        "no memory".into()
    } else {
        // SAFETY: the errors of soxr are static C strings.
        unsafe { CStr::from_ptr(message) }.to_string_lossy()
    };
    Error {
        code: Code::Failed,
        what: format!("libsoxr: {text}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sine_wave(rate: f64, frames: usize) -> Vec<f32> {
        (0..frames)
            .map(|i| (2.0 * std::f64::consts::PI * 440.0 * i as f64 / rate).sin() as f32 * 0.5)
            .collect()
    }

    fn sample_bytes(values: &[f32]) -> Vec<u8> {
        values.iter().flat_map(|v| v.to_le_bytes()).collect()
    }

    fn resample_chunk(filter: &mut Resampler, data: &[u8], last: bool) -> Result<Vec<u8>> {
        let mut out = vec![0; filter.output_capacity(data.len())?];
        let written = filter.process(data, last, &mut out)?;
        out.truncate(written);
        Ok(out)
    }

    #[test]
    fn output_is_aligned_with_the_input_for_every_chunk_size() -> Result<()> {
        let input = sample_bytes(&sine_wave(48_000.0, 48_000));
        let mut whole = Resampler::new(48_000, 16_000, 1, Sample::F32, Quality::High)?;
        let a = resample_chunk(&mut whole, &input, true)?;
        let mut parts = Resampler::new(48_000, 16_000, 1, Sample::F32, Quality::High)?;
        let mut b = Vec::new();
        for chunk in input.chunks(4 * 777) {
            b.extend(resample_chunk(&mut parts, chunk, false)?);
        }
        b.extend(resample_chunk(&mut parts, &[], true)?);
        assert_eq!(a, b);
        assert_eq!(a.len() / 4, 16_000);
        let wanted = sine_wave(16_000.0, 16_000);
        for (i, got) in a.chunks_exact(4).enumerate().skip(200).take(15_600) {
            let got = f32::from_le_bytes([got[0], got[1], got[2], got[3]]);
            assert!((got - wanted[i]).abs() < 1e-4, "frame {i}");
        }
        Ok(())
    }

    #[test]
    fn rates_with_too_large_a_ratio_are_rejected() -> Result<()> {
        let new = |from, to| Resampler::new(from, to, 1, Sample::F32, Quality::Quick);
        for (from, to) in [(11_025, 1), (1, 8_000), (48_000, 47)] {
            assert!(new(from, to).is_err_and(|e| e.code == Code::BadOption));
        }
        // The maximum ratio terminates.
        let mut filter = new(48_000, 48)?;
        assert_eq!(
            resample_chunk(&mut filter, &sample_bytes(&[0.5; 4800]), true)?.len() / 4,
            5
        );
        Ok(())
    }

    #[test]
    fn the_estimated_capacity_is_enough_for_every_ratio_and_chunk() -> Result<()> {
        let rates = [
            (8_000, 48_000),
            (48_000, 8_000),
            (44_100, 48_000),
            (8_000, 192_000),
            (96_000, 4_000),
        ];
        let qualities = [Quality::Quick, Quality::Low, Quality::VeryHigh];
        for (from, to) in rates {
            for quality in qualities {
                let mut filter = Resampler::new(from, to, 2, Sample::S16, quality)?;
                let mut frames = 0;
                let mut made = 0;
                for chunk in [1, 0, 160, 7, 5_000, 3] {
                    frames += chunk;
                    made += resample_chunk(&mut filter, &vec![1; chunk * 4], false)?.len() / 4;
                }
                made += resample_chunk(&mut filter, &[], true)?.len() / 4;
                let wanted = frames as f64 * to as f64 / from as f64;
                assert!(
                    (made as f64 - wanted).abs() <= 1.0,
                    "{from} to {to}: {made}"
                );
            }
        }
        Ok(())
    }
}

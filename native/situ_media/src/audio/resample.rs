//! Streaming sample rate conversion by libsoxr: linear phase, its delay taken out (output frame k lies at k / rate).
#![allow(unsafe_code)]

use super::sample::Sample;
use super::soxr;
use crate::error::{fail, Code, Error, Result};
use std::ffi::{c_char, c_void, CStr};

/// soxr's recipes, from fast to exact.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quality {
    /// Cubic interpolation: no filter against aliases.
    Quick,
    /// 16 bits with a soft edge.
    Low,
    /// 16 bits with a sharper edge.
    Medium,
    /// 20 bits: what sound cards' 16 bits need.
    High,
    /// 28 bits: for 24-bit sound.
    VeryHigh,
}

/// Frames that are fed at a time: what soxr keeps of them stays in the cache.
const PORTION: usize = 16 * 1024;

/// Frames that may come beyond what rates and delay say, and room for soxr to see that nothing more comes.
const MARGIN: usize = 64;

/// The most that one rate may be of the other.
const MAX_RATIO: u64 = 1000;

/// A rate conversion under way, with what it still holds of the sound fed so far.
pub struct Resampler {
    handle: *mut soxr::Handle,
    frame: usize,
    align: usize,
    ratio: f64,
    finished: bool,
}

// SAFETY: a soxr handle has no ties to the thread that made it; &mut self serialises its use.
unsafe impl Send for Resampler {}

impl Resampler {
    /// Same sample type in and out: :s16, :s32, :f32 or :f64.
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
                    "resampling works on :s16, :s32, :f32 and :f64",
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
        // Beyond, libsoxr's flush takes seconds, and from 8,000 times on its quick recipe never returns.
        if u64::from(from.max(to)) > u64::from(from.min(to)) * MAX_RATIO {
            return fail(
                Code::BadOption,
                format!("cannot resample from {from} Hz to {to} Hz: more than {MAX_RATIO} times"),
            );
        }
        let io = soxr::IoSpec {
            itype: kind,
            otype: kind,
            scale: 1.0,
            e: std::ptr::null_mut(),
            // Without dither the same input gives the same bytes.
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
        // SAFETY: all pointers are to live locals; soxr copies the specs.
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
            return Err(failure(error));
        }
        Ok(Resampler {
            handle,
            frame: channels * sample.bytes(),
            align: sample.bytes(),
            ratio: to as f64 / from as f64,
            finished: false,
        })
    }

    /// The bytes that `process` needs at most for this much input.
    pub fn room(&self, bytes: usize) -> Result<usize> {
        let frames = bytes / self.frame;
        // SAFETY: the handle lives as long as self.
        let inside = unsafe { soxr::soxr_delay(self.handle) }.max(0.0);
        let frames = (frames as f64 * self.ratio + inside).ceil() as usize + MARGIN;
        match frames.checked_mul(self.frame) {
            Some(room) if room <= crate::picture::MAX_BYTES => Ok(room),
            _ => fail(Code::TooLarge, "the result would take more than 1 GiB"),
        }
    }

    /// Feeds whole frames and writes what is ready to the front of `out`, with `last` also everything that was still
    /// inside; answers the bytes written. `out` has `room` bytes.
    pub fn process(&mut self, data: &[u8], last: bool, out: &mut [u8]) -> Result<usize> {
        if self.finished {
            return fail(Code::Failed, "the resampler was already flushed");
        }
        if !data.len().is_multiple_of(self.frame) {
            return fail(
                Code::BadAudio,
                format!(
                    "{} bytes are not whole frames of {} bytes",
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
            // SAFETY: `done` frames of `frames` were consumed, so the rest lies inside the input.
            let from = unsafe { aligned.add(done * self.frame) };
            let rest = &mut out[written..];
            let portion = (frames - done).min(PORTION);
            let (used, made) = self.step(from as *const c_void, portion, rest)?;
            done += used;
            written += made * self.frame;
            if used == 0 && made == 0 {
                return fail(Code::Failed, "the resampler stands still");
            }
        }
        if last {
            self.finished = true;
            loop {
                let (_, made) = self.step(std::ptr::null(), 0, &mut out[written..])?;
                if made == 0 {
                    break;
                }
                written += made * self.frame;
            }
        }
        Ok(written)
    }

    fn step(
        &mut self,
        from: *const c_void,
        frames: usize,
        out: &mut [u8],
    ) -> Result<(usize, usize)> {
        let room = out.len() / self.frame;
        if room == 0 {
            return fail(Code::Failed, "the resampler made more than was foreseen");
        }
        if !(out.as_ptr() as usize).is_multiple_of(self.align) {
            return fail(Code::Failed, "the result's memory is not aligned");
        }
        let (mut used, mut made) = (0, 0);
        // SAFETY: `from` has `frames` frames (or is null: end of input); `out` has `room` frames, of which soxr writes
        // `made` and no more, and is aligned for its samples.
        let error = unsafe {
            let to = out.as_mut_ptr() as *mut c_void;
            soxr::soxr_process(self.handle, from, frames, &mut used, to, room, &mut made)
        };
        if error.is_null() {
            Ok((used, made.min(room)))
        } else {
            Err(failure(error))
        }
    }
}

impl Drop for Resampler {
    fn drop(&mut self) {
        // SAFETY: the handle came from soxr_create and is deleted once.
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

fn failure(message: *const c_char) -> Error {
    let text = if message.is_null() {
        "no memory".into()
    } else {
        // SAFETY: soxr's errors are static C strings.
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

    fn sine(rate: f64, frames: usize) -> Vec<f32> {
        (0..frames)
            .map(|i| (2.0 * std::f64::consts::PI * 440.0 * i as f64 / rate).sin() as f32 * 0.5)
            .collect()
    }

    fn bytes(values: &[f32]) -> Vec<u8> {
        values.iter().flat_map(|v| v.to_le_bytes()).collect()
    }

    fn run(filter: &mut Resampler, data: &[u8], last: bool) -> Result<Vec<u8>> {
        let mut out = vec![0; filter.room(data.len())?];
        let written = filter.process(data, last, &mut out)?;
        out.truncate(written);
        Ok(out)
    }

    #[test]
    fn output_lies_where_the_input_lay_whatever_the_chunks() -> Result<()> {
        let input = bytes(&sine(48_000.0, 48_000));
        let mut whole = Resampler::new(48_000, 16_000, 1, Sample::F32, Quality::High)?;
        let a = run(&mut whole, &input, true)?;
        let mut parts = Resampler::new(48_000, 16_000, 1, Sample::F32, Quality::High)?;
        let mut b = Vec::new();
        for chunk in input.chunks(4 * 777) {
            b.extend(run(&mut parts, chunk, false)?);
        }
        b.extend(run(&mut parts, &[], true)?);
        assert_eq!(a, b);
        assert_eq!(a.len() / 4, 16_000);
        let wanted = sine(16_000.0, 16_000);
        for (i, got) in a.chunks_exact(4).enumerate().skip(200).take(15_600) {
            let got = f32::from_le_bytes([got[0], got[1], got[2], got[3]]);
            assert!((got - wanted[i]).abs() < 1e-4, "frame {i}");
        }
        Ok(())
    }

    #[test]
    fn rates_too_far_apart_are_refused() -> Result<()> {
        let new = |from, to| Resampler::new(from, to, 1, Sample::F32, Quality::Quick);
        for (from, to) in [(11_025, 1), (1, 8_000), (48_000, 47)] {
            assert!(new(from, to).is_err_and(|e| e.code == Code::BadOption));
        }
        // The farthest there is ends.
        let mut filter = new(48_000, 48)?;
        assert_eq!(run(&mut filter, &bytes(&[0.5; 4800]), true)?.len() / 4, 5);
        Ok(())
    }

    #[test]
    fn the_room_foreseen_is_enough_for_every_ratio_and_piece() -> Result<()> {
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
                for piece in [1, 0, 160, 7, 5_000, 3] {
                    frames += piece;
                    made += run(&mut filter, &vec![1; piece * 4], false)?.len() / 4;
                }
                made += run(&mut filter, &[], true)?.len() / 4;
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

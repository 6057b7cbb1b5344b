//! Streaming sample rate conversion by libsoxr: linear phase, its delay taken out (output frame k lies at k / rate).
#![allow(unsafe_code)]

use super::sample::Sample;
use super::soxr;
use crate::error::{fail, Code, Error, Result};
use std::ffi::{c_char, c_void, CStr};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quality {
    Quick,
    Low,
    Medium,
    High,
    VeryHigh,
}

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

    /// Feeds whole frames and returns what is ready; with `last` also everything that was still inside.
    pub fn process(&mut self, data: &[u8], last: bool) -> Result<Vec<u8>> {
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
        let expected = (frames as f64 * self.ratio).ceil() as usize + 1024;
        if expected.saturating_mul(self.frame) > crate::picture::MAX_BYTES {
            return fail(Code::TooLarge, "the result would take more than 1 GiB");
        }
        let mut out = Vec::with_capacity(expected * self.frame);
        let copy;
        let aligned = if (data.as_ptr() as usize).is_multiple_of(self.align) {
            data.as_ptr()
        } else {
            copy = aligned_copy(data);
            copy.as_ptr() as *const u8
        };
        let mut done = 0;
        while done < frames {
            // SAFETY: `done` frames of `frames` were consumed, so the rest lies inside the input.
            let from = unsafe { aligned.add(done * self.frame) };
            let (used, made) = self.step(from as *const c_void, frames - done, &mut out)?;
            done += used;
            if used == 0 && made == 0 {
                return fail(Code::Failed, "the resampler stands still");
            }
        }
        if last {
            self.finished = true;
            while self.step(std::ptr::null(), 0, &mut out)?.1 > 0 {}
        }
        Ok(out)
    }

    fn step(
        &mut self,
        from: *const c_void,
        frames: usize,
        out: &mut Vec<u8>,
    ) -> Result<(usize, usize)> {
        let room = 4096.max((frames as f64 * self.ratio) as usize + 64);
        let start = out.len();
        out.reserve(room * self.frame);
        let (mut used, mut made) = (0, 0);
        // SAFETY: `from` has `frames` frames (or is null: end of input); `out` has `room` frames of spare capacity, of
        // which soxr writes `made` and no more.
        let error = unsafe {
            let to = out.as_mut_ptr().add(start) as *mut c_void;
            soxr::soxr_process(self.handle, from, frames, &mut used, to, room, &mut made)
        };
        if !error.is_null() {
            return Err(failure(error));
        }
        // SAFETY: soxr wrote `made <= room` frames there.
        unsafe { out.set_len(start + made.min(room) * self.frame) };
        Ok((used, made))
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

    #[test]
    fn output_lies_where_the_input_lay_whatever_the_chunks() -> Result<()> {
        let input = bytes(&sine(48_000.0, 48_000));
        let mut whole = Resampler::new(48_000, 16_000, 1, Sample::F32, Quality::High)?;
        let a = whole.process(&input, true)?;
        let mut parts = Resampler::new(48_000, 16_000, 1, Sample::F32, Quality::High)?;
        let mut b = Vec::new();
        for chunk in input.chunks(4 * 777) {
            b.extend(parts.process(chunk, false)?);
        }
        b.extend(parts.process(&[], true)?);
        assert_eq!(a, b);
        assert_eq!(a.len() / 4, 16_000);
        let wanted = sine(16_000.0, 16_000);
        for (i, got) in a.chunks_exact(4).enumerate().skip(200).take(15_600) {
            let got = f32::from_le_bytes([got[0], got[1], got[2], got[3]]);
            assert!((got - wanted[i]).abs() < 1e-4, "frame {i}");
        }
        Ok(())
    }
}

//! Audio kernels as terms: `{:mix, data, {:s16, 2}, {:s16, 1}, [0.5, 0.5]}`.

use crate::audio::{AnalyzerResource, ConfigTerm, QualityTerm, ResamplerResource, SampleTerm};
use rustler::{Binary, Encoder, Env, NifMap, NifTaggedEnum, ResourceArc, Term};
use situ_media::audio::features::{Analyzer, Frame};
use situ_media::audio::mix::{self, Layout};
use situ_media::audio::resample::Resampler;
use situ_media::audio::waveform;
use situ_media::error::{fail, Code, Error, Result};
use situ_media_term::allocate_binary;
use std::sync::{Mutex, PoisonError};

type LayoutTerm = (SampleTerm, u32);

#[derive(NifTaggedEnum)]
pub enum AudioJob<'a> {
    Mix(Binary<'a>, LayoutTerm, LayoutTerm, Vec<f64>),
    Add(Binary<'a>, Binary<'a>, LayoutTerm, f64),
    Levels(Binary<'a>, LayoutTerm),
    Points(Binary<'a>, LayoutTerm, u32),
    NewResampler(u32, u32, u32, SampleTerm, QualityTerm),
    Resample(ResourceArc<ResamplerResource>, Binary<'a>, bool),
    NewAnalyzer(ConfigTerm),
    Analyze(
        ResourceArc<AnalyzerResource>,
        Binary<'a>,
        u64,
        Vec<rustler::Atom>,
    ),
}

#[derive(NifMap)]
struct FrameTerm {
    log_energy: f64,
    zero_crossing_rate: f64,
    energy: f64,
    low_energy: f64,
    high_energy: f64,
    entropy: f64,
    spectrum: Option<Vec<(f64, f64)>>,
    power: Option<Vec<f64>>,
    log_mel: Option<Vec<f64>>,
    mfcc: Option<Vec<f64>>,
}

mod atoms {
    rustler::atoms! { spectrum, power, log_mel, mfcc }
}

impl<'a> AudioJob<'a> {
    pub fn run(&self, env: Env<'a>) -> Result<Term<'a>> {
        match self {
            AudioJob::Mix(data, from, to, gains) => {
                let (from, to) = (audio_layout(from), audio_layout(to));
                let mut out = allocate_binary(mix::mixed_size(data, from, to, gains)?)?;
                mix::mix(data, from, to, gains, out.as_mut_slice());
                Ok(out.release(env).encode(env))
            }
            AudioJob::Add(a, b, form, gain) => {
                let form = check_frames(audio_layout(form), &[a, b])?;
                let mut out = allocate_binary(a.len().max(b.len()))?;
                mix::add_scaled(a, b, form, *gain, out.as_mut_slice());
                Ok(out.release(env).encode(env))
            }
            AudioJob::Levels(data, form) => Ok(mix::channel_levels(
                data,
                check_frames(audio_layout(form), &[data])?,
            )
            .encode(env)),
            AudioJob::Points(data, form, span) => {
                let form = check_frames(audio_layout(form), &[data])?;
                Ok(waveform::span_extremes(data, form, *span as usize).encode(env))
            }
            AudioJob::NewResampler(from, to, channels, sample, quality) => {
                let (sample, quality) = ((*sample).into(), (*quality).into());
                let new = Resampler::new(*from, *to, *channels as usize, sample, quality)?;
                Ok(ResourceArc::new(ResamplerResource(Mutex::new(new))).encode(env))
            }
            AudioJob::Resample(resampler, data, last) => {
                let mut guard = resampler.0.lock().map_err(lock_error)?;
                let mut out = allocate_binary(guard.output_capacity(data.len())?)?;
                let written = guard.process(data, *last, out.as_mut_slice())?;
                if !out.realloc(written) {
                    return fail(Code::OutOfMemory, format!("no memory for {written} bytes"));
                }
                Ok(out.release(env).encode(env))
            }
            AudioJob::NewAnalyzer(config) => {
                let new = Analyzer::new(config.into())?;
                Ok(ResourceArc::new(AnalyzerResource(Mutex::new(new))).encode(env))
            }
            AudioJob::Analyze(analyzer, data, index, wanted) => {
                let mut guard = analyzer.0.lock().map_err(lock_error)?;
                let frames = guard.analyze_frames(data, *index)?;
                let terms: Vec<_> = frames.into_iter().map(|f| frame_term(f, wanted)).collect();
                Ok(terms.encode(env))
            }
        }
    }
}

fn audio_layout(term: &LayoutTerm) -> Layout {
    Layout {
        sample: term.0.into(),
        channels: term.1 as usize,
    }
}

fn check_frames(layout: Layout, buffers: &[&Binary]) -> Result<Layout> {
    let frame = layout.frame_bytes();
    if frame == 0 || buffers.iter().any(|b| b.len() % frame != 0) {
        return fail(
            Code::BadAudio,
            format!("the audio is not a multiple of the frame size of {frame} bytes"),
        );
    }
    Ok(layout)
}

fn frame_term(frame: Frame, wanted: &[rustler::Atom]) -> FrameTerm {
    let wants = |atom: rustler::Atom| wanted.contains(&atom);
    FrameTerm {
        log_energy: frame.log_energy,
        zero_crossing_rate: frame.zero_crossing_rate,
        energy: frame.energy,
        low_energy: frame.low_energy,
        high_energy: frame.high_energy,
        entropy: frame.entropy,
        spectrum: wants(atoms::spectrum())
            .then(|| frame.spectrum.iter().map(|c| (c.re, c.im)).collect()),
        power: wants(atoms::power()).then_some(frame.power),
        log_mel: wants(atoms::log_mel()).then_some(frame.log_mel),
        mfcc: wants(atoms::mfcc()).then_some(frame.cepstrum),
    }
}

fn lock_error<T>(_: PoisonError<T>) -> Error {
    Error {
        code: Code::Failed,
        what: "an earlier call crashed, so the state is invalid: create a new one".into(),
    }
}

//! Sound kernels as terms: `{:mix, data, {:s16, 2}, {:s16, 1}, [0.5, 0.5]}`.

use crate::sound::{AnalyzerResource, ConfigTerm, QualityTerm, ResamplerResource, SampleTerm};
use rustler::{Binary, Encoder, Env, NifMap, NifTaggedEnum, ResourceArc, Term};
use situ_media::audio::features::{Analyzer, Frame};
use situ_media::audio::mix::{self, Layout};
use situ_media::audio::resample::Resampler;
use situ_media::audio::waveform;
use situ_media::error::{fail, Code, Error, Result};
use situ_media_term::allocate;
use std::sync::{Mutex, PoisonError};

type LayoutTerm = (SampleTerm, u32);

#[derive(NifTaggedEnum)]
pub enum SoundJob<'a> {
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

impl<'a> SoundJob<'a> {
    pub fn run(&self, env: Env<'a>) -> Result<Term<'a>> {
        match self {
            SoundJob::Mix(data, from, to, gains) => {
                let (from, to) = (layout(from), layout(to));
                let mut out = allocate(mix::check(data, from, to, gains)?)?;
                mix::mix(data, from, to, gains, out.as_mut_slice());
                Ok(out.release(env).encode(env))
            }
            SoundJob::Add(a, b, form, gain) => {
                let form = whole(layout(form), &[a, b])?;
                let mut out = allocate(a.len().max(b.len()))?;
                mix::add(a, b, form, *gain, out.as_mut_slice());
                Ok(out.release(env).encode(env))
            }
            SoundJob::Levels(data, form) => {
                Ok(mix::levels(data, whole(layout(form), &[data])?).encode(env))
            }
            SoundJob::Points(data, form, span) => {
                let form = whole(layout(form), &[data])?;
                Ok(waveform::points(data, form, *span as usize).encode(env))
            }
            SoundJob::NewResampler(from, to, channels, sample, quality) => {
                let (sample, quality) = ((*sample).into(), (*quality).into());
                let new = Resampler::new(*from, *to, *channels as usize, sample, quality)?;
                Ok(ResourceArc::new(ResamplerResource(Mutex::new(new))).encode(env))
            }
            SoundJob::Resample(resampler, data, last) => {
                let mut guard = resampler.0.lock().map_err(poisoned)?;
                let mut out = allocate(guard.room(data.len())?)?;
                let written = guard.process(data, *last, out.as_mut_slice())?;
                if !out.realloc(written) {
                    return fail(Code::OutOfMemory, format!("no memory for {written} bytes"));
                }
                Ok(out.release(env).encode(env))
            }
            SoundJob::NewAnalyzer(config) => {
                let new = Analyzer::new(config.into())?;
                Ok(ResourceArc::new(AnalyzerResource(Mutex::new(new))).encode(env))
            }
            SoundJob::Analyze(analyzer, data, index, wanted) => {
                let mut guard = analyzer.0.lock().map_err(poisoned)?;
                let frames = guard.frames(data, *index)?;
                let terms: Vec<_> = frames.into_iter().map(|f| frame_term(f, wanted)).collect();
                Ok(terms.encode(env))
            }
        }
    }
}

fn layout(term: &LayoutTerm) -> Layout {
    Layout {
        sample: term.0.into(),
        channels: term.1 as usize,
    }
}

fn whole(layout: Layout, buffers: &[&Binary]) -> Result<Layout> {
    let frame = layout.frame();
    if frame == 0 || buffers.iter().any(|b| b.len() % frame != 0) {
        return fail(
            Code::BadAudio,
            format!("the bytes are not whole frames of {frame} bytes"),
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

fn poisoned<T>(_: PoisonError<T>) -> Error {
    Error {
        code: Code::Failed,
        what: "an earlier call failed half-way; start again".into(),
    }
}

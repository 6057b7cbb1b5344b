//! Audio types as terms, and the two resources that outlive a call.

use rustler::{NifMap, NifUnitEnum, Resource};
use situ_media::audio::features::{Analyzer, Config};
use situ_media::audio::resample::{Quality, Resampler};
use situ_media::audio::sample::Sample;
use std::sync::Mutex;

#[derive(Clone, Copy, NifUnitEnum)]
pub enum SampleTerm {
    U8,
    S16,
    S24,
    S32,
    F32,
    F64,
}

impl From<SampleTerm> for Sample {
    fn from(sample: SampleTerm) -> Sample {
        match sample {
            SampleTerm::U8 => Sample::U8,
            SampleTerm::S16 => Sample::S16,
            SampleTerm::S24 => Sample::S24,
            SampleTerm::S32 => Sample::S32,
            SampleTerm::F32 => Sample::F32,
            SampleTerm::F64 => Sample::F64,
        }
    }
}

#[derive(Clone, Copy, NifUnitEnum)]
pub enum QualityTerm {
    Quick,
    Low,
    Medium,
    High,
    VeryHigh,
}

impl From<QualityTerm> for Quality {
    fn from(quality: QualityTerm) -> Quality {
        match quality {
            QualityTerm::Quick => Quality::Quick,
            QualityTerm::Low => Quality::Low,
            QualityTerm::Medium => Quality::Medium,
            QualityTerm::High => Quality::High,
            QualityTerm::VeryHigh => Quality::VeryHigh,
        }
    }
}

#[derive(NifMap)]
pub struct ConfigTerm {
    rate: u32,
    channels: u32,
    sample: SampleTerm,
    frame: u32,
    shift: u32,
    dither_scale: f64,
    start_hz: f64,
    end_hz: f64,
    low_end_hz: f64,
    high_start_hz: f64,
    entropy_bandwidth_hz: f64,
    mel_bands: u32,
    cepstra: u32,
    mel_low_hz: f64,
    mel_high_hz: f64,
}

impl From<&ConfigTerm> for Config {
    fn from(c: &ConfigTerm) -> Config {
        Config {
            rate: c.rate,
            channels: c.channels as usize,
            sample: c.sample.into(),
            frame: c.frame as usize,
            shift: c.shift as usize,
            dither_scale: c.dither_scale,
            start_hz: c.start_hz,
            end_hz: c.end_hz,
            low_end_hz: c.low_end_hz,
            high_start_hz: c.high_start_hz,
            entropy_bandwidth_hz: c.entropy_bandwidth_hz,
            mel_bands: c.mel_bands as usize,
            cepstra: c.cepstra as usize,
            mel_low_hz: c.mel_low_hz,
            mel_high_hz: c.mel_high_hz,
        }
    }
}

pub struct ResamplerResource(pub Mutex<Resampler>);
pub struct AnalyzerResource(pub Mutex<Analyzer>);

#[rustler::resource_impl]
impl Resource for ResamplerResource {}
#[rustler::resource_impl]
impl Resource for AnalyzerResource {}

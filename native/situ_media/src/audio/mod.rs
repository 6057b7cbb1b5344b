//! Audio: sample types, mixing, resampling, features.

pub mod features;
pub mod mel;
pub mod mix;
pub mod resample;
pub mod sample;
mod soxr;
pub mod waveform;

//! The BEAM bindings of situ_media: they decode, call and encode, and contain no algorithms.
//!
//! Every kernel is a `Job`. The Elixir side sends small jobs to `run` (on the calling scheduler, charging their time
//! to the process) and large ones to `run_dirty`.

mod audio;
mod audio_job;
mod drawing;
mod job;

use audio_job::AudioJob;
use job::Job;
use rustler::{Env, Term};
use situ_media_term::{encode_reply, run_charged};

#[rustler::nif]
fn run<'a>(env: Env<'a>, job: Job<'a>) -> Term<'a> {
    run_charged(env, || encode_reply(env, job.run(env)))
}

#[rustler::nif(schedule = "DirtyCpu")]
fn run_dirty<'a>(env: Env<'a>, job: Job<'a>) -> Term<'a> {
    encode_reply(env, job.run(env))
}

#[rustler::nif]
fn run_sound<'a>(env: Env<'a>, job: AudioJob<'a>) -> Term<'a> {
    run_charged(env, || encode_reply(env, job.run(env)))
}

#[rustler::nif(schedule = "DirtyCpu")]
fn run_sound_dirty<'a>(env: Env<'a>, job: AudioJob<'a>) -> Term<'a> {
    encode_reply(env, job.run(env))
}

rustler::init!("Elixir.Situ.Media.Native", load = situ_media_term::load);

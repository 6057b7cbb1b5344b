//! BEAM glue of situ_media: decode, call, encode. No algorithms here.
//!
//! Every kernel is a `Job`; the Elixir side sends small ones to `run` (on the calling scheduler, with their time
//! charged) and large ones to `run_dirty`.

mod drawing;
mod job;
mod sound;
mod sound_job;

use job::Job;
use rustler::{Env, Term};
use situ_media_term::{charged, reply};
use sound_job::SoundJob;

#[rustler::nif]
fn run<'a>(env: Env<'a>, job: Job<'a>) -> Term<'a> {
    charged(env, || reply(env, job.run(env)))
}

#[rustler::nif(schedule = "DirtyCpu")]
fn run_dirty<'a>(env: Env<'a>, job: Job<'a>) -> Term<'a> {
    reply(env, job.run(env))
}

#[rustler::nif]
fn run_sound<'a>(env: Env<'a>, job: SoundJob<'a>) -> Term<'a> {
    charged(env, || reply(env, job.run(env)))
}

#[rustler::nif(schedule = "DirtyCpu")]
fn run_sound_dirty<'a>(env: Env<'a>, job: SoundJob<'a>) -> Term<'a> {
    reply(env, job.run(env))
}

rustler::init!("Elixir.Situ.Media.Native", load = situ_media_term::load);

//! BEAM glue of the OpenCV kernels, in a library of its own: without OpenCV the rest of situ_media still loads.

mod ffi;
mod job;

use job::Job;
use rustler::{Env, Term};
use situ_media_term::{charged, reply};

#[rustler::nif]
fn run<'a>(env: Env<'a>, job: Job<'a>) -> Term<'a> {
    charged(env, || reply(env, job.run(env)))
}

#[rustler::nif(schedule = "DirtyCpu")]
fn run_dirty<'a>(env: Env<'a>, job: Job<'a>) -> Term<'a> {
    reply(env, job.run(env))
}

rustler::init!("Elixir.Situ.Media.OpenCV", load = situ_media_term::load);

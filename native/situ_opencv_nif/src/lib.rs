//! The BEAM bindings of the OpenCV kernels. They are in a separate library, so that the rest of situ_media loads
//! without OpenCV.

mod ffi;
mod job;

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

rustler::init!("Elixir.Situ.Media.OpenCV", load = situ_media_term::load);

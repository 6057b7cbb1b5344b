//! BEAM glue of situ_infer: decode, call, encode. No algorithms here.
use rustler::{Atom, Binary, Encoder, Env, NifResult, OwnedBinary, Resource, ResourceArc, Term};
use situ_infer::{
    ElementType, Failure, Kind, Model, Options, Patch, Picture, PixelLayout, Port, Provider,
    Tensor, TensorView,
};
use std::path::Path;
use std::time::Instant;

mod atoms {
    rustler::atoms! { ok, error, busy, library, model, input, run, provider }
}

struct ModelResource(Model);

#[rustler::resource_impl]
impl Resource for ModelResource {}

fn kind(kind: Kind) -> Atom {
    match kind {
        Kind::Library => atoms::library(),
        Kind::Model => atoms::model(),
        Kind::Input => atoms::input(),
        Kind::Run => atoms::run(),
        Kind::Provider => atoms::provider(),
    }
}

fn failed<'a>(env: Env<'a>, failure: &Failure) -> Term<'a> {
    (atoms::error(), (kind(failure.kind), failure.text.as_str())).encode(env)
}

#[rustler::nif(schedule = "DirtyIo")]
fn load_runtime(env: Env<'_>, path: String) -> Term<'_> {
    match situ_infer::load(Path::new(&path)) {
        Ok(()) => atoms::ok().encode(env),
        Err(failure) => failed(env, &failure),
    }
}

#[rustler::nif(schedule = "DirtyIo")]
fn runtime_version(env: Env<'_>) -> Term<'_> {
    situ_infer::version().encode(env)
}

/// `device` below 0 is the CPU, else the number of a CUDA device.
#[rustler::nif(schedule = "DirtyCpu")]
fn load_model<'a>(
    env: Env<'a>,
    bytes: Binary<'a>,
    threads: usize,
    sessions: usize,
    device: i32,
    folder: String,
) -> Term<'a> {
    let provider = if device < 0 {
        Provider::Cpu
    } else {
        Provider::Cuda { device }
    };
    let options = Options {
        threads,
        sessions,
        provider,
        folder: Some(folder),
    };
    match Model::load(bytes.as_slice(), options) {
        Ok(model) => {
            let inputs = ports(&model.inputs);
            let outputs = ports(&model.outputs);
            let resource = ResourceArc::new(ModelResource(model));
            (atoms::ok(), (resource, inputs, outputs)).encode(env)
        }
        Err(failure) => failed(env, &failure),
    }
}

fn ports(ports: &[Port]) -> Vec<(String, Option<&'static str>, Vec<i64>)> {
    let row = |p: &Port| (p.name.clone(), p.ty.map(ElementType::name), p.shape.clone());
    ports.iter().map(row).collect()
}

type Input<'a> = (String, String, Vec<i64>, Binary<'a>);

fn views<'i>(inputs: &'i [Input<'_>]) -> Result<Vec<TensorView<'i>>, Failure> {
    inputs
        .iter()
        .map(|(name, ty, shape, data)| {
            let ty = ElementType::parse(ty).ok_or_else(|| Failure {
                kind: Kind::Input,
                text: format!("input {name:?}: unknown element type {ty:?}"),
            })?;
            Ok(TensorView {
                name: name.clone(),
                ty,
                shape: shape.clone(),
                data: data.as_slice(),
            })
        })
        .collect()
}

fn outputs(env: Env<'_>, tensors: Vec<Tensor>, nanos: u64) -> NifResult<Term<'_>> {
    let mut rows = Vec::with_capacity(tensors.len());
    for tensor in tensors {
        let mut data = OwnedBinary::new(tensor.data.len());
        data.as_mut_slice().copy_from_slice(&tensor.data);
        rows.push((
            tensor.name,
            tensor.ty.name(),
            tensor.shape,
            data.release(env),
        ));
    }
    Ok((atoms::ok(), rows, nanos).encode(env))
}

fn nanos(since: Instant) -> u64 {
    u64::try_from(since.elapsed().as_nanos()).unwrap_or(u64::MAX)
}

fn finish(
    env: Env<'_>,
    result: Result<Vec<Tensor>, Failure>,
    started: Instant,
) -> NifResult<Term<'_>> {
    let spent = nanos(started);
    match result {
        Ok(tensors) => outputs(env, tensors, spent),
        Err(failure) => Ok(failed(env, &failure)),
    }
}

#[rustler::nif(schedule = "DirtyCpu")]
fn run_dirty<'a>(
    env: Env<'a>,
    model: ResourceArc<ModelResource>,
    inputs: Vec<Input<'a>>,
) -> NifResult<Term<'a>> {
    let started = Instant::now();
    let result = views(&inputs).and_then(|views| model.0.run(&views));
    finish(env, result, started)
}

/// For networks of a fraction of a millisecond: no thread hop, but the time is charged to the caller.
#[rustler::nif]
fn run_inline<'a>(
    env: Env<'a>,
    model: ResourceArc<ModelResource>,
    inputs: Vec<Input<'a>>,
) -> NifResult<Term<'a>> {
    let started = Instant::now();
    let result = match views(&inputs) {
        Ok(views) => match model.0.try_run(&views) {
            Ok(result) => result,
            Err(situ_infer::Busy) => return Ok(atoms::busy().encode(env)),
        },
        Err(failure) => Err(failure),
    };
    // One per cent of a timeslice is about 10 us.
    let percent = i32::try_from(nanos(started) / 10_000)
        .unwrap_or(100)
        .clamp(1, 100);
    rustler::schedule::consume_timeslice(env, percent);
    finish(env, result, started)
}

type Size = (usize, usize, usize, String);

/// `(width, height, stride, format)`, six matrix numbers, patch size, scale and offset, as `situ_infer::Patch` has
/// them.
#[rustler::nif(schedule = "DirtyCpu")]
fn cut_patch<'a>(
    env: Env<'a>,
    data: Binary<'a>,
    size: Size,
    matrix: (f64, f64, f64, f64, f64, f64),
    patch: (usize, usize),
    range: (f64, f64),
) -> Term<'a> {
    let (width, height, stride, format) = size;
    let patch = Patch {
        matrix: matrix.into(),
        width: patch.0,
        height: patch.1,
        scale: range.0 as f32,
        offset: range.1 as f32,
    };
    let cut = || {
        let layout = PixelLayout::parse(&format)?;
        let picture = Picture {
            data: data.as_slice(),
            width,
            height,
            stride,
            layout,
        };
        let mut out = OwnedBinary::new(situ_infer::patch_bytes(&patch)?);
        situ_infer::cut(&picture, &patch, out.as_mut_slice()).then_some(out)
    };
    match cut() {
        Some(out) => (atoms::ok(), out.release(env)).encode(env),
        None => atoms::error().encode(env),
    }
}

rustler::init!("Elixir.Situ.Infer.Native");

//! The BEAM bindings of situ_infer: they decode, call and encode, and contain no algorithms.
use rustler::{Atom, Binary, Encoder, Env, NifResult, OwnedBinary, Resource, ResourceArc, Term};
use situ_infer::{
    ElementType, Failure, Image, Kind, Model, Options, Patch, PixelLayout, Port, Provider, Tensor,
    TensorView,
};
use std::path::Path;
use std::time::Instant;

mod atoms {
    rustler::atoms! { ok, error, busy, library, model, input, run, provider }
}

struct ModelResource(Model);

#[rustler::resource_impl]
impl Resource for ModelResource {}

fn kind_atom(kind: Kind) -> Atom {
    match kind {
        Kind::Library => atoms::library(),
        Kind::Model => atoms::model(),
        Kind::Input => atoms::input(),
        Kind::Run => atoms::run(),
        Kind::Provider => atoms::provider(),
    }
}

fn encode_failure<'a>(env: Env<'a>, failure: &Failure) -> Term<'a> {
    (
        atoms::error(),
        (kind_atom(failure.kind), failure.text.as_str()),
    )
        .encode(env)
}

#[rustler::nif(schedule = "DirtyIo")]
fn load_runtime(env: Env<'_>, path: String) -> Term<'_> {
    match situ_infer::load_runtime(Path::new(&path)) {
        Ok(()) => atoms::ok().encode(env),
        Err(failure) => encode_failure(env, &failure),
    }
}

#[rustler::nif(schedule = "DirtyIo")]
fn runtime_version(env: Env<'_>) -> Term<'_> {
    situ_infer::runtime_version().encode(env)
}

/// Loads a model. A `device` below 0 is the CPU; other numbers are CUDA devices.
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
            let inputs = encode_ports(&model.inputs);
            let outputs = encode_ports(&model.outputs);
            let resource = ResourceArc::new(ModelResource(model));
            (atoms::ok(), (resource, inputs, outputs)).encode(env)
        }
        Err(failure) => encode_failure(env, &failure),
    }
}

fn encode_ports(ports: &[Port]) -> Vec<(String, Option<&'static str>, Vec<i64>)> {
    let row = |p: &Port| (p.name.clone(), p.ty.map(ElementType::name), p.shape.clone());
    ports.iter().map(row).collect()
}

type Input<'a> = (String, String, Vec<i64>, Binary<'a>);

fn parse_inputs<'i>(inputs: &'i [Input<'_>]) -> Result<Vec<TensorView<'i>>, Failure> {
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

fn encode_outputs(env: Env<'_>, tensors: Vec<Tensor>, nanos: u64) -> NifResult<Term<'_>> {
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

fn elapsed_nanos(since: Instant) -> u64 {
    u64::try_from(since.elapsed().as_nanos()).unwrap_or(u64::MAX)
}

fn encode_result(
    env: Env<'_>,
    result: Result<Vec<Tensor>, Failure>,
    started: Instant,
) -> NifResult<Term<'_>> {
    let spent = elapsed_nanos(started);
    match result {
        Ok(tensors) => encode_outputs(env, tensors, spent),
        Err(failure) => Ok(encode_failure(env, &failure)),
    }
}

#[rustler::nif(schedule = "DirtyCpu")]
fn run_dirty<'a>(
    env: Env<'a>,
    model: ResourceArc<ModelResource>,
    inputs: Vec<Input<'a>>,
) -> NifResult<Term<'a>> {
    let started = Instant::now();
    let result = parse_inputs(&inputs).and_then(|views| model.0.run(&views));
    encode_result(env, result, started)
}

/// Runs networks that take a fraction of a millisecond on the calling scheduler, and charges the time to the caller.
#[rustler::nif]
fn run_inline<'a>(
    env: Env<'a>,
    model: ResourceArc<ModelResource>,
    inputs: Vec<Input<'a>>,
) -> NifResult<Term<'a>> {
    let started = Instant::now();
    let result = match parse_inputs(&inputs) {
        Ok(views) => match model.0.try_run(&views) {
            Ok(result) => result,
            Err(situ_infer::Busy) => return Ok(atoms::busy().encode(env)),
        },
        Err(failure) => Err(failure),
    };
    // One percent of a time slice is about 10 us.
    let percent = i32::try_from(elapsed_nanos(started) / 10_000)
        .unwrap_or(100)
        .clamp(1, 100);
    rustler::schedule::consume_timeslice(env, percent);
    encode_result(env, result, started)
}

type Size = (usize, usize, usize, String);

/// Cuts a patch. The arguments are `(width, height, stride, format)`, six matrix numbers, the size of the patch, and
/// scale and offset, as in `situ_infer::Patch`.
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
        let image = Image {
            data: data.as_slice(),
            width,
            height,
            stride,
            layout,
        };
        let mut out = OwnedBinary::new(situ_infer::patch_bytes(&patch)?);
        situ_infer::cut_patch(&image, &patch, out.as_mut_slice()).then_some(out)
    };
    match cut() {
        Some(out) => (atoms::ok(), out.release(env)).encode(env),
        None => atoms::error().encode(env),
    }
}

rustler::init!("Elixir.Situ.Infer.Native");

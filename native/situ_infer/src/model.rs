//! One loaded network.
use crate::tensor::{from_value, ElementType, Tensor, TensorView};
use crate::{runtime, Failure, Kind};
use ort::ep::{self, ExecutionProvider};
use ort::session::{builder::SessionBuilder, Session};
use ort::value::{Outlet, ValueType};
use std::borrow::Cow;
use std::sync::{Mutex, PoisonError, TryLockError};

/// A named input or output. A dimension of -1 is free.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Port {
    pub name: String,
    pub ty: Option<ElementType>,
    pub shape: Vec<i64>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Provider {
    Cpu,
    Cuda { device: i32 },
}

#[derive(Debug, Clone, Copy)]
pub struct Options {
    pub threads: usize,
    pub provider: Provider,
}

/// Another caller is inside the network: come back on a thread that may wait.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Busy;

/// A network ready to run. ONNX Runtime's `Run` is not safe to enter twice, hence the lock.
pub struct Model {
    session: Mutex<Session>,
    pub inputs: Vec<Port>,
    pub outputs: Vec<Port>,
}

impl Model {
    /// Builds a network from a model file's bytes.
    pub fn load(bytes: &[u8], options: Options) -> Result<Self, Failure> {
        let environment = runtime::environment()?;
        let mut builder = configure(Session::builder(&environment).map_err(no_model)?, options)?;
        let session = builder.commit_from_memory(bytes).map_err(no_model)?;
        let inputs = session.inputs().iter().map(port).collect();
        let outputs = session.outputs().iter().map(port).collect();
        Ok(Self {
            session: Mutex::new(session),
            inputs,
            outputs,
        })
    }

    /// Runs the network, waiting for its turn.
    pub fn run(&self, inputs: &[TensorView<'_>]) -> Result<Vec<Tensor>, Failure> {
        let mut session = self.session.lock().unwrap_or_else(PoisonError::into_inner);
        run(&mut session, inputs)
    }

    /// Runs the network unless another caller is inside: never waits for a lock.
    pub fn try_run(&self, inputs: &[TensorView<'_>]) -> Result<Result<Vec<Tensor>, Failure>, Busy> {
        match self.session.try_lock() {
            Ok(mut session) => Ok(run(&mut session, inputs)),
            Err(TryLockError::Poisoned(poisoned)) => Ok(run(&mut poisoned.into_inner(), inputs)),
            Err(TryLockError::WouldBlock) => Err(Busy),
        }
    }
}

fn no_model(error: ort::Error) -> Failure {
    Failure::new(Kind::Model, error.to_string())
}

fn configure(builder: SessionBuilder, options: Options) -> Result<SessionBuilder, Failure> {
    let failed = |e: ort::Error<SessionBuilder>| Failure::new(Kind::Model, e.to_string());
    let builder = builder
        .with_intra_threads(options.threads)
        .map_err(failed)?;
    let builder = builder.with_inter_threads(1).map_err(failed)?;
    let builder = builder.with_deterministic_compute(true).map_err(failed)?;
    let builder = builder.with_intra_op_spinning(false).map_err(failed)?;
    match options.provider {
        Provider::Cpu => Ok(builder),
        Provider::Cuda { device } => {
            let cuda = ep::CUDA::default().with_device_id(device);
            if !ep::CUDA::is_available().unwrap_or(false) {
                let text = "this ONNX Runtime was built without CUDA";
                return Err(Failure::new(Kind::Provider, text));
            }
            builder
                .with_execution_providers([cuda.build().error_on_failure()])
                .map_err(|e| Failure::new(Kind::Provider, e.to_string()))
        }
    }
}

fn port(outlet: &Outlet) -> Port {
    let name = outlet.name().to_owned();
    match outlet.dtype() {
        ValueType::Tensor { ty, shape, .. } => Port {
            name,
            ty: ElementType::from_ort(*ty),
            shape: shape.to_vec(),
        },
        _ => Port {
            name,
            ty: None,
            shape: Vec::new(),
        },
    }
}

fn run(session: &mut Session, inputs: &[TensorView<'_>]) -> Result<Vec<Tensor>, Failure> {
    let mut values = Vec::with_capacity(inputs.len());
    for input in inputs {
        values.push((Cow::Borrowed(input.name.as_str()), input.to_value()?));
    }
    let outputs = session
        .run(values)
        .map_err(|e| Failure::new(Kind::Run, e.to_string()))?;
    outputs
        .iter()
        .map(|(name, value)| from_value(name, &value))
        .collect()
}

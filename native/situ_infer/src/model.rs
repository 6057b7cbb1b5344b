//! A loaded network.
use crate::tensor::{from_value, ElementType, Tensor, TensorView};
use crate::{runtime, Failure, Kind};
use ort::ep::{self, ExecutionProvider};
use ort::session::{builder::SessionBuilder, Session};
use ort::value::{Outlet, ValueType};
use std::borrow::Cow;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError, TryLockError};

/// A named input or output. A dimension of -1 is free.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Port {
    /// The name in the model file.
    pub name: String,
    /// The element type, or `None` if the port is not a tensor or its type is not supported.
    pub ty: Option<ElementType>,
    /// The sizes, outermost dimension first.
    pub shape: Vec<i64>,
}

/// The device that runs a network.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Provider {
    /// The CPU.
    Cpu,
    /// An NVIDIA GPU, if the library was built with CUDA.
    Cuda {
        /// The number of the GPU.
        device: i32,
    },
}

/// The options for running a network.
#[derive(Debug, Clone)]
pub struct Options {
    /// The number of threads inside a run.
    pub threads: usize,
    /// The maximum number of concurrent runs.
    pub sessions: usize,
    /// The device that runs the network.
    pub provider: Provider,
    /// The folder of the weight files that the model file refers to; `None` means the working directory.
    pub folder: Option<String>,
}

/// All sessions are in use. Call `run` on a thread that may block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Busy;

/// A network that can be run by several callers concurrently.
///
/// A session of ONNX Runtime supports only one run at a time. Additional sessions are therefore built on demand, up
/// to `Options::sessions`; after that, callers wait.
pub struct Model {
    pool: Mutex<Pool>,
    returned: Condvar,
    /// The network's inputs.
    pub inputs: Vec<Port>,
    /// The network's outputs.
    pub outputs: Vec<Port>,
}

struct Pool {
    idle: Vec<Session>,
    /// The number of sessions that may still be built.
    remaining: usize,
    /// The model, which is freed when no more sessions may be built.
    bytes: Vec<u8>,
    options: Options,
}

impl Model {
    /// Builds a network from the bytes of a model file.
    pub fn load(bytes: &[u8], options: Options) -> Result<Self, Failure> {
        let session = build_session(bytes, &options)?;
        let inputs = session.inputs().iter().map(outlet_port).collect();
        let outputs = session.outputs().iter().map(outlet_port).collect();
        let remaining = options.sessions.saturating_sub(1);
        let bytes = if remaining > 0 {
            bytes.to_vec()
        } else {
            Vec::new()
        };
        Ok(Self {
            pool: Mutex::new(Pool {
                idle: vec![session],
                remaining,
                bytes,
                options,
            }),
            returned: Condvar::new(),
            inputs,
            outputs,
        })
    }

    /// Runs the network. If all sessions are in use, builds another one or waits.
    pub fn run(&self, inputs: &[TensorView<'_>]) -> Result<Vec<Tensor>, Failure> {
        let session = self.take_session()?;
        self.run_with(session, inputs)
    }

    /// Runs the network unless all sessions are in use. Never waits and never builds a session.
    pub fn try_run(&self, inputs: &[TensorView<'_>]) -> Result<Result<Vec<Tensor>, Failure>, Busy> {
        let session = match self.pool.try_lock() {
            Ok(mut pool) => pool.idle.pop(),
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner().idle.pop(),
            Err(TryLockError::WouldBlock) => None,
        };
        Ok(self.run_with(session.ok_or(Busy)?, inputs))
    }

    fn lock_pool(&self) -> MutexGuard<'_, Pool> {
        self.pool.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn take_session(&self) -> Result<Session, Failure> {
        let mut pool = self.lock_pool();
        loop {
            if let Some(session) = pool.idle.pop() {
                return Ok(session);
            }
            if pool.remaining > 0 {
                return self.add_session(pool);
            }
            pool = self
                .returned
                .wait(pool)
                .unwrap_or_else(PoisonError::into_inner);
        }
    }

    // Building a session is slow, so the lock is released.
    fn add_session(&self, mut pool: MutexGuard<'_, Pool>) -> Result<Session, Failure> {
        pool.remaining -= 1;
        let options = pool.options.clone();
        let bytes = if pool.remaining == 0 {
            std::mem::take(&mut pool.bytes)
        } else {
            pool.bytes.clone()
        };
        drop(pool);
        build_session(&bytes, &options).inspect_err(|_| {
            let mut pool = self.lock_pool();
            pool.remaining += 1;
            pool.bytes = bytes;
        })
    }

    fn run_with(
        &self,
        mut session: Session,
        inputs: &[TensorView<'_>],
    ) -> Result<Vec<Tensor>, Failure> {
        let result = run_session(&mut session, inputs);
        self.lock_pool().idle.push(session);
        self.returned.notify_one();
        result
    }
}

// Weights above 2 GB do not fit into a model file and are stored in files next to it.
const FOLDER_KEY: &str = "session.model_external_initializers_file_folder_path";

fn build_session(bytes: &[u8], options: &Options) -> Result<Session, Failure> {
    let environment = runtime::current_environment()?;
    let mut builder = configure_session(
        Session::builder(&environment).map_err(model_error)?,
        options,
    )?;
    builder.commit_from_memory(bytes).map_err(model_error)
}

fn model_error(error: ort::Error) -> Failure {
    Failure::new(Kind::Model, error.to_string())
}

fn configure_session(
    builder: SessionBuilder,
    options: &Options,
) -> Result<SessionBuilder, Failure> {
    let failed = |e: ort::Error<SessionBuilder>| Failure::new(Kind::Model, e.to_string());
    let builder = builder
        .with_intra_threads(options.threads)
        .map_err(failed)?;
    let builder = builder.with_inter_threads(1).map_err(failed)?;
    let builder = builder.with_deterministic_compute(true).map_err(failed)?;
    let mut builder = builder.with_intra_op_spinning(false).map_err(failed)?;
    if let Some(folder) = &options.folder {
        builder = builder
            .with_config_entry(FOLDER_KEY, folder)
            .map_err(failed)?;
    }
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

fn outlet_port(outlet: &Outlet) -> Port {
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

fn run_session(session: &mut Session, inputs: &[TensorView<'_>]) -> Result<Vec<Tensor>, Failure> {
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

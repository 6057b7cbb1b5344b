//! One loaded network.
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
    /// As the model file has it.
    pub name: String,
    /// `None` for what is no tensor or of a type that does not cross the border.
    pub ty: Option<ElementType>,
    /// Sizes, the outermost first.
    pub shape: Vec<i64>,
}

/// The device that runs a network.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Provider {
    /// The machine's processor.
    Cpu,
    /// NVIDIA's, when the library was built with it.
    Cuda {
        /// Its number.
        device: i32,
    },
}

/// How a network is run.
#[derive(Debug, Clone)]
pub struct Options {
    /// Threads inside one run.
    pub threads: usize,
    /// The most runs at once.
    pub sessions: usize,
    /// The device that runs it.
    pub provider: Provider,
    /// The folder of the weight files that the model file names; `None` means the working directory.
    pub folder: Option<String>,
}

/// Every session is in use: come back on a thread that may wait.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Busy;

/// A network ready to run, by several callers at once.
///
/// A session of ONNX Runtime may run once at a time, so a second caller gets a session of its own, made when it is
/// first needed, up to `Options::sessions` of them; then callers wait.
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
    /// How many more sessions may be made, and the model's bytes; these are freed when that is 0.
    left: usize,
    bytes: Vec<u8>,
    options: Options,
}

impl Model {
    /// Builds a network from a model file's bytes.
    pub fn load(bytes: &[u8], options: Options) -> Result<Self, Failure> {
        let session = build(bytes, &options)?;
        let inputs = session.inputs().iter().map(port).collect();
        let outputs = session.outputs().iter().map(port).collect();
        let left = options.sessions.saturating_sub(1);
        let bytes = if left > 0 { bytes.to_vec() } else { Vec::new() };
        Ok(Self {
            pool: Mutex::new(Pool {
                idle: vec![session],
                left,
                bytes,
                options,
            }),
            returned: Condvar::new(),
            inputs,
            outputs,
        })
    }

    /// Runs the network; makes a session or waits for one where all are in use.
    pub fn run(&self, inputs: &[TensorView<'_>]) -> Result<Vec<Tensor>, Failure> {
        let session = self.take()?;
        self.run_with(session, inputs)
    }

    /// Runs the network unless all sessions are in use: never waits and makes none.
    pub fn try_run(&self, inputs: &[TensorView<'_>]) -> Result<Result<Vec<Tensor>, Failure>, Busy> {
        let session = match self.pool.try_lock() {
            Ok(mut pool) => pool.idle.pop(),
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner().idle.pop(),
            Err(TryLockError::WouldBlock) => None,
        };
        Ok(self.run_with(session.ok_or(Busy)?, inputs))
    }

    fn pool(&self) -> MutexGuard<'_, Pool> {
        self.pool.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn take(&self) -> Result<Session, Failure> {
        let mut pool = self.pool();
        loop {
            if let Some(session) = pool.idle.pop() {
                return Ok(session);
            }
            if pool.left > 0 {
                return self.another(pool);
            }
            pool = self
                .returned
                .wait(pool)
                .unwrap_or_else(PoisonError::into_inner);
        }
    }

    // Building takes a while, so it happens without the lock.
    fn another(&self, mut pool: MutexGuard<'_, Pool>) -> Result<Session, Failure> {
        pool.left -= 1;
        let options = pool.options.clone();
        let bytes = if pool.left == 0 {
            std::mem::take(&mut pool.bytes)
        } else {
            pool.bytes.clone()
        };
        drop(pool);
        build(&bytes, &options).inspect_err(|_| {
            let mut pool = self.pool();
            pool.left += 1;
            pool.bytes = bytes;
        })
    }

    fn run_with(
        &self,
        mut session: Session,
        inputs: &[TensorView<'_>],
    ) -> Result<Vec<Tensor>, Failure> {
        let result = run(&mut session, inputs);
        self.pool().idle.push(session);
        self.returned.notify_one();
        result
    }
}

// Weights above 2 GB do not fit into a model file and are files next to it.
const FOLDER_KEY: &str = "session.model_external_initializers_file_folder_path";

fn build(bytes: &[u8], options: &Options) -> Result<Session, Failure> {
    let environment = runtime::environment()?;
    let mut builder = configure(Session::builder(&environment).map_err(no_model)?, options)?;
    builder.commit_from_memory(bytes).map_err(no_model)
}

fn no_model(error: ort::Error) -> Failure {
    Failure::new(Kind::Model, error.to_string())
}

fn configure(builder: SessionBuilder, options: &Options) -> Result<SessionBuilder, Failure> {
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

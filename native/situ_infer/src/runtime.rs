//! The single ONNX Runtime of this OS process.
use crate::{Failure, Kind};
use ort::environment::Environment;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

// The environment lives as long as the process: ONNX Runtime allows only one, and sessions outlive their callers.
static ENVIRONMENT: Mutex<Option<Environment>> = Mutex::new(None);

/// Loads the library at `path`. Does nothing if one is already loaded. Errors are not cached, so a later call may
/// succeed.
pub fn load_runtime(path: &Path) -> Result<(), Failure> {
    let mut slot = ENVIRONMENT.lock().unwrap_or_else(PoisonError::into_inner);
    if slot.is_some() {
        return Ok(());
    }
    let builder = ort::init_from(path).map_err(|e| Failure::new(Kind::Library, e.to_string()))?;
    let environment = builder
        .with_name("situ")
        .with_telemetry(false)
        .build()
        .map_err(|e| Failure::new(Kind::Library, e.to_string()))?;
    // Errors are returned to the caller, so the library does not need to print them.
    environment.set_log_level(ort::logging::LogLevel::Fatal);
    *slot = Some(environment);
    Ok(())
}

/// Returns the build information of the library, or `None` if none is loaded.
#[must_use]
pub fn runtime_version() -> Option<String> {
    let slot = ENVIRONMENT.lock().unwrap_or_else(PoisonError::into_inner);
    slot.as_ref().map(|_| ort::info().to_owned())
}

pub(crate) fn current_environment() -> Result<Environment, Failure> {
    let slot = ENVIRONMENT.lock().unwrap_or_else(PoisonError::into_inner);
    slot.clone()
        .ok_or_else(|| Failure::new(Kind::Library, "no ONNX Runtime library is loaded"))
}

//! The one ONNX Runtime of this OS process.
use crate::{Failure, Kind};
use ort::environment::Environment;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

// Kept for the life of the process: ONNX Runtime allows one environment, and sessions outlive their callers.
static ENVIRONMENT: Mutex<Option<Environment>> = Mutex::new(None);

/// Opens the library at `path`. Does nothing when one is open already; a failure is not kept, so a later call may
/// succeed.
pub fn load(path: &Path) -> Result<(), Failure> {
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
    // Errors come back to the caller; the library need not print them too.
    environment.set_log_level(ort::logging::LogLevel::Fatal);
    *slot = Some(environment);
    Ok(())
}

/// The library's build line, `None` when none is open.
#[must_use]
pub fn version() -> Option<String> {
    let slot = ENVIRONMENT.lock().unwrap_or_else(PoisonError::into_inner);
    slot.as_ref().map(|_| ort::info().to_owned())
}

pub(crate) fn environment() -> Result<Environment, Failure> {
    let slot = ENVIRONMENT.lock().unwrap_or_else(PoisonError::into_inner);
    slot.clone()
        .ok_or_else(|| Failure::new(Kind::Library, "no ONNX Runtime library is open"))
}

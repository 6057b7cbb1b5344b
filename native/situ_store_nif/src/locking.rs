//! Locks between operating system processes, each held by one process of the VM.

use std::sync::Mutex;

use rustler::{Binary, Encoder, Env, LocalPid, Monitor, ResourceArc, Term};
use situ_store::file_lock::{self, Attempt, FileLock};
use situ_store::reader::lock_mutex;

use crate::paths::FilePath;
use crate::{atoms, errors};

/// The lock, and the monitor of the process that holds it.
pub struct LockResource(Mutex<Option<FileLock>>, Mutex<Option<Monitor>>);

#[rustler::resource_impl]
impl rustler::Resource for LockResource {
    /// Releases the lock when its process ends, without waiting for a garbage collection.
    fn down<'a>(&'a self, _env: Env<'a>, _pid: LocalPid, _monitor: Monitor) {
        drop(lock_mutex(&self.0).take());
    }
}

type Handle = ResourceArc<LockResource>;

/// Acquires a lock: `{:ok, lock}`, or `{:held, description_of_the_holder}`.
#[rustler::nif(schedule = "DirtyIo")]
fn file_lock<'a>(env: Env<'a>, path: FilePath, holder: Binary<'a>) -> Term<'a> {
    match file_lock::acquire(&path.0, holder.as_slice()) {
        Ok(Attempt::Taken(taken)) => {
            let handle = ResourceArc::new(LockResource(Mutex::new(Some(taken)), Mutex::default()));
            (atoms::ok(), handle).encode(env)
        }
        Ok(Attempt::Held(holder)) => {
            (atoms::held(), String::from_utf8_lossy(&holder).into_owned()).encode(env)
        }
        Err(error) => errors::encode_error(env, &error),
    }
}

/// Gives the lock to a process and releases it when that process ends. Returns whether the process is alive.
#[rustler::nif]
fn file_lock_give(env: Env<'_>, handle: Handle, pid: LocalPid) -> bool {
    let mut monitor = lock_mutex(&handle.1);
    if let Some(before) = monitor.take() {
        env.demonitor(&handle, &before);
    }
    *monitor = env.monitor(&handle, &pid);
    monitor.is_some()
}

#[rustler::nif(schedule = "DirtyIo")]
fn file_unlock(handle: Handle) -> rustler::Atom {
    drop(lock_mutex(&handle.0).take());
    atoms::ok()
}

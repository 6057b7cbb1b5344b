//! How the C library keeps the memory that kernels use while they run.

use rustler::{Env, Term};

/// Free memory at the end of a heap up to this size stays with the process, and blocks up to it come from heaps.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const KEPT: i32 = 32 << 20;

/// To be named in `rustler::init!`.
///
/// Kernels of OpenCV, libsoxr and libjpeg-turbo allocate and free several megabytes a call. glibc gives such memory
/// back to the system at once, and the next call takes it again, page by page: half of Canny's time. Each dirty
/// scheduler's heap may keep 32 MiB instead. The VM's own memory is not concerned: it has its own allocators.
pub fn load(_env: Env, _info: Term) -> bool {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: mallopt takes two integers, locks its own state, and answers 0 for values it does not like.
    #[allow(unsafe_code)]
    unsafe {
        libc::mallopt(libc::M_TRIM_THRESHOLD, KEPT);
        libc::mallopt(libc::M_MMAP_THRESHOLD, KEPT);
    }
    true
}

//! Bindings of the functions of libsoxr (soxr.h 0.1.x) that are used here.
#![allow(unsafe_code)]

use std::ffi::{c_char, c_double, c_int, c_uint, c_ulong, c_void};

#[repr(C)]
pub struct IoSpec {
    pub itype: c_int,
    pub otype: c_int,
    pub scale: c_double,
    pub e: *mut c_void,
    pub flags: c_ulong,
}

#[repr(C)]
pub struct QualitySpec {
    pub precision: c_double,
    pub phase_response: c_double,
    pub passband_end: c_double,
    pub stopband_begin: c_double,
    pub e: *mut c_void,
    pub flags: c_ulong,
}

#[repr(C)]
pub struct Handle {
    _private: [u8; 0],
}

pub const NO_DITHER: c_ulong = 8;
pub const FLOAT32: c_int = 0;
pub const FLOAT64: c_int = 1;
pub const INT32: c_int = 2;
pub const INT16: c_int = 3;

extern "C" {
    pub fn soxr_create(
        input_rate: c_double,
        output_rate: c_double,
        channels: c_uint,
        error: *mut *const c_char,
        io: *const IoSpec,
        quality: *const QualitySpec,
        runtime: *const c_void,
    ) -> *mut Handle;
    pub fn soxr_process(
        handle: *mut Handle,
        input: *const c_void,
        input_frames: usize,
        input_done: *mut usize,
        output: *mut c_void,
        output_frames: usize,
        output_done: *mut usize,
    ) -> *const c_char;
    pub fn soxr_delay(handle: *mut Handle) -> c_double;
    pub fn soxr_delete(handle: *mut Handle);
    pub fn soxr_quality_spec(recipe: c_ulong, flags: c_ulong) -> QualitySpec;
}

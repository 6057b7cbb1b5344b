//! The functions of cpp/kernels.cc.
#![allow(unsafe_code)]

use situ_media::error::{fail, Code, Result};
use situ_media::picture::{Shape, View};
use std::ffi::{c_char, CStr};

#[repr(C)]
pub struct CPicture {
    data: *mut u8,
    width: i32,
    height: i32,
    stride: i64,
    channels: i32,
    depth: i32,
}

/// Bytes of an error's text.
const ERROR_ROOM: usize = 512;

extern "C" {
    fn situ_warp_affine(
        src: *const CPicture,
        dst: *mut CPicture,
        matrix: *const f64,
        interpolation: i32,
        border: i32,
        color: *const f64,
        error: *mut c_char,
        room: usize,
    ) -> i32;
    fn situ_warp_perspective(
        src: *const CPicture,
        dst: *mut CPicture,
        matrix: *const f64,
        interpolation: i32,
        border: i32,
        color: *const f64,
        error: *mut c_char,
        room: usize,
    ) -> i32;
    fn situ_resize_bilinear(
        src: *const CPicture,
        dst: *mut CPicture,
        error: *mut c_char,
        room: usize,
    ) -> i32;
    fn situ_gaussian(
        src: *const CPicture,
        dst: *mut CPicture,
        size: i32,
        sigma: f64,
        error: *mut c_char,
        room: usize,
    ) -> i32;
    fn situ_box_blur(
        src: *const CPicture,
        dst: *mut CPicture,
        size: i32,
        error: *mut c_char,
        room: usize,
    ) -> i32;
    fn situ_median_blur(
        src: *const CPicture,
        dst: *mut CPicture,
        size: i32,
        error: *mut c_char,
        room: usize,
    ) -> i32;
    fn situ_canny(
        src: *const CPicture,
        dst: *mut CPicture,
        low: f64,
        high: f64,
        error: *mut c_char,
        room: usize,
    ) -> i32;
    fn situ_sobel(src: *const CPicture, dst: *mut CPicture, error: *mut c_char, room: usize)
        -> i32;
    fn situ_morphology(
        src: *const CPicture,
        dst: *mut CPicture,
        kind: i32,
        size: i32,
        error: *mut c_char,
        room: usize,
    ) -> i32;
    fn situ_equalize(
        src: *const CPicture,
        dst: *mut CPicture,
        error: *mut c_char,
        room: usize,
    ) -> i32;
}

/// How to fill what a warp does not cover.
pub struct Sampling {
    pub interpolation: i32,
    pub border: i32,
    pub color: [f64; 4],
}

pub enum Call {
    WarpAffine([f64; 6], Sampling),
    WarpPerspective([f64; 9], Sampling),
    ResizeBilinear,
    Gaussian(i32, f64),
    BoxBlur(i32),
    MedianBlur(i32),
    Canny(f64, f64),
    Sobel,
    Morphology(i32, i32),
    Equalize,
}

fn c_picture(shape: Shape, stride: usize, data: *mut u8) -> CPicture {
    CPicture {
        data,
        width: shape.width as i32,
        height: shape.height as i32,
        stride: stride as i64,
        channels: shape.format.channels() as i32,
        depth: shape.format.bytes_per_channel() as i32,
    }
}

fn words(bytes: &[u8]) -> Vec<u16> {
    let pair = |b: &[u8]| u16::from_ne_bytes([b[0], b[1]]);
    bytes.chunks_exact(2).map(pair).collect()
}

fn bytes(words: &[u16]) -> &[u8] {
    // SAFETY: every byte pattern is a valid u8 and u8 has no alignment to violate.
    let (_, middle, _) = unsafe { words.align_to::<u8>() };
    middle
}

/// Runs one kernel from `src` into `out`, a picture of `shape` without gaps.
pub fn call(src: &View, shape: Shape, out: &mut [u8], call: &Call) -> Result<()> {
    if out.len() != shape.bytes()
        || [src.shape, shape]
            .iter()
            .any(|s| s.width.max(s.height) > 1 << 30)
    {
        return fail(Code::Failed, "the buffer does not fit the picture");
    }
    // OpenCV wants 16-bit channels at even places.
    let depth = src.shape.format.bytes_per_channel();
    let (even, tight);
    let (stride, data) =
        if src.stride.is_multiple_of(depth) && (src.data.as_ptr() as usize).is_multiple_of(depth) {
            (src.stride, src.data)
        } else {
            tight = src.tight();
            even = words(&tight);
            (src.shape.row_bytes(), bytes(&even))
        };
    // C++ reads through this pointer only.
    let from = c_picture(src.shape, stride, data.as_ptr() as *mut u8);
    let mut to = c_picture(shape, shape.row_bytes(), out.as_mut_ptr());
    let mut text = [0 as c_char; ERROR_ROOM];
    let (e, n) = (text.as_mut_ptr(), text.len());
    // SAFETY: `View` guarantees that every row of `src` lies in its slice, `out` has exactly the bytes of `shape`, the
    // C++ side checks that OpenCV wrote there, catches every exception, and fills `text` with at most `n` bytes.
    let status = unsafe {
        match call {
            Call::WarpAffine(m, s) => situ_warp_affine(
                &from,
                &mut to,
                m.as_ptr(),
                s.interpolation,
                s.border,
                s.color.as_ptr(),
                e,
                n,
            ),
            Call::WarpPerspective(m, s) => situ_warp_perspective(
                &from,
                &mut to,
                m.as_ptr(),
                s.interpolation,
                s.border,
                s.color.as_ptr(),
                e,
                n,
            ),
            Call::ResizeBilinear => situ_resize_bilinear(&from, &mut to, e, n),
            Call::Gaussian(size, sigma) => situ_gaussian(&from, &mut to, *size, *sigma, e, n),
            Call::BoxBlur(size) => situ_box_blur(&from, &mut to, *size, e, n),
            Call::MedianBlur(size) => situ_median_blur(&from, &mut to, *size, e, n),
            Call::Canny(low, high) => situ_canny(&from, &mut to, *low, *high, e, n),
            Call::Sobel => situ_sobel(&from, &mut to, e, n),
            Call::Morphology(kind, size) => situ_morphology(&from, &mut to, *kind, *size, e, n),
            Call::Equalize => situ_equalize(&from, &mut to, e, n),
        }
    };
    if status == 0 {
        return Ok(());
    }
    text[ERROR_ROOM - 1] = 0;
    // SAFETY: the last byte was just set to 0.
    let message = unsafe { CStr::from_ptr(text.as_ptr()) }.to_string_lossy();
    fail(Code::Failed, format!("OpenCV: {message}"))
}

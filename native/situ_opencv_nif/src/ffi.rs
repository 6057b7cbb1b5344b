//! Bindings of the functions in cpp/kernels.cc.
#![allow(unsafe_code)]

use situ_media::error::{fail, Code, Result};
use situ_media::image::{Shape, View};
use std::ffi::{c_char, CStr};

#[repr(C)]
pub struct CImage {
    data: *mut u8,
    width: i32,
    height: i32,
    stride: i64,
    channels: i32,
    depth: i32,
}

/// The size of the buffer for an error message, in bytes.
const ERROR_BYTES: usize = 512;

extern "C" {
    fn situ_warp_affine(
        src: *const CImage,
        dst: *mut CImage,
        matrix: *const f64,
        interpolation: i32,
        border: i32,
        color: *const f64,
        error: *mut c_char,
        room: usize,
    ) -> i32;
    fn situ_warp_perspective(
        src: *const CImage,
        dst: *mut CImage,
        matrix: *const f64,
        interpolation: i32,
        border: i32,
        color: *const f64,
        error: *mut c_char,
        room: usize,
    ) -> i32;
    fn situ_resize_bilinear(
        src: *const CImage,
        dst: *mut CImage,
        error: *mut c_char,
        room: usize,
    ) -> i32;
    fn situ_gaussian(
        src: *const CImage,
        dst: *mut CImage,
        size: i32,
        sigma: f64,
        error: *mut c_char,
        room: usize,
    ) -> i32;
    fn situ_box_blur(
        src: *const CImage,
        dst: *mut CImage,
        size: i32,
        error: *mut c_char,
        room: usize,
    ) -> i32;
    fn situ_median_blur(
        src: *const CImage,
        dst: *mut CImage,
        size: i32,
        error: *mut c_char,
        room: usize,
    ) -> i32;
    fn situ_canny(
        src: *const CImage,
        dst: *mut CImage,
        low: f64,
        high: f64,
        error: *mut c_char,
        room: usize,
    ) -> i32;
    fn situ_sobel(src: *const CImage, dst: *mut CImage, error: *mut c_char, room: usize) -> i32;
    fn situ_morphology(
        src: *const CImage,
        dst: *mut CImage,
        kind: i32,
        size: i32,
        error: *mut c_char,
        room: usize,
    ) -> i32;
    fn situ_equalize(src: *const CImage, dst: *mut CImage, error: *mut c_char, room: usize) -> i32;
}

/// The interpolation of a warp, and the values of pixels outside the source.
pub struct Sampling {
    pub interpolation: i32,
    pub border: i32,
    pub color: [f64; 4],
}

pub enum Kernel {
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

fn c_image(shape: Shape, stride: usize, data: *mut u8) -> CImage {
    CImage {
        data,
        width: shape.width as i32,
        height: shape.height as i32,
        stride: stride as i64,
        channels: shape.format.channel_count() as i32,
        depth: shape.format.bytes_per_channel() as i32,
    }
}

fn to_words(bytes: &[u8]) -> Vec<u16> {
    let pair = |b: &[u8]| u16::from_ne_bytes([b[0], b[1]]);
    bytes.chunks_exact(2).map(pair).collect()
}

fn as_bytes(words: &[u16]) -> &[u8] {
    // SAFETY: every byte pattern is a valid u8 and u8 has no alignment to violate.
    let (_, middle, _) = unsafe { words.align_to::<u8>() };
    middle
}

/// Runs a kernel from `src` into `out`, an image of `shape` with contiguous rows.
pub fn run_kernel(src: &View, shape: Shape, out: &mut [u8], kernel: &Kernel) -> Result<()> {
    if out.len() != shape.bytes()
        || [src.shape, shape]
            .iter()
            .any(|s| s.width.max(s.height) > 1 << 30)
    {
        return fail(
            Code::Failed,
            "the buffer does not match the size of the image",
        );
    }
    // OpenCV requires that 16-bit channels are at even addresses.
    let depth = src.shape.format.bytes_per_channel();
    let (even, tight);
    let (stride, data) =
        if src.stride.is_multiple_of(depth) && (src.data.as_ptr() as usize).is_multiple_of(depth) {
            (src.stride, src.data)
        } else {
            tight = src.packed_pixels();
            even = to_words(&tight);
            (src.shape.row_bytes(), as_bytes(&even))
        };
    // The C++ side only reads through this pointer.
    let from = c_image(src.shape, stride, data.as_ptr() as *mut u8);
    let mut to = c_image(shape, shape.row_bytes(), out.as_mut_ptr());
    let mut text = [0 as c_char; ERROR_BYTES];
    let (e, n) = (text.as_mut_ptr(), text.len());
    // SAFETY: `View` guarantees that every row of `src` is in its slice, and `out` has exactly the bytes of `shape`.
    // The C++ side checks that OpenCV wrote to `out`, catches every exception, and writes at most `n` bytes to
    // `text`.
    let status = unsafe {
        match kernel {
            Kernel::WarpAffine(m, s) => situ_warp_affine(
                &from,
                &mut to,
                m.as_ptr(),
                s.interpolation,
                s.border,
                s.color.as_ptr(),
                e,
                n,
            ),
            Kernel::WarpPerspective(m, s) => situ_warp_perspective(
                &from,
                &mut to,
                m.as_ptr(),
                s.interpolation,
                s.border,
                s.color.as_ptr(),
                e,
                n,
            ),
            Kernel::ResizeBilinear => situ_resize_bilinear(&from, &mut to, e, n),
            Kernel::Gaussian(size, sigma) => situ_gaussian(&from, &mut to, *size, *sigma, e, n),
            Kernel::BoxBlur(size) => situ_box_blur(&from, &mut to, *size, e, n),
            Kernel::MedianBlur(size) => situ_median_blur(&from, &mut to, *size, e, n),
            Kernel::Canny(low, high) => situ_canny(&from, &mut to, *low, *high, e, n),
            Kernel::Sobel => situ_sobel(&from, &mut to, e, n),
            Kernel::Morphology(kind, size) => situ_morphology(&from, &mut to, *kind, *size, e, n),
            Kernel::Equalize => situ_equalize(&from, &mut to, e, n),
        }
    };
    if status == 0 {
        return Ok(());
    }
    text[ERROR_BYTES - 1] = 0;
    // SAFETY: the last byte was just set to 0.
    let message = unsafe { CStr::from_ptr(text.as_ptr()) }.to_string_lossy();
    fail(Code::Failed, format!("OpenCV: {message}"))
}

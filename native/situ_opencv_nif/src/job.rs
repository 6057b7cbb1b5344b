//! OpenCV kernels as terms: `{:gaussian, image, 5, 1.4}`.

use crate::ffi::{call, Call, Sampling};
use rustler::{Env, NifTaggedEnum, NifUnitEnum, Term};
use situ_media::error::{fail, Code, Result};
use situ_media::picture::{Format, Shape, View};
use situ_media_term::{picture, Picture};

#[derive(Clone, Copy, NifUnitEnum)]
pub enum Interpolation {
    Nearest,
    Bilinear,
    Bicubic,
}

#[derive(Clone, Copy, NifUnitEnum)]
pub enum Border {
    Constant,
    Replicate,
}

#[derive(Clone, Copy, NifUnitEnum)]
pub enum Morph {
    Erode,
    Dilate,
    Open,
    Close,
}

type Color = (f64, f64, f64, f64);
type Edge = (Interpolation, Border, Color);

#[derive(NifTaggedEnum)]
pub enum Job<'a> {
    WarpAffine(Picture<'a>, u32, u32, Vec<f64>, Edge),
    WarpPerspective(Picture<'a>, u32, u32, Vec<f64>, Edge),
    ResizeBilinear(Picture<'a>, u32, u32),
    Gaussian(Picture<'a>, i32, f64),
    BoxBlur(Picture<'a>, i32),
    MedianBlur(Picture<'a>, i32),
    Canny(Picture<'a>, f64, f64),
    Sobel(Picture<'a>),
    Morphology(Picture<'a>, Morph, i32),
    Equalize(Picture<'a>),
}

impl<'a> Job<'a> {
    pub fn run(&self, env: Env<'a>) -> Result<Term<'a>> {
        match self {
            Job::WarpAffine(p, w, h, m, edge) => {
                let m: [f64; 6] = matrix(m)?;
                warp(env, p, (*w, *h), &Call::WarpAffine(m, sampling(edge)))
            }
            Job::WarpPerspective(p, w, h, m, edge) => {
                let m: [f64; 9] = matrix(m)?;
                warp(env, p, (*w, *h), &Call::WarpPerspective(m, sampling(edge)))
            }
            Job::ResizeBilinear(p, w, h) => warp(env, p, (*w, *h), &Call::ResizeBilinear),
            Job::Gaussian(p, size, sigma) => {
                window(*size, 1 << 10)?;
                same(env, &p.view()?, &Call::Gaussian(*size, *sigma))
            }
            Job::BoxBlur(p, size) => {
                window(*size, 1 << 10)?;
                same(env, &p.view()?, &Call::BoxBlur(*size))
            }
            Job::MedianBlur(p, size) => {
                window(*size, 255)?;
                same(env, &p.view()?, &Call::MedianBlur(*size))
            }
            Job::Canny(p, low, high) => gray8(env, &p.view()?, &Call::Canny(*low, *high)),
            Job::Sobel(p) => gray8(env, &p.view()?, &Call::Sobel),
            Job::Equalize(p) => gray8(env, &p.view()?, &Call::Equalize),
            Job::Morphology(p, kind, size) => {
                window(*size, 255)?;
                same(env, &p.view()?, &Call::Morphology(*kind as i32, *size))
            }
        }
    }
}

fn matrix<const N: usize>(values: &[f64]) -> Result<[f64; N]> {
    match values.try_into() {
        Ok(m) if values.iter().all(|v| v.is_finite()) => Ok(m),
        _ => fail(
            Code::BadOption,
            format!("a warp matrix has {N} finite numbers"),
        ),
    }
}

fn window(size: i32, max: i32) -> Result<()> {
    if size % 2 == 1 && (1..=max).contains(&size) {
        return Ok(());
    }
    fail(
        Code::BadOption,
        format!("the window must be odd and 1 to {max}, not {size}"),
    )
}

fn sampling(edge: &Edge) -> Sampling {
    let (interpolation, border, color) = edge;
    Sampling {
        interpolation: *interpolation as i32,
        border: *border as i32,
        color: (*color).into(),
    }
}

/// OpenCV addresses the pixels of a warp's source with 16-bit numbers.
fn warp<'a>(env: Env<'a>, p: &Picture<'a>, size: (u32, u32), kernel: &Call) -> Result<Term<'a>> {
    let view = p.view()?;
    let shape = Shape::new(size.0 as usize, size.1 as usize, view.shape.format)?;
    if [view.shape, shape]
        .iter()
        .any(|s| s.width.max(s.height) > 32_766)
    {
        return fail(
            Code::TooLarge,
            "warps work on pictures of up to 32766 pixels a side",
        );
    }
    picture(env, shape, |out| call(&view, shape, out, kernel))
}

fn same<'a>(env: Env<'a>, view: &View, kernel: &Call) -> Result<Term<'a>> {
    picture(env, view.shape, |out| call(view, view.shape, out, kernel))
}

fn gray8<'a>(env: Env<'a>, view: &View, kernel: &Call) -> Result<Term<'a>> {
    if view.shape.format != Format::Gray8 {
        let what = format!(
            "this operation works on :gray8, not {}",
            view.shape.format.name()
        );
        return fail(Code::BadFormat, what);
    }
    same(env, view, kernel)
}

//! OpenCV kernels as terms: `{:gaussian, image, 5, 1.4}`.

use crate::ffi::{run_kernel, Kernel, Sampling};
use rustler::{Env, NifTaggedEnum, NifUnitEnum, Term};
use situ_media::error::{fail, Code, Result};
use situ_media::image::{Format, Shape, View};
use situ_media_term::{build_image, ImageTerm};

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
    WarpAffine(ImageTerm<'a>, u32, u32, Vec<f64>, Edge),
    WarpPerspective(ImageTerm<'a>, u32, u32, Vec<f64>, Edge),
    ResizeBilinear(ImageTerm<'a>, u32, u32),
    Gaussian(ImageTerm<'a>, i32, f64),
    BoxBlur(ImageTerm<'a>, i32),
    MedianBlur(ImageTerm<'a>, i32),
    Canny(ImageTerm<'a>, f64, f64),
    Sobel(ImageTerm<'a>),
    Morphology(ImageTerm<'a>, Morph, i32),
    Equalize(ImageTerm<'a>),
}

impl<'a> Job<'a> {
    pub fn run(&self, env: Env<'a>) -> Result<Term<'a>> {
        match self {
            Job::WarpAffine(p, w, h, m, edge) => {
                let m: [f64; 6] = parse_matrix(m)?;
                warp_image(
                    env,
                    p,
                    (*w, *h),
                    &Kernel::WarpAffine(m, edge_sampling(edge)),
                )
            }
            Job::WarpPerspective(p, w, h, m, edge) => {
                let m: [f64; 9] = parse_matrix(m)?;
                warp_image(
                    env,
                    p,
                    (*w, *h),
                    &Kernel::WarpPerspective(m, edge_sampling(edge)),
                )
            }
            Job::ResizeBilinear(p, w, h) => warp_image(env, p, (*w, *h), &Kernel::ResizeBilinear),
            Job::Gaussian(p, size, sigma) => {
                check_window(*size, 1 << 10)?;
                run_same_shape(env, &p.view()?, &Kernel::Gaussian(*size, *sigma))
            }
            Job::BoxBlur(p, size) => {
                check_window(*size, 1 << 10)?;
                run_same_shape(env, &p.view()?, &Kernel::BoxBlur(*size))
            }
            Job::MedianBlur(p, size) => {
                check_window(*size, 255)?;
                run_same_shape(env, &p.view()?, &Kernel::MedianBlur(*size))
            }
            Job::Canny(p, low, high) => run_gray8(env, &p.view()?, &Kernel::Canny(*low, *high)),
            Job::Sobel(p) => run_gray8(env, &p.view()?, &Kernel::Sobel),
            Job::Equalize(p) => run_gray8(env, &p.view()?, &Kernel::Equalize),
            Job::Morphology(p, kind, size) => {
                check_window(*size, 255)?;
                run_same_shape(env, &p.view()?, &Kernel::Morphology(*kind as i32, *size))
            }
        }
    }
}

fn parse_matrix<const N: usize>(values: &[f64]) -> Result<[f64; N]> {
    match values.try_into() {
        Ok(m) if values.iter().all(|v| v.is_finite()) => Ok(m),
        _ => fail(
            Code::BadOption,
            format!("a warp matrix must have {N} finite numbers"),
        ),
    }
}

fn check_window(size: i32, max: i32) -> Result<()> {
    if size % 2 == 1 && (1..=max).contains(&size) {
        return Ok(());
    }
    fail(
        Code::BadOption,
        format!("the window size must be odd and 1 to {max}, not {size}"),
    )
}

fn edge_sampling(edge: &Edge) -> Sampling {
    let (interpolation, border, color) = edge;
    Sampling {
        interpolation: *interpolation as i32,
        border: *border as i32,
        color: (*color).into(),
    }
}

/// Runs a warp or a resize. OpenCV addresses the pixels of the source with 16-bit numbers, which limits the size.
fn warp_image<'a>(
    env: Env<'a>,
    p: &ImageTerm<'a>,
    size: (u32, u32),
    kernel: &Kernel,
) -> Result<Term<'a>> {
    let view = p.view()?;
    let shape = Shape::new(size.0 as usize, size.1 as usize, view.shape.format)?;
    if [view.shape, shape]
        .iter()
        .any(|s| s.width.max(s.height) > 32_766)
    {
        return fail(
            Code::TooLarge,
            "warps support images of up to 32766 pixels per side",
        );
    }
    build_image(env, shape, |out| run_kernel(&view, shape, out, kernel))
}

fn run_same_shape<'a>(env: Env<'a>, view: &View, kernel: &Kernel) -> Result<Term<'a>> {
    build_image(env, view.shape, |out| {
        run_kernel(view, view.shape, out, kernel)
    })
}

fn run_gray8<'a>(env: Env<'a>, view: &View, kernel: &Kernel) -> Result<Term<'a>> {
    if view.shape.format != Format::Gray8 {
        let what = format!(
            "this operation requires :gray8, not {}",
            view.shape.format.name()
        );
        return fail(Code::BadFormat, what);
    }
    run_same_shape(env, view, kernel)
}

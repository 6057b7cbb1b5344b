//! Image kernels as terms: `{:resize, image, width, height, :bilinear}`.

use crate::drawing::{draw_figures, open_typeface, Drawing};
use rustler::{Binary, Encoder, Env, NifTaggedEnum, NifUnitEnum, Term};
use situ_media::convolve::Kernel;
use situ_media::depth::PseudoColor;
use situ_media::error::Result;
use situ_media::geometry::Axis;
use situ_media::image::View;
use situ_media::jpeg::{self, Subsampling};
use situ_media::op::Op;
use situ_media::pixelwise::Threshold;
use situ_media::resize::Filter;
use situ_media::{compare, png_file, statistics, tensor, yuv};
use situ_media_term::{allocate_binary, build_image, copy_to_binary, ImageTerm, PixelFormat};

macro_rules! mirror_enum {
    ($name:ident => $target:ty { $($variant:ident),* }) => {
        #[derive(Clone, Copy, NifUnitEnum)]
        pub enum $name { $($variant),* }
        impl From<$name> for $target {
            fn from(value: $name) -> Self {
                match value { $($name::$variant => <$target>::$variant),* }
            }
        }
    };
}

mirror_enum!(FilterTerm => Filter { Nearest, Bilinear, Bicubic, Area, Smooth, Lanczos });
mirror_enum!(AxisTerm => Axis { Horizontal, Vertical, Both });
mirror_enum!(ThresholdTerm => Threshold { Binary, BinaryInverted, Truncate, ToZero, ToZeroInverted });
mirror_enum!(SubsamplingTerm => Subsampling { Full, Half, Quarter });

mirror_enum!(YuvTerm => yuv::Layout { Nv12, I420, Yuyv });

#[derive(NifTaggedEnum)]
pub enum Job<'a> {
    Convert(ImageTerm<'a>, PixelFormat),
    Crop(ImageTerm<'a>, i64, i64, i64, i64),
    Resize(ImageTerm<'a>, u32, u32, FilterTerm),
    Letterbox(ImageTerm<'a>, u32, u32, FilterTerm, Binary<'a>),
    Flip(ImageTerm<'a>, AxisTerm),
    QuarterTurns(ImageTerm<'a>, u32),
    Invert(ImageTerm<'a>),
    Threshold(ImageTerm<'a>, u32, u32, ThresholdTerm),
    ExtractChannel(ImageTerm<'a>, u32),
    AbsoluteDifference(ImageTerm<'a>, ImageTerm<'a>),
    Convolve(ImageTerm<'a>, u32, u32, Vec<i32>),
    PseudoColorize(ImageTerm<'a>, f64, f64, u16, bool),
    Paste(
        ImageTerm<'a>,
        ImageTerm<'a>,
        Option<ImageTerm<'a>>,
        i64,
        i64,
    ),
    Statistics(ImageTerm<'a>, Option<(i64, i64, i64, i64)>),
    Histogram(ImageTerm<'a>, Option<(i64, i64, i64, i64)>),
    Compare(ImageTerm<'a>, ImageTerm<'a>, u32),
    ToF32(ImageTerm<'a>, bool, f32, f32),
    JpegEncode(ImageTerm<'a>, i32, SubsamplingTerm),
    JpegHeader(Binary<'a>),
    JpegDecode(Binary<'a>, Option<PixelFormat>),
    PngEncode(ImageTerm<'a>, u8),
    PngDecode(Binary<'a>),
    YuvDecode(Binary<'a>, YuvTerm, u32, u32),
    Draw(ImageTerm<'a>, Vec<Drawing<'a>>),
    /// Text, height of a capital letter, font files.
    MeasureText(&'a str, f64, Vec<Binary<'a>>),
}

impl<'a> Job<'a> {
    pub fn run(&self, env: Env<'a>) -> Result<Term<'a>> {
        match self {
            Job::Statistics(p, rect) => Ok(statistics_term(env, &crop_view(p, rect)?)),
            Job::Histogram(p, rect) => {
                Ok(statistics::channel_histograms(&crop_view(p, rect)?).encode(env))
            }
            Job::Compare(a, b, tolerance) => {
                let d = compare::compare_images(&a.view()?, &b.view()?, *tolerance)?;
                Ok((d.max, d.mean, d.outliers).encode(env))
            }
            Job::ToF32(p, channels_first, scale, offset) => {
                let layout = tensor::Layout {
                    channels_first: *channels_first,
                    scale: *scale,
                    offset: *offset,
                };
                tensor_term(env, &p.view()?, layout)
            }
            Job::JpegEncode(p, quality, subsampling) => {
                let bytes = jpeg::encode(&p.view()?, *quality, (*subsampling).into())?;
                Ok(copy_to_binary(env, &bytes)?.encode(env))
            }
            Job::JpegHeader(bytes) => {
                let shape = jpeg::read_shape(bytes, None)?;
                Ok((shape.width, shape.height).encode(env))
            }
            Job::JpegDecode(bytes, format) => {
                let shape = jpeg::read_shape(bytes, format.map(Into::into))?;
                build_image(env, shape, |out| jpeg::decode(bytes, shape, out))
            }
            Job::PngEncode(p, level) => {
                let bytes = png_file::encode(&p.view()?, *level)?;
                Ok(copy_to_binary(env, &bytes)?.encode(env))
            }
            Job::PngDecode(bytes) => {
                let png = png_file::decode(bytes)?;
                build_image(env, png.shape, |out| {
                    out.copy_from_slice(&png.pixels);
                    Ok(())
                })
            }
            Job::YuvDecode(bytes, layout, width, height) => {
                let layout = (*layout).into();
                let shape =
                    yuv::frame_shape(bytes.len(), layout, *width as usize, *height as usize)?;
                build_image(env, shape, |out| {
                    yuv::to_bgr(bytes, layout, shape, out);
                    Ok(())
                })
            }
            Job::Draw(p, all) => draw_figures(env, &p.view()?, all),
            Job::MeasureText(text, size, fonts) => {
                Ok(open_typeface(fonts)?.measure(text, *size)?.encode(env))
            }
            _ => self.run_op(env),
        }
    }

    /// Runs the jobs whose result is an image with a shape known beforehand.
    fn run_op(&self, env: Env<'a>) -> Result<Term<'a>> {
        match self {
            Job::Convert(p, format) => apply_op(env, p, Op::Convert((*format).into())),
            Job::Crop(p, x, y, w, h) => apply_op(env, p, Op::Crop(*x, *y, *w, *h)),
            Job::Resize(p, w, h, filter) => {
                let op = Op::Resize(*w as usize, *h as usize, (*filter).into());
                apply_op(env, p, op)
            }
            Job::Letterbox(p, w, h, filter, pixel) => {
                let pixel = pixel.as_slice().to_vec();
                let op = Op::Letterbox(*w as usize, *h as usize, (*filter).into(), pixel);
                apply_op(env, p, op)
            }
            Job::Flip(p, axis) => apply_op(env, p, Op::Flip((*axis).into())),
            Job::QuarterTurns(p, turns) => apply_op(env, p, Op::QuarterTurns(*turns)),
            Job::Invert(p) => apply_op(env, p, Op::Invert),
            Job::Threshold(p, t, max, kind) => {
                apply_op(env, p, Op::Threshold(*t, *max, (*kind).into()))
            }
            Job::ExtractChannel(p, channel) => {
                apply_op(env, p, Op::ExtractChannel(*channel as usize))
            }
            Job::AbsoluteDifference(a, b) => apply_op(env, a, Op::AbsoluteDifference(b.view()?)),
            Job::Convolve(p, width, height, taps) => {
                let (width, height) = (*width as usize, *height as usize);
                let taps = taps.clone();
                apply_op(
                    env,
                    p,
                    Op::Convolve(Kernel {
                        width,
                        height,
                        taps,
                    }),
                )
            }
            Job::PseudoColorize(p, near, far, invalid, transparent) => {
                let (near, far, invalid, transparent) = (*near, *far, *invalid, *transparent);
                let how = PseudoColor {
                    near,
                    far,
                    invalid,
                    transparent,
                };
                apply_op(env, p, Op::PseudoColorize(how))
            }
            Job::Paste(p, part, mask, x, y) => {
                let mask = mask.as_ref().map(ImageTerm::view).transpose()?;
                apply_op(env, p, Op::Paste(part.view()?, mask, *x, *y))
            }
            _ => situ_media::error::fail(situ_media::error::Code::Failed, "not an image job"),
        }
    }
}

fn apply_op<'a>(env: Env<'a>, source: &ImageTerm<'a>, op: Op) -> Result<Term<'a>> {
    let view = source.view()?;
    let shape = op.result_shape(&view)?;
    build_image(env, shape, |out| op.run(&view, shape, out))
}

fn crop_view<'v>(p: &'v ImageTerm, rect: &Option<(i64, i64, i64, i64)>) -> Result<View<'v>> {
    match rect {
        None => p.view(),
        Some((x, y, w, h)) => p.view()?.crop(*x, *y, *w, *h),
    }
}

fn statistics_term<'a>(env: Env<'a>, view: &View) -> Term<'a> {
    statistics::channel_statistics(view)
        .into_iter()
        .map(|c| (c.min, c.max, c.mean, c.deviation))
        .collect::<Vec<_>>()
        .encode(env)
}

fn tensor_term<'a>(env: Env<'a>, view: &View, layout: tensor::Layout) -> Result<Term<'a>> {
    let mut out = allocate_binary(tensor::tensor_bytes(view.shape)?)?;
    tensor::to_f32(view, layout, out.as_mut_slice());
    Ok(out.release(env).encode(env))
}

//! Picture kernels as terms: `{:resize, image, width, height, :bilinear}`.

use crate::drawing::{draw, typeface, Drawn};
use rustler::{Binary, Encoder, Env, NifTaggedEnum, NifUnitEnum, Term};
use situ_media::convolve::Kernel;
use situ_media::depth::PseudoColor;
use situ_media::error::Result;
use situ_media::geometry::Axis;
use situ_media::jpeg::{self, Subsampling};
use situ_media::op::Op;
use situ_media::picture::View;
use situ_media::pixelwise::Threshold;
use situ_media::resize::Filter;
use situ_media::{compare, png_file, statistics, tensor, yuv};
use situ_media_term::{allocate, binary, picture, Picture, PixelFormat};

macro_rules! mirror {
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

mirror!(FilterTerm => Filter { Nearest, Bilinear, Bicubic, Area, Smooth, Lanczos });
mirror!(AxisTerm => Axis { Horizontal, Vertical, Both });
mirror!(ThresholdTerm => Threshold { Binary, BinaryInverted, Truncate, ToZero, ToZeroInverted });
mirror!(SubsamplingTerm => Subsampling { Full, Half, Quarter });

mirror!(YuvTerm => yuv::Layout { Nv12, I420, Yuyv });

#[derive(NifTaggedEnum)]
pub enum Job<'a> {
    Convert(Picture<'a>, PixelFormat),
    Crop(Picture<'a>, i64, i64, i64, i64),
    Resize(Picture<'a>, u32, u32, FilterTerm),
    Letterbox(Picture<'a>, u32, u32, FilterTerm, Binary<'a>),
    Flip(Picture<'a>, AxisTerm),
    QuarterTurns(Picture<'a>, u32),
    Invert(Picture<'a>),
    Threshold(Picture<'a>, u32, u32, ThresholdTerm),
    ExtractChannel(Picture<'a>, u32),
    AbsoluteDifference(Picture<'a>, Picture<'a>),
    Convolve(Picture<'a>, u32, u32, Vec<i32>),
    PseudoColorize(Picture<'a>, f64, f64, u16, bool),
    Paste(Picture<'a>, Picture<'a>, Option<Picture<'a>>, i64, i64),
    Statistics(Picture<'a>, Option<(i64, i64, i64, i64)>),
    Histogram(Picture<'a>, Option<(i64, i64, i64, i64)>),
    Compare(Picture<'a>, Picture<'a>, u32),
    ToF32(Picture<'a>, bool, f32, f32),
    JpegEncode(Picture<'a>, i32, SubsamplingTerm),
    JpegHeader(Binary<'a>),
    JpegDecode(Binary<'a>, Option<PixelFormat>),
    PngEncode(Picture<'a>, u8),
    PngDecode(Binary<'a>),
    YuvDecode(Binary<'a>, YuvTerm, u32, u32),
    Draw(Picture<'a>, Vec<Drawn<'a>>),
    /// Text, height of a capital, font files.
    MeasureText(&'a str, f64, Vec<Binary<'a>>),
}

impl<'a> Job<'a> {
    pub fn run(&self, env: Env<'a>) -> Result<Term<'a>> {
        match self {
            Job::Statistics(p, rect) => Ok(statistics_term(env, &part(p, rect)?)),
            Job::Histogram(p, rect) => Ok(statistics::histogram(&part(p, rect)?).encode(env)),
            Job::Compare(a, b, tolerance) => {
                let d = compare::compare(&a.view()?, &b.view()?, *tolerance)?;
                Ok((d.max, d.mean, d.outliers).encode(env))
            }
            Job::ToF32(p, channels_first, scale, offset) => {
                let layout = tensor::Layout {
                    channels_first: *channels_first,
                    scale: *scale,
                    offset: *offset,
                };
                to_f32(env, &p.view()?, layout)
            }
            Job::JpegEncode(p, quality, subsampling) => {
                let bytes = jpeg::encode(&p.view()?, *quality, (*subsampling).into())?;
                Ok(binary(env, &bytes)?.encode(env))
            }
            Job::JpegHeader(bytes) => {
                let shape = jpeg::header(bytes, None)?;
                Ok((shape.width, shape.height).encode(env))
            }
            Job::JpegDecode(bytes, format) => {
                let shape = jpeg::header(bytes, format.map(Into::into))?;
                picture(env, shape, |out| jpeg::decode(bytes, shape, out))
            }
            Job::PngEncode(p, level) => {
                let bytes = png_file::encode(&p.view()?, *level)?;
                Ok(binary(env, &bytes)?.encode(env))
            }
            Job::PngDecode(bytes) => {
                let png = png_file::decode(bytes)?;
                picture(env, png.shape, |out| {
                    out.copy_from_slice(&png.pixels);
                    Ok(())
                })
            }
            Job::YuvDecode(bytes, layout, width, height) => {
                let layout = (*layout).into();
                let shape = yuv::shape(bytes.len(), layout, *width as usize, *height as usize)?;
                picture(env, shape, |out| {
                    yuv::to_bgr(bytes, layout, shape, out);
                    Ok(())
                })
            }
            Job::Draw(p, all) => draw(env, &p.view()?, all),
            Job::MeasureText(text, size, fonts) => {
                Ok(typeface(fonts)?.measure(text, *size)?.encode(env))
            }
            _ => self.run_op(env),
        }
    }

    /// The jobs whose result is a picture of a shape known beforehand.
    fn run_op(&self, env: Env<'a>) -> Result<Term<'a>> {
        match self {
            Job::Convert(p, format) => apply(env, p, Op::Convert((*format).into())),
            Job::Crop(p, x, y, w, h) => apply(env, p, Op::Crop(*x, *y, *w, *h)),
            Job::Resize(p, w, h, filter) => {
                let op = Op::Resize(*w as usize, *h as usize, (*filter).into());
                apply(env, p, op)
            }
            Job::Letterbox(p, w, h, filter, pixel) => {
                let pixel = pixel.as_slice().to_vec();
                let op = Op::Letterbox(*w as usize, *h as usize, (*filter).into(), pixel);
                apply(env, p, op)
            }
            Job::Flip(p, axis) => apply(env, p, Op::Flip((*axis).into())),
            Job::QuarterTurns(p, turns) => apply(env, p, Op::QuarterTurns(*turns)),
            Job::Invert(p) => apply(env, p, Op::Invert),
            Job::Threshold(p, t, max, kind) => {
                apply(env, p, Op::Threshold(*t, *max, (*kind).into()))
            }
            Job::ExtractChannel(p, channel) => apply(env, p, Op::ExtractChannel(*channel as usize)),
            Job::AbsoluteDifference(a, b) => apply(env, a, Op::AbsoluteDifference(b.view()?)),
            Job::Convolve(p, width, height, taps) => {
                let (width, height) = (*width as usize, *height as usize);
                let taps = taps.clone();
                apply(
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
                apply(env, p, Op::PseudoColorize(how))
            }
            Job::Paste(p, part, mask, x, y) => {
                let mask = mask.as_ref().map(Picture::view).transpose()?;
                apply(env, p, Op::Paste(part.view()?, mask, *x, *y))
            }
            _ => situ_media::error::fail(situ_media::error::Code::Failed, "not a picture job"),
        }
    }
}

fn apply<'a>(env: Env<'a>, source: &Picture<'a>, op: Op) -> Result<Term<'a>> {
    let view = source.view()?;
    let shape = op.shape(&view)?;
    picture(env, shape, |out| op.run(&view, shape, out))
}

fn part<'v>(p: &'v Picture, rect: &Option<(i64, i64, i64, i64)>) -> Result<View<'v>> {
    match rect {
        None => p.view(),
        Some((x, y, w, h)) => p.view()?.part(*x, *y, *w, *h),
    }
}

fn statistics_term<'a>(env: Env<'a>, view: &View) -> Term<'a> {
    statistics::channels(view)
        .into_iter()
        .map(|c| (c.min, c.max, c.mean, c.deviation))
        .collect::<Vec<_>>()
        .encode(env)
}

fn to_f32<'a>(env: Env<'a>, view: &View, layout: tensor::Layout) -> Result<Term<'a>> {
    let mut out = allocate(tensor::bytes(view.shape)?)?;
    tensor::to_f32(view, layout, out.as_mut_slice());
    Ok(out.release(env).encode(env))
}

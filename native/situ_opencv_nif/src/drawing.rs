//! Figures on a picture: lines, rectangles and circles by OpenCV, text by situ_media.

use crate::ffi::{draw_on, CShape};
use rustler::{Binary, Env, NifTaggedEnum, Term};
use situ_media::error::{fail, Code, Result};
use situ_media::picture::View;
use situ_media::text::{Style, Typeface};
use situ_media_term::picture;
use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;

type Color = (f64, f64, f64, f64);

#[derive(NifTaggedEnum)]
pub enum Figure<'a> {
    /// Kind, four numbers, colour, thickness.
    Shape(i32, (f64, f64, f64, f64), Color, i32),
    /// Place and height of a capital, colour, background, text, font files.
    Text(
        (f64, f64, f64),
        Color,
        Option<Color>,
        &'a str,
        Vec<Binary<'a>>,
    ),
}

impl Figure<'_> {
    fn place(&self) -> [f64; 4] {
        match self {
            Figure::Shape(_, place, ..) => (*place).into(),
            Figure::Text((x, y, size), ..) => [*x, *y, *size, 0.0],
        }
    }

    fn shape(&self) -> Option<CShape> {
        match self {
            Figure::Shape(kind, place, color, thickness) => Some(CShape {
                kind: *kind,
                place: (*place).into(),
                color: (*color).into(),
                thickness: (*thickness).clamp(-1, 1000),
            }),
            Figure::Text(..) => None,
        }
    }
}

/// A copy of the picture with the figures on it, in order.
pub fn draw<'a>(env: Env<'a>, view: &View, figures: &[Figure]) -> Result<Term<'a>> {
    // Beyond this OpenCV's fixed point overflows; what lies so far outside is not seen anyway.
    let reach = 1e6;
    let fits = |f: &Figure| f.place().iter().all(|v| v.abs() <= reach);
    if !figures.iter().all(fits) {
        return fail(
            Code::BadOption,
            "figures must lie within 1,000,000 pixels of the picture",
        );
    }
    picture(env, view.shape, |out| {
        for (to, from) in out
            .chunks_exact_mut(view.shape.row_bytes())
            .zip(view.rows())
        {
            to.copy_from_slice(from);
        }
        let same_kind = |a: &Figure, b: &Figure| a.shape().is_some() == b.shape().is_some();
        for run in figures.chunk_by(same_kind) {
            let shapes: Vec<CShape> = run.iter().filter_map(Figure::shape).collect();
            if !shapes.is_empty() {
                draw_on(view.shape, out, &shapes)?;
            }
            for figure in run {
                write(figure, view, out)?;
            }
        }
        Ok(())
    })
}

fn write(figure: &Figure, view: &View, out: &mut [u8]) -> Result<()> {
    let Figure::Text((x, y, size), color, background, text, fonts) = figure else {
        return Ok(());
    };
    let style = Style {
        at: (*x, *y),
        size: *size,
        color: (*color).into(),
        background: background.map(Into::into),
    };
    typeface(fonts)?.draw(text, &style, view.shape, out)
}

pub fn typeface(paths: &[Binary]) -> Result<Typeface> {
    Typeface::open(
        paths
            .iter()
            .map(|p| Path::new(OsStr::from_bytes(p.as_slice()))),
    )
}

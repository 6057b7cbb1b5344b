//! Figures and text to draw, as terms: `{:shape, {:line, {0.0, 0.0}, {9.0, 5.0}, 1.0}, color}`, `{:text, ...}`.

use rustler::{Binary, Env, NifTaggedEnum, Term};
use situ_media::draw::{self, Figure};
use situ_media::error::{fail, Code, Result};
use situ_media::image::View;
use situ_media::text::{Style, Typeface};
use situ_media_term::build_image;
use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;

type Point = (f64, f64);
type Color = (f64, f64, f64, f64);

#[derive(NifTaggedEnum)]
pub enum FigureTerm {
    Line(Point, Point, f64),
    /// Left, top, width, height.
    Rectangle((f64, f64, f64, f64), Option<f64>),
    Circle(Point, f64, Option<f64>),
}

#[derive(NifTaggedEnum)]
pub enum Drawing<'a> {
    Shape(FigureTerm, Color),
    /// Position and height of a capital letter, color, background, text, font files.
    Text(
        (f64, f64, f64),
        Color,
        Option<Color>,
        &'a str,
        Vec<Binary<'a>>,
    ),
}

impl From<&FigureTerm> for Figure {
    fn from(shape: &FigureTerm) -> Figure {
        match *shape {
            FigureTerm::Line(from, to, width) => Figure::Line { from, to, width },
            FigureTerm::Rectangle(rect, width) => Figure::Rectangle(rect.into(), width),
            FigureTerm::Circle(center, radius, width) => Figure::Circle(center, radius, width),
        }
    }
}

/// Returns a copy of the image with all figures drawing on it, in order.
pub fn draw_figures<'a>(env: Env<'a>, view: &View, all: &[Drawing]) -> Result<Term<'a>> {
    build_image(env, view.shape, |out| {
        for (to, from) in out
            .chunks_exact_mut(view.shape.row_bytes())
            .zip(view.rows())
        {
            to.copy_from_slice(from);
        }
        for drawing in all {
            match drawing {
                Drawing::Shape(shape, color) => {
                    draw::draw_figure(&shape.into(), (*color).into(), view.shape, out)?
                }
                text => draw_text(text, view, out)?,
            }
        }
        Ok(())
    })
}

fn draw_text(drawing: &Drawing, view: &View, out: &mut [u8]) -> Result<()> {
    let Drawing::Text((x, y, size), color, background, text, fonts) = drawing else {
        return Ok(());
    };
    // Beyond any image, but pixel numbers stay exact integers.
    if x.abs().max(y.abs()) > draw::REACH {
        return fail(
            Code::BadOption,
            "text must be within 1,000,000 pixels of the image",
        );
    }
    let style = Style {
        at: (*x, *y),
        size: *size,
        color: (*color).into(),
        background: background.map(Into::into),
    };
    open_typeface(fonts)?.draw(text, &style, view.shape, out)
}

pub fn open_typeface(paths: &[Binary]) -> Result<Typeface> {
    Typeface::open(
        paths
            .iter()
            .map(|p| Path::new(OsStr::from_bytes(p.as_slice()))),
    )
}

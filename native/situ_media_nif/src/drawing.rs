//! Figures on a picture as terms: `{:shape, {:line, {0.0, 0.0}, {9.0, 5.0}, 1.0}, color}`, `{:text, ...}`.

use rustler::{Binary, Env, NifTaggedEnum, Term};
use situ_media::draw::{self, Figure};
use situ_media::error::{fail, Code, Result};
use situ_media::picture::View;
use situ_media::text::{Style, Typeface};
use situ_media_term::picture;
use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;

type Point = (f64, f64);
type Color = (f64, f64, f64, f64);

#[derive(NifTaggedEnum)]
pub enum Shape {
    Line(Point, Point, f64),
    /// Left, top, width, height.
    Rectangle((f64, f64, f64, f64), Option<f64>),
    Circle(Point, f64, Option<f64>),
}

#[derive(NifTaggedEnum)]
pub enum Drawn<'a> {
    Shape(Shape, Color),
    /// Place and height of a capital, colour, background, text, font files.
    Text(
        (f64, f64, f64),
        Color,
        Option<Color>,
        &'a str,
        Vec<Binary<'a>>,
    ),
}

impl From<&Shape> for Figure {
    fn from(shape: &Shape) -> Figure {
        match *shape {
            Shape::Line(from, to, width) => Figure::Line { from, to, width },
            Shape::Rectangle(place, width) => Figure::Rectangle(place.into(), width),
            Shape::Circle(middle, radius, width) => Figure::Circle(middle, radius, width),
        }
    }
}

/// A copy of the picture with everything on it, in order.
pub fn draw<'a>(env: Env<'a>, view: &View, all: &[Drawn]) -> Result<Term<'a>> {
    picture(env, view.shape, |out| {
        for (to, from) in out
            .chunks_exact_mut(view.shape.row_bytes())
            .zip(view.rows())
        {
            to.copy_from_slice(from);
        }
        for drawn in all {
            match drawn {
                Drawn::Shape(shape, color) => {
                    draw::draw(&shape.into(), (*color).into(), view.shape, out)?
                }
                text => write(text, view, out)?,
            }
        }
        Ok(())
    })
}

fn write(drawn: &Drawn, view: &View, out: &mut [u8]) -> Result<()> {
    let Drawn::Text((x, y, size), color, background, text, fonts) = drawn else {
        return Ok(());
    };
    // Far enough for every picture, near enough for whole numbers of pixels.
    if x.abs().max(y.abs()) > draw::REACH {
        return fail(
            Code::BadOption,
            "text must lie within 1,000,000 pixels of the picture",
        );
    }
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

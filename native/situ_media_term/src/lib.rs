//! Media structs as BEAM terms, shared by the NIF libraries that use them.

mod memory;

pub use memory::load;

use rustler::{Binary, Encoder, Env, NifStruct, NifUnitEnum, OwnedBinary, Term};
use situ_media::error::{fail, Code, Error, Result};
use situ_media::image::{Format, Shape, View};
use std::time::Instant;

#[derive(Clone, Copy, NifUnitEnum)]
pub enum PixelFormat {
    Gray8,
    Gray16,
    Bgr24,
    Rgb24,
    Bgrx32,
    Bgra32,
    Rgba32,
    Rgba64,
}

macro_rules! convert_by_name {
    ($($name:ident),*) => {
        impl From<PixelFormat> for Format {
            fn from(format: PixelFormat) -> Format {
                match format { $(PixelFormat::$name => Format::$name),* }
            }
        }
        impl From<Format> for PixelFormat {
            fn from(format: Format) -> PixelFormat {
                match format { $(Format::$name => PixelFormat::$name),* }
            }
        }
    };
}

convert_by_name!(Gray8, Gray16, Bgr24, Rgb24, Bgrx32, Bgra32, Rgba32, Rgba64);

/// The struct `%Situ.Image{}`.
#[derive(NifStruct)]
#[module = "Situ.Image"]
pub struct ImageTerm<'a> {
    pub width: u32,
    pub height: u32,
    pub format: PixelFormat,
    pub stride: u32,
    pub data: Binary<'a>,
}

impl<'a> ImageTerm<'a> {
    pub fn view(&self) -> Result<View<'_>> {
        let shape = Shape::new(
            self.width as usize,
            self.height as usize,
            self.format.into(),
        )?;
        View::new(shape, self.stride as usize, self.data.as_slice())
    }

    pub fn new(env: Env<'a>, shape: Shape, data: OwnedBinary) -> ImageTerm<'a> {
        ImageTerm {
            width: shape.width as u32,
            height: shape.height as u32,
            format: shape.format.into(),
            stride: shape.row_bytes() as u32,
            data: data.release(env),
        }
    }
}

/// Allocates an uninitialized binary. Returns an error if no memory is left, where `OwnedBinary::new` would abort the
/// VM.
pub fn allocate_binary(bytes: usize) -> Result<OwnedBinary> {
    let mut binary = OwnedBinary::new(0);
    if binary.realloc(bytes) {
        Ok(binary)
    } else {
        fail(Code::OutOfMemory, format!("no memory for {bytes} bytes"))
    }
}

/// Copies bytes to a binary.
pub fn copy_to_binary<'a>(env: Env<'a>, bytes: &[u8]) -> Result<Binary<'a>> {
    let mut owned = allocate_binary(bytes.len())?;
    owned.as_mut_slice().copy_from_slice(bytes);
    Ok(owned.release(env))
}

/// Builds a new image of `shape` whose pixels are written by `fill`.
pub fn build_image<'a>(
    env: Env<'a>,
    shape: Shape,
    fill: impl FnOnce(&mut [u8]) -> Result<()>,
) -> Result<Term<'a>> {
    let mut data = allocate_binary(shape.bytes())?;
    fill(data.as_mut_slice())?;
    Ok(ImageTerm::new(env, shape, data).encode(env))
}

mod atoms {
    rustler::atoms! {
        ok, error, bad_image, bad_format, bad_size, bad_rect, bad_option, too_large, bad_jpeg, bad_png,
        bad_audio, bad_font, out_of_memory, failed
    }
}

/// Encodes a result as `{:ok, term}` or `{:error, code, what}`.
pub fn encode_reply<'a>(env: Env<'a>, result: Result<Term<'a>>) -> Term<'a> {
    match result {
        Ok(term) => (atoms::ok(), term).encode(env),
        Err(Error { code, what }) => (atoms::error(), error_atom(code), what).encode(env),
    }
}

fn error_atom(code: Code) -> rustler::Atom {
    match code {
        Code::BadImage => atoms::bad_image(),
        Code::BadFormat => atoms::bad_format(),
        Code::BadSize => atoms::bad_size(),
        Code::BadRect => atoms::bad_rect(),
        Code::BadOption => atoms::bad_option(),
        Code::TooLarge => atoms::too_large(),
        Code::BadJpeg => atoms::bad_jpeg(),
        Code::BadPng => atoms::bad_png(),
        Code::BadAudio => atoms::bad_audio(),
        Code::BadFont => atoms::bad_font(),
        Code::OutOfMemory => atoms::out_of_memory(),
        Code::Failed => atoms::failed(),
    }
}

/// Runs `work` on a normal scheduler and charges its time to the process; 1 % of a time slice is 10 us.
pub fn run_charged<'a>(env: Env<'a>, work: impl FnOnce() -> Term<'a>) -> Term<'a> {
    let start = Instant::now();
    let result = work();
    let percent = (start.elapsed().as_micros() / 10).clamp(1, 100) as i32;
    rustler::schedule::consume_timeslice(env, percent);
    result
}

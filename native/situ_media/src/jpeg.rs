//! JPEG by libjpeg-turbo.

use crate::error::{fail, Code, Error, Result};
use crate::picture::{Format, Shape, View};
use turbojpeg::{Compressor, Decompressor, Image, OutputBuf, OwnedBuf, PixelFormat, Subsamp};

/// Cameras and programs write ten or so. A progressive file may have thousands, a few bytes and a pass over the whole
/// picture each.
const MAX_SCANS: usize = 100;

/// Above this, memory is taken as it is needed.
const LARGE: usize = 64 << 20;

/// How many pixels share one value of colour; brightness is kept for each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Subsampling {
    /// None do (4:4:4): best for text and edges.
    Full,
    /// Two side by side (4:2:2).
    Half,
    /// Two by two (4:2:0): what cameras write, the smallest.
    Quarter,
}

fn pixel_format(format: Format) -> Result<PixelFormat> {
    match format {
        Format::Gray8 => Ok(PixelFormat::GRAY),
        Format::Bgr24 => Ok(PixelFormat::BGR),
        Format::Rgb24 => Ok(PixelFormat::RGB),
        Format::Bgrx32 => Ok(PixelFormat::BGRX),
        Format::Bgra32 => Ok(PixelFormat::BGRA),
        Format::Rgba32 => Ok(PixelFormat::RGBA),
        Format::Gray16 | Format::Rgba64 => fail(
            Code::BadFormat,
            format!("JPEG has 8 bits a channel, this is {}", format.name()),
        ),
    }
}

fn bad(error: turbojpeg::Error) -> Error {
    Error {
        code: Code::BadJpeg,
        what: format!("JPEG: {error}"),
    }
}

/// Quality 1..100; alpha is dropped.
pub fn encode(src: &View, quality: i32, subsampling: Subsampling) -> Result<OwnedBuf> {
    if !(1..=100).contains(&quality) {
        return fail(
            Code::BadOption,
            format!("JPEG quality is 1 to 100, not {quality}"),
        );
    }
    let format = pixel_format(src.shape.format)?;
    let mut compressor = Compressor::new().map_err(bad)?;
    compressor.set_quality(quality);
    compressor.set_subsamp(match (src.shape.format, subsampling) {
        (Format::Gray8, _) => Subsamp::Gray,
        (_, Subsampling::Full) => Subsamp::None,
        (_, Subsampling::Half) => Subsamp::Sub2x1,
        (_, Subsampling::Quarter) => Subsamp::Sub2x2,
    });
    let image = Image {
        pixels: src.data,
        width: src.shape.width,
        pitch: src.stride,
        height: src.shape.height,
        format,
    };
    if src.data.len() < src.stride * src.shape.height {
        // The binding wants the last row padded too.
        let tight = src.tight();
        let image = Image {
            pixels: &tight[..],
            pitch: src.shape.row_bytes(),
            ..image
        };
        return compress(compressor, image);
    }
    compress(compressor, image)
}

/// With room for the worst case from the start libjpeg never has to grow its buffer, copying it; pages that are not
/// written cost nothing.
fn compress(mut compressor: Compressor, image: Image<&[u8]>) -> Result<OwnedBuf> {
    let worst = compressor.buf_len(image.width, image.height).map_err(bad)?;
    let buffer = if worst <= LARGE {
        OwnedBuf::allocate(worst)
    } else {
        OwnedBuf::new()
    };
    let mut output = OutputBuf::from(buffer);
    compressor.compress(image, &mut output).map_err(bad)?;
    Ok(output.into_owned())
}

/// The picture's shape from the header; grey for grey JPEGs, else `wanted` (`:bgr24` by default on the Elixir side).
///
/// The size claimed must be plausible for the bytes there are: a block of 64 pixels takes at least one bit in any scan
/// that carries it, so 1 byte cannot stand for more than 512 pixels (with some slack: 1024).
pub fn header(bytes: &[u8], wanted: Option<Format>) -> Result<Shape> {
    let header = Decompressor::new()
        .and_then(|mut d| d.read_header(bytes))
        .map_err(bad)?;
    if header.width == 0 || header.height == 0 {
        return fail(Code::BadJpeg, "JPEG: the header is cut off");
    }
    let format = match (wanted, header.colorspace) {
        (Some(format), _) => format,
        (None, turbojpeg::Colorspace::Gray) => Format::Gray8,
        (None, _) => Format::Bgr24,
    };
    pixel_format(format)?;
    let shape = Shape::new(header.width, header.height, format)?;
    if header.width * header.height / 1024 > bytes.len() {
        return fail(
            Code::BadJpeg,
            format!(
                "JPEG: the header claims {}x{}, but there are only {} bytes",
                header.width,
                header.height,
                bytes.len()
            ),
        );
    }
    Ok(shape)
}

/// Decodes into `out`, which has the bytes of the shape that `header` answered for the same bytes. More than 100 scans
/// are refused before any is decoded ([`Code::BadJpeg`]): each costs a pass over the picture. After an error the
/// contents of `out` are undefined.
pub fn decode(bytes: &[u8], shape: Shape, out: &mut [u8]) -> Result<()> {
    let scans = bytes.windows(2).filter(|w| w == &[0xFF, 0xDA]).count();
    if scans > MAX_SCANS {
        return fail(
            Code::BadJpeg,
            format!("JPEG: {scans} scans are more than the {MAX_SCANS} that a picture may have"),
        );
    }
    let mut decompressor = Decompressor::new().map_err(bad)?;
    let header = decompressor.read_header(bytes).map_err(bad)?;
    if (header.width, header.height) != (shape.width, shape.height) || out.len() != shape.bytes() {
        return fail(Code::Failed, "JPEG: the buffer does not fit the picture");
    }
    let image = Image {
        pixels: out,
        width: shape.width,
        pitch: shape.row_bytes(),
        height: shape.height,
        format: pixel_format(shape.format)?,
    };
    decompressor.decompress(bytes, image).map_err(bad)
}

//! JPEG encoding and decoding with libjpeg-turbo.

use crate::error::{fail, Code, Error, Result};
use crate::image::{Format, Shape, View};
use turbojpeg::{Compressor, Decompressor, Image, OutputBuf, OwnedBuf, PixelFormat, Subsamp};

/// Cameras and programs write about ten scans. A malicious progressive file may have thousands, each a few bytes long
/// and a pass over the whole image.
const MAX_SCANS: usize = 100;

/// Above this size, the output buffer grows on demand.
const LARGE: usize = 64 << 20;

/// How many pixels share one chroma value. Every pixel has its own luma value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Subsampling {
    /// One value for each pixel (4:4:4): best for text and edges.
    Full,
    /// One value for two adjacent pixels (4:2:2).
    Half,
    /// One value for 2 x 2 pixels (4:2:0): the default of cameras, and the smallest.
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
            format!(
                "JPEG has 8 bits per channel, so it cannot store {}",
                format.name()
            ),
        ),
    }
}

fn jpeg_error(error: turbojpeg::Error) -> Error {
    Error {
        code: Code::BadJpeg,
        what: format!("JPEG: {error}"),
    }
}

/// Encodes an image with a quality of 1 to 100. The alpha channel is dropped.
pub fn encode(src: &View, quality: i32, subsampling: Subsampling) -> Result<OwnedBuf> {
    if !(1..=100).contains(&quality) {
        return fail(
            Code::BadOption,
            format!("JPEG quality must be 1 to 100, not {quality}"),
        );
    }
    let format = pixel_format(src.shape.format)?;
    let mut compressor = Compressor::new().map_err(jpeg_error)?;
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
        // The binding requires padding after the last row, too.
        let tight = src.packed_pixels();
        let image = Image {
            pixels: &tight[..],
            pitch: src.shape.row_bytes(),
            ..image
        };
        return compress_image(compressor, image);
    }
    compress_image(compressor, image)
}

/// Compresses an image. A buffer for the worst case means that libjpeg never has to grow and copy it; pages that are
/// not written cost nothing.
fn compress_image(mut compressor: Compressor, image: Image<&[u8]>) -> Result<OwnedBuf> {
    let worst = compressor
        .buf_len(image.width, image.height)
        .map_err(jpeg_error)?;
    let buffer = if worst <= LARGE {
        OwnedBuf::allocate(worst)
    } else {
        OwnedBuf::new()
    };
    let mut output = OutputBuf::from(buffer);
    compressor
        .compress(image, &mut output)
        .map_err(jpeg_error)?;
    Ok(output.into_owned())
}

/// Reads the shape of the image from the header. The format is gray for gray JPEGs, otherwise `wanted` (`:bgr24` by
/// default on the Elixir side).
///
/// The claimed size must be plausible for the number of bytes. A block of 64 pixels takes at least one bit in every
/// scan that contains it, so one byte cannot encode more than 512 pixels (1024 with some margin).
pub fn read_shape(bytes: &[u8], wanted: Option<Format>) -> Result<Shape> {
    let header = Decompressor::new()
        .and_then(|mut d| d.read_header(bytes))
        .map_err(jpeg_error)?;
    if header.width == 0 || header.height == 0 {
        return fail(Code::BadJpeg, "JPEG: the header is truncated");
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

/// Decodes into `out`, which must have the bytes of the shape that `read_shape` returned for the same bytes. Files
/// with more than 100 scans are rejected before decoding ([`Code::BadJpeg`]), because each scan costs a pass over the
/// image. After an error, the contents of `out` are undefined.
pub fn decode(bytes: &[u8], shape: Shape, out: &mut [u8]) -> Result<()> {
    let scans = bytes.windows(2).filter(|w| w == &[0xFF, 0xDA]).count();
    if scans > MAX_SCANS {
        return fail(
            Code::BadJpeg,
            format!("JPEG: {scans} scans are more than the maximum of {MAX_SCANS}"),
        );
    }
    let mut decompressor = Decompressor::new().map_err(jpeg_error)?;
    let header = decompressor.read_header(bytes).map_err(jpeg_error)?;
    if (header.width, header.height) != (shape.width, shape.height) || out.len() != shape.bytes() {
        return fail(
            Code::Failed,
            "JPEG: the buffer does not match the size of the image",
        );
    }
    let image = Image {
        pixels: out,
        width: shape.width,
        pitch: shape.row_bytes(),
        height: shape.height,
        format: pixel_format(shape.format)?,
    };
    decompressor.decompress(bytes, image).map_err(jpeg_error)
}

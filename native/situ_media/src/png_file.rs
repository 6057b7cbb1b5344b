//! PNG encoding and decoding, 8 and 16 bits, with the `png` crate.

use crate::color;
use crate::error::{fail, Code, Error, Result};
use crate::image::{Format, Shape, View, MAX_BYTES};
use png::{BitDepth, ColorType, Compression, Decoder, Encoder, Limits, Transformations};
use std::io::Cursor;

fn png_error(what: impl std::fmt::Display) -> Error {
    Error {
        code: Code::BadPng,
        what: format!("PNG: {what}"),
    }
}

/// Encodes an image. `level` is 0 (fast), 1 (balanced) or 2 (small).
pub fn encode(src: &View, level: u8) -> Result<Vec<u8>> {
    // Formats that PNG cannot store are converted first (PNG is red first, 16 bits are big-endian).
    let (target, color, depth) = match src.shape.format {
        Format::Gray8 => (Format::Gray8, ColorType::Grayscale, BitDepth::Eight),
        Format::Gray16 => (Format::Gray16, ColorType::Grayscale, BitDepth::Sixteen),
        Format::Bgr24 | Format::Rgb24 | Format::Bgrx32 => {
            (Format::Rgb24, ColorType::Rgb, BitDepth::Eight)
        }
        Format::Bgra32 | Format::Rgba32 => (Format::Rgba32, ColorType::Rgba, BitDepth::Eight),
        Format::Rgba64 => (Format::Rgba64, ColorType::Rgba, BitDepth::Sixteen),
    };
    let shape = Shape::new(src.shape.width, src.shape.height, target)?;
    let mut pixels = vec![0; shape.bytes()];
    color::convert(src, target, &mut pixels);
    if depth == BitDepth::Sixteen {
        swap_bytes(&mut pixels);
    }
    let mut out = Vec::new();
    let mut encoder = Encoder::new(&mut out, shape.width as u32, shape.height as u32);
    encoder.set_color(color);
    encoder.set_depth(depth);
    encoder.set_compression(match level {
        0 => Compression::Fast,
        1 => Compression::Balanced,
        _ => Compression::High,
    });
    encoder
        .write_header()
        .and_then(|mut w| {
            w.write_image_data(&pixels)?;
            w.finish()
        })
        .map_err(png_error)?;
    Ok(out)
}

fn swap_bytes(pixels: &mut [u8]) {
    pixels.chunks_exact_mut(2).for_each(|p| p.swap(0, 1));
}

/// A decoded PNG in its native format: gray8, gray16, rgb24, rgba32 or rgba64.
pub struct Decoded {
    /// Size and format.
    pub shape: Shape,
    /// Contiguous rows; channels of 16 bits are little-endian.
    pub pixels: Vec<u8>,
}

/// Decodes a PNG. Deflate compresses by a factor of at most 1032, so a header that claims more pixels than the bytes
/// can contain is rejected before allocating memory.
pub fn decode(bytes: &[u8]) -> Result<Decoded> {
    let mut decoder = Decoder::new_with_limits(Cursor::new(bytes), Limits { bytes: MAX_BYTES });
    decoder.set_transformations(Transformations::EXPAND);
    decoder.set_ignore_text_chunk(true);
    let info = decoder.read_header_info().map_err(png_error)?;
    let claimed = info.width as u64 * info.height as u64 * info.bits_per_pixel() as u64 / 8;
    if claimed > bytes.len() as u64 * 1032 + 4096 {
        return fail(
            Code::BadPng,
            format!(
                "PNG: the header claims {}x{}, but there are only {} bytes",
                info.width,
                info.height,
                bytes.len()
            ),
        );
    }
    let mut reader = decoder.read_info().map_err(png_error)?;
    let size = reader.output_buffer_size().filter(|n| *n <= MAX_BYTES);
    let Some(size) = size else {
        return fail(Code::TooLarge, "PNG: the image would need more than 1 GiB");
    };
    let mut pixels = Vec::new();
    pixels.try_reserve_exact(size).map_err(png_error)?;
    pixels.resize(size, 0);
    let frame = reader.next_frame(&mut pixels).map_err(png_error)?;
    pixels.truncate(frame.buffer_size());
    let (color, depth) = (frame.color_type, frame.bit_depth);
    expand_pixels(
        frame.width as usize,
        frame.height as usize,
        color,
        depth,
        pixels,
    )
}

fn expand_pixels(
    w: usize,
    h: usize,
    color: ColorType,
    depth: BitDepth,
    pixels: Vec<u8>,
) -> Result<Decoded> {
    let wide = depth == BitDepth::Sixteen;
    let mut pixels = pixels;
    if wide {
        swap_bytes(&mut pixels);
    }
    let (format, pixels) = match (color, wide) {
        (ColorType::Grayscale, false) => (Format::Gray8, pixels),
        (ColorType::Grayscale, true) => (Format::Gray16, pixels),
        (ColorType::Rgb, false) => (Format::Rgb24, pixels),
        (ColorType::Rgba, false) => (Format::Rgba32, pixels),
        (ColorType::Rgba, true) => (Format::Rgba64, pixels),
        (ColorType::Rgb, true) => (
            Format::Rgba64,
            append_opaque_alpha(&pixels, 6, &[0, 1, 2, 3, 4, 5]),
        ),
        (ColorType::GrayscaleAlpha, false) => (Format::Rgba32, gray_alpha8(&pixels)),
        (ColorType::GrayscaleAlpha, true) => (Format::Rgba64, gray_alpha16(&pixels)),
        (ColorType::Indexed, _) => return fail(Code::BadPng, "PNG: the palette was not expanded"),
    };
    let shape = Shape::new(w, h, format)?;
    if pixels.len() != shape.bytes() {
        return fail(Code::BadPng, "PNG: rows are missing");
    }
    Ok(Decoded { shape, pixels })
}

fn append_opaque_alpha(pixels: &[u8], size: usize, order: &[usize]) -> Vec<u8> {
    pixels
        .chunks_exact(size)
        .flat_map(|p| {
            order
                .iter()
                .map(|i| p[*i])
                .chain([255, 255])
                .collect::<Vec<_>>()
        })
        .collect()
}

fn gray_alpha8(pixels: &[u8]) -> Vec<u8> {
    pixels
        .chunks_exact(2)
        .flat_map(|p| [p[0], p[0], p[0], p[1]])
        .collect()
}

fn gray_alpha16(pixels: &[u8]) -> Vec<u8> {
    pixels
        .chunks_exact(4)
        .flat_map(|p| [p[0], p[1], p[0], p[1], p[0], p[1], p[2], p[3]])
        .collect()
}

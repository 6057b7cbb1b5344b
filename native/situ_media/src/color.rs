//! Conversion between pixel formats.
//!
//! Gray is computed in the depth of the source. 8-bit values are widened by v * 257, and 16-bit values are narrowed
//! by v >> 8. A missing alpha channel becomes opaque, and an unused channel is written as 255.

use crate::gray;
use crate::image::{Format, View};

/// A pixel as red, green, blue, alpha in the depth of its format.
trait Pixel {
    const BYTES: usize;
    const WIDE: bool;
    const GRAY: bool;
    fn read_rgba(p: &[u8]) -> [u32; 4];
    fn write_rgba(rgba: [u32; 4], p: &mut [u8]);
}

macro_rules! color8 {
    ($name:ident, $bytes:expr, $r:expr, $g:expr, $b:expr, $alpha:expr) => {
        struct $name;
        impl Pixel for $name {
            const BYTES: usize = $bytes;
            const WIDE: bool = false;
            const GRAY: bool = false;
            #[inline(always)]
            fn read_rgba(p: &[u8]) -> [u32; 4] {
                let alpha = if $alpha { p[$bytes - 1] as u32 } else { 255 };
                [p[$r] as u32, p[$g] as u32, p[$b] as u32, alpha]
            }
            #[inline(always)]
            fn write_rgba(c: [u32; 4], p: &mut [u8]) {
                p[$r] = c[0] as u8;
                p[$g] = c[1] as u8;
                p[$b] = c[2] as u8;
                if $bytes == 4 {
                    p[$bytes - 1] = if $alpha { c[3] as u8 } else { 255 };
                }
            }
        }
    };
}

color8!(Bgr24, 3, 2, 1, 0, false);
color8!(Rgb24, 3, 0, 1, 2, false);
color8!(Bgrx32, 4, 2, 1, 0, false);
color8!(Bgra32, 4, 2, 1, 0, true);
color8!(Rgba32, 4, 0, 1, 2, true);

struct Gray8;
impl Pixel for Gray8 {
    const BYTES: usize = 1;
    const WIDE: bool = false;
    const GRAY: bool = true;
    #[inline(always)]
    fn read_rgba(p: &[u8]) -> [u32; 4] {
        let v = p[0] as u32;
        [v, v, v, 255]
    }
    #[inline(always)]
    fn write_rgba(c: [u32; 4], p: &mut [u8]) {
        p[0] = c[0] as u8;
    }
}

fn read_wide(p: &[u8], channel: usize) -> u32 {
    u16::from_le_bytes([p[channel * 2], p[channel * 2 + 1]]) as u32
}

fn write_wide(p: &mut [u8], channel: usize, value: u32) {
    p[channel * 2..channel * 2 + 2].copy_from_slice(&(value as u16).to_le_bytes());
}

struct Gray16;
impl Pixel for Gray16 {
    const BYTES: usize = 2;
    const WIDE: bool = true;
    const GRAY: bool = true;
    #[inline(always)]
    fn read_rgba(p: &[u8]) -> [u32; 4] {
        let v = read_wide(p, 0);
        [v, v, v, 65535]
    }
    #[inline(always)]
    fn write_rgba(c: [u32; 4], p: &mut [u8]) {
        write_wide(p, 0, c[0]);
    }
}

struct Rgba64;
impl Pixel for Rgba64 {
    const BYTES: usize = 8;
    const WIDE: bool = true;
    const GRAY: bool = false;
    #[inline(always)]
    fn read_rgba(p: &[u8]) -> [u32; 4] {
        [
            read_wide(p, 0),
            read_wide(p, 1),
            read_wide(p, 2),
            read_wide(p, 3),
        ]
    }
    #[inline(always)]
    fn write_rgba(c: [u32; 4], p: &mut [u8]) {
        (0..4).for_each(|i| write_wide(p, i, c[i]));
    }
}

fn convert_rows<S: Pixel, D: Pixel>(src: &View, out: &mut [u8]) {
    let row_out = src.shape.width * D::BYTES;
    for (row, out) in src.rows().zip(out.chunks_exact_mut(row_out)) {
        for (p, o) in row
            .chunks_exact(S::BYTES)
            .zip(out.chunks_exact_mut(D::BYTES))
        {
            let mut c = S::read_rgba(p);
            if D::GRAY && !S::GRAY {
                c[0] = gray::gray_value(c[0], c[1], c[2]);
            }
            if D::WIDE && !S::WIDE {
                c = c.map(|v| v * 257);
            } else if S::WIDE && !D::WIDE {
                c = c.map(|v| v >> 8);
            }
            D::write_rgba(c, o);
        }
    }
}

/// Converts the image into `out`, which holds `width * height` contiguous pixels of `format`.
pub fn convert(src: &View, format: Format, out: &mut [u8]) {
    let from = src.shape.format;
    if from == format {
        return copy_rows(src, out);
    }
    let (blue, red) = (gray::BLUE, gray::RED);
    match (from, format) {
        (Format::Bgr24, Format::Gray8) => convert_gray_rows(src, out, blue, red),
        (Format::Rgb24, Format::Gray8) => convert_gray_rows(src, out, red, blue),
        _ => dispatch_source(src, format, out),
    }
}

/// Copies the rows without their padding.
pub fn copy_rows(src: &View, out: &mut [u8]) {
    if src.is_packed() {
        return out.copy_from_slice(&src.data[..src.shape.bytes()]);
    }
    for (row, out) in src.rows().zip(out.chunks_exact_mut(src.shape.row_bytes())) {
        out.copy_from_slice(row);
    }
}

fn convert_gray_rows(src: &View, out: &mut [u8], first: u32, third: u32) {
    for (row, out) in src.rows().zip(out.chunks_exact_mut(src.shape.width)) {
        gray::convert_row24(row, out, first, third);
    }
}

fn dispatch_source(src: &View, format: Format, out: &mut [u8]) {
    match src.shape.format {
        Format::Gray8 => dispatch_target::<Gray8>(src, format, out),
        Format::Gray16 => dispatch_target::<Gray16>(src, format, out),
        Format::Bgr24 => dispatch_target::<Bgr24>(src, format, out),
        Format::Rgb24 => dispatch_target::<Rgb24>(src, format, out),
        Format::Bgrx32 => dispatch_target::<Bgrx32>(src, format, out),
        Format::Bgra32 => dispatch_target::<Bgra32>(src, format, out),
        Format::Rgba32 => dispatch_target::<Rgba32>(src, format, out),
        Format::Rgba64 => dispatch_target::<Rgba64>(src, format, out),
    }
}

fn dispatch_target<S: Pixel>(src: &View, format: Format, out: &mut [u8]) {
    match format {
        Format::Gray8 => convert_rows::<S, Gray8>(src, out),
        Format::Gray16 => convert_rows::<S, Gray16>(src, out),
        Format::Bgr24 => convert_rows::<S, Bgr24>(src, out),
        Format::Rgb24 => convert_rows::<S, Rgb24>(src, out),
        Format::Bgrx32 => convert_rows::<S, Bgrx32>(src, out),
        Format::Bgra32 => convert_rows::<S, Bgra32>(src, out),
        Format::Rgba32 => convert_rows::<S, Rgba32>(src, out),
        Format::Rgba64 => convert_rows::<S, Rgba64>(src, out),
    }
}

//! Moves pixels without changing them: flips, quarter turns, padding, pasting.

use crate::error::{fail, Code, Result};
use crate::image::{Shape, View};
use crate::resize::{resize_image, Filter};

/// The axis of a flip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// Swaps top and bottom.
    Horizontal,
    /// Swaps left and right.
    Vertical,
    /// Swaps both, which is a half turn.
    Both,
}

/// Mirrors `src` into `out`, which has exactly its bytes without padding.
pub fn flip(src: &View, axis: Axis, out: &mut [u8]) {
    let row_bytes = src.shape.row_bytes();
    let height = src.shape.height;
    for (y, target) in out.chunks_exact_mut(row_bytes).enumerate() {
        let from = if axis == Axis::Vertical {
            y
        } else {
            height - 1 - y
        };
        if axis == Axis::Horizontal {
            target.copy_from_slice(src.row(from));
        } else {
            mirror_row(src.row(from), target, src.shape.format.pixel_bytes());
        }
    }
}

fn mirror_row(row: &[u8], out: &mut [u8], size: usize) {
    match size {
        1 => row.iter().rev().zip(out).for_each(|(p, o)| *o = *p),
        3 => mirror_pixels::<3>(row, out),
        4 => mirror_pixels::<4>(row, out),
        2 => mirror_pixels::<2>(row, out),
        _ => mirror_pixels::<8>(row, out),
    }
}

fn mirror_pixels<const N: usize>(row: &[u8], out: &mut [u8]) {
    for (p, o) in row.chunks_exact(N).rev().zip(out.chunks_exact_mut(N)) {
        o.copy_from_slice(p);
    }
}

/// Rotates clockwise by `turns` quarter turns. For odd numbers, the caller has swapped width and height.
pub fn rotate_quarter_turns(src: &View, turns: u32, out: &mut [u8]) {
    let size = src.shape.format.pixel_bytes();
    let (w, h) = (src.shape.width, src.shape.height);
    let out_width = if turns % 2 == 1 { h } else { w };
    for (i, target) in out.chunks_exact_mut(size).enumerate() {
        let (x, y) = (i % out_width, i / out_width);
        let (sx, sy) = match turns % 4 {
            0 => (x, y),
            1 => (y, h - 1 - x),
            2 => (w - 1 - x, h - 1 - y),
            _ => (w - 1 - y, x),
        };
        target.copy_from_slice(&src.row(sy)[sx * size..sx * size + size]);
    }
}

/// Fills `out` with copies of a pixel.
pub fn fill_pixels(out: &mut [u8], pixel: &[u8]) {
    out.chunks_exact_mut(pixel.len())
        .for_each(|o| o.copy_from_slice(pixel));
}

/// Returns the rectangle of an image in a letterbox: the largest size of the same aspect ratio that fits, centered.
pub fn letterbox_rect(from: Shape, width: usize, height: usize) -> (usize, usize, usize, usize) {
    let scale = (width as f64 / from.width as f64).min(height as f64 / from.height as f64);
    let w = ((from.width as f64 * scale).round() as usize).clamp(1, width);
    let h = ((from.height as f64 * scale).round() as usize).clamp(1, height);
    ((width - w) / 2, (height - h) / 2, w, h)
}

/// Resizes the image into the center of `out` (of shape `shape`), and fills the rest with `pixel`.
pub fn letterbox(
    src: &View,
    shape: Shape,
    filter: Filter,
    pixel: &[u8],
    out: &mut [u8],
) -> Result<()> {
    let (x, y, w, h) = letterbox_rect(src.shape, shape.width, shape.height);
    let inner = Shape::new(w, h, src.shape.format)?;
    let mut small = vec![0; inner.bytes()];
    resize_image(src, inner, filter, &mut small)?;
    fill_pixels(out, pixel);
    let small = View::new(inner, inner.row_bytes(), &small)?;
    paste(&small, None, x as i64, y as i64, shape, out)
}

/// Copies `src` over `out` with its top left corner at (`x`, `y`). Parts outside the image are clipped. If there is a
/// gray mask of the size of `src`, only pixels with a nonzero mask are copied.
pub fn paste(
    src: &View,
    mask: Option<&View>,
    x: i64,
    y: i64,
    shape: Shape,
    out: &mut [u8],
) -> Result<()> {
    if src.shape.format != shape.format {
        return fail(
            Code::BadFormat,
            format!(
                "cannot paste {} into {}",
                src.shape.format.name(),
                shape.format.name()
            ),
        );
    }
    if let Some(mask) = mask {
        let same = mask.shape.width == src.shape.width && mask.shape.height == src.shape.height;
        if !same || mask.shape.format.pixel_bytes() != 1 {
            return fail(
                Code::BadFormat,
                "the mask must be :gray8 and have the size of the pasted image",
            );
        }
    }
    let size = shape.format.pixel_bytes();
    let x_from = (-x).max(0);
    let x_to = (src.shape.width as i64).min(shape.width as i64 - x);
    let y_from = (-y).max(0);
    let y_to = (src.shape.height as i64).min(shape.height as i64 - y);
    if x_from >= x_to {
        return Ok(());
    }
    let (from, to) = (x_from as usize, x_to as usize);
    let left = (x + x_from) as usize * size;
    for sy in y_from..y_to.max(y_from) {
        let row = &src.row(sy as usize)[from * size..to * size];
        let start = (y + sy) as usize * shape.row_bytes() + left;
        let target = &mut out[start..start + row.len()];
        match mask {
            None => target.copy_from_slice(row),
            Some(mask) => copy_masked(row, &mask.row(sy as usize)[from..to], size, target),
        }
    }
    Ok(())
}

fn copy_masked(row: &[u8], mask: &[u8], size: usize, out: &mut [u8]) {
    for ((p, m), o) in row
        .chunks_exact(size)
        .zip(mask)
        .zip(out.chunks_exact_mut(size))
    {
        if *m != 0 {
            o.copy_from_slice(p);
        }
    }
}

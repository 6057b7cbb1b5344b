//! Moving pixels about without changing them: flips, quarter turns, padding, pasting.

use crate::error::{fail, Code, Result};
use crate::picture::{Shape, View};
use crate::resize::{resize, Filter};

/// About which line a picture is mirrored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// Top becomes bottom.
    Horizontal,
    /// Left becomes right.
    Vertical,
    /// Both: a half turn.
    Both,
}

/// Mirrors `src` into `out`, which has exactly its bytes without gaps.
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
            mirror(src.row(from), target, src.shape.format.bytes());
        }
    }
}

fn mirror(row: &[u8], out: &mut [u8], size: usize) {
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

/// Clockwise by `turns` quarter turns; the caller has swapped width and height for odd ones.
pub fn quarter_turns(src: &View, turns: u32, out: &mut [u8]) {
    let size = src.shape.format.bytes();
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

/// Fills `out` with one pixel.
pub fn fill(out: &mut [u8], pixel: &[u8]) {
    out.chunks_exact_mut(pixel.len())
        .for_each(|o| o.copy_from_slice(pixel));
}

/// Where a picture lands in a letterbox: largest size of the same proportions that fits, in the middle.
pub fn letterbox_place(from: Shape, width: usize, height: usize) -> (usize, usize, usize, usize) {
    let scale = (width as f64 / from.width as f64).min(height as f64 / from.height as f64);
    let w = ((from.width as f64 * scale).round() as usize).clamp(1, width);
    let h = ((from.height as f64 * scale).round() as usize).clamp(1, height);
    ((width - w) / 2, (height - h) / 2, w, h)
}

/// Resizes into the middle of `out` (shape `shape`), the rest is `pixel`.
pub fn letterbox(
    src: &View,
    shape: Shape,
    filter: Filter,
    pixel: &[u8],
    out: &mut [u8],
) -> Result<()> {
    let (x, y, w, h) = letterbox_place(src.shape, shape.width, shape.height);
    let inner = Shape::new(w, h, src.shape.format)?;
    let mut small = vec![0; inner.bytes()];
    resize(src, inner, filter, &mut small)?;
    fill(out, pixel);
    let small = View::new(inner, inner.row_bytes(), &small)?;
    paste(&small, None, x as i64, y as i64, shape, out)
}

/// Copies `src` over `out` with its top left corner at `x`, `y`; what falls outside is cut off. With a grey mask of the
/// size of `src`, only where the mask is not 0.
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
        if !same || mask.shape.format.bytes() != 1 {
            return fail(
                Code::BadFormat,
                "the mask must be :gray8 of the size of the picture pasted",
            );
        }
    }
    let size = shape.format.bytes();
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
            Some(mask) => masked(row, &mask.row(sy as usize)[from..to], size, target),
        }
    }
    Ok(())
}

fn masked(row: &[u8], mask: &[u8], size: usize, out: &mut [u8]) {
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

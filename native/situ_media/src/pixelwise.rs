//! Operations on individual channel values.

use crate::error::{fail, Code, Result};
use crate::image::{Format, View};

/// The rule for a value `v` with a threshold `t` and the maximum value `max`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Threshold {
    /// `max` above `t`, else 0.
    Binary,
    /// 0 above `t`, else `max`.
    BinaryInverted,
    /// `t` above `t`, else `v`.
    Truncate,
    /// `v` above `t`, else 0.
    ToZero,
    /// 0 above `t`, else `v`.
    ToZeroInverted,
}

fn map_bytes(src: &View, out: &mut [u8], f: impl Fn(u8) -> u8) {
    for (row, out) in src.rows().zip(out.chunks_exact_mut(src.shape.row_bytes())) {
        row.iter().zip(out).for_each(|(p, o)| *o = f(*p));
    }
}

fn map_words(src: &View, out: &mut [u8], f: impl Fn(u16) -> u16) {
    for (row, out) in src.rows().zip(out.chunks_exact_mut(src.shape.row_bytes())) {
        for (p, o) in row.chunks_exact(2).zip(out.chunks_exact_mut(2)) {
            o.copy_from_slice(&f(u16::from_le_bytes([p[0], p[1]])).to_le_bytes());
        }
    }
}

fn is_wide(src: &View) -> bool {
    src.shape.format.bytes_per_channel() == 2
}

/// Inverts values: 255 - v (65535 - v for 16 bits). Alpha and unused channels are copied.
pub fn invert(src: &View, out: &mut [u8]) {
    if is_wide(src) {
        map_words(src, out, |v| u16::MAX - v);
    } else {
        map_bytes(src, out, |v| !v);
    }
    copy_fourth_channel(src, out);
}

fn copy_fourth_channel(src: &View, out: &mut [u8]) {
    let format = src.shape.format;
    let Some(index) = format.fourth_channel() else {
        return;
    };
    let (size, depth) = (format.pixel_bytes(), format.bytes_per_channel());
    for (row, out) in src.rows().zip(out.chunks_exact_mut(src.shape.row_bytes())) {
        for (p, o) in row.chunks_exact(size).zip(out.chunks_exact_mut(size)) {
            o[index * depth..].copy_from_slice(&p[index * depth..]);
        }
    }
}

macro_rules! threshold_fn {
    ($kind:expr, $t:expr, $max:expr) => {
        move |v| match $kind {
            Threshold::Binary => {
                if v > $t {
                    $max
                } else {
                    0
                }
            }
            Threshold::BinaryInverted => {
                if v > $t {
                    0
                } else {
                    $max
                }
            }
            Threshold::Truncate => v.min($t),
            Threshold::ToZero => {
                if v > $t {
                    v
                } else {
                    0
                }
            }
            Threshold::ToZeroInverted => {
                if v > $t {
                    0
                } else {
                    v
                }
            }
        }
    };
}

/// Applies the threshold to every channel, including alpha.
pub fn threshold(src: &View, t: u32, max: u32, kind: Threshold, out: &mut [u8]) {
    if is_wide(src) {
        let (t, max) = (t.min(65535) as u16, max.min(65535) as u16);
        map_words(src, out, threshold_fn!(kind, t, max));
    } else {
        let (t, max) = (t.min(255) as u8, max.min(255) as u8);
        map_bytes(src, out, threshold_fn!(kind, t, max));
    }
}

/// Extracts the channel with this index in memory as gray of the same depth.
pub fn extract_channel(src: &View, channel: usize, out: &mut [u8]) {
    let (size, depth) = (
        src.shape.format.pixel_bytes(),
        src.shape.format.bytes_per_channel(),
    );
    let from = channel * depth;
    for (row, out) in src
        .rows()
        .zip(out.chunks_exact_mut(src.shape.width * depth))
    {
        for (p, o) in row.chunks_exact(size).zip(out.chunks_exact_mut(depth)) {
            o.copy_from_slice(&p[from..from + depth]);
        }
    }
}

/// Computes |a - b| for every channel. The unused channel of :bgrx32 is written as 255.
pub fn absolute_difference(a: &View, b: &View, out: &mut [u8]) -> Result<()> {
    if a.shape != b.shape {
        return fail(
            Code::BadFormat,
            "two images must have the same size and format to be compared",
        );
    }
    let row_bytes = a.shape.row_bytes();
    for ((ra, rb), out) in a.rows().zip(b.rows()).zip(out.chunks_exact_mut(row_bytes)) {
        if is_wide(a) {
            difference_words(ra, rb, out);
        } else {
            ra.iter()
                .zip(rb)
                .zip(out.iter_mut())
                .for_each(|((x, y), o)| *o = x.abs_diff(*y));
        }
        if a.shape.format == Format::Bgrx32 {
            out.iter_mut().skip(3).step_by(4).for_each(|x| *x = 255);
        }
    }
    Ok(())
}

fn difference_words(a: &[u8], b: &[u8], out: &mut [u8]) {
    for ((x, y), o) in a
        .chunks_exact(2)
        .zip(b.chunks_exact(2))
        .zip(out.chunks_exact_mut(2))
    {
        let (x, y) = (
            u16::from_le_bytes([x[0], x[1]]),
            u16::from_le_bytes([y[0], y[1]]),
        );
        o.copy_from_slice(&x.abs_diff(y).to_le_bytes());
    }
}

//! Convolution of grey pictures with a small integer kernel, as \psi defines it: the sum over the taps that lie inside
//! the picture, divided by how many those are, truncated towards zero, clipped to the range.

use crate::error::{fail, Code, Result};
use crate::picture::View;

/// At most this many taps: keeps one call bounded.
const MAX_TAPS: usize = 961;

/// Weights of a pixel's neighbourhood; the pixel itself lies at (`width / 2`, `height / 2`), divisions rounding down.
#[derive(Clone, Debug)]
pub struct Kernel {
    /// Taps of a row.
    pub width: usize,
    /// Rows of taps.
    pub height: usize,
    /// The weights, row by row: `width * height`, 1 to 961 of them.
    pub taps: Vec<i32>,
}

/// Refuses pictures that are not grey ([`Code::BadFormat`]) and kernels whose taps do not fit their size
/// ([`Code::BadOption`]).
pub fn check(src: &View, kernel: &Kernel) -> Result<()> {
    if src.shape.format.channels() != 1 {
        return fail(
            Code::BadFormat,
            format!(
                "convolve works on :gray8 and :gray16, not {}",
                src.shape.format.name()
            ),
        );
    }
    let taps = kernel.width.saturating_mul(kernel.height);
    if taps == 0 || taps != kernel.taps.len() || taps > MAX_TAPS {
        return fail(
            Code::BadOption,
            "a kernel has 1 to 961 taps, rows of equal length",
        );
    }
    Ok(())
}

/// Into `out`, which has the bytes of `src` without gaps; `check` has passed both.
pub fn convolve(src: &View, kernel: &Kernel, out: &mut [u8]) {
    let depth = src.shape.format.bytes_per_channel();
    let (w, h) = (src.shape.width as i64, src.shape.height as i64);
    let max = if depth == 2 { 65535 } else { 255 };
    let value = |x: i64, y: i64| -> i64 {
        let row = src.row(y as usize);
        let x = x as usize;
        if depth == 2 {
            u16::from_le_bytes([row[2 * x], row[2 * x + 1]]) as i64
        } else {
            row[x] as i64
        }
    };
    let (cx, cy) = (kernel.width as i64 / 2, kernel.height as i64 / 2);
    for (i, o) in out.chunks_exact_mut(depth).enumerate() {
        let (x, y) = (i as i64 % w, i as i64 / w);
        let (mut sum, mut count) = (0i64, 0i64);
        for (k, tap) in kernel.taps.iter().enumerate() {
            let sx = x + k as i64 % kernel.width as i64 - cx;
            let sy = y + k as i64 / kernel.width as i64 - cy;
            if sx >= 0 && sy >= 0 && sx < w && sy < h {
                sum += *tap as i64 * value(sx, sy);
                count += 1;
            }
        }
        let v = (sum / count.max(1)).clamp(0, max) as u16;
        o.copy_from_slice(&v.to_le_bytes()[..depth]);
    }
}

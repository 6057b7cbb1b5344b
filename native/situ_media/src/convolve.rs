//! Convolution of gray images with a small integer kernel, as defined by \psi: the sum over the taps inside the
//! image, divided by their number, truncated towards zero, and clipped to the range.

use crate::error::{fail, Code, Result};
use crate::image::View;

/// The maximum number of taps, which bounds the time of a call.
const MAX_TAPS: usize = 961;

/// The weights of a pixel's neighbourhood. The pixel itself is at (`width / 2`, `height / 2`), rounded down.
#[derive(Clone, Debug)]
pub struct Kernel {
    /// The number of taps in a row.
    pub width: usize,
    /// The number of rows.
    pub height: usize,
    /// The weights, row by row: `width * height` of them, 1 to 961.
    pub taps: Vec<i32>,
}

/// Checks the arguments. Images that are not gray return [`Code::BadFormat`], and kernels whose taps do not match
/// their size [`Code::BadOption`].
pub fn check_kernel(src: &View, kernel: &Kernel) -> Result<()> {
    if src.shape.format.channel_count() != 1 {
        return fail(
            Code::BadFormat,
            format!(
                "convolve supports :gray8 and :gray16, not {}",
                src.shape.format.name()
            ),
        );
    }
    let taps = kernel.width.saturating_mul(kernel.height);
    if taps == 0 || taps != kernel.taps.len() || taps > MAX_TAPS {
        return fail(
            Code::BadOption,
            "a kernel must have 1 to 961 taps in rows of equal length",
        );
    }
    Ok(())
}

/// Convolves `src` into `out`, which has the bytes of `src` without padding. `check_kernel` must have accepted both.
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

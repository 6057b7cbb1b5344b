//! How far two pictures are apart.

use crate::error::{fail, Code, Result};
use crate::picture::View;

/// How far two pictures are apart, over all channel values.
#[derive(Clone, Copy, Debug)]
pub struct Difference {
    /// The largest difference, in stored units (0..255 or 0..65,535).
    pub max: u32,
    /// Their mean.
    pub mean: f64,
    /// Fraction of channel values that differ by more than the tolerance.
    pub outliers: f64,
}

/// How far two pictures of the same shape differ, channel value by channel value, alpha and unused channels included.
/// Shapes that differ are refused ([`Code::BadFormat`]).
pub fn compare(a: &View, b: &View, tolerance: u32) -> Result<Difference> {
    if a.shape != b.shape {
        return fail(
            Code::BadFormat,
            "two pictures compared must have the same size and format",
        );
    }
    let wide = a.shape.format.bytes_per_channel() == 2;
    let (mut max, mut sum, mut out, mut count) = (0u32, 0u64, 0u64, 0u64);
    let mut see = |d: u32| {
        max = max.max(d);
        sum += d as u64;
        out += (d > tolerance) as u64;
        count += 1;
    };
    for (ra, rb) in a.rows().zip(b.rows()) {
        if wide {
            for (x, y) in ra.chunks_exact(2).zip(rb.chunks_exact(2)) {
                see(
                    u16::from_le_bytes([x[0], x[1]]).abs_diff(u16::from_le_bytes([y[0], y[1]]))
                        as u32,
                );
            }
        } else {
            ra.iter()
                .zip(rb)
                .for_each(|(x, y)| see(x.abs_diff(*y) as u32));
        }
    }
    Ok(Difference {
        max,
        mean: sum as f64 / count as f64,
        outliers: out as f64 / count as f64,
    })
}

//! Comparison of two images.

use crate::error::{fail, Code, Result};
use crate::image::View;

/// How much two images differ, over all channel values.
#[derive(Clone, Copy, Debug)]
pub struct Difference {
    /// The maximum difference, in stored units (0..255 or 0..65,535).
    pub max: u32,
    /// The mean difference.
    pub mean: f64,
    /// The fraction of channel values that differ by more than the tolerance.
    pub outliers: f64,
}

/// Compares two images of the same shape by channel value, including alpha and unused channels. Images of different
/// shapes return [`Code::BadFormat`].
pub fn compare_images(a: &View, b: &View, tolerance: u32) -> Result<Difference> {
    if a.shape != b.shape {
        return fail(
            Code::BadFormat,
            "two images must have the same size and format to be compared",
        );
    }
    let wide = a.shape.format.bytes_per_channel() == 2;
    let (mut max, mut sum, mut out, mut count) = (0u32, 0u64, 0u64, 0u64);
    let mut record = |d: u32| {
        max = max.max(d);
        sum += d as u64;
        out += (d > tolerance) as u64;
        count += 1;
    };
    for (ra, rb) in a.rows().zip(b.rows()) {
        if wide {
            for (x, y) in ra.chunks_exact(2).zip(rb.chunks_exact(2)) {
                record(
                    u16::from_le_bytes([x[0], x[1]]).abs_diff(u16::from_le_bytes([y[0], y[1]]))
                        as u32,
                );
            }
        } else {
            ra.iter()
                .zip(rb)
                .for_each(|(x, y)| record(x.abs_diff(*y) as u32));
        }
    }
    Ok(Difference {
        max,
        mean: sum as f64 / count as f64,
        outliers: out as f64 / count as f64,
    })
}

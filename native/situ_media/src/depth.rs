//! Visualization of depth images.

use crate::image::View;

/// How depth is mapped to colors.
#[derive(Clone, Copy, Debug)]
pub struct PseudoColor {
    /// The minimum of the color range, in stored units (before scaling to metres).
    pub near: f64,
    /// The maximum of the color range, in the same units; greater than `near`.
    pub far: f64,
    /// The value of pixels without a measurement (0 for most cameras).
    pub invalid: u16,
    /// Whether pixels without a color are transparent instead of black.
    pub transparent: bool,
}

/// Colors a depth image from blue (near) to red (far). Values outside `near..far` and invalid values become black (or
/// transparent). `out` is :bgra32.
pub fn pseudo_colorize(src: &View, how: PseudoColor, out: &mut [u8]) {
    let span = (how.far - how.near).max(f64::MIN_POSITIVE);
    for (row, out) in src.rows().zip(out.chunks_exact_mut(src.shape.width * 4)) {
        for (p, o) in row.chunks_exact(2).zip(out.chunks_exact_mut(4)) {
            let d = u16::from_le_bytes([p[0], p[1]]);
            let value = f64::from(d);
            if d == how.invalid || value < how.near || value > how.far {
                o.copy_from_slice(&[0, 0, 0, if how.transparent { 0 } else { 255 }]);
            } else {
                let [r, g, b] = depth_color(1.0 - (value - how.near) / span);
                o.copy_from_slice(&[b, g, r, 255]);
            }
        }
    }
}

fn depth_color(s: f64) -> [u8; 3] {
    let (r, g, b) = if s < 0.25 {
        (1.0, s / 0.25, 0.0)
    } else if s < 0.5 {
        (1.0 - (s - 0.25) / 0.25, 1.0, 0.0)
    } else if s < 0.75 {
        (0.0, 1.0, (s - 0.5) / 0.25)
    } else {
        (0.0, 1.0 - (s - 0.75) / 0.25, 1.0)
    };
    [r, g, b].map(|v| (v * 255.0) as u8)
}

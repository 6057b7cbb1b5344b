//! Cutting an oriented patch out of a picture, straight into a network's input tensor.

/// How one pixel lies in memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PixelLayout {
    /// Bytes of a pixel: 1, 3 or 4.
    pub bytes: usize,
    /// The place of red in it, from 0; equal to the other two for grey.
    pub red: usize,
    /// The place of green.
    pub green: usize,
    /// The place of blue.
    pub blue: usize,
}

impl PixelLayout {
    /// By Situ's name of the format; 16-bit formats are not taken.
    #[must_use]
    pub fn parse(name: &str) -> Option<Self> {
        let (bytes, red, green, blue) = match name {
            "gray8" => (1, 0, 0, 0),
            "rgb24" => (3, 0, 1, 2),
            "bgr24" => (3, 2, 1, 0),
            "rgba32" => (4, 0, 1, 2),
            "bgrx32" | "bgra32" => (4, 2, 1, 0),
            _ => return None,
        };
        Some(Self {
            bytes,
            red,
            green,
            blue,
        })
    }
}

/// A picture, borrowed.
#[derive(Debug, Clone, Copy)]
pub struct Picture<'a> {
    /// The rows, the topmost first.
    pub data: &'a [u8],
    /// Pixels of a row, at least 1.
    pub width: usize,
    /// Rows, at least 1.
    pub height: usize,
    /// Bytes from the start of a row to that of the next, at least `width * layout.bytes`. The last row
    /// need not be padded.
    pub stride: usize,
    /// How a pixel lies in it.
    pub layout: PixelLayout,
}

/// The patch to cut: `matrix` maps a patch pixel `(x, y)` to a picture position, `(m0 x + m1 y + m2, m3 x + m4 y +
/// m5)`, both counted from the centre of the first pixel. A value `v` becomes `v * scale + offset`; outside of the
/// picture is black.
#[derive(Debug, Clone, Copy)]
pub struct Patch {
    /// `[m0, m1, m2, m3, m4, m5]`, in pixels of the picture; all of them finite.
    pub matrix: [f64; 6],
    /// Pixels of a patch's row.
    pub width: usize,
    /// Rows of the patch; `width * height` is 1 to 16,777,216.
    pub height: usize,
    /// The factor for a channel value (0 to 255).
    pub scale: f32,
    /// The number added afterwards.
    pub offset: f32,
}

impl Picture<'_> {
    fn fits(&self) -> bool {
        let row = self.width.checked_mul(self.layout.bytes);
        let before = self
            .height
            .checked_sub(1)
            .and_then(|h| h.checked_mul(self.stride));
        match (row, before) {
            (Some(row), Some(before)) => {
                self.width > 0
                    && row <= self.stride
                    && before
                        .checked_add(row)
                        .is_some_and(|n| n <= self.data.len())
            }
            _ => false,
        }
    }

    fn pixel(&self, x: i64, y: i64) -> [f32; 3] {
        let (Ok(x), Ok(y)) = (usize::try_from(x), usize::try_from(y)) else {
            return [0.0; 3];
        };
        if x >= self.width || y >= self.height {
            return [0.0; 3];
        }
        let at = y * self.stride + x * self.layout.bytes;
        let channel = |c: usize| self.data.get(at + c).copied().map_or(0.0, f32::from);
        [
            channel(self.layout.red),
            channel(self.layout.green),
            channel(self.layout.blue),
        ]
    }

    /// Anywhere: what lies outside of the picture is black.
    fn sample(&self, x: f64, y: f64) -> [f32; 3] {
        if !(x > -1.0 && y > -1.0 && x < self.width as f64 && y < self.height as f64) {
            return [0.0; 3];
        }
        let (fx, fy) = (x.floor(), y.floor());
        let (ax, ay) = ((x - fx) as f32, (y - fy) as f32);
        let (ix, iy) = (fx as i64, fy as i64);
        let (a, b) = (self.pixel(ix, iy), self.pixel(ix + 1, iy));
        let (c, d) = (self.pixel(ix, iy + 1), self.pixel(ix + 1, iy + 1));
        let mut out = [0.0; 3];
        for (i, o) in out.iter_mut().enumerate() {
            let top = a[i] + (b[i] - a[i]) * ax;
            let bottom = c[i] + (d[i] - c[i]) * ax;
            *o = top + (bottom - top) * ay;
        }
        out
    }

    /// As `sample`, where all four neighbours lie inside. With the layout known to the compiler nothing is left to be
    /// checked but the two ends.
    #[inline(always)]
    fn sample_inside<const BYTES: usize, const RED: usize, const BLUE: usize>(
        &self,
        x: f64,
        y: f64,
    ) -> Option<[f32; 3]> {
        // Both are 0 or more: truncation is the floor.
        let (ix, iy) = (x as i32, y as i32);
        let (ax, ay) = (x as f32 - ix as f32, y as f32 - iy as f32);
        let at = iy as usize * self.stride + ix as usize * BYTES;
        let top = self.data.get(at..at + 2 * BYTES)?;
        let bottom = self
            .data
            .get(at + self.stride..at + self.stride + 2 * BYTES)?;
        let (right, low) = (ax, ay);
        let (left, high) = (1.0 - ax, 1.0 - ay);
        let channel = |c: usize| {
            let upper = f32::from(top[c]) * left + f32::from(top[c + BYTES]) * right;
            let lower = f32::from(bottom[c]) * left + f32::from(bottom[c + BYTES]) * right;
            upper * high + lower * low
        };
        let green = if BYTES == 1 { 0 } else { 1 };
        Some([channel(RED), channel(green), channel(BLUE)])
    }
}

/// The steps `0..count` at which `start + step * i` lies in `0..limit`, with room to spare at both ends.
fn inside(start: f64, step: f64, limit: f64, count: usize) -> std::ops::Range<usize> {
    const ROOM: f64 = 1e-6;
    let all = 0..count;
    if step.abs() < 1e-12 {
        return if start >= ROOM && start < limit - ROOM {
            all
        } else {
            0..0
        };
    }
    let (a, b) = ((ROOM - start) / step, (limit - ROOM - start) / step);
    let (from, to) = (a.min(b).ceil().max(0.0), a.max(b).floor());
    if to < from {
        return 0..0;
    }
    // Casts saturate.
    (from as usize).min(count)..(to as usize).saturating_add(1).min(count)
}

/// How many bytes the floats of a patch take; `None` when it is empty or over 16 million pixels.
#[must_use]
pub fn patch_bytes(patch: &Patch) -> Option<usize> {
    let pixels = patch.width.checked_mul(patch.height)?;
    (1..=1 << 24)
        .contains(&pixels)
        .then_some(pixels * 3 * std::mem::size_of::<f32>())
}

/// Writes the patch as RGB floats in native order, rows first (`[height, width, 3]`), to `out`, which holds
/// `patch_bytes`. Answers false, with nothing written, when the picture's numbers do not agree with its bytes or
/// those of the patch with `out`.
#[must_use]
pub fn cut(picture: &Picture<'_>, patch: &Patch, out: &mut [u8]) -> bool {
    if patch_bytes(patch) != Some(out.len())
        || !picture.fits()
        || patch.matrix.iter().any(|m| !m.is_finite())
    {
        return false;
    }
    match bytemuck::try_cast_slice_mut::<u8, f32>(out) {
        Ok(floats) => cut_floats(picture, patch, floats),
        // Memory that is not aligned for floats.
        Err(_) => {
            let mut floats = vec![0.0; out.len() / std::mem::size_of::<f32>()];
            cut_floats(picture, patch, &mut floats);
            out.copy_from_slice(bytemuck::cast_slice(&floats));
        }
    }
    true
}

fn cut_floats(picture: &Picture<'_>, patch: &Patch, out: &mut [f32]) {
    match (picture.layout.bytes, picture.layout.red) {
        (1, _) => fill::<1, 0, 0>(picture, patch, out),
        (3, 0) => fill::<3, 0, 2>(picture, patch, out),
        (3, _) => fill::<3, 2, 0>(picture, patch, out),
        (_, 0) => fill::<4, 0, 2>(picture, patch, out),
        _ => fill::<4, 2, 0>(picture, patch, out),
    }
}

fn fill<const BYTES: usize, const RED: usize, const BLUE: usize>(
    picture: &Picture<'_>,
    patch: &Patch,
    out: &mut [f32],
) {
    let [m0, m1, m2, m3, m4, m5] = patch.matrix;
    let (right, bottom) = (picture.width as f64 - 1.0, picture.height as f64 - 1.0);
    let put = |pixel: &mut [f32], rgb: [f32; 3]| {
        for (o, v) in pixel.iter_mut().zip(rgb) {
            *o = v * patch.scale + patch.offset;
        }
    };
    for (y, row) in out.chunks_exact_mut(patch.width * 3).enumerate() {
        let (bx, by) = (m1 * y as f64 + m2, m4 * y as f64 + m5);
        let across = inside(bx, m0, right, patch.width);
        let down = inside(by, m3, bottom, patch.width);
        let from = across.start.max(down.start);
        let to = across.end.min(down.end).max(from);
        for (x, pixel) in row.chunks_exact_mut(3).enumerate() {
            let (sx, sy) = (m0 * x as f64 + bx, m3 * x as f64 + by);
            let fast = if x >= from && x < to {
                picture.sample_inside::<BYTES, RED, BLUE>(sx, sy)
            } else {
                None
            };
            put(pixel, fast.unwrap_or_else(|| picture.sample(sx, sy)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const IDENTITY: [f64; 6] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0];

    fn picture(data: &[u8], width: usize, height: usize, format: &str) -> Picture<'static> {
        let layout = PixelLayout::parse(format).unwrap_or(PixelLayout {
            bytes: 1,
            red: 0,
            green: 0,
            blue: 0,
        });
        let data: &'static [u8] = Box::leak(data.to_vec().into_boxed_slice());
        Picture {
            data,
            width,
            height,
            stride: width * layout.bytes,
            layout,
        }
    }

    fn patch(matrix: [f64; 6], width: usize, height: usize) -> Patch {
        Patch {
            matrix,
            width,
            height,
            scale: 1.0,
            offset: 0.0,
        }
    }

    fn floats(picture: &Picture<'_>, patch: &Patch) -> Option<Vec<f32>> {
        let mut out = vec![0.0_f32; patch_bytes(patch)? / 4];
        cut(picture, patch, bytemuck::cast_slice_mut(&mut out)).then_some(out)
    }

    #[test]
    fn memory_that_is_not_aligned_is_filled_too() {
        let p = picture(&[1, 2, 3, 4, 5, 6], 2, 1, "bgr24");
        let mut bytes = vec![0_u8; 2 * 12 + 1];
        assert!(cut(&p, &patch(IDENTITY, 2, 1), &mut bytes[1..]));
        let first = [bytes[1], bytes[2], bytes[3], bytes[4]];
        assert_eq!(f32::from_ne_bytes(first), 3.0);
        assert!(!cut(&p, &patch(IDENTITY, 2, 1), &mut bytes));
    }

    #[test]
    fn the_identity_swaps_bgr_to_rgb() {
        let p = picture(&[1, 2, 3, 4, 5, 6], 2, 1, "bgr24");
        assert_eq!(
            floats(&p, &patch(IDENTITY, 2, 1)),
            Some(vec![3.0, 2.0, 1.0, 6.0, 5.0, 4.0])
        );
    }

    #[test]
    fn half_way_is_the_mean_and_outside_is_black() {
        let p = picture(&[10, 30], 2, 1, "gray8");
        let half = patch([1.0, 0.0, 0.5, 0.0, 1.0, 0.0], 2, 1);
        assert_eq!(
            floats(&p, &half),
            Some(vec![20.0, 20.0, 20.0, 15.0, 15.0, 15.0])
        );
    }

    // Every way through is the slow one: turned, mirrored, partly and wholly outside, in every layout.
    #[test]
    fn the_fast_way_is_the_slow_way() {
        let data: Vec<u8> = (0..4 * 23 * 17).map(|i| (i * 37 % 251) as u8).collect();
        for format in ["gray8", "rgb24", "bgr24", "rgba32", "bgrx32"] {
            let p = picture(&data, 23, 17, format);
            for i in 0..40 {
                let (angle, side) = (f64::from(i) * 0.37, 0.1 + f64::from(i) * 0.11);
                let (c, s) = (side * angle.cos(), side * angle.sin());
                let (x, y) = (f64::from(i % 7) * 5.0 - 8.0, f64::from(i % 5) * 4.0 - 6.0);
                let patch = patch([c, -s, x, s, c, y], 19, 13);
                let fast = floats(&p, &patch).unwrap_or_default();
                assert_eq!(fast.len(), 19 * 13 * 3);
                for (n, rgb) in fast.chunks_exact(3).enumerate() {
                    let (u, v) = ((n % 19) as f64, (n / 19) as f64);
                    let slow = p.sample(c * u - s * v + x, s * u + c * v + y);
                    for (a, b) in rgb.iter().zip(slow) {
                        assert!((a - b).abs() < 1e-2, "{format} {i} {n}: {rgb:?} {slow:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn lies_about_the_size_are_refused() {
        let mut p = picture(&[0; 4], 2, 2, "gray8");
        p.height = 3;
        assert_eq!(floats(&p, &patch(IDENTITY, 2, 2)), None);
        p.height = 0;
        assert_eq!(floats(&p, &patch(IDENTITY, 2, 2)), None);
        p.height = 2;
        assert_eq!(floats(&p, &patch([f64::NAN; 6], 2, 2)), None);
        assert_eq!(floats(&p, &patch(IDENTITY, 0, 2)), None);
    }
}

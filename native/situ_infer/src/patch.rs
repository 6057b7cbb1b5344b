//! Cuts an oriented patch out of an image, directly into the input tensor of a network.

/// The memory layout of a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PixelLayout {
    /// The bytes of a pixel: 1, 3 or 4.
    pub bytes: usize,
    /// The index of red, from 0; equal to the other two for gray.
    pub red: usize,
    /// The index of green.
    pub green: usize,
    /// The index of blue.
    pub blue: usize,
}

impl PixelLayout {
    /// Returns the layout of a format by its name in Situ, or `None` for unsupported formats such as 16-bit ones.
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

/// A borrowed image.
#[derive(Debug, Clone, Copy)]
pub struct Image<'a> {
    /// The rows, starting at the top.
    pub data: &'a [u8],
    /// The pixels per row, at least 1.
    pub width: usize,
    /// The number of rows, at least 1.
    pub height: usize,
    /// The distance in bytes between the starts of two rows, at least `width * layout.bytes`. The last row does not
    /// need padding.
    pub stride: usize,
    /// The layout of a pixel.
    pub layout: PixelLayout,
}

/// The patch to cut. `matrix` maps a patch pixel `(x, y)` to an image position, `(m0 x + m1 y + m2, m3 x + m4 y +
/// m5)`, both relative to the center of the first pixel. A value `v` becomes `v * scale + offset`. Pixels outside the
/// image are black.
#[derive(Debug, Clone, Copy)]
pub struct Patch {
    /// The matrix `[m0, m1, m2, m3, m4, m5]` in image pixels; all numbers are finite.
    pub matrix: [f64; 6],
    /// The pixels per row of the patch.
    pub width: usize,
    /// The number of rows of the patch; `width * height` is 1 to 16,777,216.
    pub height: usize,
    /// The factor for a channel value (0 to 255).
    pub scale: f32,
    /// The number added after scaling.
    pub offset: f32,
}

impl Image<'_> {
    fn is_valid(&self) -> bool {
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

    fn pixel_at(&self, x: i64, y: i64) -> [f32; 3] {
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

    /// Samples the image at any position. Pixels outside the image are black.
    fn sample_bilinear(&self, x: f64, y: f64) -> [f32; 3] {
        if !(x > -1.0 && y > -1.0 && x < self.width as f64 && y < self.height as f64) {
            return [0.0; 3];
        }
        let (fx, fy) = (x.floor(), y.floor());
        let (ax, ay) = ((x - fx) as f32, (y - fy) as f32);
        let (ix, iy) = (fx as i64, fy as i64);
        let (a, b) = (self.pixel_at(ix, iy), self.pixel_at(ix + 1, iy));
        let (c, d) = (self.pixel_at(ix, iy + 1), self.pixel_at(ix + 1, iy + 1));
        let mut out = [0.0; 3];
        for (i, o) in out.iter_mut().enumerate() {
            let top = a[i] + (b[i] - a[i]) * ax;
            let bottom = c[i] + (d[i] - c[i]) * ax;
            *o = top + (bottom - top) * ay;
        }
        out
    }

    /// Samples the image like `sample_bilinear`, where all four neighbours are inside. Since the layout is known at
    /// compile time, only the two ends are checked.
    #[inline(always)]
    fn sample_inside<const BYTES: usize, const RED: usize, const BLUE: usize>(
        &self,
        x: f64,
        y: f64,
    ) -> Option<[f32; 3]> {
        // Both are nonnegative, so truncation rounds down.
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

/// Returns the steps of `0..count` at which `start + step * i` is in `0..limit`, with a margin at both ends.
fn steps_inside(start: f64, step: f64, limit: f64, count: usize) -> std::ops::Range<usize> {
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

/// Returns the bytes of the floats of a patch; `None` if it is empty or has more than 16 million pixels.
#[must_use]
pub fn patch_bytes(patch: &Patch) -> Option<usize> {
    let pixels = patch.width.checked_mul(patch.height)?;
    (1..=1 << 24)
        .contains(&pixels)
        .then_some(pixels * 3 * std::mem::size_of::<f32>())
}

/// Writes the patch as RGB floats in native byte order, row by row (`[height, width, 3]`), to `out`, which has
/// `patch_bytes`. Returns false and writes nothing if the size of the image does not match its bytes, or that of the
/// patch does not match `out`.
#[must_use]
pub fn cut_patch(image: &Image<'_>, patch: &Patch, out: &mut [u8]) -> bool {
    if patch_bytes(patch) != Some(out.len())
        || !image.is_valid()
        || patch.matrix.iter().any(|m| !m.is_finite())
    {
        return false;
    }
    match bytemuck::try_cast_slice_mut::<u8, f32>(out) {
        Ok(floats) => cut_float_patch(image, patch, floats),
        // The memory is not aligned for floats.
        Err(_) => {
            let mut floats = vec![0.0; out.len() / std::mem::size_of::<f32>()];
            cut_float_patch(image, patch, &mut floats);
            out.copy_from_slice(bytemuck::cast_slice(&floats));
        }
    }
    true
}

fn cut_float_patch(image: &Image<'_>, patch: &Patch, out: &mut [f32]) {
    match (image.layout.bytes, image.layout.red) {
        (1, _) => fill_patch::<1, 0, 0>(image, patch, out),
        (3, 0) => fill_patch::<3, 0, 2>(image, patch, out),
        (3, _) => fill_patch::<3, 2, 0>(image, patch, out),
        (_, 0) => fill_patch::<4, 0, 2>(image, patch, out),
        _ => fill_patch::<4, 2, 0>(image, patch, out),
    }
}

fn fill_patch<const BYTES: usize, const RED: usize, const BLUE: usize>(
    image: &Image<'_>,
    patch: &Patch,
    out: &mut [f32],
) {
    let [m0, m1, m2, m3, m4, m5] = patch.matrix;
    let (right, bottom) = (image.width as f64 - 1.0, image.height as f64 - 1.0);
    let write_pixel = |pixel: &mut [f32], rgb: [f32; 3]| {
        for (o, v) in pixel.iter_mut().zip(rgb) {
            *o = v * patch.scale + patch.offset;
        }
    };
    for (y, row) in out.chunks_exact_mut(patch.width * 3).enumerate() {
        let (bx, by) = (m1 * y as f64 + m2, m4 * y as f64 + m5);
        let across = steps_inside(bx, m0, right, patch.width);
        let down = steps_inside(by, m3, bottom, patch.width);
        let from = across.start.max(down.start);
        let to = across.end.min(down.end).max(from);
        for (x, pixel) in row.chunks_exact_mut(3).enumerate() {
            let (sx, sy) = (m0 * x as f64 + bx, m3 * x as f64 + by);
            let fast = if x >= from && x < to {
                image.sample_inside::<BYTES, RED, BLUE>(sx, sy)
            } else {
                None
            };
            write_pixel(pixel, fast.unwrap_or_else(|| image.sample_bilinear(sx, sy)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const IDENTITY: [f64; 6] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0];

    fn build_image(data: &[u8], width: usize, height: usize, format: &str) -> Image<'static> {
        let layout = PixelLayout::parse(format).unwrap_or(PixelLayout {
            bytes: 1,
            red: 0,
            green: 0,
            blue: 0,
        });
        let data: &'static [u8] = Box::leak(data.to_vec().into_boxed_slice());
        Image {
            data,
            width,
            height,
            stride: width * layout.bytes,
            layout,
        }
    }

    fn build_patch(matrix: [f64; 6], width: usize, height: usize) -> Patch {
        Patch {
            matrix,
            width,
            height,
            scale: 1.0,
            offset: 0.0,
        }
    }

    fn patch_floats(image: &Image<'_>, patch: &Patch) -> Option<Vec<f32>> {
        let mut out = vec![0.0_f32; patch_bytes(patch)? / 4];
        cut_patch(image, patch, bytemuck::cast_slice_mut(&mut out)).then_some(out)
    }

    #[test]
    fn unaligned_memory_is_filled_too() {
        let p = build_image(&[1, 2, 3, 4, 5, 6], 2, 1, "bgr24");
        let mut bytes = vec![0_u8; 2 * 12 + 1];
        assert!(cut_patch(&p, &build_patch(IDENTITY, 2, 1), &mut bytes[1..]));
        let first = [bytes[1], bytes[2], bytes[3], bytes[4]];
        assert_eq!(f32::from_ne_bytes(first), 3.0);
        assert!(!cut_patch(&p, &build_patch(IDENTITY, 2, 1), &mut bytes));
    }

    #[test]
    fn the_identity_swaps_bgr_to_rgb() {
        let p = build_image(&[1, 2, 3, 4, 5, 6], 2, 1, "bgr24");
        assert_eq!(
            patch_floats(&p, &build_patch(IDENTITY, 2, 1)),
            Some(vec![3.0, 2.0, 1.0, 6.0, 5.0, 4.0])
        );
    }

    #[test]
    fn a_position_between_pixels_is_their_mean_and_outside_is_black() {
        let p = build_image(&[10, 30], 2, 1, "gray8");
        let half = build_patch([1.0, 0.0, 0.5, 0.0, 1.0, 0.0], 2, 1);
        assert_eq!(
            patch_floats(&p, &half),
            Some(vec![20.0, 20.0, 20.0, 15.0, 15.0, 15.0])
        );
    }

    // Compares the fast path with the slow one for rotated, mirrored, and partly or completely outside patches, in
    // every layout.
    #[test]
    fn the_fast_path_equals_the_slow_path() {
        let data: Vec<u8> = (0..4 * 23 * 17).map(|i| (i * 37 % 251) as u8).collect();
        for format in ["gray8", "rgb24", "bgr24", "rgba32", "bgrx32"] {
            let p = build_image(&data, 23, 17, format);
            for i in 0..40 {
                let (angle, side) = (f64::from(i) * 0.37, 0.1 + f64::from(i) * 0.11);
                let (c, s) = (side * angle.cos(), side * angle.sin());
                let (x, y) = (f64::from(i % 7) * 5.0 - 8.0, f64::from(i % 5) * 4.0 - 6.0);
                let patch = build_patch([c, -s, x, s, c, y], 19, 13);
                let fast = patch_floats(&p, &patch).unwrap_or_default();
                assert_eq!(fast.len(), 19 * 13 * 3);
                for (n, rgb) in fast.chunks_exact(3).enumerate() {
                    let (u, v) = ((n % 19) as f64, (n / 19) as f64);
                    let slow = p.sample_bilinear(c * u - s * v + x, s * u + c * v + y);
                    for (a, b) in rgb.iter().zip(slow) {
                        assert!((a - b).abs() < 1e-2, "{format} {i} {n}: {rgb:?} {slow:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn wrong_sizes_are_rejected() {
        let mut p = build_image(&[0; 4], 2, 2, "gray8");
        p.height = 3;
        assert_eq!(patch_floats(&p, &build_patch(IDENTITY, 2, 2)), None);
        p.height = 0;
        assert_eq!(patch_floats(&p, &build_patch(IDENTITY, 2, 2)), None);
        p.height = 2;
        assert_eq!(patch_floats(&p, &build_patch([f64::NAN; 6], 2, 2)), None);
        assert_eq!(patch_floats(&p, &build_patch(IDENTITY, 0, 2)), None);
    }
}

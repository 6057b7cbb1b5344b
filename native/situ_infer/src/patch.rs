//! Cutting an oriented patch out of a picture, straight into a network's input tensor.

/// How one pixel lies in memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PixelLayout {
    pub bytes: usize,
    pub red: usize,
    pub green: usize,
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
    pub data: &'a [u8],
    pub width: usize,
    pub height: usize,
    pub stride: usize,
    pub layout: PixelLayout,
}

/// What to cut: `matrix` maps a patch pixel `(x, y)` to a picture position, `(m0 x + m1 y + m2, m3 x + m4 y + m5)`, both counted
/// from the centre of the first pixel. A value `v` becomes `v * scale + offset`; outside of the picture is black.
#[derive(Debug, Clone, Copy)]
pub struct Patch {
    pub matrix: [f64; 6],
    pub width: usize,
    pub height: usize,
    pub scale: f32,
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
}

/// The patch as RGB floats, rows first (`[height, width, 3]`), or `None` when the picture's numbers do not agree with its bytes
/// or the patch is empty or over 16 million pixels.
#[must_use]
pub fn cut(picture: &Picture<'_>, patch: &Patch) -> Option<Vec<f32>> {
    let pixels = patch
        .width
        .checked_mul(patch.height)
        .filter(|n| (1..=1 << 24).contains(n))?;
    if !picture.fits() || patch.matrix.iter().any(|m| !m.is_finite()) {
        return None;
    }
    let [m0, m1, m2, m3, m4, m5] = patch.matrix;
    let mut out = Vec::with_capacity(pixels * 3);
    for y in 0..patch.height {
        let (bx, by) = (m1 * y as f64 + m2, m4 * y as f64 + m5);
        for x in 0..patch.width {
            let rgb = picture.sample(m0 * x as f64 + bx, m3 * x as f64 + by);
            out.extend(rgb.map(|v| v * patch.scale + patch.offset));
        }
    }
    Some(out)
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

    #[test]
    fn the_identity_swaps_bgr_to_rgb() {
        let p = picture(&[1, 2, 3, 4, 5, 6], 2, 1, "bgr24");
        assert_eq!(
            cut(&p, &patch(IDENTITY, 2, 1)),
            Some(vec![3.0, 2.0, 1.0, 6.0, 5.0, 4.0])
        );
    }

    #[test]
    fn half_way_is_the_mean_and_outside_is_black() {
        let p = picture(&[10, 30], 2, 1, "gray8");
        let half = patch([1.0, 0.0, 0.5, 0.0, 1.0, 0.0], 2, 1);
        assert_eq!(
            cut(&p, &half),
            Some(vec![20.0, 20.0, 20.0, 15.0, 15.0, 15.0])
        );
    }

    #[test]
    fn lies_about_the_size_are_refused() {
        let mut p = picture(&[0; 4], 2, 2, "gray8");
        p.height = 3;
        assert_eq!(cut(&p, &patch(IDENTITY, 2, 2)), None);
        p.height = 0;
        assert_eq!(cut(&p, &patch(IDENTITY, 2, 2)), None);
        p.height = 2;
        assert_eq!(cut(&p, &patch([f64::NAN; 6], 2, 2)), None);
        assert_eq!(cut(&p, &patch(IDENTITY, 0, 2)), None);
    }
}

//! Camera intrinsics, and a table with the direction of each pixel.
//!
//! The model is the rational Brown-Conrady model of `Situ.Space.Camera`, which is the reference in the tests.

use crate::error::{fail, Code, Result};

/// The intrinsics of a camera, in pixels.
#[derive(Clone, Copy, Debug)]
pub struct Camera {
    /// The pixels per row.
    pub width: usize,
    /// The number of rows.
    pub height: usize,
    /// The focal lengths along x and y.
    pub focal: (f64, f64),
    /// The principal point.
    pub principal: (f64, f64),
    /// The coefficients k1 to k6.
    pub radial: [f64; 6],
    /// The coefficients p0 and p1.
    pub tangential: (f64, f64),
    /// Whether the closed form maps undistorted to distorted points.
    pub distorts: bool,
}

const MAX_STEPS: usize = 100;
const TOLERANCE: f64 = 1e-16;
const MAX_PIXELS: usize = 1 << 27;

impl Camera {
    fn radial_factor(&self, r2: f64) -> f64 {
        let k = &self.radial;
        (1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[2])))
            / (1.0 + r2 * (k[3] + r2 * (k[4] + r2 * k[5])))
    }

    /// Applies the closed form to a point of the plane at distance 1.
    pub fn distort(&self, x: f64, y: f64) -> (f64, f64) {
        let r2 = x * x + y * y;
        let d = self.radial_factor(r2);
        let (p0, p1) = self.tangential;
        (
            x * d + p1 * (r2 + 2.0 * x * x) + 2.0 * p0 * x * y,
            y * d + p0 * (r2 + 2.0 * y * y) + 2.0 * p1 * x * y,
        )
    }

    /// Inverts the closed form by Newton's method. Returns `None` where it does not converge or the image is
    /// mirrored.
    pub fn undistort(&self, tx: f64, ty: f64) -> Option<(f64, f64)> {
        let (mut x, mut y) = (tx, ty);
        for _ in 0..MAX_STEPS {
            let (dx, dy) = self.distort(x, y);
            let (ex, ey) = (dx - tx, dy - ty);
            if ex * ex + ey * ey < TOLERANCE {
                return (self.radial_factor(x * x + y * y) > 0.0).then_some((x, y));
            }
            let (a, b, d) = self.jacobian(x, y);
            let determinant = a * d - b * b;
            if determinant.abs() < TOLERANCE || !determinant.is_finite() {
                return None;
            }
            (x, y) = (
                x - (d * ex - b * ey) / determinant,
                y - (a * ey - b * ex) / determinant,
            );
        }
        None
    }

    // Returns the partial derivatives: of x by x, of x by y (equal to y by x), and of y by y.
    fn jacobian(&self, x: f64, y: f64) -> (f64, f64, f64) {
        let k = &self.radial;
        let (p0, p1) = self.tangential;
        let r2 = x * x + y * y;
        let above = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[2]));
        let below = 1.0 + r2 * (k[3] + r2 * (k[4] + r2 * k[5]));
        let d = above / below;
        let slope = ((k[0] + r2 * (2.0 * k[1] + 3.0 * r2 * k[2])) * below
            - above * (k[3] + r2 * (2.0 * k[4] + 3.0 * r2 * k[5])))
            / (below * below);
        (
            d + 2.0 * x * x * slope + 6.0 * p1 * x + 2.0 * p0 * y,
            2.0 * x * y * slope + 2.0 * p1 * y + 2.0 * p0 * x,
            d + 2.0 * y * y * slope + 6.0 * p0 * y + 2.0 * p1 * x,
        )
    }

    /// Returns the pixel that shows a point in the frame of the camera, which may be outside the image. Returns
    /// `None` for points that are not in front of the camera, and where the lens model has no solution.
    pub fn project(&self, [x, y, z]: [f64; 3]) -> Option<(f64, f64)> {
        if x <= 0.0 {
            return None;
        }
        let ideal = (-y / x, -z / x);
        let (nx, ny) = if self.distorts {
            self.distort(ideal.0, ideal.1)
        } else {
            self.undistort(ideal.0, ideal.1)?
        };
        let ((fx, fy), (cx, cy)) = (self.focal, self.principal);
        Some((fx * nx + cx, fy * ny + cy))
    }

    /// Returns, for every pixel, the point where its ray meets the plane at distance 1 (to the right, down), or NaN
    /// for pixels without a ray.
    pub fn ray_table(&self, undistort: bool) -> Result<Vec<[f32; 2]>> {
        let pixels = self.width.saturating_mul(self.height);
        if pixels == 0 || pixels > MAX_PIXELS {
            return fail(
                Code::TooLarge,
                format!(
                    "a camera of {}x{} pixels is too large or empty",
                    self.width, self.height
                ),
            );
        }
        let mut table = Vec::with_capacity(pixels);
        for py in 0..self.height {
            for px in 0..self.width {
                let x = (px as f64 - self.principal.0) / self.focal.0;
                let y = (py as f64 - self.principal.1) / self.focal.1;
                let point = match (undistort, self.distorts) {
                    (false, _) => Some((x, y)),
                    (true, true) => self.undistort(x, y),
                    (true, false) => Some(self.distort(x, y)),
                };
                let (x, y) = point.unwrap_or((f64::NAN, f64::NAN));
                table.push([x as f32, y as f32]);
            }
        }
        Ok(table)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    pub fn wide_camera() -> Camera {
        Camera {
            width: 64,
            height: 57,
            focal: (50.5, 50.5),
            principal: (32.2, 33.5),
            radial: [0.2, -0.1, 0.01, 0.15, -0.05, 0.005],
            tangential: (1e-4, -2e-4),
            distorts: true,
        }
    }

    #[test]
    fn undistort_inverts_distort() {
        for i in -60..60 {
            for j in -60..60 {
                let (x, y) = (f64::from(i) / 100.0, f64::from(j) / 100.0);
                let (dx, dy) = wide_camera().distort(x, y);
                let (ux, uy) = wide_camera().undistort(dx, dy).unwrap_or((9.0, 9.0));
                assert!((ux - x).abs() < 1e-6 && (uy - y).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn a_folding_lens_has_no_solution_beyond_the_fold() {
        let lens = Camera {
            radial: [-0.5, 0.0, 0.0, 0.0, 0.0, 0.0],
            tangential: (0.0, 0.0),
            ..wide_camera()
        };
        assert!(lens.undistort(0.4, 0.2).is_some());
        assert!(lens.undistort(3.0, 3.0).is_none());
        assert!(lens.undistort(6.0, 6.0).is_none());
    }

    #[test]
    fn a_camera_larger_than_memory_is_rejected() {
        let camera = Camera {
            width: usize::MAX,
            ..wide_camera()
        };
        assert!(camera.ray_table(true).is_err());
    }
}

//! Builds clouds and meshes from depth images.

use crate::error::{fail, Code, Result};

/// A depth image: 16-bit little-endian values, 0 for pixels without a measurement.
#[derive(Clone, Copy, Debug)]
pub struct Depth<'a> {
    width: usize,
    height: usize,
    stride: usize,
    data: &'a [u8],
    scale: f64,
    along_ray: bool,
}

/// How pixels are selected as points.
#[derive(Clone, Copy, Debug)]
pub struct Sampling {
    /// Only every n-th pixel of every n-th row is used.
    pub sparsity: usize,
    /// Only pixels whose eight neighbours have a measurement, too, are used.
    pub robust: bool,
}

impl<'a> Depth<'a> {
    /// Builds a checked view of the bytes. `scale` is the size of one unit in metres. With `along_ray`, values are
    /// distances along the ray instead of distances to the image plane.
    pub fn new(
        (width, height, stride): (usize, usize, usize),
        data: &'a [u8],
        scale: f64,
        along_ray: bool,
    ) -> Result<Depth<'a>> {
        let row = width.checked_mul(2);
        let needed = height
            .checked_sub(1)
            .and_then(|rows| rows.checked_mul(stride))
            .zip(row)
            .and_then(|(above, row)| above.checked_add(row));
        match (row, needed) {
            (Some(row), Some(needed)) if width > 0 && row <= stride && needed <= data.len() => {
                Ok(Depth {
                    width,
                    height,
                    stride,
                    data,
                    scale,
                    along_ray,
                })
            }
            _ => fail(
                Code::BadDepth,
                format!(
                    "{} bytes are not a depth image of {width}x{height} pixels with {stride} bytes per row",
                    data.len()
                ),
            ),
        }
    }

    fn value_at(&self, x: usize, y: usize) -> u16 {
        let at = y * self.stride + 2 * x;
        match self.data.get(at..at + 2) {
            Some(bytes) => u16::from_le_bytes([bytes[0], bytes[1]]),
            None => 0,
        }
    }

    fn has_measured_neighbours(&self, x: usize, y: usize) -> bool {
        x > 0
            && y > 0
            && x + 1 < self.width
            && y + 1 < self.height
            && (y - 1..=y + 1).all(|y| (x - 1..=x + 1).all(|x| self.value_at(x, y) != 0))
    }

    /// Returns the pixels per row, and the number of rows.
    pub(crate) fn image_size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    pub(crate) fn check_table(&self, table: &[u8]) -> Result<()> {
        if table.len() == self.width * self.height * 8 {
            Ok(())
        } else {
            fail(
                Code::BadCamera,
                format!(
                    "the table has {} pixels, the depth image {}",
                    table.len() / 8,
                    self.width * self.height
                ),
            )
        }
    }

    pub(crate) fn point_at(&self, x: usize, y: usize, table: &[u8]) -> Option<[f32; 3]> {
        let value = self.value_at(x, y);
        let at = (y * self.width + x) * 8;
        let ray = table.get(at..at + 8)?;
        let nx = f32::from_le_bytes([ray[0], ray[1], ray[2], ray[3]]);
        let ny = f32::from_le_bytes([ray[4], ray[5], ray[6], ray[7]]);
        if value == 0 || !nx.is_finite() || !ny.is_finite() {
            return None;
        }
        let mut depth = f32::from(value) * self.scale as f32;
        if self.along_ray {
            depth /= (nx * nx + ny * ny + 1.0).sqrt();
        }
        Some([depth, -nx * depth, -ny * depth])
    }

    /// Builds the cloud in the frame of the camera, row by row, without pixels that have no measurement. `table` is
    /// the ray table of the camera (`Camera::ray_table`) as bytes. `colors` are three bytes per pixel of an image
    /// with the same view, or empty; the colors of the points are returned after the cloud.
    pub fn build_cloud(
        &self,
        table: &[u8],
        sampling: Sampling,
        colors: &[u8],
    ) -> Result<(Vec<u8>, Vec<u8>)> {
        self.check_table(table)?;
        if !colors.is_empty() && colors.len() != self.width * self.height * 3 {
            return fail(
                Code::BadOption,
                format!(
                    "{} bytes of colors are not three for each of the {}x{} pixels",
                    colors.len(),
                    self.width,
                    self.height
                ),
            );
        }
        let mut point_colors = Vec::new();
        let step = sampling.sparsity.max(1);
        let mut out =
            Vec::with_capacity(self.width.div_ceil(step) * self.height.div_ceil(step) * 12);
        for y in (0..self.height).step_by(step) {
            for x in (0..self.width).step_by(step) {
                if sampling.robust && !self.has_measured_neighbours(x, y) {
                    continue;
                }
                if let Some([px, py, pz]) = self.point_at(x, y, table) {
                    out.extend_from_slice(&px.to_le_bytes());
                    out.extend_from_slice(&py.to_le_bytes());
                    out.extend_from_slice(&pz.to_le_bytes());
                    let at = (y * self.width + x) * 3;
                    point_colors.extend_from_slice(colors.get(at..at + 3).unwrap_or_default());
                }
            }
        }
        Ok((out, point_colors))
    }

    /// Builds a mesh: triangles between neighbouring pixels whose depths differ by at most `edge` metres. Returns the
    /// vertices and the indices.
    pub fn build_mesh(
        &self,
        table: &[u8],
        edge: f64,
        sparsity: usize,
    ) -> Result<(Vec<u8>, Vec<u8>)> {
        self.check_table(table)?;
        let step = sparsity.max(1);
        let (columns, rows) = (self.width.div_ceil(step), self.height.div_ceil(step));
        let mut vertices = Vec::new();
        let mut numbers = vec![u32::MAX; columns * rows];
        let mut count = 0u32;
        for row in 0..rows {
            for column in 0..columns {
                if let Some(point) = self.point_at(column * step, row * step, table) {
                    point
                        .iter()
                        .for_each(|c| vertices.extend_from_slice(&c.to_le_bytes()));
                    numbers[row * columns + column] = count;
                    count += 1;
                }
            }
        }
        // The comparison uses integer units of the image, so that a difference of exactly `edge` is kept.
        let most = edge / self.scale + 1e-6;
        let depth = |column: usize, row: usize| f64::from(self.value_at(column * step, row * step));
        let mut indices = Vec::new();
        for row in 1..rows {
            for column in 1..columns {
                let corners = [
                    (column - 1, row - 1),
                    (column, row - 1),
                    (column - 1, row),
                    (column, row),
                ];
                for triangle in [[0, 2, 1], [1, 2, 3]] {
                    let corners = triangle.map(|i: usize| corners[i]);
                    let number = corners.map(|(c, r)| numbers[r * columns + c]);
                    let depths = corners.map(|(c, r)| depth(c, r));
                    let near = depths.iter().fold(f64::INFINITY, |a, b| a.min(*b));
                    let far = depths.iter().fold(0.0f64, |a, b| a.max(*b));
                    if number.iter().all(|n| *n != u32::MAX) && far - near <= most {
                        number
                            .iter()
                            .for_each(|n| indices.extend_from_slice(&n.to_le_bytes()));
                    }
                }
            }
        }
        Ok((vertices, indices))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn build_table(width: usize, height: usize) -> Vec<u8> {
        let mut bytes = Vec::new();
        for y in 0..height {
            for x in 0..width {
                bytes.extend_from_slice(&(x as f32).to_le_bytes());
                bytes.extend_from_slice(&(y as f32).to_le_bytes());
            }
        }
        bytes
    }

    fn depth_bytes(values: &[u16]) -> Vec<u8> {
        values.iter().flat_map(|v| v.to_le_bytes()).collect()
    }

    fn parse_floats(bytes: &[u8]) -> Vec<f32> {
        bytes
            .chunks_exact(4)
            .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
            .collect()
    }

    const ALL: Sampling = Sampling {
        sparsity: 1,
        robust: false,
    };

    #[test]
    fn points_are_on_their_rays_and_unmeasured_pixels_are_skipped() -> Result<()> {
        let data = depth_bytes(&[1000, 0, 2000, 500]);
        let d = Depth::new((2, 2, 4), &data, 0.001, false)?;
        let points = parse_floats(&d.build_cloud(&build_table(2, 2), ALL, &[])?.0);
        assert_eq!(points, [1.0, -0.0, -0.0, 2.0, -0.0, -2.0, 0.5, -0.5, -0.5]);
        let colors: Vec<u8> = (0..12).collect();
        let (_, point_colors) = d.build_cloud(&build_table(2, 2), ALL, &colors)?;
        assert_eq!(point_colors, [0, 1, 2, 6, 7, 8, 9, 10, 11]);
        Ok(())
    }

    #[test]
    fn a_distance_along_the_ray_is_projected_onto_the_axis() -> Result<()> {
        let data = depth_bytes(&[1000, 1732]);
        let d = Depth::new((2, 1, 4), &data, 0.001, true)?;
        let mut rays = build_table(2, 1);
        rays[12..16].copy_from_slice(&1.0f32.to_le_bytes());
        let points = parse_floats(&d.build_cloud(&rays, ALL, &[])?.0);
        assert!((points[3] - 1.732 / 3.0f32.sqrt()).abs() < 1e-6);
        Ok(())
    }

    #[test]
    fn robust_points_have_eight_measured_neighbours() -> Result<()> {
        let mut values = [1000u16; 16];
        values[0] = 0;
        let data = depth_bytes(&values);
        let d = Depth::new((4, 4, 8), &data, 0.001, false)?;
        let robust = Sampling {
            robust: true,
            ..ALL
        };
        assert_eq!(
            d.build_cloud(&build_table(4, 4), robust, &[])?.0.len() / 12,
            3
        );
        assert_eq!(
            d.build_cloud(&build_table(4, 4), Sampling { sparsity: 2, ..ALL }, &[])?
                .0
                .len()
                / 12,
            3
        );
        Ok(())
    }

    #[test]
    fn triangles_do_not_bridge_an_edge() -> Result<()> {
        let data = depth_bytes(&[1000, 1000, 3000, 1000, 1000, 3000]);
        let d = Depth::new((3, 2, 6), &data, 0.001, false)?;
        let (vertices, indices) = d.build_mesh(&build_table(3, 2), 0.2, 1)?;
        assert_eq!((vertices.len() / 12, indices.len() / 12), (6, 2));
        let (_, all) = d.build_mesh(&build_table(3, 2), 5.0, 1)?;
        assert_eq!(all.len() / 12, 4);
        // A difference of exactly the edge is kept, and one more unit is not.
        for (far, count) in [(1200, 2), (1201, 0)] {
            let data = depth_bytes(&[1000, far, 1000, far]);
            let d = Depth::new((2, 2, 4), &data, 0.001, false)?;
            assert_eq!(
                d.build_mesh(&build_table(2, 2), 0.2, 1)?.1.len() / 12,
                count
            );
        }
        Ok(())
    }

    #[test]
    fn images_and_tables_of_different_sizes_are_rejected() -> Result<()> {
        assert!(Depth::new((2, 2, 4), &[0; 7], 1.0, false).is_err());
        assert!(Depth::new((0, 2, 4), &[0; 8], 1.0, false).is_err());
        assert!(Depth::new((usize::MAX, usize::MAX, usize::MAX), &[0; 8], 1.0, false).is_err());
        let data = [0; 8];
        let d = Depth::new((2, 2, 4), &data, 1.0, false)?;
        assert!(d.build_cloud(&[0; 31], ALL, &[]).is_err());
        assert!(d.build_cloud(&build_table(2, 2), ALL, &[0; 11]).is_err());
        Ok(())
    }
}

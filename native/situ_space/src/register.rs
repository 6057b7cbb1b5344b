//! Registration: finds the colors of a camera's image for the pixels of another camera's depth image.

use crate::camera::Camera;
use crate::depth::Depth;
use crate::error::{fail, Code, Result};

/// An image with its camera, and the pose of the depth camera in the frame of this camera.
#[derive(Clone, Copy, Debug)]
pub struct ColorImage<'a> {
    /// The intrinsics; the size is that of the image.
    pub camera: Camera,
    /// Three bytes per pixel, row by row.
    pub pixels: &'a [u8],
    /// The rows of the rotation from the frame of the depth camera.
    pub rotation: [[f64; 3]; 3],
    /// The position of the depth camera in metres.
    pub position: [f64; 3],
}

/// Returns three bytes of color for each pixel of the depth image; black if the depth is unknown or the point is
/// outside the color image. `table` is the ray table of the depth camera (`Camera::ray_table`).
pub fn register_colors(depth: &Depth, table: &[u8], image: &ColorImage) -> Result<Vec<u8>> {
    depth.check_table(table)?;
    let (width, height) = (image.camera.width, image.camera.height);
    if width.checked_mul(height).and_then(|n| n.checked_mul(3)) != Some(image.pixels.len()) {
        return fail(
            Code::BadOption,
            format!(
                "{} bytes of colors are not three for each of the {width}x{height} pixels",
                image.pixels.len()
            ),
        );
    }
    let (columns, rows) = depth.image_size();
    let mut out = Vec::with_capacity(columns * rows * 3);
    for y in 0..rows {
        for x in 0..columns {
            let seen = depth
                .point_at(x, y, table)
                .and_then(|point| image.color_at(point));
            out.extend_from_slice(&seen.unwrap_or_default());
        }
    }
    Ok(out)
}

impl ColorImage<'_> {
    fn color_at(&self, point: [f32; 3]) -> Option<[u8; 3]> {
        let [x, y, z] = point.map(f64::from);
        let position = [0, 1, 2].map(|i| {
            let [a, b, c] = self.rotation[i];
            a * x + b * y + c * z + self.position[i]
        });
        let (px, py) = self.camera.project(position)?;
        // Rounds to the nearest pixel center; as in ray tables, centers have integer coordinates.
        let (px, py) = ((px + 0.5).floor(), (py + 0.5).floor());
        if px < 0.0 || py < 0.0 || px >= self.camera.width as f64 || py >= self.camera.height as f64
        {
            return None;
        }
        let at = (py as usize * self.camera.width + px as usize) * 3;
        self.pixels.get(at..at + 3)?.try_into().ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn build_camera(width: usize, height: usize, focal: f64) -> Camera {
        Camera {
            width,
            height,
            focal: (focal, focal),
            principal: (width as f64 / 2.0, height as f64 / 2.0),
            radial: [0.0; 6],
            tangential: (0.0, 0.0),
            distorts: true,
        }
    }

    fn table_bytes(camera: &Camera) -> Vec<u8> {
        let table = camera.ray_table(true).unwrap_or_default();
        table
            .iter()
            .flatten()
            .flat_map(|v| v.to_le_bytes())
            .collect()
    }

    #[test]
    fn a_displaced_camera_sees_the_same_point_at_a_different_pixel() -> Result<()> {
        // The scene is 2 m away. The color camera has a longer focal length and is 0.1 m to the left.
        let eye = build_camera(4, 2, 4.0);
        let data: Vec<u8> = [2000u16; 8].iter().flat_map(|v| v.to_le_bytes()).collect();
        let depth = Depth::new((4, 2, 8), &data, 0.001, false)?;
        let lens = build_camera(8, 4, 80.0);
        let pixels: Vec<u8> = (0..96).collect();
        let image = ColorImage {
            camera: lens,
            pixels: &pixels,
            rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            position: [0.0, -0.1, 0.0],
        };
        let found = register_colors(&depth, &table_bytes(&eye), &image)?;
        assert_eq!(found.len(), 24);
        // The middle pixel (2, 1) is straight ahead. In the color image it is 80 * 0.1 / 2 = 4 pixels right of (4,
        // 2), outside of the 8 columns.
        assert_eq!(found[18..21], [0, 0, 0]);
        let nearer = ColorImage {
            position: [0.0, -0.05, 0.0],
            ..image
        };
        let found = register_colors(&depth, &table_bytes(&eye), &nearer)?;
        let at = (2 * 8 + 6) * 3;
        assert_eq!(found[18..21], [at, at + 1, at + 2]);
        assert!(register_colors(
            &depth,
            &table_bytes(&eye),
            &ColorImage {
                pixels: &[1, 2],
                ..image
            }
        )
        .is_err());
        Ok(())
    }
}

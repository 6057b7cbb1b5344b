//! The colours of one camera's picture at the pixels of another camera's depth image.

use crate::camera::Camera;
use crate::depth::Depth;
use crate::error::{fail, Code, Result};

/// A picture with its camera, and where the depth camera stands in that camera's frame.
#[derive(Clone, Copy, Debug)]
pub struct Colored<'a> {
    /// The lens; its size is the picture's.
    pub camera: Camera,
    /// Three bytes a pixel, row by row.
    pub pixels: &'a [u8],
    /// Rows of the rotation from the depth camera's frame.
    pub rotation: [[f64; 3]; 3],
    /// Where the depth camera is, metres.
    pub position: [f64; 3],
}

/// Three bytes for each pixel of the depth image: the colour of what it shows; black where that is not known, or not in
/// the picture. `table` is of the depth camera (`Camera::table`).
pub fn colors(depth: &Depth, table: &[u8], picture: &Colored) -> Result<Vec<u8>> {
    depth.check(table)?;
    let (width, height) = (picture.camera.width, picture.camera.height);
    if width.checked_mul(height).and_then(|n| n.checked_mul(3)) != Some(picture.pixels.len()) {
        return fail(
            Code::BadOption,
            format!(
                "{} bytes of colours are not three for each of {width}x{height} pixels",
                picture.pixels.len()
            ),
        );
    }
    let (columns, rows) = depth.size();
    let mut out = Vec::with_capacity(columns * rows * 3);
    for y in 0..rows {
        for x in 0..columns {
            let seen = depth
                .point(x, y, table)
                .and_then(|point| picture.color(point));
            out.extend_from_slice(&seen.unwrap_or_default());
        }
    }
    Ok(out)
}

impl Colored<'_> {
    fn color(&self, point: [f32; 3]) -> Option<[u8; 3]> {
        let [x, y, z] = point.map(f64::from);
        let place = [0, 1, 2].map(|i| {
            let [a, b, c] = self.rotation[i];
            a * x + b * y + c * z + self.position[i]
        });
        let (px, py) = self.camera.project(place)?;
        // the pixel whose middle is nearest: as tables have them, middles are whole numbers
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

    fn camera(width: usize, height: usize, focal: f64) -> Camera {
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

    fn bytes(camera: &Camera) -> Vec<u8> {
        let table = camera.table(true).unwrap_or_default();
        table
            .iter()
            .flatten()
            .flat_map(|v| v.to_le_bytes())
            .collect()
    }

    #[test]
    fn a_camera_beside_sees_the_same_elsewhere() -> Result<()> {
        // 2 m away; the colour camera is twice as sharp and stands 0.1 m to the left
        let eye = camera(4, 2, 4.0);
        let data: Vec<u8> = [2000u16; 8].iter().flat_map(|v| v.to_le_bytes()).collect();
        let depth = Depth::new((4, 2, 8), &data, 0.001, false)?;
        let lens = camera(8, 4, 80.0);
        let pixels: Vec<u8> = (0..96).collect();
        let picture = Colored {
            camera: lens,
            pixels: &pixels,
            rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            position: [0.0, -0.1, 0.0],
        };
        let found = colors(&depth, &bytes(&eye), &picture)?;
        assert_eq!(found.len(), 24);
        // the middle pixel (2, 1) lies straight ahead: 80 * 0.1 / 2 = 4 pixels right of (4, 2), outside of 8
        assert_eq!(found[18..21], [0, 0, 0]);
        let nearer = Colored {
            position: [0.0, -0.05, 0.0],
            ..picture
        };
        let found = colors(&depth, &bytes(&eye), &nearer)?;
        let at = (2 * 8 + 6) * 3;
        assert_eq!(found[18..21], [at, at + 1, at + 2]);
        assert!(colors(
            &depth,
            &bytes(&eye),
            &Colored {
                pixels: &[1, 2],
                ..picture
            }
        )
        .is_err());
        Ok(())
    }
}

//! Which way the surface under each point faces.

use crate::error::Result;
use crate::grid::{bytes, length, points, Grid};
use crate::plane::spread;
use nalgebra::Vector3;

/// For every point the unit normal of the plane through its neighbours within `radius` metres, turned towards
/// `viewpoint`; zero where fewer than three neighbours are there. And how curved the surface is, 0 (flat) to 1/3.
pub fn normals(cloud: &[u8], radius: f64, viewpoint: [f64; 3]) -> Result<(Vec<u8>, Vec<u8>)> {
    let radius = length(radius, "the radius")?;
    let points = points(cloud)?;
    let grid = Grid::new(&points, radius);
    let viewpoint = Vector3::from(viewpoint);
    let mut near = Vec::new();
    let mut curvatures = Vec::with_capacity(points.len() * 4);
    let mut out = Vec::with_capacity(points.len());
    for point in &points {
        near.clear();
        grid.around(point, |i| near.push(i));
        let (normal, curvature) = match spread(near.iter().map(|&i| &points[i])) {
            Some((_, normal, share)) => {
                let to_viewer =
                    viewpoint - Vector3::new(point[0].into(), point[1].into(), point[2].into());
                let facing = if normal.dot(&to_viewer) < 0.0 {
                    -normal
                } else {
                    normal
                };
                (
                    [facing.x as f32, facing.y as f32, facing.z as f32],
                    share as f32,
                )
            }
            None => ([0.0; 3], 0.0),
        };
        out.push(normal);
        curvatures.extend_from_slice(&curvature.to_le_bytes());
    }
    Ok((bytes(out), curvatures))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_floor_faces_up_and_a_lone_point_nowhere() -> Result<()> {
        let floor = (0..25).map(|i| [(i % 5) as f32 * 0.1, (i / 5) as f32 * 0.1, 0.0]);
        let (normals, curvature) = normals(
            &bytes(floor.chain([[9.0, 9.0, 9.0]])),
            0.15,
            [0.0, 0.0, 2.0],
        )?;
        let found = points(&normals)?;
        assert!(found[..25].iter().all(|n| n[2] > 0.999));
        assert_eq!(found[25], [0.0; 3]);
        assert!(curvature
            .chunks_exact(4)
            .all(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]) < 1e-6));
        Ok(())
    }
}

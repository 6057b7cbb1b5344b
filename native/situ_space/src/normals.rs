//! Estimates surface normals.

use crate::error::Result;
use crate::grid::{check_length, encode_points, parse_points, Grid};
use crate::plane::measure_spread;
use nalgebra::Vector3;

/// Returns the unit normal of every point: that of the plane through its neighbours within `radius` metres, oriented
/// towards `viewpoint`. It is zero for points with fewer than three neighbours. Also returns the curvature, from 0
/// (flat) to 1/3.
pub fn estimate_normals(
    cloud: &[u8],
    radius: f64,
    viewpoint: [f64; 3],
) -> Result<(Vec<u8>, Vec<u8>)> {
    let radius = check_length(radius, "the radius")?;
    let points = parse_points(cloud)?;
    let grid = Grid::new(&points, radius);
    let viewpoint = Vector3::from(viewpoint);
    let mut near = Vec::new();
    let mut curvatures = Vec::with_capacity(points.len() * 4);
    let mut out = Vec::with_capacity(points.len());
    for point in &points {
        near.clear();
        grid.visit_near(point, |i| near.push(i));
        let (normal, curvature) = match measure_spread(near.iter().map(|&i| &points[i])) {
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
    Ok((encode_points(out), curvatures))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_floor_faces_up_and_a_single_point_has_no_normal() -> Result<()> {
        let floor = (0..25).map(|i| [(i % 5) as f32 * 0.1, (i / 5) as f32 * 0.1, 0.0]);
        let (normals, curvature) = estimate_normals(
            &encode_points(floor.chain([[9.0, 9.0, 9.0]])),
            0.15,
            [0.0, 0.0, 2.0],
        )?;
        let found = parse_points(&normals)?;
        assert!(found[..25].iter().all(|n| n[2] > 0.999));
        assert_eq!(found[25], [0.0; 3]);
        assert!(curvature
            .chunks_exact(4)
            .all(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]) < 1e-6));
        Ok(())
    }
}

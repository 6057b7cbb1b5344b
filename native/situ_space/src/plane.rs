//! Fits planes to point clouds.

use crate::error::{fail, Code, Result};
use crate::grid::{check_length, parse_points, Point};
use nalgebra::{Matrix3, Vector3};

/// A plane, and the points on it.
#[derive(Clone, Debug, PartialEq)]
pub struct Plane {
    /// The unit normal, with a z that is not negative.
    pub normal: [f64; 3],
    /// The dot product of the normal and any point of the plane.
    pub offset: f64,
    /// The indices of the points within the tolerance.
    pub inliers: Vec<u32>,
}

/// Finds the plane with the most points within `tolerance` (metres), out of `rounds` random triples, and fits it to
/// these points by least squares. The same `seed` gives the same plane. Source: M. Fischler, R. Bolles, Random Sample
/// Consensus, 1981.
pub fn find_plane(cloud: &[u8], tolerance: f64, rounds: u32, seed: u64) -> Result<Plane> {
    let tolerance = f64::from(check_length(tolerance, "the tolerance")?);
    let points = parse_points(cloud)?;
    if points.len() < 3 {
        return fail(
            Code::Degenerate,
            format!("a plane needs at least 3 points, got {}", points.len()),
        );
    }
    let mut random = Random(seed);
    let mut best: Option<(Vector3<f64>, f64, usize)> = None;
    for _ in 0..rounds.clamp(1, 100_000) {
        let [a, b, c] = [0; 3].map(|_| to_vector(&points[random.next_below(points.len())]));
        if let Some(normal) = (b - a).cross(&(c - a)).try_normalize(1e-12) {
            let offset = normal.dot(&a);
            let count = points
                .iter()
                .filter(|p| is_near(p, &normal, offset, tolerance))
                .count();
            if best.is_none_or(|(_, _, most)| count > most) {
                best = Some((normal, offset, count));
            }
        }
    }
    let Some((normal, offset, _)) = best else {
        return fail(Code::Degenerate, "all points are on one line");
    };
    let on_it: Vec<&Point> = points
        .iter()
        .filter(|p| is_near(p, &normal, offset, tolerance))
        .collect();
    let (normal, offset) = fit_plane(&on_it).unwrap_or((normal, offset));
    let inliers = (0..points.len())
        .filter(|&i| is_near(&points[i], &normal, offset, tolerance))
        .map(|i| i as u32)
        .collect();
    Ok(Plane {
        normal: [normal.x, normal.y, normal.z],
        offset,
        inliers,
    })
}

fn is_near(point: &Point, normal: &Vector3<f64>, offset: f64, tolerance: f64) -> bool {
    (normal.dot(&to_vector(point)) - offset).abs() <= tolerance
}

fn to_vector(point: &Point) -> Vector3<f64> {
    Vector3::new(point[0].into(), point[1].into(), point[2].into())
}

/// Returns the least-squares plane of the points: it contains their mean and is perpendicular to the direction of
/// least variance.
pub fn fit_plane(points: &[&Point]) -> Option<(Vector3<f64>, f64)> {
    let (mean, normal, _) = measure_spread(points.iter().copied())?;
    let normal = if normal.z < 0.0 { -normal } else { normal };
    Some((normal, normal.dot(&mean)))
}

/// Returns the mean of the points, the direction of least variance, and its share of the total variance; `None` for
/// fewer than three points.
pub fn measure_spread<'a>(
    points: impl Iterator<Item = &'a Point> + Clone,
) -> Option<(Vector3<f64>, Vector3<f64>, f64)> {
    let mut count = 0.0;
    let mut mean = Vector3::zeros();
    for point in points.clone() {
        mean += to_vector(point);
        count += 1.0;
    }
    if count < 3.0 {
        return None;
    }
    mean /= count;
    let mut covariance = Matrix3::zeros();
    for point in points {
        let d = to_vector(point) - mean;
        covariance += d * d.transpose();
    }
    let eigen = covariance.symmetric_eigen();
    let least = eigen.eigenvalues.imin();
    let all: f64 = eigen.eigenvalues.iter().sum();
    let normal = eigen.eigenvectors.column(least).into_owned();
    let share = if all > 0.0 {
        (eigen.eigenvalues[least] / all).max(0.0)
    } else {
        0.0
    };
    Some((mean, normal, share))
}

// SplitMix64 (G. Steele, D. Lea, C. Flood, 2014) is sufficient to choose triples, and is the same on every machine.
struct Random(u64);

impl Random {
    fn next_below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((u128::from(z ^ (z >> 31)) * n as u128) >> 64) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::encode_points;

    #[test]
    fn the_floor_is_found_among_other_objects() -> Result<()> {
        let floor = (0..100).map(|i| {
            [
                (i % 10) as f32,
                (i / 10) as f32,
                0.5 + 0.001 * (i % 3) as f32,
            ]
        });
        let things = (0..40).map(|i| [i as f32 * 0.1, 3.0, 1.0 + i as f32 * 0.05]);
        let plane = find_plane(&encode_points(floor.chain(things)), 0.01, 200, 7)?;
        assert!(plane.normal[2] > 0.999 && (plane.offset - 0.501).abs() < 0.005);
        assert_eq!(plane.inliers, (0..100).collect::<Vec<u32>>());
        Ok(())
    }

    #[test]
    fn the_same_seed_gives_the_same_plane() -> Result<()> {
        let cloud = encode_points(
            (0..50).map(|i| [(i * 7 % 11) as f32, (i * 5 % 13) as f32, (i % 3) as f32]),
        );
        assert_eq!(
            find_plane(&cloud, 0.1, 50, 1)?,
            find_plane(&cloud, 0.1, 50, 1)?
        );
        Ok(())
    }

    #[test]
    fn points_on_a_line_do_not_span_a_plane() {
        let line = encode_points((0..10).map(|i| [i as f32, 0.0, 0.0]));
        assert_eq!(
            find_plane(&line, 0.1, 50, 1).map_err(|e| e.code),
            Err(Code::Degenerate)
        );
        assert!(find_plane(&encode_points([[0.0; 3]; 2]), 0.1, 50, 1).is_err());
    }
}

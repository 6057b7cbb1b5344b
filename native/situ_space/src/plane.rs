//! The plane that most points lie on.

use crate::error::{fail, Code, Result};
use crate::grid::{length, points, Point};
use nalgebra::{Matrix3, Vector3};

/// A plane, and the points on it.
#[derive(Clone, Debug, PartialEq)]
pub struct Plane {
    /// Of unit length, with a z that is not negative.
    pub normal: [f64; 3],
    /// The normal times any point of the plane.
    pub offset: f64,
    /// The numbers of the points that lie within the tolerance.
    pub inliers: Vec<u32>,
}

/// The plane within whose `tolerance` (metres) most points lie, out of `rounds` random triples, fitted by least
/// squares to them. The same `seed` gives the same plane. Source: M. Fischler, R. Bolles, Random Sample Consensus,
/// 1981.
pub fn ransac(cloud: &[u8], tolerance: f64, rounds: u32, seed: u64) -> Result<Plane> {
    let tolerance = f64::from(length(tolerance, "the tolerance")?);
    let points = points(cloud)?;
    if points.len() < 3 {
        return fail(
            Code::Degenerate,
            format!("{} points span no plane", points.len()),
        );
    }
    let mut random = Random(seed);
    let mut best: Option<(Vector3<f64>, f64, usize)> = None;
    for _ in 0..rounds.clamp(1, 100_000) {
        let [a, b, c] = [0; 3].map(|_| vector(&points[random.below(points.len())]));
        if let Some(normal) = (b - a).cross(&(c - a)).try_normalize(1e-12) {
            let offset = normal.dot(&a);
            let count = points
                .iter()
                .filter(|p| near(p, &normal, offset, tolerance))
                .count();
            if best.is_none_or(|(_, _, most)| count > most) {
                best = Some((normal, offset, count));
            }
        }
    }
    let Some((normal, offset, _)) = best else {
        return fail(Code::Degenerate, "all points lie on one line");
    };
    let on_it: Vec<&Point> = points
        .iter()
        .filter(|p| near(p, &normal, offset, tolerance))
        .collect();
    let (normal, offset) = fit(&on_it).unwrap_or((normal, offset));
    let inliers = (0..points.len())
        .filter(|&i| near(&points[i], &normal, offset, tolerance))
        .map(|i| i as u32)
        .collect();
    Ok(Plane {
        normal: [normal.x, normal.y, normal.z],
        offset,
        inliers,
    })
}

fn near(point: &Point, normal: &Vector3<f64>, offset: f64, tolerance: f64) -> bool {
    (normal.dot(&vector(point)) - offset).abs() <= tolerance
}

fn vector(point: &Point) -> Vector3<f64> {
    Vector3::new(point[0].into(), point[1].into(), point[2].into())
}

/// The plane of least squares through the points: through their mean, across the direction in which they spread least.
pub fn fit(points: &[&Point]) -> Option<(Vector3<f64>, f64)> {
    let (mean, normal, _) = spread(points.iter().copied())?;
    let normal = if normal.z < 0.0 { -normal } else { normal };
    Some((normal, normal.dot(&mean)))
}

/// The mean of points, the direction in which they spread least, and the share of the spread that lies in it; `None`
/// for fewer than three points.
pub fn spread<'a>(
    points: impl Iterator<Item = &'a Point> + Clone,
) -> Option<(Vector3<f64>, Vector3<f64>, f64)> {
    let mut count = 0.0;
    let mut mean = Vector3::zeros();
    for point in points.clone() {
        mean += vector(point);
        count += 1.0;
    }
    if count < 3.0 {
        return None;
    }
    mean /= count;
    let mut covariance = Matrix3::zeros();
    for point in points {
        let d = vector(point) - mean;
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

// SplitMix64 (G. Steele, D. Lea, C. Flood, 2014): enough to choose triples, the same on every machine.
struct Random(u64);

impl Random {
    fn below(&mut self, n: usize) -> usize {
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
    use crate::grid::bytes;

    #[test]
    fn the_floor_is_found_among_other_things() -> Result<()> {
        let floor = (0..100).map(|i| {
            [
                (i % 10) as f32,
                (i / 10) as f32,
                0.5 + 0.001 * (i % 3) as f32,
            ]
        });
        let things = (0..40).map(|i| [i as f32 * 0.1, 3.0, 1.0 + i as f32 * 0.05]);
        let plane = ransac(&bytes(floor.chain(things)), 0.01, 200, 7)?;
        assert!(plane.normal[2] > 0.999 && (plane.offset - 0.501).abs() < 0.005);
        assert_eq!(plane.inliers, (0..100).collect::<Vec<u32>>());
        Ok(())
    }

    #[test]
    fn the_same_seed_gives_the_same_plane() -> Result<()> {
        let cloud =
            bytes((0..50).map(|i| [(i * 7 % 11) as f32, (i * 5 % 13) as f32, (i % 3) as f32]));
        assert_eq!(ransac(&cloud, 0.1, 50, 1)?, ransac(&cloud, 0.1, 50, 1)?);
        Ok(())
    }

    #[test]
    fn points_on_a_line_span_no_plane() {
        let line = bytes((0..10).map(|i| [i as f32, 0.0, 0.0]));
        assert_eq!(
            ransac(&line, 0.1, 50, 1).map_err(|e| e.code),
            Err(Code::Degenerate)
        );
        assert!(ransac(&bytes([[0.0; 3]; 2]), 0.1, 50, 1).is_err());
    }
}

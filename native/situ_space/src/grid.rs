//! A spatial hash: all points within a radius of a point are in its cell or in one of the 26 cells around it.

use crate::error::{fail, Code, Result};
use rustc_hash::FxHashMap as HashMap;

/// A point as its three coordinates.
pub type Point = [f32; 3];

/// Parses the points. Coordinates that are not finite are an error.
pub fn parse_points(bytes: &[u8]) -> Result<Vec<Point>> {
    if !bytes.len().is_multiple_of(12) {
        return fail(
            Code::BadCloud,
            format!(
                "{} bytes are not a whole number of points of 12 bytes",
                bytes.len()
            ),
        );
    }
    let points: Vec<Point> = bytes
        .chunks_exact(12)
        .map(|b| {
            [
                f32::from_le_bytes([b[0], b[1], b[2], b[3]]),
                f32::from_le_bytes([b[4], b[5], b[6], b[7]]),
                f32::from_le_bytes([b[8], b[9], b[10], b[11]]),
            ]
        })
        .collect();
    match points.iter().position(|p| p.iter().any(|c| !c.is_finite())) {
        Some(at) => fail(Code::BadCloud, format!("point {at} is not finite")),
        None => Ok(points),
    }
}

/// Encodes points as bytes.
pub fn encode_points(points: impl IntoIterator<Item = Point>) -> Vec<u8> {
    let mut out = Vec::new();
    for point in points {
        point
            .iter()
            .for_each(|c| out.extend_from_slice(&c.to_le_bytes()));
    }
    out
}

/// The indices of a cubic cell.
pub type Cell = [i64; 3];

/// Returns the cell of size `size` that contains the point.
pub fn find_cell(point: &Point, size: f32) -> Cell {
    // `floor` is a library call on processors without SSE 4.1, and SSE 4.1 is not enabled by default.
    point.map(|c| {
        let edges = f64::from(c) / f64::from(size);
        let towards_zero = edges as i64;
        towards_zero.saturating_sub(i64::from(edges < towards_zero as f64))
    })
}

/// Checks that a length in metres is valid as an edge or a radius.
pub fn check_length(value: f64, name: &str) -> Result<f32> {
    if (1e-6..=1e6).contains(&value) {
        Ok(value as f32)
    } else {
        fail(
            Code::BadOption,
            format!("{name} must be a length between 1e-6 and 1e6 metres, got: {value}"),
        )
    }
}

/// Finds all points within a fixed radius of a point.
pub struct Grid<'a> {
    points: &'a [Point],
    radius: f32,
    cells: HashMap<Cell, Vec<u32>>,
}

impl<'a> Grid<'a> {
    /// Sorts the points into cells.
    pub fn new(points: &'a [Point], radius: f32) -> Grid<'a> {
        let mut cells: HashMap<Cell, Vec<u32>> = HashMap::default();
        for (i, point) in points.iter().enumerate() {
            cells
                .entry(find_cell(point, radius))
                .or_default()
                .push(i as u32);
        }
        Grid {
            points,
            radius,
            cells,
        }
    }

    /// Calls `found` with the index of each point within the radius, including the point itself.
    pub fn visit_near(&self, point: &Point, mut found: impl FnMut(usize)) {
        let middle = find_cell(point, self.radius);
        let limit = self.radius * self.radius;
        for dx in -1..=1 {
            for dy in -1..=1 {
                for dz in -1..=1 {
                    let near = [middle[0] + dx, middle[1] + dy, middle[2] + dz];
                    for &i in self.cells.get(&near).into_iter().flatten() {
                        if squared_distance(&self.points[i as usize], point) <= limit {
                            found(i as usize);
                        }
                    }
                }
            }
        }
    }
}

/// Returns the squared distance.
pub fn squared_distance(a: &Point, b: &Point) -> f32 {
    let (x, y, z) = (a[0] - b[0], a[1] - b[1], a[2] - b[2]);
    x * x + y * y + z * z
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cell_begins_at_its_lower_edge_on_both_sides_of_zero() {
        let all = [
            0.0, -0.0, 0.05, -0.05, 0.049_999, -0.049_999, 1.0e6, -1.0e6, 1.0e-30, -1.0e-30,
            3.4e38, -3.4e38,
        ];
        for c in all {
            for size in [1e-6_f32, 0.05, 1.0, 1e6] {
                let floor = (f64::from(c) / f64::from(size)).floor() as i64;
                assert_eq!(
                    find_cell(&[c, 0.0, 0.0], size)[0],
                    floor,
                    "{c} in cells of {size}"
                );
            }
        }
    }
}

//! Renders a room as seen by an ideal depth camera, by casting rays against boxes and capsules.

use crate::error::{fail, Code, Result};
use crate::grid::Point;

/// An object in the room, with a color (red, green, blue).
#[derive(Clone, Copy, Debug)]
pub enum Shape {
    /// An axis-aligned box, seen from outside (or from inside: the walls of the room).
    Box {
        /// The minimum corner.
        min: Point,
        /// The maximum corner.
        max: Point,
        /// The color.
        color: [u8; 3],
    },
    /// All points within a radius of a segment: a limb, or a ball if both ends are equal.
    Capsule {
        /// One end.
        from: Point,
        /// The other end.
        to: Point,
        /// The radius in metres.
        radius: f32,
        /// The color.
        color: [u8; 3],
    },
}

/// The pose of the camera: its position, and the rows of its rotation matrix.
#[derive(Clone, Copy, Debug)]
pub struct Viewpoint {
    /// The position in metres.
    pub position: Point,
    /// Rotates directions from the frame of the camera to that of the room.
    pub rotation: [[f32; 3]; 3],
}

fn dot(a: &Point, b: &Point) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn subtract(a: &Point, b: &Point) -> Point {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

impl Shape {
    /// Returns the distance along a ray (in lengths of its direction).
    fn ray_distance(&self, origin: &Point, ray: &Point, inverse: &Point) -> Option<f32> {
        match self {
            Shape::Box { min, max, .. } => box_distance(min, max, origin, inverse),
            Shape::Capsule {
                from, to, radius, ..
            } => hit_capsule(from, to, *radius, origin, ray).map(|(t, _)| t),
        }
    }

    /// Returns the surface normal at the point where a ray meets the shape.
    fn surface_normal(&self, origin: &Point, ray: &Point) -> Point {
        let hit = match self {
            Shape::Box { min, max, .. } => hit_box(min, max, origin, ray),
            Shape::Capsule {
                from, to, radius, ..
            } => hit_capsule(from, to, *radius, origin, ray),
        };
        hit.map_or([0.0; 3], |(_, normal)| normal)
    }

    /// Returns a ball that contains the shape.
    fn bounding_ball(&self) -> (Point, f32) {
        let (a, b, more) = match self {
            Shape::Box { min, max, .. } => (min, max, 0.0),
            Shape::Capsule {
                from, to, radius, ..
            } => (from, to, *radius),
        };
        let half: Point = std::array::from_fn(|i| (b[i] - a[i]) / 2.0);
        let center = std::array::from_fn(|i| (a[i] + b[i]) / 2.0);
        (center, dot(&half, &half).sqrt() + more)
    }

    fn color(&self) -> [u8; 3] {
        match self {
            Shape::Box { color, .. } | Shape::Capsule { color, .. } => *color,
        }
    }
}

/// Returns the distance to a box. `inverse` contains the reciprocals of the direction of the ray.
fn box_distance(min: &Point, max: &Point, origin: &Point, inverse: &Point) -> Option<f32> {
    let (mut enter, mut leave) = (f32::NEG_INFINITY, f32::INFINITY);
    for axis in 0..3 {
        let a = (min[axis] - origin[axis]) * inverse[axis];
        let b = (max[axis] - origin[axis]) * inverse[axis];
        enter = enter.max(a.min(b));
        leave = leave.min(a.max(b));
    }
    if enter > leave || leave <= 0.0 {
        None
    } else {
        Some(if enter > 0.0 { enter } else { leave })
    }
}

fn hit_box(min: &Point, max: &Point, origin: &Point, ray: &Point) -> Option<(f32, Point)> {
    let (mut enter, mut leave) = (f32::NEG_INFINITY, f32::INFINITY);
    let (mut entry, mut exit) = ([0.0; 3], [0.0; 3]);
    for axis in 0..3 {
        let inverse = 1.0 / ray[axis];
        let (a, b) = (
            (min[axis] - origin[axis]) * inverse,
            (max[axis] - origin[axis]) * inverse,
        );
        let (near, far) = if a <= b { (a, b) } else { (b, a) };
        let facing = if ray[axis] > 0.0 { -1.0 } else { 1.0 };
        if near > enter {
            enter = near;
            entry = [0.0; 3];
            entry[axis] = facing;
        }
        if far < leave {
            leave = far;
            exit = [0.0; 3];
            exit[axis] = facing;
        }
    }
    if enter > leave || leave <= 0.0 {
        None
    } else if enter > 0.0 {
        Some((enter, entry))
    } else {
        Some((leave, exit))
    }
}

fn hit_ball(center: &Point, radius: f32, origin: &Point, ray: &Point) -> Option<(f32, Point)> {
    let from = subtract(origin, center);
    let (a, b, c) = (
        dot(ray, ray),
        dot(&from, ray),
        dot(&from, &from) - radius * radius,
    );
    let under = b * b - a * c;
    if under < 0.0 {
        return None;
    }
    let t = (-b - under.sqrt()) / a;
    (t > 0.0).then(|| {
        let p = std::array::from_fn(|i| (from[i] + t * ray[i]) / radius);
        (t, p)
    })
}

fn hit_capsule(
    a: &Point,
    b: &Point,
    radius: f32,
    origin: &Point,
    ray: &Point,
) -> Option<(f32, Point)> {
    let axis = subtract(b, a);
    let from = subtract(origin, a);
    let (length2, along, start) = (dot(&axis, &axis), dot(&axis, ray), dot(&axis, &from));
    let qa = length2 * dot(ray, ray) - along * along;
    if length2 > 0.0 && qa > 1e-12 {
        let qb = length2 * dot(&from, ray) - start * along;
        let qc = length2 * (dot(&from, &from) - radius * radius) - start * start;
        let under = qb * qb - qa * qc;
        if under < 0.0 {
            return None;
        }
        let t = (-qb - under.sqrt()) / qa;
        let y = start + t * along;
        if t > 0.0 && y > 0.0 && y < length2 {
            let s = y / length2;
            let normal = std::array::from_fn(|i| (from[i] + t * ray[i] - s * axis[i]) / radius);
            return Some((t, normal));
        }
    }
    let (near, far) = (
        hit_ball(a, radius, origin, ray),
        hit_ball(b, radius, origin, ray),
    );
    match (near, far) {
        (Some(x), Some(y)) => Some(if x.0 <= y.0 { x } else { y }),
        (x, y) => x.or(y),
    }
}

/// Renders the room for a camera whose pixel rays are in `table` (two floats per pixel). Returns the depth to the
/// image plane in units of `scale` metres (0 beyond the range of 16 bits), and the colors (red, green, blue), lit by
/// a lamp at the camera.
pub fn render_room(
    shapes: &[Shape],
    view: &Viewpoint,
    table: &[u8],
    scale: f64,
) -> Result<(Vec<u8>, Vec<u8>)> {
    if table.is_empty() || !table.len().is_multiple_of(8) {
        return fail(
            Code::BadCamera,
            "the size of the ray table must be a positive multiple of 8 bytes",
        );
    }
    if !(scale.is_finite() && scale > 0.0) {
        return fail(
            Code::BadOption,
            format!("a depth scale must be a positive number of metres, not {scale}"),
        );
    }
    let pixels = table.len() / 8;
    let mut depth = Vec::with_capacity(pixels * 2);
    let mut rgb = Vec::with_capacity(pixels * 3);
    let rays: Vec<(f32, f32)> = table
        .chunks_exact(8)
        .map(|b| {
            let nx = f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
            (nx, f32::from_le_bytes([b[4], b[5], b[6], b[7]]))
        })
        .collect();
    let mut seen = Vec::with_capacity(shapes.len());
    for strip in rays.chunks(STRIP) {
        seen.clear();
        match Cone::enclosing_rays(strip) {
            Some(cone) => seen.extend(shapes.iter().filter(|s| cone.may_meet(s, view))),
            None => seen.extend(shapes.iter()),
        }
        for (nx, ny) in strip {
            let (value, color) = render_pixel(&seen, view, *nx, *ny, scale);
            depth.extend_from_slice(&value.to_le_bytes());
            rgb.extend_from_slice(&color);
        }
    }
    Ok((depth, rgb))
}

/// The number of neighbouring pixels that share the search for visible shapes.
const STRIP: usize = 32;

/// All directions within an angle of an axis, in the frame of the camera.
struct Cone {
    axis: Point,
    cos: f32,
    sin: f32,
}

impl Cone {
    /// Returns the narrowest cone around the middle ray of a strip that contains all its rays; `None` if a ray is
    /// unknown.
    fn enclosing_rays(strip: &[(f32, f32)]) -> Option<Cone> {
        let units: Vec<Point> = strip.iter().map(|(nx, ny)| unit_ray(nx, ny)).collect();
        let axis = *units.get(units.len() / 2)?;
        let cos = units.iter().map(|u| dot(u, &axis)).fold(1.0, f32::min) - 1e-6;
        if !cos.is_finite() || units.iter().any(|u| !u[0].is_finite()) {
            return None;
        }
        let sin = (1.0 - cos * cos).max(0.0).sqrt();
        Some(Cone { axis, cos, sin })
    }

    /// Returns whether a ray of the cone may meet the shape. The check uses the bounding ball, so it never misses a
    /// shape.
    fn may_meet(&self, shape: &Shape, view: &Viewpoint) -> bool {
        let (center, radius) = shape.bounding_ball();
        let from = subtract(&center, &view.position);
        let axis: Point = std::array::from_fn(|i| dot(&view.rotation[i], &self.axis));
        let along = dot(&from, &axis);
        let across = (dot(&from, &from) - along * along).max(0.0).sqrt();
        across * self.cos - along * self.sin <= radius * 1.001 + 1e-4
    }
}

fn unit_ray(nx: &f32, ny: &f32) -> Point {
    let length = (1.0 + nx * nx + ny * ny).sqrt();
    [1.0 / length, -nx / length, -ny / length]
}

fn render_pixel(
    shapes: &[&Shape],
    view: &Viewpoint,
    nx: f32,
    ny: f32,
    scale: f64,
) -> (u16, [u8; 3]) {
    if !(nx.is_finite() && ny.is_finite()) {
        return (0, [0; 3]);
    }
    // With this direction, a distance of 1 along the ray is a depth of 1 m.
    let local = [1.0, -nx, -ny];
    let ray: Point = std::array::from_fn(|i| dot(&view.rotation[i], &local));
    let inverse = ray.map(|c| 1.0 / c);
    let mut nearest: Option<(f32, &Shape)> = None;
    for shape in shapes {
        if let Some(t) = shape.ray_distance(&view.position, &ray, &inverse) {
            if nearest.is_none_or(|(least, _)| t < least) {
                nearest = Some((t, shape));
            }
        }
    }
    match nearest {
        None => (0, [0; 3]),
        Some((t, shape)) => {
            let (normal, color) = (shape.surface_normal(&view.position, &ray), shape.color());
            let light = (dot(&normal, &ray).abs() / dot(&ray, &ray).sqrt()).clamp(0.0, 1.0);
            let value = (f64::from(t) / scale).round();
            let value = if value <= f64::from(u16::MAX) {
                value as u16
            } else {
                0
            };
            (
                value,
                color.map(|c| (f32::from(c) * (0.35 + 0.65 * light)) as u8),
            )
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEVEL: Viewpoint = Viewpoint {
        position: [0.0, 0.0, 1.0],
        rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    };
    const ROOM: Shape = Shape::Box {
        min: [-1.0, -2.0, 0.0],
        max: [4.0, 2.0, 3.0],
        color: [200, 200, 200],
    };

    fn depth_at(shapes: &[Shape], nx: f32, ny: f32) -> u16 {
        let all: Vec<&Shape> = shapes.iter().collect();
        render_pixel(&all, &LEVEL, nx, ny, 0.001).0
    }

    #[test]
    fn walls_floor_and_objects_have_the_right_depth() {
        assert_eq!(depth_at(&[ROOM], 0.0, 0.0), 4000);
        // The ray down at 45 degrees meets the floor one metre ahead.
        assert_eq!(depth_at(&[ROOM], 0.0, 1.0), 1000);
        // The ray to the right at 45 degrees meets the wall, which is 2 m to the side.
        assert_eq!(depth_at(&[ROOM], 1.0, 0.0), 2000);
        let ball = Shape::Capsule {
            from: [2.0, 0.0, 1.0],
            to: [2.0, 0.0, 1.0],
            radius: 0.5,
            color: [255, 0, 0],
        };
        assert_eq!(depth_at(&[ROOM, ball], 0.0, 0.0), 1500);
        let person = Shape::Capsule {
            from: [2.0, 0.0, 0.2],
            to: [2.0, 0.0, 1.6],
            radius: 0.2,
            color: [0, 0, 255],
        };
        assert_eq!(depth_at(&[ROOM, person], 0.0, 0.0), 1800);
        assert_eq!(
            depth_at(&[ROOM, person], 0.2, 0.0),
            depth_at(&[ROOM], 0.2, 0.0)
        );
    }

    #[test]
    fn rays_without_a_hit_are_black_and_unknown() {
        assert_eq!(render_pixel(&[], &LEVEL, 0.0, 0.0, 0.001), (0, [0; 3]));
        assert_eq!(
            render_pixel(&[&ROOM], &LEVEL, f32::NAN, 0.0, 0.001),
            (0, [0; 3])
        );
        assert!(render_room(&[ROOM], &LEVEL, &[0; 7], 0.001).is_err());
        assert!(render_room(&[ROOM], &LEVEL, &[0; 8], 0.0).is_err());
    }

    #[test]
    fn culling_shapes_for_a_strip_changes_no_pixel() {
        let mut shapes = vec![ROOM];
        for i in 0..40 {
            let at = |k: i32| ((i * k) % 17) as f32 / 17.0;
            let from = [0.5 + 3.0 * at(3), -1.9 + 3.8 * at(5), 2.8 * at(7)];
            shapes.push(Shape::Capsule {
                from,
                to: [from[0] + at(11) - 0.5, from[1] + at(13) - 0.5, from[2]],
                radius: 0.02 + 0.2 * at(2),
                color: [i as u8, 2, 3],
            });
        }
        let mut table = Vec::new();
        for y in 0..60 {
            for x in 0..83 {
                let nx = if x == 7 && y == 9 {
                    f32::NAN
                } else {
                    (x as f32 - 41.0) / 30.0
                };
                table.extend_from_slice(&nx.to_le_bytes());
                table.extend_from_slice(&((y as f32 - 30.0) / 30.0).to_le_bytes());
            }
        }
        let (depth, rgb) = render_room(&shapes, &LEVEL, &table, 0.001).unwrap_or_default();
        let all: Vec<&Shape> = shapes.iter().collect();
        for (i, b) in table.chunks_exact(8).enumerate() {
            let nx = f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
            let ny = f32::from_le_bytes([b[4], b[5], b[6], b[7]]);
            let (value, color) = render_pixel(&all, &LEVEL, nx, ny, 0.001);
            assert_eq!(value.to_le_bytes(), [depth[2 * i], depth[2 * i + 1]]);
            assert_eq!(color, [rgb[3 * i], rgb[3 * i + 1], rgb[3 * i + 2]]);
        }
    }
}

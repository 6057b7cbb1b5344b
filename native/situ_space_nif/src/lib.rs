//! The BEAM bindings of situ_space: they decode, call and encode, and contain no algorithms.
//!
//! Every function runs on a dirty scheduler, because the cost of a cloud depends on its content.

use rustler::{Binary, Encoder, Env, NifTaggedEnum, NifTuple, OwnedBinary, Term};
use situ_space::camera::Camera;
use situ_space::depth::{Depth, Sampling};
use situ_space::error::{fail, Code, Error, Result};
use situ_space::register::ColorImage;
use situ_space::room::{Shape, Viewpoint};
use situ_space::{cloud, normals, plane, register, room};

mod files;

mod atoms {
    rustler::atoms! { ok, error, bad_cloud, bad_depth, bad_camera, bad_option, degenerate, too_large }
}

fn error_atom(code: Code) -> rustler::Atom {
    match code {
        Code::BadCloud => atoms::bad_cloud(),
        Code::BadDepth => atoms::bad_depth(),
        Code::BadCamera => atoms::bad_camera(),
        Code::BadOption => atoms::bad_option(),
        Code::Degenerate => atoms::degenerate(),
        Code::TooLarge => atoms::too_large(),
    }
}

/// Encodes a result as `{:ok, term}` or `{:error, code, what}`.
fn encode_reply<'a>(env: Env<'a>, result: Result<Term<'a>>) -> Term<'a> {
    match result {
        Ok(term) => (atoms::ok(), term).encode(env),
        Err(Error { code, what }) => (atoms::error(), error_atom(code), what).encode(env),
    }
}

/// Encodes bytes as `{:ok, binary}`.
fn encode_binary_reply<'a>(env: Env<'a>, result: Result<Vec<u8>>) -> Term<'a> {
    encode_reply(
        env,
        result.and_then(|bytes| Ok(copy_to_binary(env, &bytes)?.encode(env))),
    )
}

/// Encodes two byte vectors as `{:ok, {binary, binary}}`.
fn encode_binaries_reply<'a>(env: Env<'a>, result: Result<(Vec<u8>, Vec<u8>)>) -> Term<'a> {
    encode_reply(
        env,
        result.and_then(|(a, b)| {
            Ok((copy_to_binary(env, &a)?, copy_to_binary(env, &b)?).encode(env))
        }),
    )
}

/// Encodes points with a number for each as `{:ok, {binary, binary}}`.
fn encode_points_reply<'a>(env: Env<'a>, result: Result<(Vec<u8>, Vec<u32>)>) -> Term<'a> {
    encode_reply(
        env,
        result.and_then(|(p, n)| {
            Ok((copy_to_binary(env, &p)?, encode_numbers(env, &n)?).encode(env))
        }),
    )
}

/// Copies bytes to a binary. Returns an error if no memory is left, where `OwnedBinary::new` would abort the VM.
fn copy_to_binary<'a>(env: Env<'a>, bytes: &[u8]) -> Result<Binary<'a>> {
    let mut owned = OwnedBinary::new(0);
    if !owned.realloc(bytes.len()) {
        return fail(
            Code::TooLarge,
            format!("no memory for {} bytes", bytes.len()),
        );
    }
    owned.as_mut_slice().copy_from_slice(bytes);
    Ok(owned.release(env))
}

fn encode_numbers<'a>(env: Env<'a>, values: &[u32]) -> Result<Binary<'a>> {
    let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    copy_to_binary(env, &bytes)
}

/// A camera: `{width, height, focal, principal, radial, tangential, distorts?}`.
#[derive(NifTuple)]
struct CameraTerm {
    width: u32,
    height: u32,
    focal: (f64, f64),
    principal: (f64, f64),
    radial: (f64, f64, f64, f64, f64, f64),
    tangential: (f64, f64),
    distorts: bool,
}

impl From<CameraTerm> for Camera {
    fn from(c: CameraTerm) -> Camera {
        let (k1, k2, k3, k4, k5, k6) = c.radial;
        Camera {
            width: c.width as usize,
            height: c.height as usize,
            focal: c.focal,
            principal: c.principal,
            radial: [k1, k2, k3, k4, k5, k6],
            tangential: c.tangential,
            distorts: c.distorts,
        }
    }
}

/// A depth image: `{width, height, stride, data, scale, along_ray?}`.
#[derive(NifTuple)]
struct DepthTerm<'a> {
    width: u32,
    height: u32,
    stride: u32,
    data: Binary<'a>,
    scale: f64,
    along_ray: bool,
}

impl<'a> DepthTerm<'a> {
    fn view(&self) -> Result<Depth<'_>> {
        let shape = (
            self.width as usize,
            self.height as usize,
            self.stride as usize,
        );
        Depth::new(shape, self.data.as_slice(), self.scale, self.along_ray)
    }
}

type Vector = (f64, f64, f64);
/// The rows of a rotation matrix.
type Rotation = (Vector, Vector, Vector);

fn to_f64_array((x, y, z): Vector) -> [f64; 3] {
    [x, y, z]
}

fn to_f64_rows((a, b, c): Rotation) -> [[f64; 3]; 3] {
    [a, b, c].map(to_f64_array)
}

fn to_f32_array((x, y, z): Vector) -> [f32; 3] {
    [x as f32, y as f32, z as f32]
}

#[rustler::nif(schedule = "DirtyCpu")]
fn ray_table<'a>(env: Env<'a>, camera: CameraTerm, undistort: bool) -> Term<'a> {
    let table = Camera::from(camera).ray_table(undistort).and_then(|rays| {
        let bytes: Vec<u8> = rays
            .iter()
            .flatten()
            .flat_map(|c| c.to_le_bytes())
            .collect();
        Ok(copy_to_binary(env, &bytes)?.encode(env))
    });
    encode_reply(env, table)
}

#[rustler::nif(schedule = "DirtyCpu")]
fn depth_cloud<'a>(
    env: Env<'a>,
    depth: DepthTerm<'a>,
    table: Binary<'a>,
    sparsity: u32,
    robust: bool,
    colors: Binary<'a>,
) -> Term<'a> {
    let sampling = Sampling {
        sparsity: sparsity as usize,
        robust,
    };
    let points = depth
        .view()
        .and_then(|d| d.build_cloud(table.as_slice(), sampling, colors.as_slice()));
    encode_binaries_reply(env, points)
}

#[rustler::nif(schedule = "DirtyCpu")]
fn depth_mesh<'a>(
    env: Env<'a>,
    depth: DepthTerm<'a>,
    table: Binary<'a>,
    edge: f64,
    sparsity: u32,
) -> Term<'a> {
    let mesh = depth
        .view()
        .and_then(|d| d.build_mesh(table.as_slice(), edge, sparsity as usize));
    encode_binaries_reply(env, mesh)
}

/// Finds the colors of depth pixels. The image is `{camera, pixels, rotation, position}`, with the rotation and
/// position of the depth camera in the frame of its camera.
#[rustler::nif(schedule = "DirtyCpu")]
fn depth_colors<'a>(
    env: Env<'a>,
    depth: DepthTerm<'a>,
    table: Binary<'a>,
    (camera, pixels, rotation, position): (CameraTerm, Binary<'a>, Rotation, Vector),
) -> Term<'a> {
    let image = ColorImage {
        camera: camera.into(),
        pixels: pixels.as_slice(),
        rotation: to_f64_rows(rotation),
        position: to_f64_array(position),
    };
    let colors = depth
        .view()
        .and_then(|d| register::register_colors(&d, table.as_slice(), &image));
    encode_binary_reply(env, colors)
}

#[rustler::nif(schedule = "DirtyCpu")]
fn downsample<'a>(env: Env<'a>, points: Binary<'a>, size: f64) -> Term<'a> {
    let result = cloud::downsample(points.as_slice(), size);
    encode_points_reply(env, result)
}

#[rustler::nif(schedule = "DirtyCpu")]
fn thin<'a>(env: Env<'a>, records: Binary<'a>, size: u32, most: u32) -> Term<'a> {
    let result = cloud::thin_records(records.as_slice(), size as usize, most as usize);
    encode_binary_reply(env, result)
}

#[rustler::nif(schedule = "DirtyCpu")]
fn within<'a>(
    env: Env<'a>,
    points: Binary<'a>,
    colors: Binary<'a>,
    values: Binary<'a>,
    planes: Vec<(f64, f64, f64, f64)>,
    most: u32,
) -> Term<'a> {
    let planes: Vec<[f32; 4]> = planes
        .iter()
        .map(|&(a, b, c, d)| [a as f32, b as f32, c as f32, d as f32])
        .collect();
    let extras = [(colors.as_slice(), 3), (values.as_slice(), 4)];
    let found = cloud::clip_by_planes(points.as_slice(), &extras, &planes, most as usize);
    encode_reply(
        env,
        found.and_then(|(p, more, n)| {
            let colors = copy_to_binary(env, &more[0])?;
            let values = copy_to_binary(env, &more[1])?;
            Ok((copy_to_binary(env, &p)?, colors, values, n as u64).encode(env))
        }),
    )
}

#[rustler::nif(schedule = "DirtyCpu")]
fn clusters<'a>(env: Env<'a>, points: Binary<'a>, radius: f64, least: u32) -> Term<'a> {
    let result = cloud::find_clusters(points.as_slice(), radius, least as usize);
    encode_reply(
        env,
        result.and_then(|n| Ok(encode_numbers(env, &n)?.encode(env))),
    )
}

#[rustler::nif(schedule = "DirtyCpu")]
fn clip<'a>(env: Env<'a>, points: Binary<'a>, min: Vector, max: Vector) -> Term<'a> {
    let result = cloud::clip_to_box(points.as_slice(), to_f64_array(min), to_f64_array(max));
    encode_points_reply(env, result)
}

#[rustler::nif(schedule = "DirtyCpu")]
fn transform<'a>(
    env: Env<'a>,
    points: Binary<'a>,
    rotation: Rotation,
    position: Vector,
) -> Term<'a> {
    let rows = to_f64_rows(rotation);
    let result = cloud::transform_points(points.as_slice(), rows, to_f64_array(position));
    encode_binary_reply(env, result)
}

#[rustler::nif(schedule = "DirtyCpu")]
fn plane<'a>(env: Env<'a>, points: Binary<'a>, tolerance: f64, rounds: u32, seed: u64) -> Term<'a> {
    let result = plane::find_plane(points.as_slice(), tolerance, rounds, seed).and_then(|found| {
        let [x, y, z] = found.normal;
        let inliers = encode_numbers(env, &found.inliers)?;
        Ok(((x, y, z), found.offset, inliers).encode(env))
    });
    encode_reply(env, result)
}

#[rustler::nif(schedule = "DirtyCpu")]
fn normals<'a>(env: Env<'a>, points: Binary<'a>, radius: f64, viewpoint: Vector) -> Term<'a> {
    let result = normals::estimate_normals(points.as_slice(), radius, to_f64_array(viewpoint));
    encode_binaries_reply(env, result)
}

/// A shape: `{:box, min, max, color}` or `{:capsule, from, to, radius, color}`.
#[derive(NifTaggedEnum)]
enum ShapeTerm {
    Box(Vector, Vector, (u8, u8, u8)),
    Capsule(Vector, Vector, f64, (u8, u8, u8)),
}

impl From<ShapeTerm> for Shape {
    fn from(shape: ShapeTerm) -> Shape {
        match shape {
            ShapeTerm::Box(min, max, color) => Shape::Box {
                min: to_f32_array(min),
                max: to_f32_array(max),
                color: color.into(),
            },
            ShapeTerm::Capsule(from, to, radius, color) => Shape::Capsule {
                from: to_f32_array(from),
                to: to_f32_array(to),
                radius: radius as f32,
                color: color.into(),
            },
        }
    }
}

#[rustler::nif(schedule = "DirtyCpu")]
fn render<'a>(
    env: Env<'a>,
    shapes: Vec<ShapeTerm>,
    position: Vector,
    rotation: Rotation,
    table: Binary<'a>,
    scale: f64,
) -> Term<'a> {
    let shapes: Vec<Shape> = shapes.into_iter().map(Shape::from).collect();
    let view = Viewpoint {
        position: to_f32_array(position),
        rotation: [
            to_f32_array(rotation.0),
            to_f32_array(rotation.1),
            to_f32_array(rotation.2),
        ],
    };
    let result = room::render_room(&shapes, &view, table.as_slice(), scale);
    encode_binaries_reply(env, result)
}

rustler::init!("Elixir.Situ.Space.Native");

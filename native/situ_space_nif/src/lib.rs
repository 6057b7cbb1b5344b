//! BEAM glue of situ_space: decode, call, encode. No algorithms here.
//!
//! Every function runs on a dirty scheduler: what a cloud costs depends on its content.

use rustler::{Binary, Encoder, Env, NifTaggedEnum, NifTuple, OwnedBinary, Term};
use situ_space::camera::Camera;
use situ_space::depth::{Depth, Sampling};
use situ_space::error::{fail, Code, Error, Result};
use situ_space::register::Colored;
use situ_space::room::{Shape, Viewpoint};
use situ_space::{cloud, normals, plane, register, room};

mod files;

mod atoms {
    rustler::atoms! { ok, error, bad_cloud, bad_depth, bad_camera, bad_option, degenerate, too_large }
}

fn atom(code: Code) -> rustler::Atom {
    match code {
        Code::BadCloud => atoms::bad_cloud(),
        Code::BadDepth => atoms::bad_depth(),
        Code::BadCamera => atoms::bad_camera(),
        Code::BadOption => atoms::bad_option(),
        Code::Degenerate => atoms::degenerate(),
        Code::TooLarge => atoms::too_large(),
    }
}

/// `{:ok, term}` or `{:error, code, what}`.
fn reply<'a>(env: Env<'a>, result: Result<Term<'a>>) -> Term<'a> {
    match result {
        Ok(term) => (atoms::ok(), term).encode(env),
        Err(Error { code, what }) => (atoms::error(), atom(code), what).encode(env),
    }
}

/// Memory of the BEAM; an error when there is none left (`OwnedBinary::new` would abort the VM).
fn binary<'a>(env: Env<'a>, bytes: &[u8]) -> Result<Binary<'a>> {
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

fn numbers<'a>(env: Env<'a>, values: &[u32]) -> Result<Binary<'a>> {
    let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    binary(env, &bytes)
}

/// `{width, height, focal, principal, radial, tangential, distorts?}`.
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

/// `{width, height, stride, data, scale, along_ray?}`.
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

type Row = (f64, f64, f64);

fn row((x, y, z): Row) -> [f64; 3] {
    [x, y, z]
}

fn single((x, y, z): Row) -> [f32; 3] {
    [x as f32, y as f32, z as f32]
}

#[rustler::nif(schedule = "DirtyCpu")]
fn ray_table<'a>(env: Env<'a>, camera: CameraTerm, undistort: bool) -> Term<'a> {
    let table = Camera::from(camera).table(undistort).and_then(|rays| {
        let bytes: Vec<u8> = rays
            .iter()
            .flatten()
            .flat_map(|c| c.to_le_bytes())
            .collect();
        Ok(binary(env, &bytes)?.encode(env))
    });
    reply(env, table)
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
        .and_then(|d| d.cloud(table.as_slice(), sampling, colors.as_slice()));
    reply(
        env,
        points.and_then(|(p, c)| Ok((binary(env, &p)?, binary(env, &c)?).encode(env))),
    )
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
        .and_then(|d| d.mesh(table.as_slice(), edge, sparsity as usize));
    reply(
        env,
        mesh.and_then(|(v, i)| Ok((binary(env, &v)?, binary(env, &i)?).encode(env))),
    )
}

/// `picture` is `{camera, pixels, rotation, position}`, its rotation and position of the depth camera in its frame.
#[rustler::nif(schedule = "DirtyCpu")]
fn depth_colors<'a>(
    env: Env<'a>,
    depth: DepthTerm<'a>,
    table: Binary<'a>,
    (camera, pixels, rotation, position): (CameraTerm, Binary<'a>, (Row, Row, Row), Row),
) -> Term<'a> {
    let picture = Colored {
        camera: camera.into(),
        pixels: pixels.as_slice(),
        rotation: [row(rotation.0), row(rotation.1), row(rotation.2)],
        position: row(position),
    };
    let colors = depth
        .view()
        .and_then(|d| register::colors(&d, table.as_slice(), &picture));
    reply(env, colors.and_then(|c| Ok(binary(env, &c)?.encode(env))))
}

#[rustler::nif(schedule = "DirtyCpu")]
fn downsample<'a>(env: Env<'a>, points: Binary<'a>, size: f64) -> Term<'a> {
    let result = cloud::downsample(points.as_slice(), size);
    reply(
        env,
        result.and_then(|(p, n)| Ok((binary(env, &p)?, numbers(env, &n)?).encode(env))),
    )
}

#[rustler::nif(schedule = "DirtyCpu")]
fn thin<'a>(env: Env<'a>, records: Binary<'a>, size: u32, most: u32) -> Term<'a> {
    let result = cloud::thin(records.as_slice(), size as usize, most as usize);
    reply(env, result.and_then(|r| Ok(binary(env, &r)?.encode(env))))
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
    let found = cloud::within(points.as_slice(), &extras, &planes, most as usize);
    reply(
        env,
        found.and_then(|(p, more, n)| {
            let (colors, values) = (binary(env, &more[0])?, binary(env, &more[1])?);
            Ok((binary(env, &p)?, colors, values, n as u64).encode(env))
        }),
    )
}

#[rustler::nif(schedule = "DirtyCpu")]
fn clusters<'a>(env: Env<'a>, points: Binary<'a>, radius: f64, least: u32) -> Term<'a> {
    let result = cloud::clusters(points.as_slice(), radius, least as usize);
    reply(env, result.and_then(|n| Ok(numbers(env, &n)?.encode(env))))
}

#[rustler::nif(schedule = "DirtyCpu")]
fn clip<'a>(env: Env<'a>, points: Binary<'a>, min: Row, max: Row) -> Term<'a> {
    let result = cloud::clip(points.as_slice(), row(min), row(max));
    reply(
        env,
        result.and_then(|(p, n)| Ok((binary(env, &p)?, numbers(env, &n)?).encode(env))),
    )
}

#[rustler::nif(schedule = "DirtyCpu")]
fn transform<'a>(
    env: Env<'a>,
    points: Binary<'a>,
    rotation: (Row, Row, Row),
    position: Row,
) -> Term<'a> {
    let rows = [row(rotation.0), row(rotation.1), row(rotation.2)];
    let result = cloud::transform(points.as_slice(), rows, row(position));
    reply(env, result.and_then(|p| Ok(binary(env, &p)?.encode(env))))
}

#[rustler::nif(schedule = "DirtyCpu")]
fn plane<'a>(env: Env<'a>, points: Binary<'a>, tolerance: f64, rounds: u32, seed: u64) -> Term<'a> {
    let result = plane::ransac(points.as_slice(), tolerance, rounds, seed).and_then(|found| {
        let [x, y, z] = found.normal;
        Ok(((x, y, z), found.offset, numbers(env, &found.inliers)?).encode(env))
    });
    reply(env, result)
}

#[rustler::nif(schedule = "DirtyCpu")]
fn normals<'a>(env: Env<'a>, points: Binary<'a>, radius: f64, viewpoint: Row) -> Term<'a> {
    let result = normals::normals(points.as_slice(), radius, row(viewpoint));
    reply(
        env,
        result.and_then(|(n, c)| Ok((binary(env, &n)?, binary(env, &c)?).encode(env))),
    )
}

/// `{:box, min, max, color}` or `{:capsule, from, to, radius, color}`.
#[derive(NifTaggedEnum)]
enum ShapeTerm {
    Box(Row, Row, (u8, u8, u8)),
    Capsule(Row, Row, f64, (u8, u8, u8)),
}

impl From<ShapeTerm> for Shape {
    fn from(shape: ShapeTerm) -> Shape {
        match shape {
            ShapeTerm::Box(min, max, color) => Shape::Box {
                min: single(min),
                max: single(max),
                color: color.into(),
            },
            ShapeTerm::Capsule(from, to, radius, color) => Shape::Capsule {
                from: single(from),
                to: single(to),
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
    position: Row,
    rotation: (Row, Row, Row),
    table: Binary<'a>,
    scale: f64,
) -> Term<'a> {
    let shapes: Vec<Shape> = shapes.into_iter().map(Shape::from).collect();
    let view = Viewpoint {
        position: single(position),
        rotation: [single(rotation.0), single(rotation.1), single(rotation.2)],
    };
    let result = room::render(&shapes, &view, table.as_slice(), scale);
    reply(
        env,
        result.and_then(|(d, rgb)| Ok((binary(env, &d)?, binary(env, &rgb)?).encode(env))),
    )
}

rustler::init!("Elixir.Situ.Space.Native");

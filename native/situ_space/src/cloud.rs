//! Downsampling, selecting, clustering and transforming point clouds.

use crate::error::{fail, Code, Result};
use crate::grid::{check_length, encode_points, find_cell, parse_points, Cell, Grid, Point};
use rustc_hash::FxHashMap as HashMap;

/// Returns one point for every cell of `size` metres: the mean of the points inside, in the order in which the cells
/// first occurred, with their number of points.
pub fn downsample(cloud: &[u8], size: f64) -> Result<(Vec<u8>, Vec<u32>)> {
    let size = check_length(size, "the size of a voxel")?;
    let points = parse_points(cloud)?;
    let mut indices = CellIndices::default();
    let mut sums: Vec<([f64; 3], u32)> = Vec::new();
    // Consecutive points in a cloud are mostly neighbours in space.
    let mut last: Option<(Cell, usize)> = None;
    for point in &points {
        let cell = find_cell(point, size);
        let index = match last {
            Some((same, index)) if same == cell => index,
            _ => indices.index_of(cell, sums.len()),
        };
        last = Some((cell, index));
        if index == sums.len() {
            sums.push(([0.0; 3], 0));
        }
        let (sum, count) = &mut sums[index];
        for (s, c) in sum.iter_mut().zip(point) {
            *s += f64::from(*c);
        }
        *count += 1;
    }
    let means = sums
        .iter()
        .map(|(sum, count)| sum.map(|s| (s / f64::from(*count)) as f32));
    Ok((
        encode_points(means),
        sums.iter().map(|(_, count)| *count).collect(),
    ))
}

/// The index of each cell. A cell within a million cells of the origin is packed into one number, which is faster to
/// look up.
#[derive(Default)]
struct CellIndices {
    near: HashMap<u64, usize>,
    far: HashMap<Cell, usize>,
}

impl CellIndices {
    /// Returns the index of the cell, which becomes `next` if the cell is new.
    fn index_of(&mut self, cell: Cell, next: usize) -> usize {
        const HALF: i64 = 1 << 20;
        if cell.iter().all(|c| (-HALF..HALF).contains(c)) {
            let [x, y, z] = cell.map(|c| (c + HALF) as u64);
            *self.near.entry(x << 42 | y << 21 | z).or_insert(next)
        } else {
            *self.far.entry(cell).or_insert(next)
        }
    }
}

/// The selected points, the selected bytes of each extra, and the number of points found.
pub type Selection = (Vec<u8>, Vec<Vec<u8>>, usize);

/// Returns the points in front of all planes `(a, b, c, d)`, where `ax + by + cz + d >= 0`. At most `most` points are
/// returned, evenly spaced by index and in their order, with their `extras` and the number of points found. Each
/// extra has a fixed number of bytes per point, or is empty. Points that are not finite are skipped.
pub fn clip_by_planes(
    cloud: &[u8],
    extras: &[(&[u8], usize)],
    planes: &[[f32; 4]],
    most: usize,
) -> Result<Selection> {
    let count = cloud.len() / 12;
    let fits = |(bytes, size): &(&[u8], usize)| bytes.is_empty() || bytes.len() == count * size;
    if !cloud.len().is_multiple_of(12) || !extras.iter().all(fits) {
        return fail(
            Code::BadCloud,
            format!(
                "{} bytes of points and {} bytes of extras are not a cloud",
                cloud.len(),
                extras.iter().map(|e| e.0.len()).sum::<usize>()
            ),
        );
    }
    if count > u32::MAX as usize {
        return fail(
            Code::TooLarge,
            format!("{count} points do not have 32-bit indices"),
        );
    }
    let at = |i: usize, k: usize| -> f32 {
        let from = i * 12 + k * 4;
        cloud
            .get(from..from + 4)
            .and_then(|b| b.try_into().ok())
            .map_or(f32::NAN, f32::from_le_bytes)
    };
    let found: Vec<u32> = (0..count)
        .filter(|&i| {
            let (x, y, z) = (at(i, 0), at(i, 1), at(i, 2));
            (x + y + z).is_finite()
                && planes
                    .iter()
                    .all(|[a, b, c, d]| a * x + b * y + c * z + d >= 0.0)
        })
        .map(|i| i as u32)
        .collect();
    let kept = found.len().min(most);
    let mut points = Vec::with_capacity(kept * 12);
    let mut more = vec![Vec::new(); extras.len()];
    for i in 0..kept {
        let nth = (i as u64 * found.len() as u64 / kept as u64) as usize;
        let from = found.get(nth).map_or(0, |&n| n as usize);
        points.extend_from_slice(cloud.get(from * 12..from * 12 + 12).unwrap_or_default());
        for (out, (bytes, size)) in more.iter_mut().zip(extras) {
            out.extend_from_slice(
                bytes
                    .get(from * size..from * size + size)
                    .unwrap_or_default(),
            );
        }
    }
    Ok((points, more, found.len()))
}

/// Returns at most `most` of the records of `size` bytes, evenly spaced by index.
pub fn thin_records(records: &[u8], size: usize, most: usize) -> Result<Vec<u8>> {
    if size == 0 || most == 0 || !records.len().is_multiple_of(size) {
        return fail(
            Code::BadOption,
            format!(
                "cannot reduce {} bytes of records of {size} bytes to {most}",
                records.len()
            ),
        );
    }
    let count = records.len() / size;
    if count <= most {
        return Ok(records.to_vec());
    }
    let mut kept = Vec::with_capacity(most * size);
    for i in 0..most {
        // The product of two lengths in memory fits in 64 bits.
        let at = (i as u64 * count as u64 / most as u64) as usize * size;
        kept.extend_from_slice(records.get(at..at + size).unwrap_or_default());
    }
    Ok(kept)
}

/// Returns the cluster number of every point. Points closer than `radius` metres belong to the same cluster. Clusters
/// of fewer than `least` points are discarded (`u32::MAX`); the others are numbered by decreasing size, ties by their
/// first point.
pub fn find_clusters(cloud: &[u8], radius: f64, least: usize) -> Result<Vec<u32>> {
    let radius = check_length(radius, "the radius")?;
    let points = parse_points(cloud)?;
    if points.len() >= u32::MAX as usize {
        return fail(
            Code::TooLarge,
            format!("{} points do not have 32-bit indices", points.len()),
        );
    }
    let grid = Grid::new(&points, radius);
    let mut group = vec![u32::MAX; points.len()];
    let mut sizes: Vec<usize> = Vec::new();
    for start in 0..points.len() {
        if group[start] != u32::MAX {
            continue;
        }
        let number = sizes.len() as u32;
        sizes.push(flood_cluster(&grid, &points, start, number, &mut group));
    }
    let mut order: Vec<usize> = (0..sizes.len()).filter(|&i| sizes[i] >= least).collect();
    order.sort_by_key(|&i| (std::cmp::Reverse(sizes[i]), i));
    let mut names = vec![u32::MAX; sizes.len()];
    for (name, &i) in order.iter().enumerate() {
        names[i] = name as u32;
    }
    Ok(group.iter().map(|&g| names[g as usize]).collect())
}

fn flood_cluster(
    grid: &Grid,
    points: &[Point],
    start: usize,
    number: u32,
    group: &mut [u32],
) -> usize {
    let mut open = vec![start];
    group[start] = number;
    let mut size = 0;
    while let Some(i) = open.pop() {
        size += 1;
        grid.visit_near(&points[i], |j| {
            if group[j] == u32::MAX {
                group[j] = number;
                open.push(j);
            }
        });
    }
    size
}

/// Returns the points within `min..=max` in their order, and their indices in the cloud.
pub fn clip_to_box(cloud: &[u8], min: [f64; 3], max: [f64; 3]) -> Result<(Vec<u8>, Vec<u32>)> {
    let points = parse_points(cloud)?;
    let inside = |p: &Point| (0..3).all(|i| f64::from(p[i]) >= min[i] && f64::from(p[i]) <= max[i]);
    let kept: Vec<usize> = (0..points.len()).filter(|&i| inside(&points[i])).collect();
    let indices = kept.iter().map(|&i| i as u32).collect();
    Ok((encode_points(kept.into_iter().map(|i| points[i])), indices))
}

/// Applies a rotation (the rows of a matrix) and a translation to every point.
pub fn transform_points(
    cloud: &[u8],
    rotation: [[f64; 3]; 3],
    move_by: [f64; 3],
) -> Result<Vec<u8>> {
    let moved = parse_points(cloud)?.into_iter().map(|p| {
        let p = p.map(f64::from);
        let mut out = [0.0f32; 3];
        for (o, (row, d)) in out.iter_mut().zip(rotation.iter().zip(move_by)) {
            *o = (row[0] * p[0] + row[1] * p[1] + row[2] * p[2] + d) as f32;
        }
        out
    });
    Ok(encode_points(moved))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_are_thinned_evenly() {
        let records: Vec<u8> = (0..10).collect();
        assert_eq!(thin_records(&records, 1, 4), Ok(vec![0, 2, 5, 7]));
        assert_eq!(thin_records(&records, 2, 2), Ok(vec![0, 1, 4, 5]));
        assert_eq!(thin_records(&records, 2, 9), Ok(records.clone()));
        assert_eq!(thin_records(&[], 12, 9), Ok(vec![]));
        assert!(thin_records(&records, 3, 9).is_err());
        assert!(thin_records(&records, 0, 9).is_err());
        assert!(thin_records(&records, 1, 0).is_err());
    }

    #[test]
    fn a_voxel_contains_the_mean_of_its_points() -> Result<()> {
        let cloud = encode_points([
            [0.1, 0.1, 0.1],
            [5.0, 0.0, 0.0],
            [0.3, 0.1, 0.1],
            [-0.1, 0.0, 0.0],
        ]);
        let (means, counts) = downsample(&cloud, 1.0)?;
        assert_eq!(counts, [2, 1, 1]);
        let first = parse_points(&means)?[0];
        assert!((first[0] - 0.2).abs() < 1e-6 && (first[1] - 0.1).abs() < 1e-6);
        Ok(())
    }

    #[test]
    fn cells_far_from_the_origin_work_like_near_ones() -> Result<()> {
        let far = 3.0e6_f32;
        let cloud = encode_points([
            [far, 0.0, 0.0],
            [0.2, 0.0, 0.0],
            [far, 0.25, 0.0],
            [-far, 0.0, 0.0],
            [0.4, 0.0, 0.0],
        ]);
        let (means, counts) = downsample(&cloud, 1.0)?;
        assert_eq!(counts, [2, 2, 1]);
        assert_eq!(parse_points(&means)?[0][0], far);
        Ok(())
    }

    #[test]
    fn points_in_front_of_planes_keep_their_order_and_colors() -> Result<()> {
        let row: Vec<[f32; 3]> = (0..10).map(|i| [i as f32, 0.0, 0.0]).collect();
        let cloud = encode_points(row.into_iter().chain([[f32::NAN, 0.0, 0.0]]));
        let colors: Vec<u8> = (0..33).collect();
        // x from 2 to 7
        let planes = [[1.0, 0.0, 0.0, -2.0], [-1.0, 0.0, 0.0, 7.0]];
        let extras = [(&colors[..], 3), (&colors[..22], 2), (&[][..], 4)];
        let (some, more, all) = clip_by_planes(&cloud, &extras, &planes, 3)?;
        assert_eq!(all, 6);
        let some: Vec<f32> = parse_points(&some)?.iter().map(|p| p[0]).collect();
        assert_eq!(some, [2.0, 4.0, 6.0]);
        assert_eq!(more[0], [6, 7, 8, 12, 13, 14, 18, 19, 20]);
        assert_eq!(
            (&more[1][..], more[2].len()),
            (&[4, 5, 8, 9, 12, 13][..], 0)
        );
        assert_eq!(clip_by_planes(&cloud, &[], &planes, 100)?.0.len(), 6 * 12);
        assert_eq!(clip_by_planes(&[], &[], &planes, 5)?.2, 0);
        assert!(clip_by_planes(&cloud, &[(&[1], 3)], &planes, 5).is_err());
        assert!(clip_by_planes(&[1], &[], &planes, 5).is_err());
        Ok(())
    }

    #[test]
    fn points_that_touch_are_one_cluster() -> Result<()> {
        let line = (0..10).map(|i| [i as f32 * 0.1, 0.0, 0.0]);
        let far = (0..3).map(|i| [5.0, i as f32 * 0.1, 0.0]);
        let cloud = encode_points(far.chain(line).chain([[9.0, 9.0, 9.0]]));
        let named = find_clusters(&cloud, 0.15, 2)?;
        assert_eq!(named[..3], [1, 1, 1]);
        assert_eq!(named[3..13], [0; 10]);
        assert_eq!(named[13], u32::MAX);
        Ok(())
    }

    #[test]
    fn invalid_clouds_and_lengths_are_rejected() {
        assert!(downsample(&[0; 13], 1.0).is_err());
        assert!(downsample(&encode_points([[f32::NAN, 0.0, 0.0]]), 1.0).is_err());
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(downsample(&[], bad).is_err());
            assert!(find_clusters(&[], bad, 1).is_err());
        }
        assert_eq!(downsample(&[], 1.0).map(|(b, _)| b.len()), Ok(0));
    }

    #[test]
    fn clipping_keeps_the_order_and_returns_the_indices() -> Result<()> {
        let cloud = encode_points([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.5, 0.5, 0.5]]);
        let (kept, indices) = clip_to_box(&cloud, [-1.0; 3], [1.0; 3])?;
        assert_eq!((kept.len() / 12, indices), (2, vec![0, 2]));
        Ok(())
    }
}

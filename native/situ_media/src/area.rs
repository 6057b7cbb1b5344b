//! Resizing by area: every pixel of the result is the mean of the pixels it covers, weighted by the covered share.

use crate::image::{Format, Shape, View};

/// The pixels that a column (or row) of the result covers: the first one, and the share of each from there on.
struct Cover {
    first: usize,
    shares: Vec<f32>,
}

fn compute_covers(from: usize, to: usize) -> Vec<Cover> {
    let step = from as f64 / to as f64;
    (0..to)
        .map(|i| {
            let (low, high) = (i as f64 * step, ((i + 1) as f64 * step).min(from as f64));
            let first = (low as usize).min(from - 1);
            let last = (high.ceil() as usize).clamp(first + 1, from);
            let share = |x: usize| ((x + 1) as f64).min(high) - (x as f64).max(low);
            let shares = (first..last).map(|x| (share(x) / step) as f32).collect();
            Cover { first, shares }
        })
        .collect()
}

/// Resizes `src` to `shape` (of the same format) into `out`.
pub fn resize_by_area(src: &View, shape: Shape, out: &mut [u8]) {
    let format = src.shape.format;
    let channels = format.channel_count();
    let columns = compute_covers(src.shape.width, shape.width);
    let rows = compute_covers(src.shape.height, shape.height);
    let alpha = format.has_alpha().then_some(channels - 1);
    let mut line = vec![0.0_f32; src.shape.width * channels];
    let mut narrow = vec![0.0_f32; shape.width * channels];
    // A row that contributes to two rows of the result is needed twice.
    let mut narrowed = None;
    let mut sums = vec![0.0_f32; shape.width * channels];
    for (cover, target) in rows.iter().zip(out.chunks_exact_mut(shape.row_bytes())) {
        sums.fill(0.0);
        for (i, share) in cover.shares.iter().enumerate() {
            let y = cover.first + i;
            if narrowed != Some(y) {
                load_row(src.row(y), format, alpha, channels, &mut line);
                shrink_row(&line, &columns, channels, &mut narrow);
                narrowed = Some(y);
            }
            for (sum, value) in sums.iter_mut().zip(&narrow) {
                *sum += value * share;
            }
        }
        store_row(&sums, format, alpha, channels, target);
    }
}

/// Loads a row as floats, with colors multiplied by alpha.
fn load_row(row: &[u8], format: Format, alpha: Option<usize>, channels: usize, line: &mut [f32]) {
    if format.bytes_per_channel() == 2 {
        for (value, bytes) in line.iter_mut().zip(row.chunks_exact(2)) {
            *value = f32::from(u16::from_le_bytes([bytes[0], bytes[1]]));
        }
    } else {
        for (value, byte) in line.iter_mut().zip(row) {
            *value = f32::from(*byte);
        }
    }
    if let Some(alpha) = alpha {
        for pixel in line.chunks_exact_mut(channels) {
            let weight = pixel[alpha];
            for value in &mut pixel[..alpha] {
                *value *= weight;
            }
        }
    }
}

fn shrink_row(line: &[f32], columns: &[Cover], channels: usize, narrow: &mut [f32]) {
    for (cover, pixel) in columns.iter().zip(narrow.chunks_exact_mut(channels)) {
        pixel.fill(0.0);
        let from = line[cover.first * channels..].chunks_exact(channels);
        for (share, source) in cover.shares.iter().zip(from) {
            for (sum, value) in pixel.iter_mut().zip(source) {
                *sum += value * share;
            }
        }
    }
}

fn store_row(
    sums: &[f32],
    format: Format,
    alpha: Option<usize>,
    channels: usize,
    target: &mut [u8],
) {
    let value = |sums: &[f32], c: usize| match alpha {
        Some(alpha) if c != alpha && sums[alpha] > 0.0 => sums[c] / sums[alpha],
        Some(alpha) if c != alpha => 0.0,
        _ => sums[c],
    };
    let size = format.bytes_per_channel();
    let pixels = sums.chunks_exact(channels);
    for (sums, pixel) in pixels.zip(target.chunks_exact_mut(channels * size)) {
        for (c, bytes) in pixel.chunks_exact_mut(size).enumerate() {
            // Casts saturate.
            let rounded = value(sums, c) + 0.5;
            if size == 2 {
                bytes.copy_from_slice(&(rounded as u16).to_le_bytes());
            } else {
                bytes[0] = rounded as u8;
            }
        }
    }
}

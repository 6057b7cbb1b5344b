//! Colour put onto pixels, as much of each as is covered.

use crate::picture::Shape;

/// Pixels from (left, top) to before (right, bottom); may be empty or lie outside of the picture.
#[derive(Clone, Copy)]
pub struct Area {
    pub left: i64,
    pub top: i64,
    pub right: i64,
    pub bottom: i64,
}

impl Area {
    /// All of a picture.
    pub fn of(shape: Shape) -> Area {
        Area {
            left: 0,
            top: 0,
            right: shape.width as i64,
            bottom: shape.height as i64,
        }
    }

    pub fn is_empty(&self) -> bool {
        self.left >= self.right || self.top >= self.bottom
    }

    pub fn common(self, other: Area) -> Area {
        Area {
            left: self.left.max(other.left),
            top: self.top.max(other.top),
            right: self.right.min(other.right),
            bottom: self.bottom.min(other.bottom),
        }
    }

    pub fn around(self, other: Area) -> Area {
        Area {
            left: self.left.min(other.left),
            top: self.top.min(other.top),
            right: self.right.max(other.right),
            bottom: self.bottom.max(other.bottom),
        }
    }

    pub fn grown(self, by: i64) -> Area {
        Area {
            left: self.left.saturating_sub(by),
            top: self.top.saturating_sub(by),
            right: self.right.saturating_add(by),
            bottom: self.bottom.saturating_add(by),
        }
    }

    pub fn width(&self) -> usize {
        (self.right - self.left).max(0) as usize
    }

    pub fn height(&self) -> usize {
        (self.bottom - self.top).max(0) as usize
    }
}

/// From `old` towards `new` by `cover` of 255.
pub fn mix(old: u32, new: u32, cover: u32) -> u32 {
    (old * (255 - cover) + new * cover + 127) / 255
}

/// Colours the pixels of `area`, which lies inside of the picture, as far as each is covered.
pub fn blend(out: &mut [u8], shape: Shape, area: Area, coverage: &[u8], color: [f64; 4]) {
    let channels = shape.format.channels();
    let wide = shape.format.bytes_per_channel() == 2;
    let color = color.map(|v| v.clamp(0.0, if wide { 65_535.0 } else { 255.0 }).round() as u32);
    let rows = out.chunks_exact_mut(shape.row_bytes());
    let rows = rows.skip(area.top as usize);
    let from = area.left as usize * shape.format.bytes();
    for (row, cover) in rows.zip(coverage.chunks_exact(area.width())) {
        let pixels = row[from..].chunks_exact_mut(shape.format.bytes());
        for (pixel, &cover) in pixels.zip(cover).filter(|(_, &cover)| cover > 0) {
            for (i, color) in color.iter().enumerate().take(channels) {
                if wide {
                    let value = &mut pixel[2 * i..2 * i + 2];
                    let old = u16::from_le_bytes([value[0], value[1]]);
                    let new = mix(old.into(), *color, cover.into()) as u16;
                    value.copy_from_slice(&new.to_le_bytes());
                } else {
                    pixel[i] = mix(pixel[i].into(), *color, cover.into()) as u8;
                }
            }
        }
    }
}

/// Colours `area`, which lies inside of the picture or is empty.
pub fn fill(out: &mut [u8], shape: Shape, area: Area, color: [f64; 4]) {
    if !area.is_empty() {
        let full = vec![255; area.width() * area.height()];
        blend(out, shape, area, &full, color);
    }
}

//! Blending of a color onto pixels in proportion to their coverage.

use crate::image::Shape;

/// The pixels from (left, top) up to but excluding (right, bottom). The rectangle may be empty or outside the image.
#[derive(Clone, Copy)]
pub struct Rect {
    pub left: i64,
    pub top: i64,
    pub right: i64,
    pub bottom: i64,
}

impl Rect {
    /// Returns the rectangle of the image.
    pub fn of_image(shape: Shape) -> Rect {
        Rect {
            left: 0,
            top: 0,
            right: shape.width as i64,
            bottom: shape.height as i64,
        }
    }

    pub fn is_empty(&self) -> bool {
        self.left >= self.right || self.top >= self.bottom
    }

    pub fn intersect(self, other: Rect) -> Rect {
        Rect {
            left: self.left.max(other.left),
            top: self.top.max(other.top),
            right: self.right.min(other.right),
            bottom: self.bottom.min(other.bottom),
        }
    }

    pub fn union(self, other: Rect) -> Rect {
        Rect {
            left: self.left.min(other.left),
            top: self.top.min(other.top),
            right: self.right.max(other.right),
            bottom: self.bottom.max(other.bottom),
        }
    }

    pub fn expand_by(self, by: i64) -> Rect {
        Rect {
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

/// Interpolates from `old` to `new` by `cover` of 255.
pub fn mix_channel(old: u32, new: u32, cover: u32) -> u32 {
    (old * (255 - cover) + new * cover + 127) / 255
}

/// Blends the color onto the pixels of `area`, which must be inside the image, in proportion to their coverage.
pub fn blend_color(out: &mut [u8], shape: Shape, area: Rect, coverage: &[u8], color: [f64; 4]) {
    let channels = shape.format.channel_count();
    let wide = shape.format.bytes_per_channel() == 2;
    let color = color.map(|v| v.clamp(0.0, if wide { 65_535.0 } else { 255.0 }).round() as u32);
    let rows = out.chunks_exact_mut(shape.row_bytes());
    let rows = rows.skip(area.top as usize);
    let from = area.left as usize * shape.format.pixel_bytes();
    for (row, cover) in rows.zip(coverage.chunks_exact(area.width())) {
        let pixels = row[from..].chunks_exact_mut(shape.format.pixel_bytes());
        for (pixel, &cover) in pixels.zip(cover).filter(|(_, &cover)| cover > 0) {
            for (i, color) in color.iter().enumerate().take(channels) {
                if wide {
                    let value = &mut pixel[2 * i..2 * i + 2];
                    let old = u16::from_le_bytes([value[0], value[1]]);
                    let new = mix_channel(old.into(), *color, cover.into()) as u16;
                    value.copy_from_slice(&new.to_le_bytes());
                } else {
                    pixel[i] = mix_channel(pixel[i].into(), *color, cover.into()) as u8;
                }
            }
        }
    }
}

/// Fills `area`, which must be inside the image or empty.
pub fn fill_rect(out: &mut [u8], shape: Shape, area: Rect, color: [f64; 4]) {
    if !area.is_empty() {
        let full = vec![255; area.width() * area.height()];
        blend_color(out, shape, area, &full, color);
    }
}

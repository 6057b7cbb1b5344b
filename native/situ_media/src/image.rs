//! Pixel formats, shapes, and a checked view of an image's bytes.

use crate::error::{fail, Code, Result};

/// The maximum size of an image. The Elixir side documents the same number.
pub const MAX_BYTES: usize = 1 << 30;

/// The channels of a pixel, their order in memory and their depth. Channels of 16 bits are little-endian.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// One channel of 8 bits.
    Gray8,
    /// One channel of 16 bits; also used for depth images.
    Gray16,
    /// Blue, green, red, 8 bits each.
    Bgr24,
    /// Red, green, blue, 8 bits each.
    Rgb24,
    /// Blue, green, red and an unused byte, which is written as 255.
    Bgrx32,
    /// Blue, green, red, alpha (0 transparent, 255 opaque). Colors are not premultiplied.
    Bgra32,
    /// Red, green, blue, alpha, as in `Bgra32`.
    Rgba32,
    /// Red, green, blue, alpha, 16 bits each.
    Rgba64,
}

impl Format {
    /// Returns the number of channels of a pixel, including unused ones: 1, 3 or 4.
    pub fn channel_count(self) -> usize {
        match self {
            Format::Gray8 | Format::Gray16 => 1,
            Format::Bgr24 | Format::Rgb24 => 3,
            _ => 4,
        }
    }

    /// Returns 1 or 2.
    pub fn bytes_per_channel(self) -> usize {
        match self {
            Format::Gray16 | Format::Rgba64 => 2,
            _ => 1,
        }
    }

    /// Returns the bytes of a pixel: 1, 2, 3, 4 or 8.
    pub fn pixel_bytes(self) -> usize {
        self.channel_count() * self.bytes_per_channel()
    }

    /// Returns the index of the alpha (or unused) channel.
    pub fn fourth_channel(self) -> Option<usize> {
        (self.channel_count() == 4).then_some(3)
    }

    /// Returns whether the fourth_channel channel is the opacity of the pixel.
    pub fn has_alpha(self) -> bool {
        matches!(self, Format::Bgra32 | Format::Rgba32 | Format::Rgba64)
    }

    /// Returns the Elixir name of the format, with its colon, for messages.
    pub fn name(self) -> &'static str {
        match self {
            Format::Gray8 => ":gray8",
            Format::Gray16 => ":gray16",
            Format::Bgr24 => ":bgr24",
            Format::Rgb24 => ":rgb24",
            Format::Bgrx32 => ":bgrx32",
            Format::Bgra32 => ":bgra32",
            Format::Rgba32 => ":rgba32",
            Format::Rgba64 => ":rgba64",
        }
    }
}

/// The size and format of an image whose rows are contiguous.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// The number of pixels in a row, at least 1.
    pub width: usize,
    /// The number of rows, at least 1.
    pub height: usize,
    /// The format of every pixel.
    pub format: Format,
}

impl Shape {
    /// Builds a shape. Empty and oversized shapes are rejected here, before every allocation.
    pub fn new(width: usize, height: usize, format: Format) -> Result<Shape> {
        if width == 0 || height == 0 {
            return fail(
                Code::BadSize,
                format!("an image cannot be {width}x{height}: both sides must be at least 1"),
            );
        }
        let bytes = width
            .checked_mul(height)
            .and_then(|n| n.checked_mul(format.pixel_bytes()));
        match bytes {
            Some(n) if n <= MAX_BYTES => Ok(Shape {
                width,
                height,
                format,
            }),
            _ => fail(
                Code::TooLarge,
                format!(
                    "{width}x{height} {} would need more than {MAX_BYTES} bytes",
                    format.name()
                ),
            ),
        }
    }

    /// Returns the bytes of a row without padding.
    pub fn row_bytes(&self) -> usize {
        self.width * self.format.pixel_bytes()
    }

    /// Returns the bytes of all rows without padding, at most [`MAX_BYTES`].
    pub fn bytes(&self) -> usize {
        self.row_bytes() * self.height
    }
}

/// A borrowed image. Every row was checked to be inside `data`.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// The size and format.
    pub shape: Shape,
    /// The distance in bytes between the starts of two rows, at least `shape.row_bytes()`.
    pub stride: usize,
    /// The rows, starting at the top. Bytes after the last pixel are ignored.
    pub data: &'a [u8],
}

impl<'a> View<'a> {
    /// Builds a view. Returns [`Code::BadImage`] if the stride is smaller than a row, or if the data ends before the
    /// last pixel. The last row does not need padding.
    pub fn new(shape: Shape, stride: usize, data: &'a [u8]) -> Result<View<'a>> {
        let row = shape.row_bytes();
        let needed = stride
            .checked_mul(shape.height - 1)
            .and_then(|n| n.checked_add(row));
        match needed {
            Some(n) if stride >= row && n <= data.len() => Ok(View {
                shape,
                stride,
                data,
            }),
            _ => fail(
                Code::BadImage,
                format!(
                    "{} bytes are too few for {}x{} {} with stride {stride}",
                    data.len(),
                    shape.width,
                    shape.height,
                    shape.format.name()
                ),
            ),
        }
    }

    /// Returns the pixels of row `y`, counted from the top. `y` must be less than the height.
    pub fn row(&self, y: usize) -> &'a [u8] {
        &self.data[y * self.stride..y * self.stride + self.shape.row_bytes()]
    }

    /// Iterates over the rows from the top, without their padding.
    pub fn rows(&self) -> impl Iterator<Item = &'a [u8]> + '_ {
        (0..self.shape.height).map(|y| self.row(y))
    }

    /// Returns whether the rows are contiguous.
    pub fn is_packed(&self) -> bool {
        self.stride == self.shape.row_bytes()
    }

    /// Returns a view of a part of the image, without copying. The part must be inside the image.
    pub fn crop(&self, x: i64, y: i64, width: i64, height: i64) -> Result<View<'a>> {
        let shape = self.shape;
        let inside = x >= 0
            && y >= 0
            && width > 0
            && height > 0
            && x.checked_add(width)
                .is_some_and(|e| e <= shape.width as i64)
            && y.checked_add(height)
                .is_some_and(|e| e <= shape.height as i64);
        if !inside {
            return fail(
                Code::BadRect,
                format!(
                    "the rectangle {width}x{height} at {{{x}, {y}}} is not inside the {}x{} image",
                    shape.width, shape.height
                ),
            );
        }
        let (x, y) = (x as usize, y as usize);
        let part = Shape::new(width as usize, height as usize, shape.format)?;
        View::new(
            part,
            self.stride,
            &self.data[y * self.stride + x * shape.format.pixel_bytes()..],
        )
    }

    /// Returns the pixels without padding; borrowed if the rows are contiguous.
    pub fn packed_pixels(&self) -> std::borrow::Cow<'a, [u8]> {
        if self.is_packed() {
            std::borrow::Cow::Borrowed(&self.data[..self.shape.bytes()])
        } else {
            std::borrow::Cow::Owned(self.rows().flatten().copied().collect())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rejects_shapes_that_do_not_fit_the_bytes() {
        let shape = Shape::new(3, 2, Format::Gray8);
        assert!(shape
            .and_then(|s| View::new(s, 4, &[0; 7]))
            .is_ok_and(|v| v.row(1).len() == 3));
        assert!(Shape::new(3, 2, Format::Gray8)
            .and_then(|s| View::new(s, 4, &[0; 6]))
            .is_err());
        assert!(Shape::new(3, 2, Format::Gray8)
            .and_then(|s| View::new(s, 2, &[0; 60]))
            .is_err());
        assert!(
            Shape::new(100_000, 100_000, Format::Gray8).is_err_and(|e| e.code == Code::TooLarge)
        );
        assert!(Shape::new(usize::MAX, 2, Format::Rgba64).is_err());
        assert!(Shape::new(0, 2, Format::Gray8).is_err_and(|e| e.code == Code::BadSize));
    }
}

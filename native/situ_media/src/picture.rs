//! Pixel formats, shapes, and a checked view of a picture's bytes.

use crate::error::{fail, Code, Result};

/// No picture is larger than this; the Elixir side documents the same number.
pub const MAX_BYTES: usize = 1 << 30;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    Gray8,
    Gray16,
    Bgr24,
    Rgb24,
    Bgrx32,
    Bgra32,
    Rgba32,
    Rgba64,
}

impl Format {
    pub fn channels(self) -> usize {
        match self {
            Format::Gray8 | Format::Gray16 => 1,
            Format::Bgr24 | Format::Rgb24 => 3,
            _ => 4,
        }
    }

    pub fn bytes_per_channel(self) -> usize {
        match self {
            Format::Gray16 | Format::Rgba64 => 2,
            _ => 1,
        }
    }

    pub fn bytes(self) -> usize {
        self.channels() * self.bytes_per_channel()
    }

    /// The place of the alpha (or unused) channel.
    pub fn fourth(self) -> Option<usize> {
        (self.channels() == 4).then_some(3)
    }

    pub fn has_alpha(self) -> bool {
        matches!(self, Format::Bgra32 | Format::Rgba32 | Format::Rgba64)
    }

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

/// Width, height and format; rows without gaps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    pub width: usize,
    pub height: usize,
    pub format: Format,
}

impl Shape {
    /// Refuses empty and over-large shapes: the one gate in front of every allocation.
    pub fn new(width: usize, height: usize, format: Format) -> Result<Shape> {
        if width == 0 || height == 0 {
            return fail(
                Code::BadSize,
                format!("a picture cannot be {width}x{height}"),
            );
        }
        let bytes = width
            .checked_mul(height)
            .and_then(|n| n.checked_mul(format.bytes()));
        match bytes {
            Some(n) if n <= MAX_BYTES => Ok(Shape {
                width,
                height,
                format,
            }),
            _ => fail(
                Code::TooLarge,
                format!(
                    "{width}x{height} {} would take more than {MAX_BYTES} bytes",
                    format.name()
                ),
            ),
        }
    }

    pub fn row_bytes(&self) -> usize {
        self.width * self.format.bytes()
    }

    pub fn bytes(&self) -> usize {
        self.row_bytes() * self.height
    }
}

/// A picture somebody else owns, checked: every row lies inside `data`.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    pub shape: Shape,
    pub stride: usize,
    pub data: &'a [u8],
}

impl<'a> View<'a> {
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

    pub fn row(&self, y: usize) -> &'a [u8] {
        &self.data[y * self.stride..y * self.stride + self.shape.row_bytes()]
    }

    pub fn rows(&self) -> impl Iterator<Item = &'a [u8]> + '_ {
        (0..self.shape.height).map(|y| self.row(y))
    }

    pub fn is_tight(&self) -> bool {
        self.stride == self.shape.row_bytes()
    }

    /// A part of the picture, without copying; the part must lie inside.
    pub fn part(&self, x: i64, y: i64, width: i64, height: i64) -> Result<View<'a>> {
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
                    "the rectangle {width}x{height} at {{{x}, {y}}} does not lie inside {}x{}",
                    shape.width, shape.height
                ),
            );
        }
        let (x, y) = (x as usize, y as usize);
        let part = Shape::new(width as usize, height as usize, shape.format)?;
        View::new(
            part,
            self.stride,
            &self.data[y * self.stride + x * shape.format.bytes()..],
        )
    }

    /// The pixels without gaps between rows: borrowed when there are none.
    pub fn tight(&self) -> std::borrow::Cow<'a, [u8]> {
        if self.is_tight() {
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
    fn refuses_what_the_bytes_do_not_hold() {
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

//! Pixel formats, shapes, and a checked view of a picture's bytes.

use crate::error::{fail, Code, Result};

/// No picture is larger than this; the Elixir side documents the same number.
pub const MAX_BYTES: usize = 1 << 30;

/// Channels, their order in memory and their depth. Channels of 16 bits are little-endian.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// One channel of 8 bits.
    Gray8,
    /// One channel of 16 bits; depth pictures too.
    Gray16,
    /// Blue, green, red, 8 bits each.
    Bgr24,
    /// Red, green, blue, 8 bits each.
    Rgb24,
    /// Blue, green, red and a byte without meaning, written as 255.
    Bgrx32,
    /// Blue, green, red, alpha (0 transparent, 255 opaque; colours are not multiplied with it).
    Bgra32,
    /// Red, green, blue, alpha, as in `Bgra32`.
    Rgba32,
    /// Red, green, blue, alpha, 16 bits each.
    Rgba64,
}

impl Format {
    /// Channels of a pixel, unused ones included: 1, 3 or 4.
    pub fn channels(self) -> usize {
        match self {
            Format::Gray8 | Format::Gray16 => 1,
            Format::Bgr24 | Format::Rgb24 => 3,
            _ => 4,
        }
    }

    /// 1 or 2.
    pub fn bytes_per_channel(self) -> usize {
        match self {
            Format::Gray16 | Format::Rgba64 => 2,
            _ => 1,
        }
    }

    /// Bytes of a pixel: 1, 2, 3, 4 or 8.
    pub fn bytes(self) -> usize {
        self.channels() * self.bytes_per_channel()
    }

    /// The place of the alpha (or unused) channel.
    pub fn fourth(self) -> Option<usize> {
        (self.channels() == 4).then_some(3)
    }

    /// Whether the fourth channel says how opaque a pixel is.
    pub fn has_alpha(self) -> bool {
        matches!(self, Format::Bgra32 | Format::Rgba32 | Format::Rgba64)
    }

    /// The name that Elixir has for it, with its colon, for sentences.
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
    /// Pixels of a row, at least 1.
    pub width: usize,
    /// Rows, at least 1.
    pub height: usize,
    /// The format of every pixel.
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

    /// Bytes of a row without a gap behind it.
    pub fn row_bytes(&self) -> usize {
        self.width * self.format.bytes()
    }

    /// Bytes of all rows without gaps; at most [`MAX_BYTES`].
    pub fn bytes(&self) -> usize {
        self.row_bytes() * self.height
    }
}

/// A picture somebody else owns, checked: every row lies inside `data`.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// Size and format.
    pub shape: Shape,
    /// Bytes from the start of a row to that of the next, at least `shape.row_bytes()`.
    pub stride: usize,
    /// The rows, the topmost first; what lies behind the last pixel is not looked at.
    pub data: &'a [u8],
}

impl<'a> View<'a> {
    /// Refuses ([`Code::BadImage`]) a stride below a row's bytes, and data that end before the last pixel
    /// does. The last
    /// row need not be padded.
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

    /// The pixels of row `y`, counted from the top; `y` is below the height.
    pub fn row(&self, y: usize) -> &'a [u8] {
        &self.data[y * self.stride..y * self.stride + self.shape.row_bytes()]
    }

    /// All rows from the top, without the gaps between them.
    pub fn rows(&self) -> impl Iterator<Item = &'a [u8]> + '_ {
        (0..self.shape.height).map(|y| self.row(y))
    }

    /// Whether no gaps lie between the rows.
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

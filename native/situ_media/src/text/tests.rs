use super::*;
use crate::image::Format;
use std::path::PathBuf;

fn fixture_path(name: &str) -> PathBuf {
    let apps = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../apps/situ_media");
    apps.join(name)
}

fn sans_font() -> PathBuf {
    fixture_path("priv/fonts/DejaVuSans.ttf")
}

fn cjk_font() -> PathBuf {
    fixture_path("test/fixtures/cjk.ttf")
}

fn open_typeface(paths: &[PathBuf]) -> Result<Typeface> {
    Typeface::open(paths.iter().map(PathBuf::as_path))
}

/// An 8-bit gray image for white text on black.
struct Canvas {
    shape: Shape,
    data: Vec<u8>,
}

impl Canvas {
    fn new(width: usize, height: usize) -> Result<Canvas> {
        let shape = Shape::new(width, height, Format::Gray8)?;
        let data = vec![0; shape.bytes()];
        Ok(Canvas { shape, data })
    }

    fn write_text(
        mut self,
        face: &Typeface,
        text: &str,
        at: (f64, f64),
        size: f64,
    ) -> Result<Canvas> {
        let style = Style {
            at,
            size,
            color: [255.0; 4],
            background: None,
        };
        face.draw(text, &style, self.shape, &mut self.data)?;
        Ok(self)
    }

    fn ink_sum(&self) -> u64 {
        self.data.iter().map(|&v| u64::from(v)).sum()
    }

    /// Returns the first and last row and the first and last column that contain ink.
    fn ink_bounds(&self) -> Option<(usize, usize, usize, usize)> {
        let (w, lit) = (self.shape.width, |v: &u8| *v > 64);
        let top = self.data.iter().position(lit)? / w;
        let bottom = self.data.iter().rposition(lit)? / w;
        let column = |x: &usize| (0..self.shape.height).any(|y| self.data[y * w + x] > 64);
        let left = (0..w).find(column)?;
        let right = (0..w).rev().find(column)?;
        Some((top, bottom, left, right))
    }
}

#[test]
fn a_capital_has_the_given_height_below_the_given_top() -> Result<()> {
    let face = open_typeface(&[sans_font()])?;
    for size in [7.0, 16.0, 100.0] {
        let canvas = Canvas::new(200, 200)?.write_text(&face, "H", (5.0, 20.0), size)?;
        let (top, bottom, left, _) = canvas.ink_bounds().unwrap_or_default();
        assert_eq!((top, bottom), (20, 19 + size as usize));
        assert!(left >= 5 && left < 5 + size as usize);
    }
    Ok(())
}

#[test]
fn a_decomposed_letter_is_drawn_like_the_composed_one() -> Result<()> {
    let face = open_typeface(&[sans_font()])?;
    let composed = Canvas::new(60, 60)?.write_text(&face, "é", (5.0, 20.0), 30.0)?;
    let decomposed = Canvas::new(60, 60)?.write_text(&face, "e\u{301}", (5.0, 20.0), 30.0)?;
    assert!(composed.ink_sum() > 0);
    assert_eq!(composed.data, decomposed.data);
    Ok(())
}

#[test]
fn right_to_left_scripts_are_ordered_and_joined() -> Result<()> {
    let face = open_typeface(&[sans_font()])?;
    let width = |text| face.measure(text, 30.0).map(|(w, _)| w);
    // Lam and alef join into one glyph, which is narrower than the two letters.
    assert!(width("لا")? < width("ل")? + width("ا")? - 1.0);
    // The first letter of a Hebrew word is the rightmost one, even within an English line.
    let two = Canvas::new(100, 60)?.write_text(&face, "או", (5.0, 15.0), 30.0)?;
    let other = Canvas::new(100, 60)?.write_text(&face, "וא", (5.0, 15.0), 30.0)?;
    let vav = width("ו")?;
    let column = |c: &Canvas, from: f64, to: f64| -> u64 {
        let rows = c.data.chunks(c.shape.width);
        rows.flat_map(|r| &r[from as usize..to as usize])
            .map(|&v| u64::from(v))
            .sum()
    };
    let alone = Canvas::new(100, 60)?.write_text(&face, "ו", (5.0, 15.0), 30.0)?;
    assert_eq!(
        column(&two, 5.0, 5.0 + vav - 1.0),
        column(&alone, 5.0, 5.0 + vav - 1.0)
    );
    assert_ne!(
        column(&other, 5.0, 5.0 + vav - 1.0),
        column(&alone, 5.0, 5.0 + vav - 1.0)
    );
    let mixed = Canvas::new(200, 60)?.write_text(&face, "a או b", (5.0, 15.0), 30.0)?;
    assert!(mixed.ink_sum() > two.ink_sum());
    Ok(())
}

#[test]
fn a_character_is_taken_from_the_first_font_that_has_it() -> Result<()> {
    let (sans_only, cjk_only) = (
        open_typeface(&[sans_font()])?,
        open_typeface(&[cjk_font()])?,
    );
    let both = open_typeface(&[sans_font(), cjk_font()])?;
    let draw =
        |face: &Typeface, text| Canvas::new(200, 60)?.write_text(face, text, (5.0, 10.0), 30.0);
    // A missing character is drawn as the box of the first font, which is the same for all of them.
    assert_eq!(draw(&sans_only, "日")?.data, draw(&sans_only, "本")?.data);
    assert!(draw(&sans_only, "日")?.ink_sum() > 0);
    assert_ne!(draw(&cjk_only, "日")?.data, draw(&cjk_only, "本")?.data);
    assert_eq!(
        draw(&both, "\u{e01}")?.data,
        draw(&sans_only, "\u{e01}")?.data
    );
    assert_ne!(draw(&both, "日")?.data, draw(&sans_only, "日")?.data);
    assert_eq!(draw(&both, "abc")?.data, draw(&sans_only, "abc")?.data);
    let (sans_em, one) = (sans_only.measure("H", 30.0)?.0, both.measure("日", 30.0)?.0);
    let together = both.measure("H日", 30.0)?.0;
    assert!((together - sans_em - one).abs() < 0.01);
    Ok(())
}

#[test]
fn lines_are_drawn_below_each_other() -> Result<()> {
    let face = open_typeface(&[sans_font()])?;
    let canvas = Canvas::new(100, 200)?.write_text(&face, "H\r\n\nH", (5.0, 10.0), 20.0)?;
    let (width, height) = face.measure("H\n\nH", 20.0)?;
    let (top, bottom, ..) = canvas.ink_bounds().unwrap_or_default();
    assert_eq!(top, 10);
    assert!(
        (bottom as f64 - (10.0 + height - 0.35 * 20.0)).abs() <= 1.0,
        "{bottom}"
    );
    assert_eq!(width, face.measure("H", 20.0)?.0);
    assert_eq!(face.measure("", 20.0)?, (0.0, 27.0));
    Ok(())
}

#[test]
fn only_parts_outside_the_image_are_clipped() -> Result<()> {
    let face = open_typeface(&[sans_font(), cjk_font()])?;
    let text = "Ågy 日本\nשלום";
    let whole = Canvas::new(300, 200)?.write_text(&face, text, (100.0, 80.0), 25.0)?;
    for (dx, dy, w, h) in [
        (0, 0, 40, 30),
        (90, 70, 33, 61),
        (110, 90, 7, 5),
        (250, 10, 50, 190),
        (0, 190, 300, 10),
    ] {
        let at = (100.0 - dx as f64, 80.0 - dy as f64);
        let part = Canvas::new(w, h)?.write_text(&face, text, at, 25.0)?;
        for y in 0..h {
            let wanted = &whole.data[(y + dy) * 300 + dx..][..w];
            assert_eq!(&part.data[y * w..][..w], wanted, "{dx} {dy} row {y}");
        }
    }
    Ok(())
}

#[test]
fn covered_pixels_get_the_exact_color_in_every_format() -> Result<()> {
    let face = open_typeface(&[sans_font()])?;
    let formats = [
        Format::Gray8,
        Format::Gray16,
        Format::Bgr24,
        Format::Rgb24,
        Format::Bgrx32,
        Format::Bgra32,
        Format::Rgba32,
        Format::Rgba64,
    ];
    for format in formats {
        let shape = Shape::new(50, 50, format)?;
        let mut data = vec![7; shape.bytes()];
        let scale = if format.bytes_per_channel() == 2 {
            257.0
        } else {
            1.0
        };
        let style = Style {
            at: (10.0, 10.0),
            size: 30.0,
            color: [10.0, 100.0, 200.0, 255.0].map(|v| v * scale),
            background: Some([1.0, 2.0, 3.0, 4.0].map(|v| v * scale)),
        };
        face.draw("█", &style, shape, &mut data)?;
        let pixel = |x: usize, y: usize| -> Vec<f64> {
            let at = (y * 50 + x) * format.pixel_bytes();
            let bytes = &data[at..at + format.pixel_bytes()];
            match format.bytes_per_channel() {
                2 => bytes
                    .chunks(2)
                    .map(|b| f64::from(u16::from_le_bytes([b[0], b[1]])))
                    .collect(),
                _ => bytes.iter().map(|&b| f64::from(b)).collect(),
            }
        };
        let channels = format.channel_count();
        assert_eq!(pixel(20, 25), style.color[..channels], "{format:?}");
        assert_eq!(
            pixel(8, 20),
            style.background.unwrap_or_default()[..channels],
            "{format:?}"
        );
        assert_eq!(data[0], 7);
    }
    Ok(())
}

#[test]
fn text_that_cannot_be_drawn_is_an_error() -> Result<()> {
    let face = open_typeface(&[sans_font()])?;
    let code = |result: Result<(f64, f64)>| result.map_err(|e| e.code).err();
    for size in [0.0, -3.0, 2000.5, f64::NAN, f64::INFINITY] {
        assert_eq!(code(face.measure("a", size)), Some(Code::BadOption));
    }
    assert_eq!(
        code(face.measure(&"a".repeat(MAX_BYTES + 1), 9.0)),
        Some(Code::TooLarge)
    );
    for path in ["src", "/dev/zero", "no/such/file.ttf", "Cargo.toml", "priv"] {
        let opened = open_typeface(&[PathBuf::from(path)]);
        assert_eq!(opened.err().map(|e| e.code), Some(Code::BadFont), "{path}");
    }
    assert!(open_typeface(&[]).is_err());
    Ok(())
}

#[test]
fn a_changed_file_is_read_again() -> Result<()> {
    let path = std::env::temp_dir().join(format!("situ-font-{}.ttf", std::process::id()));
    let copy = |from: PathBuf| std::fs::copy(from, &path).map_err(|e| e.to_string());
    let draw = || {
        let face = open_typeface(std::slice::from_ref(&path))?;
        Canvas::new(60, 60)?.write_text(&face, "日", (5.0, 10.0), 30.0)
    };
    assert!(copy(cjk_font()).is_ok());
    let with = draw()?;
    assert!(copy(sans_font()).is_ok());
    let without = draw()?;
    assert!(std::fs::remove_file(&path).is_ok());
    assert_ne!(with.data, without.data);
    assert!(draw().is_err());
    Ok(())
}

/// Draws text with randomly damaged fonts, which must cause an error or an image. `SITU_FUZZ` sets the number of
/// rounds (default 300).
#[test]
fn damaged_fonts_do_not_crash() -> Result<()> {
    let rounds = std::env::var("SITU_FUZZ").ok().and_then(|n| n.parse().ok());
    let path = std::env::temp_dir().join(format!("situ-fuzz-{}.ttf", std::process::id()));
    let sources = [cjk_font(), sans_font()].map(|path| std::fs::read(path).unwrap_or_default());
    let mut random = Random(1);
    for round in 0..rounds.unwrap_or(300) {
        let mut bytes = sources[usize::from(round % 8 == 0)].clone();
        // Damage in the table headers is the most effective, so half of the changes are within the first 1,500 bytes.
        for _ in 0..1 + random.next_below(20) {
            let end = if random.next_below(2) == 0 {
                1500
            } else {
                bytes.len()
            };
            let at = random.next_below(end.min(bytes.len()));
            bytes[at] =
                [0, 1, 0x7F, 0x80, 0xFF, random.next_below(256) as u8][random.next_below(6)];
        }
        if random.next_below(5) == 0 {
            bytes.truncate(random.next_below(bytes.len()));
        }
        if std::fs::write(&path, &bytes).is_err() {
            return fail(Code::Failed, "cannot write the fuzzed font");
        }
        if let Ok(face) = open_typeface(std::slice::from_ref(&path)) {
            let text = "日本語 Aé\u{301}fi\nسلام 写真";
            let _ = Canvas::new(120, 80)?.write_text(&face, text, (3.5, 2.0), 20.0);
        }
    }
    assert!(std::fs::remove_file(&path).is_ok());
    Ok(())
}

struct Random(u64);

impl Random {
    fn next_below(&mut self, end: usize) -> usize {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) as usize) % end.max(1)
    }
}

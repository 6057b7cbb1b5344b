use super::*;
use crate::error::Result;
use crate::image::Format;

const ALL: [Format; 8] = [
    Format::Gray8,
    Format::Gray16,
    Format::Bgr24,
    Format::Rgb24,
    Format::Bgrx32,
    Format::Bgra32,
    Format::Rgba32,
    Format::Rgba64,
];

/// Draws the figures in gray 200 on black, and returns the rows.
fn draw_gray(figures: &[Figure], width: usize, height: usize) -> Result<Vec<Vec<u8>>> {
    let shape = Shape::new(width, height, Format::Gray8)?;
    let mut out = vec![0; shape.bytes()];
    for figure in figures {
        draw_figure(figure, [200.0; 4], shape, &mut out)?;
    }
    Ok(out.chunks(width).map(<[u8]>::to_vec).collect())
}

fn build_line(from: (f64, f64), to: (f64, f64), width: f64) -> Figure {
    Figure::Line { from, to, width }
}

fn image_column(image: &[Vec<u8>], x: usize) -> Vec<u8> {
    image.iter().map(|row| row[x]).collect()
}

#[test]
fn a_straight_line_has_the_given_width_and_ends() -> Result<()> {
    for width in [1, 3, 5] {
        let image = draw_gray(&[build_line((2.0, 5.0), (8.0, 5.0), width as f64)], 12, 11)?;
        let half = width / 2;
        let across: Vec<u8> = (0..11)
            .map(|y: i32| if (y - 5).abs() <= half { 200 } else { 0 })
            .collect();
        assert_eq!(image_column(&image, 4), across, "width {width}");
        assert_eq!(image[5], [0, 0, 200, 200, 200, 200, 200, 200, 200, 0, 0, 0]);
    }
    // Lines of even width cover two rows by half.
    let image = draw_gray(&[build_line((2.0, 5.0), (8.0, 5.0), 2.0)], 12, 11)?;
    assert_eq!(image_column(&image, 4)[4..7], [100, 200, 100]);
    Ok(())
}

#[test]
fn a_slanted_line_covers_its_area() -> Result<()> {
    for (to, width) in [
        ((70.0, 30.0), 1.0),
        ((40.0, 75.0), 4.0),
        ((12.0, 71.0), 9.5),
    ] {
        let image = draw_gray(&[build_line((10.0, 20.0), to, width)], 90, 90)?;
        let ink: f64 = image.iter().flatten().map(|&v| f64::from(v) / 200.0).sum();
        let length = (to.0 - 10.0).hypot(to.1 - 20.0) + 1.0;
        assert!(
            (ink / (length * width) - 1.0).abs() < 0.02,
            "{ink} {}",
            length * width
        );
    }
    Ok(())
}

#[test]
fn circles_cover_their_area_at_the_given_position() -> Result<()> {
    let center = (40.0, 40.5);
    let ink = |figure| -> Result<f64> {
        let image = draw_gray(&[figure], 90, 90)?;
        Ok(image.iter().flatten().map(|&v| f64::from(v) / 200.0).sum())
    };
    for radius in [3.0, 17.25, 30.0] {
        let disc = ink(Figure::Circle(center, radius, None))?;
        let area = std::f64::consts::PI * (radius + 0.5) * (radius + 0.5);
        assert!((disc / area - 1.0).abs() < 0.01, "{disc} {area}");
        let ring = ink(Figure::Circle(center, radius, Some(3.0)))?;
        let area = std::f64::consts::PI * 2.0 * radius * 3.0;
        assert!((ring / area - 1.0).abs() < 0.01, "{ring} {area}");
    }
    let dot = draw_gray(&[Figure::Circle((3.0, 2.0), 0.0, None)], 6, 5)?;
    assert_eq!(dot[2], [0, 0, 0, 200, 0, 0]);
    assert_eq!(dot.iter().flatten().filter(|&&v| v > 0).count(), 1);
    Ok(())
}

#[test]
fn rectangles_are_aligned_to_whole_pixels() -> Result<()> {
    let rows = |rect, width| draw_gray(&[Figure::Rectangle(rect, width)], 7, 5);
    let box_ = [1.0, 1.0, 5.0, 3.0];
    assert_eq!(
        rows(box_, Some(1.0))?,
        [
            [0, 0, 0, 0, 0, 0, 0],
            [0, 200, 200, 200, 200, 200, 0],
            [0, 200, 0, 0, 0, 200, 0],
            [0, 200, 200, 200, 200, 200, 0],
            [0, 0, 0, 0, 0, 0, 0],
        ]
    );
    let all = |v: &Vec<Vec<u8>>| v.iter().flatten().filter(|&&v| v == 200).count();
    assert_eq!(all(&rows(box_, Some(2.0))?), 15);
    assert_eq!(all(&rows(box_, Some(3.0))?), 7 * 5);
    assert_eq!(all(&rows(box_, None)?), 15);
    assert_eq!(all(&rows([-5.0, -5.0, 6.0, 6.0], None)?), 1);
    assert_eq!(all(&rows([1.0, 1.0, 0.0, 3.0], None)?), 0);
    assert_eq!(all(&rows([1.0, 1.0, -2.0, -3.0], None)?), 0);
    Ok(())
}

#[test]
fn only_parts_outside_the_image_are_clipped() -> Result<()> {
    let at = |dx: f64, dy: f64| {
        [
            build_line((5.0 - dx, 60.0 - dy), (95.0 - dx, 3.5 - dy), 4.0),
            build_line((50.0 - dx, -9e5 - dy), (51.0 - dx, 9e5 - dy), 1.0),
            Figure::Circle((70.0 - dx, 40.0 - dy), 25.5, Some(3.0)),
            Figure::Circle((20.0 - dx, 20.0 - dy), 9.0, None),
            Figure::Rectangle([30.0 - dx, 10.0 - dy, 40.0, 50.0], Some(5.0)),
            Figure::Circle((50.0 - dx, 9e5 - dy), 9e5 - 30.0, Some(2.0)),
        ]
    };
    let whole = draw_gray(&at(0.0, 0.0), 100, 80)?;
    for (dx, dy, w, h) in [
        (0, 0, 9, 7),
        (20, 10, 40, 40),
        (60, 33, 11, 47),
        (99, 79, 1, 1),
    ] {
        let part = draw_gray(&at(dx as f64, dy as f64), w, h)?;
        for y in 0..h {
            assert_eq!(part[y], whole[y + dy][dx..dx + w], "{dx} {dy} row {y}");
        }
    }
    Ok(())
}

#[test]
fn every_format_is_drawn_the_same() -> Result<()> {
    let figures = [
        build_line((1.0, 2.0), (17.0, 9.5), 2.5),
        Figure::Circle((9.0, 7.0), 4.0, Some(1.5)),
    ];
    let gray = draw_gray(&figures, 20, 14)?;
    for format in ALL {
        let shape = Shape::new(20, 14, format)?;
        let mut out = vec![0; shape.bytes()];
        let wide = format.bytes_per_channel() == 2;
        for figure in &figures {
            draw_figure(
                figure,
                [if wide { 51_400.0 } else { 200.0 }; 4],
                shape,
                &mut out,
            )?;
        }
        for (at, pixel) in out.chunks(format.pixel_bytes()).enumerate() {
            let value = if wide {
                f64::from(u16::from_le_bytes([pixel[0], pixel[1]])) / 257.0
            } else {
                f64::from(pixel[0])
            };
            assert!(
                (value - f64::from(gray[at / 20][at % 20])).abs() <= 1.0,
                "{format:?}"
            );
        }
    }
    Ok(())
}

#[test]
fn every_number_is_drawn_or_rejected() -> Result<()> {
    let odd = [
        0.0,
        -0.0,
        0.5,
        -1e6,
        1e6,
        1e300,
        -1e300,
        f64::NAN,
        f64::INFINITY,
        f64::MIN_POSITIVE,
    ];
    for a in odd {
        for b in odd {
            let near = [a, b].iter().all(|v| v.abs() <= REACH);
            for figure in [
                build_line((a, b), (b, a), a),
                build_line((3.0, a), (b, 2.0), b),
                Figure::Circle((a, 3.0), b, Some(a)),
                Figure::Circle((3.0, b), a, None),
                Figure::Rectangle([a, b, b, a], Some(b)),
                Figure::Rectangle([1.0, a, b, 3.0], None),
            ] {
                assert_eq!(draw_gray(&[figure], 8, 6).is_ok(), near, "{figure:?}");
            }
        }
    }
    Ok(())
}

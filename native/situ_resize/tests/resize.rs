//! These tests are outside the library, where they would compile all kernels a second time.
use situ_resize::{resize_pixels, PixelLayout, ResizeAlg, ResizeOptions};

fn nearest_options() -> ResizeOptions {
    ResizeOptions::new().resize_alg(ResizeAlg::Nearest)
}

#[test]
fn nearest_copies_pixels_of_the_source() {
    let mut target = [0; 6];
    let source = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12];
    let result = resize_pixels(
        PixelLayout::U8x3,
        ((4, 1), &source),
        ((2, 1), &mut target),
        &nearest_options(),
    );
    assert_eq!(result, Ok(()));
    assert_eq!(target, [4, 5, 6, 10, 11, 12]);
}

#[test]
fn a_short_buffer_is_rejected() {
    let mut target = [0; 6];
    let result = resize_pixels(
        PixelLayout::U8x3,
        ((4, 1), &[0; 11]),
        ((2, 1), &mut target),
        &nearest_options(),
    );
    assert_eq!(result, Err("the resizer rejected the buffers".to_string()));
}

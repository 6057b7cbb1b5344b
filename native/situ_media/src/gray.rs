//! Conversion from color to gray, the hot path of most vision: (4897 R + 9617 G + 1868 B) >> 14, exactly as in \psi.
//! White becomes 254, not 255, since the weights sum to 16382.

/// The weight of red, in 16,384ths.
pub const RED: u32 = 4897;
/// The weight of green, in 16,384ths.
pub const GREEN: u32 = 9617;
/// The weight of blue, in 16,384ths.
pub const BLUE: u32 = 1868;

/// Returns the gray value of a pixel, in the depth of its channels: 0..254 of 0..255, 0..65,527 of 0..65,535.
#[inline(always)]
pub fn gray_value(r: u32, g: u32, b: u32) -> u32 {
    (RED * r + GREEN * g + BLUE * b) >> 14
}

/// Converts a row of three-byte pixels. `first` and `third` are the weights of the first and third byte.
pub fn convert_row24(src: &[u8], out: &mut [u8], first: u32, third: u32) {
    #[cfg(target_arch = "x86_64")]
    {
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: AVX2 was detected; its loop bounds keep the function inside the slices.
            #[allow(unsafe_code)]
            let done = unsafe { avx2::convert_blocks(src, out, first as i16, third as i16) };
            return convert_row24_scalar(&src[done * 3..], &mut out[done..], first, third);
        }
    }
    convert_row24_scalar(src, out, first, third)
}

fn convert_row24_scalar(src: &[u8], out: &mut [u8], first: u32, third: u32) {
    for (p, o) in src.chunks_exact(3).zip(out) {
        *o = ((first * p[0] as u32 + GREEN * p[1] as u32 + third * p[2] as u32) >> 14) as u8;
    }
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::*;

    /// Converts complete blocks of 32 pixels, and returns the number of converted pixels.
    ///
    /// # Safety
    /// The CPU must support AVX2. Reads stay below `src.len()`, writes below `out.len()`.
    #[target_feature(enable = "avx2")]
    #[allow(unsafe_code)]
    pub unsafe fn convert_blocks(src: &[u8], out: &mut [u8], first: i16, third: i16) -> usize {
        // Each 16-byte load contains four pixels (12 bytes) and 4 more bytes, hence the margin of 4.
        let pixels = (src.len().saturating_sub(4) / 3).min(out.len()) / 32 * 32;
        // (first, second) byte pairs as 16-bit lanes, and (third, 0).
        let pair = _mm256_broadcastsi128_si256(_mm_setr_epi8(
            0, -1, 1, -1, 3, -1, 4, -1, 6, -1, 7, -1, 9, -1, 10, -1,
        ));
        let single = _mm256_broadcastsi128_si256(_mm_setr_epi8(
            2, -1, -1, -1, 5, -1, -1, -1, 8, -1, -1, -1, 11, -1, -1, -1,
        ));
        let weights = _mm256_set1_epi32(((super::GREEN as i32) << 16) | first as i32);
        let weight = _mm256_set1_epi32(third as i32);
        // The packs instructions work on 128-bit halves; this permutation restores the order of the eight groups of
        // four.
        let order = _mm256_setr_epi32(0, 4, 1, 5, 2, 6, 3, 7);
        let eight = |offset: usize| {
            let low = src.as_ptr().add(offset * 3) as *const __m128i;
            let high = src.as_ptr().add(offset * 3 + 12) as *const __m128i;
            let v = _mm256_inserti128_si256(
                _mm256_castsi128_si256(_mm_loadu_si128(low)),
                _mm_loadu_si128(high),
                1,
            );
            let a = _mm256_madd_epi16(_mm256_shuffle_epi8(v, pair), weights);
            let b = _mm256_madd_epi16(_mm256_shuffle_epi8(v, single), weight);
            _mm256_srli_epi32(_mm256_add_epi32(a, b), 14)
        };
        let mut x = 0;
        while x < pixels {
            let a = _mm256_packs_epi32(eight(x), eight(x + 8));
            let b = _mm256_packs_epi32(eight(x + 16), eight(x + 24));
            let bytes = _mm256_permutevar8x32_epi32(_mm256_packus_epi16(a, b), order);
            _mm256_storeu_si256(out.as_mut_ptr().add(x) as *mut __m256i, bytes);
            x += 32;
        }
        pixels
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_vectorized_row_equals_the_scalar_one_at_every_length() {
        let src: Vec<u8> = (0..3 * 200u32)
            .map(|i| (i.wrapping_mul(2654435761) >> 24) as u8)
            .collect();
        for n in 0..200 {
            let (mut a, mut b) = (vec![0; n], vec![0; n]);
            convert_row24(&src[..3 * n], &mut a, BLUE, RED);
            convert_row24_scalar(&src[..3 * n], &mut b, BLUE, RED);
            assert_eq!(a, b, "{n} pixels");
        }
    }

    #[test]
    fn primary_colors_have_the_documented_gray_values() {
        assert_eq!(
            (
                gray_value(255, 0, 0),
                gray_value(0, 255, 0),
                gray_value(0, 0, 255),
                gray_value(255, 255, 255)
            ),
            (76, 149, 29, 254)
        );
    }
}

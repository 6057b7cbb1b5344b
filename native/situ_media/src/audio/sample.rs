//! Sample types and their conversion. Bytes are little-endian; full scale is -1.0..1.0.

/// The storage type of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sample {
    /// Unsigned 8 bits; silence is 128.
    U8,
    /// Two's complement, 16 bits.
    S16,
    /// Two's complement, 24 bits in 3 bytes.
    S24,
    /// Two's complement, 32 bits.
    S32,
    /// IEEE 754 binary32; may exceed full scale.
    F32,
    /// IEEE 754 binary64; may exceed full scale.
    F64,
}

impl Sample {
    /// Returns the bytes of one sample.
    pub fn byte_size(self) -> usize {
        match self {
            Sample::U8 => 1,
            Sample::S16 => 2,
            Sample::S24 => 3,
            Sample::S32 | Sample::F32 => 4,
            Sample::F64 => 8,
        }
    }

    /// Returns the stored number without scaling (0..255 for 8 bits).
    #[inline(always)]
    pub fn raw_value(self, b: &[u8]) -> f64 {
        match self {
            Sample::U8 => b[0] as f64,
            Sample::S16 => i16::from_le_bytes([b[0], b[1]]) as f64,
            Sample::S24 => (i32::from_le_bytes([0, b[0], b[1], b[2]]) >> 8) as f64,
            Sample::S32 => i32::from_le_bytes([b[0], b[1], b[2], b[3]]) as f64,
            Sample::F32 => f32::from_le_bytes([b[0], b[1], b[2], b[3]]) as f64,
            Sample::F64 => f64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]),
        }
    }

    /// Returns the stored number that represents full scale (1.0).
    pub fn full_scale(self) -> f64 {
        match self {
            Sample::U8 => 128.0,
            Sample::S16 => 32_768.0,
            Sample::S24 => 8_388_608.0,
            Sample::S32 => 2_147_483_648.0,
            Sample::F32 | Sample::F64 => 1.0,
        }
    }

    /// Returns the sample scaled to -1.0..1.0. `b` must contain exactly one sample.
    #[inline(always)]
    pub fn read_value(self, b: &[u8]) -> f64 {
        let raw = self.raw_value(b);
        let raw = if self == Sample::U8 { raw - 128.0 } else { raw };
        raw / self.full_scale()
    }

    /// Writes a sample scaled to -1.0..1.0. Integers are rounded and clipped, and NaN becomes 0.
    #[inline(always)]
    pub fn write_value(self, value: f64, b: &mut [u8]) {
        match self {
            Sample::F32 => b.copy_from_slice(&(value as f32).to_le_bytes()),
            Sample::F64 => b.copy_from_slice(&value.to_le_bytes()),
            Sample::U8 => b[0] = (value * 128.0 + 128.0).round() as u8,
            Sample::S16 => b.copy_from_slice(&((value * 32_768.0).round() as i16).to_le_bytes()),
            Sample::S24 => {
                let v = (value * 8_388_608.0)
                    .round()
                    .clamp(-8_388_608.0, 8_388_607.0) as i32;
                b.copy_from_slice(&v.to_le_bytes()[..3]);
            }
            Sample::S32 => {
                b.copy_from_slice(&((value * 2_147_483_648.0).round() as i32).to_le_bytes())
            }
        }
    }
}

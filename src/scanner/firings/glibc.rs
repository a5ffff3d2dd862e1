//! Cosine and sine in single precision as glibc has computed them since 2.28: for about 1 % of all angles,
//! not the nearest float32. The polynomials and the argument reduction are those of its `sincosf`, for angles
//! below 120 radians. FORMAT.md 3.5.

/// Coefficients of the sine, from x^3 on, and of the cosine, from x^2 on.
const SINE: [f64; 3] = [
    f64::from_bits(0xbfc5_5554_5995_a603),
    f64::from_bits(0x3f81_1076_0523_0bc4),
    f64::from_bits(0xbf29_94eb_3774_cf24),
];
const COSINE: [f64; 4] = [
    f64::from_bits(0xbfdf_ffff_fd0c_621c),
    f64::from_bits(0x3fa5_5553_e106_8f19),
    f64::from_bits(0xbf56_c087_e89a_359d),
    f64::from_bits(0x3ef9_9343_027b_f8c3),
];
/// Quarters of a turn per radian, times 2^24; and radians per quarter.
const QUARTERS: f64 = f64::from_bits(0x4164_5f30_6dc9_c883);
const QUARTER: f64 = f64::from_bits(0x3ff9_21fb_5444_2d18);
/// Angles below the first need no argument reduction; those below the second, no computation.
const EIGHTH: f32 = f32::from_bits(0x3f49_0fdb);
const TINY: f32 = f32::from_bits(0x3980_0000);

/// Cosine and sine as glibc computed them before 2.28: the nearest float32, but two terms of the series for
/// small angles.
pub fn old_cos_sin(angle: f32) -> [f32; 2] {
    /// In radians.
    const SMALL: f64 = 1.0 / 32.0;
    let wide = f64::from(angle);
    if wide.abs() < SMALL {
        [(1.0 - wide * wide / 2.0) as f32, (wide - wide * wide * wide / 6.0) as f32]
    } else {
        [libm::cos(wide) as f32, libm::sin(wide) as f32]
    }
}

pub fn sinf(angle: f32) -> f32 {
    if exponent(angle) < exponent(TINY) { angle } else { of(angle, 0) }
}

pub fn cosf(angle: f32) -> f32 {
    if exponent(angle) < exponent(TINY) { 1.0 } else { of(angle, 1) }
}

/// Exponent and leading bits of the mantissa.
fn exponent(angle: f32) -> u32 {
    angle.to_bits() >> 20 & 0x7ff
}

/// The sine of an angle plus `cosine` quarters of a turn, 0 or 1.
fn of(angle: f32, cosine: i32) -> f32 {
    let wide = f64::from(angle);
    let quarters = if exponent(angle) < exponent(EIGHTH) {
        0
    } else {
        ((wide * QUARTERS) as i32).wrapping_add(0x80_0000) >> 24
    };
    let rest = wide - f64::from(quarters) * QUARTER;
    let square = rest * rest;
    if (quarters ^ cosine) & 1 == 0 {
        let sign = [1.0, -1.0, -1.0, 1.0][(quarters & 3) as usize];
        let x = rest * sign;
        let cube = x * square;
        let high = SINE[1] + square * SINE[2];
        ((x + cube * SINE[0]) + cube * square * high) as f32
    } else {
        let sign = if quarters & 2 != 0 { -1.0 } else { 1.0 };
        let fourth = square * square;
        let high = sign * (COSINE[2] + square * COSINE[3]);
        let low = sign * (1.0 + square * COSINE[0]);
        ((low + fourth * (sign * COSINE[1])) + fourth * square * high) as f32
    }
}

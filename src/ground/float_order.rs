//! Floating-point values as integers in ascending order, their *ordinals* (the parameter `place`): adjacent
//! values differ by one, and -0.0 and 0.0 count as adjacent, 0.0 being 0. Values are passed as bits where
//! every bit must be preserved, since processors change the bits of some NaNs. FORMAT.md 3.4.

/// The ordinal of a float32 value.
pub fn ordered(value: f32) -> i64 {
    ordered32(value.to_bits())
}

/// The inverse of [`ordered`], for any integer; ordinals of no float32 are truncated to 32 bits.
pub fn from_ordered(place: i64) -> f32 {
    f32::from_bits(bits32(place))
}

/// The ordinal of the float32 value with these bits.
pub fn ordered32(bits: u32) -> i64 {
    let signed = bits as i32;
    i64::from(if signed < 0 { !(signed & i32::MAX) } else { signed })
}

/// The inverse of [`ordered32`].
pub fn bits32(place: i64) -> u32 {
    let signed = place as i32;
    (if signed < 0 { !signed | i32::MIN } else { signed }) as u32
}

/// The ordinal of the float64 value with these bits.
pub fn ordered64(bits: u64) -> i64 {
    let signed = bits as i64;
    if signed < 0 { !(signed & i64::MAX) } else { signed }
}

/// The inverse of [`ordered64`].
pub fn bits64(place: i64) -> u64 {
    (if place < 0 { !place | i64::MIN } else { place }) as u64
}

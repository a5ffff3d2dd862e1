//! Floating-point values as integers in rising order, their *places*: neighbours differ by one, and so do -0.0 and 0.0, whose
//! place is 0. The bits of a value stand for it where none of them may change, as a processor changes those of some NaNs.
//! FORMAT.md 3.4.

/// The place of a float32 value.
pub fn ordered(value: f32) -> i64 {
    ordered32(value.to_bits())
}

/// The inverse of [`ordered`], for any integer: those that stand for no float32 are truncated to 32 bits.
pub fn from_ordered(place: i64) -> f32 {
    f32::from_bits(bits32(place))
}

/// The place of the float32 value of these bits.
pub fn ordered32(bits: u32) -> i64 {
    let signed = bits as i32;
    i64::from(if signed < 0 { !(signed & i32::MAX) } else { signed })
}

/// The inverse of [`ordered32`].
pub fn bits32(place: i64) -> u32 {
    let signed = place as i32;
    (if signed < 0 { !signed | i32::MIN } else { signed }) as u32
}

/// The place of the float64 value of these bits.
pub fn ordered64(bits: u64) -> i64 {
    let signed = bits as i64;
    if signed < 0 { !(signed & i64::MAX) } else { signed }
}

/// The inverse of [`ordered64`].
pub fn bits64(place: i64) -> u64 {
    (if place < 0 { !place | i64::MIN } else { place }) as u64
}

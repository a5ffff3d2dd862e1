//! The intensities as tokens: each level is a token. Its context is the level before, and whether that agrees
//! with the one above. FORMAT.md 8.16.

use crate::entropy::TokenCoder;
use crate::ground::varint::{unzigzag, zigzag};
use crate::models::IntensityScale;

/// The number of bits coded as a token; of longer levels, the lowest bits are coded as plain bits.
const TOKEN_BITS: u32 = 8;
/// Contexts by the level before, of which 7 bits are used.
const LEVEL_CONTEXTS: usize = 64;
/// Largest difference of levels, out of 128, that counts as agreement.
const NEAR: u16 = 4;
/// The context of the flag for values that are not on the grid, and that of such values.
const IS_OFF_GRID: usize = 2 * LEVEL_CONTEXTS;
const OFF_GRID: usize = IS_OFF_GRID + 1;
/// The first context of the integers of a frame without a grid; the others follow, by the size of the
/// difference before.
const ROUGH: usize = OFF_GRID + 1;
const ROUGH_SIZES: usize = 16;
/// Number of contexts of an intensity.
pub const INTENSITY_CONTEXTS: usize = ROUGH + ROUGH_SIZES;

/// Codes the intensities of a frame.
#[derive(Clone, Default)]
pub struct IntensityTokens {
    last_off_grid: u32,
    last_difference: u64,
}

impl IntensityTokens {
    /// Codes one value, given the context levels (1 to 128; 0 = none) of the return before and of the one
    /// above. Returns the value's own context level.
    #[inline]
    pub fn code<C: TokenCoder>(
        &mut self,
        coder: &mut C,
        scale: &IntensityScale,
        (west, north): (u16, u16),
        value: &mut f32,
    ) -> u16 {
        let level = if C::ENCODES { scale.level_of(*value) } else { None };
        let is_off = !scale.is_on_grid()
            || (scale.has_exceptions() && { coder.token(IS_OFF_GRID, u8::from(level.is_none())) == 1 });
        if is_off {
            let (context, rough) = match scale.is_on_grid() {
                true => (OFF_GRID, None),
                false => (
                    ROUGH + (self.last_difference.max(1).ilog2() as usize).min(ROUGH_SIZES - 1),
                    Some(scale.rough()),
                ),
            };
            let integer = rough.map_or(value.to_bits(), |rough| rough.integer(*value));
            let difference = zigzag(i64::from(integer as i32) - i64::from(self.last_off_grid as i32));
            self.last_difference = coder.number(context, difference);
            let difference = unzigzag(self.last_difference);
            self.last_off_grid = i64::from(self.last_off_grid).wrapping_add(difference) as u32;
            if !C::ENCODES {
                *value =
                    rough.map_or(f32::from_bits(self.last_off_grid), |rough| rough.value(self.last_off_grid));
            }
            return scale.context_level(*value);
        }
        let before = if west > 0 { west } else { north };
        let agrees = north > 0 && before.abs_diff(north) < NEAR;
        let context = usize::from(before / 2).min(LEVEL_CONTEXTS - 1) * 2 + usize::from(agrees);
        let low_bits = scale.bits().saturating_sub(TOKEN_BITS);
        let level = level.unwrap_or(0);
        let high = coder.token(context, (level >> low_bits) as u8);
        let level = u32::from(high) << low_bits | coder.bits(level.into(), low_bits) as u32;
        if !C::ENCODES {
            *value = scale.value_of(level);
        }
        scale.context_of(level)
    }
}

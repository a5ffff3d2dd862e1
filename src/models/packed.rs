//! Numbers in blocks, each block with as many bits per number as its largest needs: the fastest method.
//! Ranges are coded as differences from the one before, intensity levels as differences from the least of
//! their block. FORMAT.md 8.16.

use pulp::NullaryFnOnce;

use crate::entropy::TokenCoder;
use crate::ground::lanes::dispatch;
use crate::ground::varint::{unzigzag, zigzag};
use crate::models::range::TYPICAL_RANGE;
use crate::models::{IntensityScale, RangeScale};

/// Numbers in a block: larger blocks save widths, smaller ones waste less if a single number is large.
const BLOCK: usize = 8;
/// The largest number of bits of a number.
const MOST_WIDTH: u8 = 32;
/// The width of a block is a token whose context is the width of the block before.
const WIDTH_CONTEXTS: usize = MOST_WIDTH as usize + 1;
/// The context of the number of values before one that is not on the grid.
const GAP: usize = WIDTH_CONTEXTS;
/// The largest number of bits of a level relative to the least of its block.
const MOST_LEVEL_WIDTH: u8 = 9;
/// The context of the least level of a block of width 0 or 1; one further context for each two widths
/// follows.
const LEAST: usize = GAP + 1;

/// Number of contexts of a section of ranges.
pub const PACKED_RANGE_CONTEXTS: usize = WIDTH_CONTEXTS;
/// Number of contexts of a section of intensities.
pub const PACKED_INTENSITY_CONTEXTS: usize = LEAST + MOST_LEVEL_WIDTH as usize / 2 + 1;

/// Codes ranges, in steps, in the order of the cells: the bins, centred on the range before, that contain
/// them. As in [`RangeTokens`](super::RangeTokens), they are decoded as the middles of their bins.
pub fn code_packed_ranges<C: TokenCoder>(coder: &mut C, scale: RangeScale, ranges: &mut [u32]) {
    let most = (1 << scale.bits) - 1;
    if scale.bin == 1 {
        let range = |before, miss| {
            let range = differing(before, miss);
            if (1..=most).contains(&range) { range } else { cut(range, most) }
        };
        return code_values(coder, u32::from(TYPICAL_RANGE), ranges, difference, range);
    }
    let bins = |before: u32| scale.bins_around(i64::from(before));
    let miss = |before, range| {
        let bins = bins(before);
        difference(0, (bins.of(i64::from(range)) - bins.central) as u32)
    };
    let range = |before, miss| {
        let bins = bins(before);
        bins.middle(bins.central + i64::from(differing(0, miss) as i32), scale.bits) as u32
    };
    code_values(coder, u32::from(TYPICAL_RANGE), ranges, miss, range);
}

/// Codes intensities in the order of the cells: their levels on the scale, and the values that are not on it.
/// If there is no grid, their integers on a rough scale are coded.
pub fn code_packed_intensities<C: TokenCoder>(coder: &mut C, scale: &IntensityScale, values: &mut [f32]) {
    if !scale.is_on_grid() {
        let rough = scale.rough();
        let mut integers = vec![0; values.len()];
        if C::ENCODES {
            integers.iter_mut().zip(&*values).for_each(|(integer, value)| *integer = rough.integer(*value));
        }
        code_values(coder, 0, &mut integers, difference, differing);
        if !C::ENCODES {
            values.iter_mut().zip(integers).for_each(|(value, integer)| *value = rough.value(integer));
        }
        return;
    }
    let mut levels = vec![0; values.len()];
    let mut off_grid = Vec::new();
    if C::ENCODES && !scale.has_exceptions() {
        levels.iter_mut().zip(&*values).for_each(|(level, value)| *level = scale.level_on_grid(*value));
    } else if C::ENCODES {
        let mut before = 0;
        for (place, (level, value)) in levels.iter_mut().zip(&*values).enumerate() {
            before = scale.level_of(*value).unwrap_or_else(|| {
                off_grid.push((place, *value));
                before
            });
            *level = before;
        }
    }
    dispatch(Packing { coder, values: &mut levels, blocks: Levels::default() });
    if !C::ENCODES {
        values.iter_mut().zip(&levels).for_each(|(value, level)| *value = scale.value_of(*level));
    }
    if scale.has_exceptions() {
        code_off_grid(coder, &off_grid, values);
    }
}

/// Codes the values that are not on the grid. The encoder passes them in `known`, with their indices.
fn code_off_grid<C: TokenCoder>(coder: &mut C, known: &[(usize, f32)], values: &mut [f32]) {
    let mut known = known.iter();
    let (mut next, mut last) = (0, 0u32);
    loop {
        let (place, value) = known.next().copied().unwrap_or((values.len(), 0.0));
        let gap = coder.number(GAP, (place.wrapping_sub(next)) as u64).min((values.len() - next) as u64);
        let Some(found) = values.get_mut(next + gap as usize).filter(|_| !coder.is_exhausted()) else {
            return;
        };
        if coder.bits((value.to_bits() == last).into(), 1) == 0 {
            last = coder.bits(value.to_bits().into(), 32) as u32;
        }
        *found = f32::from_bits(last);
        next += gap as usize + 1;
    }
}

/// Codes values as differences: `difference(before, value)` returns the number to be coded, and
/// `differing(before, difference)` the value.
fn code_values<C: TokenCoder>(
    coder: &mut C,
    before: u32,
    values: &mut [u32],
    difference: impl Fn(u32, u32) -> u32,
    differing: impl Fn(u32, u32) -> u32,
) {
    dispatch(Packing { coder, values, blocks: Differences { before, width: 0, difference, differing } });
}

/// Codes values block by block.
trait Blocks {
    /// Codes a block.
    fn code<C: TokenCoder>(&mut self, coder: &mut C, block: &mut [u32]);
}

/// A coder and values in blocks, for a function compiled for several vector units.
struct Packing<'a, C, B> {
    coder: &'a mut C,
    values: &'a mut [u32],
    blocks: B,
}

impl<C: TokenCoder, B: Blocks> NullaryFnOnce for Packing<'_, C, B> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Packing { coder, values, mut blocks } = self;
        let (whole, rest) = values.as_chunks_mut::<BLOCK>();
        // The block length is a constant here, so that this loop is compiled for it.
        for block in whole {
            blocks.code(coder, block);
            if coder.is_exhausted() {
                return;
            }
        }
        if !rest.is_empty() {
            blocks.code(coder, rest);
        }
    }
}

/// Blocks of differences.
struct Differences<D, V> {
    /// The last value of the preceding block.
    before: u32,
    /// The width of the preceding block.
    width: u8,
    difference: D,
    differing: V,
}

impl<D: Fn(u32, u32) -> u32, V: Fn(u32, u32) -> u32> Blocks for Differences<D, V> {
    #[inline(always)]
    fn code<C: TokenCoder>(&mut self, coder: &mut C, block: &mut [u32]) {
        let mut differences = [0; BLOCK];
        if C::ENCODES {
            let mut before = self.before;
            for (coded, value) in differences.iter_mut().zip(&*block) {
                *coded = (self.difference)(before, *value);
                before = (self.differing)(before, *coded);
            }
        }
        self.width = coder.token(usize::from(self.width), width_of(&differences)).min(MOST_WIDTH);
        code_block(coder, u32::from(self.width), &mut differences[..block.len()]);
        for (difference, value) in differences.iter().zip(block) {
            self.before = (self.differing)(self.before, *difference);
            *value = self.before;
        }
    }
}

/// Blocks of levels. Levels are so noisy that they are closer to the least of their block than to each other.
#[derive(Default)]
struct Levels {
    /// The least level of the preceding block.
    least: u32,
    /// The width of the preceding block.
    width: u8,
}

impl Blocks for Levels {
    #[inline(always)]
    fn code<C: TokenCoder>(&mut self, coder: &mut C, block: &mut [u32]) {
        let (mut least, mut above) = (0, [0; BLOCK]);
        if C::ENCODES {
            least = block.iter().fold(u32::MAX, |least, level| least.min(*level));
            above.iter_mut().zip(&*block).for_each(|(above, level)| *above = level.wrapping_sub(least));
        }
        self.width = coder.token(usize::from(self.width), width_of(&above)).min(MOST_LEVEL_WIDTH);
        let change = zigzag(i64::from(least) - i64::from(self.least));
        let change = unzigzag(coder.number(LEAST + usize::from(self.width / 2), change));
        self.least = i64::from(self.least).wrapping_add(change) as u32;
        code_block(coder, u32::from(self.width), &mut above[..block.len()]);
        above.iter().zip(block).for_each(|(above, level)| *level = self.least.wrapping_add(*above));
    }
}

/// The bits of the largest of these numbers.
#[inline(always)]
fn width_of(numbers: &[u32; BLOCK]) -> u8 {
    let largest = numbers.iter().fold(0, |all, number| all | number);
    (u32::BITS - largest.leading_zeros()) as u8
}

/// Codes numbers of `width` bits, as many at a time as the coder accepts.
#[inline(always)]
fn code_block<C: TokenCoder>(coder: &mut C, width: u32, numbers: &mut [u32]) {
    match width {
        0 => numbers.fill(0),
        1..=7 => code_groups::<C, 8>(coder, width, numbers),
        8..=14 => code_groups::<C, 4>(coder, width, numbers),
        15..=28 => code_groups::<C, 2>(coder, width, numbers),
        _ => code_groups::<C, 1>(coder, width, numbers),
    }
}

#[inline(always)]
fn code_groups<C: TokenCoder, const N: usize>(coder: &mut C, width: u32, numbers: &mut [u32]) {
    let mask = u32::MAX >> (u32::BITS - width);
    let (groups, rest) = numbers.as_chunks_mut::<N>();
    for group in groups {
        let bits = (0..N).fold(0, |bits, i| bits | u64::from(group[i]) << (i as u32 * width));
        let bits = coder.bits(bits, N as u32 * width);
        (0..N).for_each(|i| group[i] = (bits >> (i as u32 * width)) as u32 & mask);
    }
    rest.iter_mut().for_each(|number| *number = coder.bits((*number).into(), width) as u32);
}

/// Clamps a range of a damaged section to the valid ones; a function of its own, so that it does not slow
/// down valid ranges.
#[cold]
fn cut(range: u32, most: u32) -> u32 {
    range.clamp(1, most)
}

/// The difference of a value from the one before, small magnitudes first: 0, -1, 1, -2 become 0, 1, 2, 3.
#[inline]
fn difference(before: u32, value: u32) -> u32 {
    let difference = value.wrapping_sub(before) as i32;
    (difference << 1 ^ difference >> 31) as u32
}

/// The inverse of [`difference`]: the value itself.
#[inline]
fn differing(before: u32, difference: u32) -> u32 {
    before.wrapping_add(difference >> 1 ^ (difference & 1).wrapping_neg())
}

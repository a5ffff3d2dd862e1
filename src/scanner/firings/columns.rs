//! The azimuths of the firings: the tick of each, and the ticks from block to block.
//! FORMAT.md 8.2.

use super::Firings;
use super::timing::Span;
use crate::entropy::{AdaptiveBit, BitCoder, IntegerModel};
use crate::ground::angle::shorter_way;
use crate::ground::error::{Error, Result};
use crate::scanner::RangeImage;

/// The last difference, clamped to this magnitude, is the context of the next one.
const FAR: i64 = 2;
/// Number of such contexts.
const CONTEXTS: usize = 2 * FAR as usize + 1;

/// Adaptive models of the columns of firings.
#[derive(Clone)]
pub struct FiringColumnModel {
    is_full: AdaptiveBit,
    count: IntegerModel,
    /// Whether a column belongs to the same block as the one before it, by whether that one did.
    same_block: [AdaptiveBit; 2],
    /// Differences between a step of the ticks and the step before it.
    steps: Vec<IntegerModel>,
    /// Differences between a span and the step to the next block.
    spans: Vec<IntegerModel>,
    /// Whether a column has another span than the one before it in its block, and by how much it is longer.
    has_own_span: AdaptiveBit,
    own_spans: IntegerModel,
    /// The number of the firing in its block, by whether the column before it belongs to the same block.
    firing: [AdaptiveBit; 2],
}

impl Default for FiringColumnModel {
    fn default() -> Self {
        FiringColumnModel {
            is_full: AdaptiveBit::default(),
            count: IntegerModel::default(),
            same_block: Default::default(),
            steps: vec![IntegerModel::default(); CONTEXTS],
            spans: vec![IntegerModel::default(); CONTEXTS],
            has_own_span: AdaptiveBit::default(),
            own_spans: IntegerModel::default(),
            firing: Default::default(),
        }
    }
}

fn context(difference: i64) -> usize {
    (difference.clamp(-FAR, FAR) + FAR) as usize
}

impl FiringColumnModel {
    /// Codes whether every cell is a record, the ticks of the columns, and their spans if the timing is
    /// interpolated.
    ///
    /// # Errors
    /// If there are more columns than `most`, or a value is out of range.
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        scanner: &Firings,
        image: &mut RangeImage,
        most: u64,
    ) -> Result<()> {
        image.is_full = self.is_full.code(coder, image.is_full);
        let (columns, spans) = (&mut image.columns, &mut image.spans);
        let count = self.count.code(coder, columns.len() as u64);
        if count > most {
            return Err(Error::over_limit("columns of the range image", count, most));
        }
        let interpolated = scanner.build.timing.is_interpolated();
        let turn = i64::from(scanner.build.ticks);
        if !C::ENCODES {
            columns.clear();
        }
        let (mut last_tick, mut last_step, mut change) = (0i64, 0i64, 0i64);
        let mut was_same = false;
        // The block of each column.
        let mut blocks = Vec::new();
        for column in 0..count as usize {
            if coder.is_exhausted() {
                return Ok(());
            }
            let tick = if C::ENCODES { i64::from(columns[column]) } else { 0 };
            let same = interpolated
                && self.same_block[usize::from(was_same)]
                    .code(coder, C::ENCODES && column > 0 && tick == last_tick);
            was_same = same;
            if !same {
                let step = shorter_way(tick - last_tick, turn);
                let difference = self.steps[context(change)].code_signed(coder, step.wrapping_sub(last_step));
                let step = last_step.wrapping_add(difference);
                change = difference;
                last_tick = last_tick.wrapping_add(step).rem_euclid(turn);
                last_step = step;
            }
            blocks.push(blocks.last().map_or(0, |block| block + usize::from(!same)));
            if !C::ENCODES {
                columns.push(last_tick as u32);
            }
        }
        if interpolated { self.code_spans(coder, turn, &blocks, columns, spans) } else { Ok(()) }
    }

    /// Codes the spans, given the ticks of the columns.
    fn code_spans<C: BitCoder>(
        &mut self,
        coder: &mut C,
        turn: i64,
        blocks: &[usize],
        columns: &[u32],
        spans: &mut Vec<u32>,
    ) -> Result<()> {
        let known = std::mem::take(spans);
        let (mut difference, mut last) = (0, 0i64);
        let mut next = 0;
        for (column, &block) in blocks.iter().enumerate() {
            if coder.is_exhausted() {
                return Ok(());
            }
            while next < blocks.len() && blocks[next] == block {
                next += 1;
            }
            let follows = column > 0 && blocks[column - 1] == block;
            let Span { ticks, firing } = Span::unpacked(known.get(column).copied().unwrap_or(0));
            let firing = u32::from(self.firing[usize::from(follows)].code(coder, firing == 1));
            if !follows {
                let expected = match columns.get(next) {
                    Some(&after) => (i64::from(after) - i64::from(columns[column])).rem_euclid(turn),
                    None => last,
                };
                difference = self.spans[context(difference)].code_signed(coder, i64::from(ticks) - expected);
                last = expected.wrapping_add(difference);
            } else if self.has_own_span.code(coder, i64::from(ticks) != last) {
                last = last.wrapping_add(self.own_spans.code_signed(coder, i64::from(ticks) - last));
            }
            let ticks = u32::try_from(last).ok().filter(|&ticks| i64::from(ticks) <= turn);
            let ticks = ticks.ok_or_else(|| Error::corrupt("columns: a span of more than a turn"))?;
            spans.push(Span { ticks, firing }.packed());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::entropy::{ArithmeticDecoder, ArithmeticEncoder};
    use crate::scanner::CoordinateGrid;
    use crate::scanner::firings::{Build, Laser, Origin, Recipe, Timing};

    /// A scanner of two lasers and blocks of two firings.
    fn scanner() -> Firings {
        let build = Build {
            recipe: Recipe::RoboSense,
            ticks: 36_000,
            range_step_um: 2500,
            coordinates: CoordinateGrid::Float32,
            origin: Origin::default(),
            timing: Timing::Parts(vec![0, 1 << 22, 1 << 23, 3 << 22]),
            mounting: None,
        };
        Firings::new(build, vec![Laser::default(); 2], vec![0, 1])
    }

    proptest! {
        #[test]
        fn any_columns_come_back(
            columns in prop::collection::vec((any::<bool>(), 0u32..36_000, 0u32..60, 0u32..2), 0..60),
            is_full: bool,
        ) {
            // Some columns have the tick of the one before, as in a block, but not always its span.
            let mut last = 0;
            let ticks = columns.iter().map(|&(is_same, tick, ..)| {
                last = if is_same { last } else { tick };
                last
            });
            let mut image = RangeImage::new(2, ticks.collect());
            image.spans = columns.iter().map(|&(_, _, ticks, firing)| Span { ticks, firing }.packed()).collect();
            image.is_full = is_full;
            let mut encoder = ArithmeticEncoder::default();
            let mut coded = image.clone();
            FiringColumnModel::default().code(&mut encoder, &scanner(), &mut coded, 100).unwrap();
            let bytes = encoder.finish();
            let mut decoded = RangeImage::new(2, Vec::new());
            let mut decoder = ArithmeticDecoder::new(&bytes);
            FiringColumnModel::default().code(&mut decoder, &scanner(), &mut decoded, 100).unwrap();
            prop_assert_eq!((&decoded.columns, &decoded.spans), (&image.columns, &image.spans));
            prop_assert_eq!((&coded.spans, decoded.is_full), (&image.spans, is_full));
        }
    }
}

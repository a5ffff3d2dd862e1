//! The echoes, further returns of the cells, with their ranges and intensities. FORMAT.md 8.20.

use crate::container::SectionKind;
use crate::entropy::{AdaptiveBit, BitCoder, IntegerModel};
use crate::frame::fidelity::IntensityFidelity;
use crate::frame::parts::FrameParts;
use crate::frame::sections::SectionCoder;
use crate::ground::error::{Error, Result};
use crate::scanner::{Echo, MOST_STEPS};

/// The models of echoes.
#[derive(Clone, Default)]
pub struct EchoModels {
    /// Whether there is another echo. Contexts: whether the returns to the left and above have one, and
    /// whether it is the first.
    exists: [AdaptiveBit; 8],
    /// Whether its range equals that of the first return; context: whether that was so to the left.
    same_range: [AdaptiveBit; 2],
    /// Whether the last echo of the row predicts it better than the first return; context: the previous
    /// answer.
    by_last: [AdaptiveBit; 2],
    /// Differences of ranges, in steps: from the first return, and from the last echo of the row.
    ranges: [IntegerModel; 2],
    /// Whether its intensity equals that of the first return; context: whether the range does.
    same_intensity: [AdaptiveBit; 2],
    /// Whether both intensities are whole numbers; and their differences.
    is_whole: AdaptiveBit,
    intensities: IntegerModel,
}

/// The ranges before an echo, as contexts of its own.
#[derive(Default)]
struct Before {
    /// Whether the last echo has the range of its return.
    was_same: bool,
    /// Whether the last echo that could be predicted by one before it was.
    was_last: bool,
    /// The range of the last echo of the row, in steps.
    last: Option<u32>,
}

/// Upper limit of whole numbers that float32 represents exactly.
const MOST_WHOLE: f32 = 16_777_216.0;

impl EchoModels {
    /// Codes the echoes, if the image holds fewer returns than the frame has records in the image.
    ///
    /// # Errors
    /// If the section is damaged or holds another number of echoes.
    pub fn code<S: SectionCoder>(&mut self, sections: &mut S, frame: &mut FrameParts) -> Result<()> {
        let in_image = frame.cells.len() + frame.blanks.len();
        let missing = frame.in_image().saturating_sub(in_image);
        let has_intensity =
            frame.layout.intensity.is_some() && frame.parameters.intensity != IntensityFidelity::None;
        frame.echo_intensity.resize(missing, 0.0);
        sections.section(SectionKind::Echoes, missing > 0, |coder| {
            self.code_echoes(coder, (missing, has_intensity), frame)
        })
    }

    fn code_echoes<C: BitCoder>(
        &mut self,
        coder: &mut C,
        (missing, has_intensity): (usize, bool),
        frame: &mut FrameParts,
    ) -> Result<()> {
        let width = frame.occupancy.columns() as u32;
        let mut known = std::mem::take(&mut frame.image.echoes).into_iter().peekable();
        let mut echoes: Vec<Echo> = Vec::with_capacity(if C::ENCODES { missing } else { 0 });
        let mut above = vec![false; width as usize];
        let (mut row, mut left, mut before) = (u32::MAX, false, Before::default());
        for &cell in &frame.cells {
            if coder.is_exhausted() {
                break;
            }
            if cell / width != row {
                (row, left, before.last) = (cell / width, false, None);
            }
            let column = (cell % width) as usize;
            let first_steps = frame.image.steps.cells()[cell as usize];
            let first_intensity = frame.intensity.cells()[cell as usize];
            let mut count = 0usize;
            loop {
                let place = usize::from(left) + 2 * usize::from(above[column]) + 4 * usize::from(count > 0);
                let next = known.next_if(|echo| echo.cell == cell);
                if echoes.len() >= missing || !self.exists[place].code(coder, next.is_some()) {
                    break;
                }
                let wanted = next.map_or(0, |echo| echo.steps);
                let steps = self.code_steps(coder, &mut before, first_steps, wanted)?;
                if has_intensity {
                    let value = &mut frame.echo_intensity[echoes.len()];
                    *value = self.code_intensity(coder, before.was_same, first_intensity, *value);
                }
                echoes.push(Echo { cell, steps });
                count += 1;
            }
            left = count > 0;
            above[column] = left;
        }
        if echoes.len() != missing {
            return Err(Error::corrupt("the range image holds another number of records than the frame"));
        }
        frame.image.echoes = echoes;
        Ok(())
    }

    /// Codes the range of an echo, given that of its return.
    fn code_steps<C: BitCoder>(
        &mut self,
        coder: &mut C,
        before: &mut Before,
        first_steps: u32,
        wanted: u32,
    ) -> Result<u32> {
        let is_same = self.same_range[usize::from(before.was_same)].code(coder, wanted == first_steps);
        before.was_same = is_same;
        let mut steps = first_steps;
        if !is_same {
            let mut from = first_steps;
            let mut by_last = false;
            if let Some(last) = before.last {
                let is_nearer = wanted.abs_diff(last) < wanted.abs_diff(first_steps);
                by_last = self.by_last[usize::from(before.was_last)].code(coder, is_nearer);
                before.was_last = by_last;
                from = if by_last { last } else { first_steps };
            }
            let difference = i64::from(wanted) - i64::from(from);
            let difference = self.ranges[usize::from(by_last)].code_signed(coder, difference);
            let decoded = i64::from(from).wrapping_add(difference);
            if !(1..=i64::from(MOST_STEPS)).contains(&decoded) {
                return Err(Error::corrupt("echoes: a range is out of range"));
            }
            steps = decoded as u32;
        }
        before.last = Some(steps);
        Ok(steps)
    }

    fn code_intensity<C: BitCoder>(
        &mut self,
        coder: &mut C,
        same_range: bool,
        first: f32,
        value: f32,
    ) -> f32 {
        let is_same = value.to_bits() == first.to_bits();
        if self.same_intensity[usize::from(same_range)].code(coder, is_same) {
            return first;
        }
        let whole =
            |value: f32| value.fract() == 0.0 && value.abs() < MOST_WHOLE && value.to_bits() != 1 << 31;
        if whole(first) && self.is_whole.code(coder, whole(value)) {
            let difference = self.intensities.code_signed(coder, value as i64 - first as i64);
            return (first as i64).wrapping_add(difference) as f32;
        }
        f32::from_bits(coder.code_plain(value.to_bits().into(), 32) as u32)
    }
}

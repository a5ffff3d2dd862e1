//! The heights of a beam for which its z are reproduced exactly.

use pulp::NullaryFnOnce;

use super::single_precision::SingleBeam;
use crate::ground::lanes::{dispatch, lanes};
use crate::scanner::AT_ONCE;

/// The step, in metres, of the first search, and the number of steps on each side of the mean.
const STEP: f64 = 2.5e-10;
const REACH: f64 = 800.0;

/// The data that determine the height of a beam: ranges before any offset is added, and z.
pub(super) struct Heights {
    metres: Vec<f64>,
    z: Vec<f64>,
    /// The maximum distance from z of values that round to it.
    tolerances: Vec<f64>,
}

/// The result of counting the exact z at each height on the grid.
struct Counted {
    /// The height that each point implies.
    remaining: Vec<f64>,
    /// The largest number of points that are exact at one height, and the range of such heights.
    most: usize,
    best: [f64; 2],
}

impl Heights {
    /// Collects ranges and z.
    pub fn new(points: &[(f64, f32)]) -> Self {
        let half_step = |z: f32| {
            let next = f32::from_bits(z.abs().to_bits() + 1);
            0.5 * (f64::from(next) - f64::from(z.abs()))
        };
        Heights {
            metres: points.iter().map(|(metres, _)| *metres).collect(),
            z: points.iter().map(|(_, z)| f64::from(*z)).collect(),
            tolerances: points.iter().map(|(_, z)| half_step(*z)).collect(),
        }
    }

    /// The number of exact z at the best height on the grid.
    pub fn right(&self, beam: &SingleBeam) -> usize {
        dispatch(Counting { beam, heights: self }).most
    }

    /// The number of exact z at the best of all heights, and that height.
    pub fn best(&self, beam: &SingleBeam) -> (usize, f64) {
        /// Steps on each side of the best heights on the grid within which the best of all heights is
        /// searched for.
        const NEAR: f64 = 8.0;
        let Counted { remaining, best: [low, high], .. } = dispatch(Counting { beam, heights: self });
        let [start, end] = [low - NEAR * STEP, high + NEAR * STEP];
        let mut open = 0;
        // The ends of the interval of heights for each point: one exact point more, or one fewer.
        let mut ends: Vec<(f64, i32)> = Vec::new();
        for (height, tolerance) in remaining.into_iter().zip(&self.tolerances) {
            let (low, high) = (height - tolerance, height + tolerance);
            open += i32::from(low < start && start <= high);
            if low >= start && low < end {
                ends.push((low, 1));
            }
            if high >= start && high < end {
                ends.push((high, -1));
            }
        }
        ends.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        let (mut most, mut middle) = (open, 0.5 * (low + high));
        for (place, (end, change)) in ends.iter().enumerate() {
            open += change;
            if open > most {
                let next = ends.get(place + 1).map_or(*end, |next| next.0);
                (most, middle) = (open, 0.5 * (end + next));
            }
        }
        (most.unsigned_abs() as usize, middle)
    }
}

/// The arguments of the count, for a function compiled for several vector units.
struct Counting<'a> {
    beam: &'a SingleBeam,
    heights: &'a Heights,
}

impl NullaryFnOnce for Counting<'_> {
    type Output = Counted;

    #[inline(always)]
    fn call(self) -> Counted {
        let Counting { beam, heights: Heights { metres, z, tolerances } } = self;
        let beam = *beam;
        let mut remaining = vec![0.0; z.len()];
        for (height, (metres, z)) in remaining.iter_mut().zip(metres.iter().zip(z)) {
            *height = z - f64::from(beam.distance(*metres) * beam.sine);
        }
        let (blocks, rest) = remaining.as_chunks::<AT_ONCE>();
        let (of_blocks, of_rest) = tolerances.as_chunks::<AT_ONCE>();
        let mut sums = [0.0; AT_ONCE];
        for block in blocks {
            sums = lanes(|i| sums[i] + block[i]);
        }
        let mean = sums.iter().chain(rest).sum::<f64>() / remaining.len() as f64;
        let place =
            |height: f64| ((height - mean) * (1.0 / STEP) + REACH).clamp(0.0, 2.0 * REACH + 1.0) as i32;
        // For each height, the number of points that become exact minus the number that cease to be.
        let mut changes = [0i32; 2 * REACH as usize + 2];
        for (heights, tolerances) in blocks.iter().zip(of_blocks) {
            let low: [i32; AT_ONCE] = lanes(|i| place(heights[i] - tolerances[i]));
            let high: [i32; AT_ONCE] = lanes(|i| place(heights[i] + tolerances[i]));
            for lane in 0..AT_ONCE {
                changes[low[lane] as usize] += 1;
                changes[high[lane] as usize] -= 1;
            }
        }
        for (height, tolerance) in rest.iter().zip(of_rest) {
            changes[place(height - tolerance) as usize] += 1;
            changes[place(height + tolerance) as usize] -= 1;
        }
        let (mut right, mut most, mut best) = (0, 0, [0; 2]);
        for (place, change) in changes.iter().enumerate() {
            right += change;
            if right > most {
                (most, best) = (right, [place; 2]);
            } else if right == most && best[1] + 1 == place {
                best[1] = place;
            }
        }
        let height = |place: usize| mean + (place as f64 - REACH) * STEP;
        Counted {
            remaining,
            most: most.unsigned_abs() as usize,
            best: [height(best[0]), height(best[1] + 1)],
        }
    }
}

//! Information in the residuals of the least-squares fit: neighbouring ones are similar, and surfaces of some
//! intensities are measured with a bias, and with more noise. FORMAT.md 7.4.

use crate::ground::lanes::LANES;
use crate::models::quantise::signed_level;
use crate::models::range::site::intensity_change;

/// Number of residuals to the left that the filter uses, and of those in the row above: from three columns to
/// the left to four to the right.
const LEFT: usize = 12;
const ABOVE: usize = 8;
const ABOVE_TO_THE_LEFT: usize = 3;
/// The filter's learning rate, and the value added to the power of its input, in square steps.
const FILTER_RATE: f32 = 0.015;
const LEAST_POWER: f32 = 20.0;
/// Limits in multiples of the quartile: of residuals, and of the errors from which the filter and the offsets
/// learn.
const MOST_RESIDUAL: f32 = 5.0;
const MOST_ERROR: f32 = 2.0;
/// The lower quartile of the errors' magnitudes, in steps: its initial value, its minimum, and how far it
/// moves after an error above and below it, so that three errors are above for each one below.
const FIRST_QUARTILE: f32 = 8.0;
const LEAST_QUARTILE: f32 = 0.5;
const QUARTILE_UP: f32 = 0.0125;
const QUARTILE_DOWN: f32 = 0.0375;
/// Classes of intensities for the offsets: half octaves.
const HALF_OCTAVES: usize = 16;
const OFFSET_RATE: f32 = 0.003;
/// Classes of intensities, and of their differences from the one to the left, for the noise.
const OCTAVES: usize = 8;
const CHANGES: usize = 8;
const NOISE_RATE: f32 = 0.01;
/// A miss counts as at most this multiple of the expected one.
const MOST_RATIO: f32 = 4.0;

/// The adaptive models of the residuals.
#[derive(Clone)]
pub struct Residuals {
    /// The weights of the filter.
    weights: Inputs,
    quartile: f32,
    offsets: [[f32; HALF_OCTAVES]; HALF_OCTAVES],
    noise: [f32; OCTAVES * CHANGES],
}

/// One number for each input of the filter: the residuals to the left, the farthest first, then those above.
type Inputs = [[f32; LANES]; INPUTS / LANES];
/// Number of inputs of the filter.
pub const INPUTS: usize = LEFT + ABOVE;

impl Default for Residuals {
    fn default() -> Self {
        Residuals {
            weights: Inputs::default(),
            quartile: FIRST_QUARTILE,
            offsets: [[0.0; HALF_OCTAVES]; HALF_OCTAVES],
            noise: [1.0; OCTAVES * CHANGES],
        }
    }
}

/// The residuals of the row so far and of the row above, in steps.
pub struct Rows {
    /// The residuals in the order of the returns, after as many zeros as the filter has inputs to the left.
    left: Vec<f32>,
    /// The number of these.
    end: usize,
    /// The residuals by column, with a margin on both sides: of the row above, and of the current one as far
    /// as it is coded.
    above: Vec<f32>,
    here: Vec<f32>,
}

impl Rows {
    pub fn new(columns: usize) -> Self {
        let row = vec![0.0; columns + ABOVE];
        Rows { left: vec![0.0; columns + LEFT], end: LEFT, above: row.clone(), here: row }
    }

    pub fn start_row(&mut self) {
        self.end = LEFT;
        std::mem::swap(&mut self.above, &mut self.here);
        self.here.fill(0.0);
    }

    #[inline(always)]
    fn around(&self, column: usize) -> Inputs {
        let (left, above) = (&self.left[self.end - LEFT..self.end], &self.above[column..column + ABOVE]);
        let mut inputs = Inputs::default();
        inputs[..LEFT / LANES].copy_from_slice(left.as_chunks().0);
        inputs[LEFT / LANES..].copy_from_slice(above.as_chunks().0);
        inputs
    }

    #[inline(always)]
    fn push(&mut self, column: usize, residual: f32) {
        self.left[self.end] = residual;
        self.end += 1;
        self.here[column + ABOVE_TO_THE_LEFT] = residual;
    }
}

/// The classes of a cell by its intensity and the one to the left.
#[derive(Clone, Copy)]
pub struct Classes {
    half_octaves: (usize, usize),
    noise: usize,
}

impl Classes {
    /// The classes of the cell in this column, where `levels` are the context levels of the row's
    /// intensities; 0 = none.
    #[inline(always)]
    pub fn of(levels: &[u16], column: usize) -> Self {
        let own = levels[column];
        let west = if column > 0 { levels[column - 1] } else { 0 };
        let half_octave = |level: u16| signed_level(i32::from(level)) - signed_level(0);
        let octave = (own | 1).ilog2() as usize;
        let noise = octave.min(OCTAVES - 1) * CHANGES + intensity_change(own, west);
        Classes { half_octaves: (half_octave(own), half_octave(west)), noise }
    }
}

/// The information in the residuals around a cell.
pub struct Hint {
    /// An offset for the least-squares prediction, in steps.
    pub offset: f32,
    inputs: Inputs,
    classes: Classes,
}

impl Hint {
    /// The residuals around the cell, in steps: those to the left, the farthest first, then those above.
    pub fn inputs(&self) -> &[f32] {
        self.inputs.as_flattened()
    }
}

impl Residuals {
    #[inline(always)]
    pub fn hint(&self, rows: &Rows, column: usize, classes: Classes) -> Hint {
        let inputs = rows.around(column);
        let (own, west) = classes.half_octaves;
        let offset = sum_of_products(&self.weights, &inputs) + self.offsets[own][west];
        Hint { offset, inputs, classes }
    }

    /// The expected miss at a cell, given the mean of its surroundings, `expected`: surfaces of some
    /// intensities are noisier than others.
    #[inline(always)]
    pub fn expected_miss(&self, hint: &Hint, expected: i32) -> u32 {
        (expected as f32 * self.noise[hint.classes.noise]) as i32 as u32
    }

    /// Learns from a cell's miss of `miss` steps, where the surroundings had `expected` sixteenths of a step.
    #[inline(always)]
    pub fn learn_noise(&mut self, hint: &Hint, miss: i32, expected: i32) {
        let noise = &mut self.noise[hint.classes.noise];
        let ratio = ((24 * miss) as f32 / (expected + 8) as f32).min(MOST_RATIO);
        *noise += (ratio - *noise) * NOISE_RATE;
    }

    /// Learns from a cell whose range differed from the least-squares prediction by `residual` steps.
    #[inline(always)]
    pub fn learn(&mut self, rows: &mut Rows, column: usize, hint: &Hint, residual: f32) {
        let (own, west) = hint.classes.half_octaves;
        let quartile = self.quartile;
        let error = residual - hint.offset;
        let limited = error.clamp(-MOST_ERROR * quartile, MOST_ERROR * quartile);
        let power = sum_of_products(&hint.inputs, &hint.inputs) + LEAST_POWER;
        let change = FILTER_RATE * limited / power;
        for (weights, inputs) in self.weights.iter_mut().zip(&hint.inputs) {
            for lane in 0..LANES {
                weights[lane] += change * inputs[lane];
            }
        }
        self.offsets[own][west] += limited * OFFSET_RATE;
        self.quartile = if error.abs() > quartile {
            quartile + QUARTILE_UP
        } else {
            (quartile - QUARTILE_DOWN).max(LEAST_QUARTILE)
        };

        rows.push(column, residual.clamp(-MOST_RESIDUAL * quartile, MOST_RESIDUAL * quartile));
    }
}

/// The sum of the products, lane by lane.
#[inline(always)]
fn sum_of_products(a: &Inputs, b: &Inputs) -> f32 {
    let mut sums = [0.0; LANES];
    for (a, b) in a.iter().zip(b) {
        for lane in 0..LANES {
            sums[lane] += a[lane] * b[lane];
        }
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3])
}

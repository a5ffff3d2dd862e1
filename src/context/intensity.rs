//! The intensities: levels of a grid such as hundredths, each bit of a level mixed from counters
//! in several contexts of the neighbours' levels.

use super::least_squares::LeastSquares;
use super::quantise::Levels;
use crate::entropy::{AdaptiveBit, BitCoder, IntegerModel, MixedBits};
use crate::varint::{unzigzag, zigzag};

/// How many levels make 1.0, in the files of known scanners: hundredths (KITTI), 256ths
/// (KITTI-360), 255ths, whole numbers (nuScenes, many PCD files).
const SCALES: [u32; 4] = [100, 256, 255, 1];
/// Levels have at most this many bits.
const MOST_BITS: u32 = 9;

/// The grid on which the intensities of a frame lie.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct IntensityScale {
    /// Levels that make 1.0; 0 if the intensities lie on no known grid.
    per_unit: u32,
    /// Bits of the highest level.
    bits: u32,
    /// Whether some values of the frame lie off the grid.
    exceptions: bool,
}

impl IntensityScale {
    /// Finds the grid of a frame's intensities.
    pub fn of(intensity: &[f32]) -> Self {
        let off_grid = |per_unit: u32| intensity.iter().filter(|v| level_of(**v, per_unit).is_none()).count();
        let mut best = (usize::MAX, 0);
        for per_unit in SCALES {
            best = best.min((off_grid(per_unit), per_unit));
            if best.0 == 0 {
                break;
            }
        }
        let (misses, per_unit) = best;
        if misses * 20 > intensity.len() {
            return IntensityScale::default();
        }
        let highest = intensity.iter().filter_map(|v| level_of(*v, per_unit)).max().unwrap_or(0);
        let bits = (32 - highest.leading_zeros()).max(1);
        IntensityScale { per_unit, bits, exceptions: misses > 0 }
    }

    /// Codes the grid itself.
    pub fn code<C: BitCoder>(&mut self, coder: &mut C) {
        self.per_unit = coder.code_plain(u64::from(self.per_unit), 16) as u32;
        self.bits = (coder.code_plain(u64::from(self.bits), 4) as u32).clamp(1, MOST_BITS);
        self.exceptions = coder.code_plain(u64::from(self.exceptions), 1) == 1;
    }

    /// The level of a value, cut to 1 to 128, as a context; 1 for values off the grid.
    pub fn context_level(&self, value: f32) -> u16 {
        let level = level_of(value, self.per_unit).unwrap_or(0) >> self.bits.saturating_sub(7);
        level.min(127) as u16 + 1
    }
}

/// The level of a value, if it is that of a level exactly.
fn level_of(value: f32, per_unit: u32) -> Option<u32> {
    let level = f64::from(value) * f64::from(per_unit) + 0.5;
    if !(level >= 0.0 && level < f64::from(1u32 << MOST_BITS)) || per_unit == 0 {
        return None;
    }
    let level = level as u32;
    (value_of(level, per_unit).to_bits() == value.to_bits()).then_some(level)
}

/// The value at a level.
fn value_of(level: u32, per_unit: u32) -> f32 {
    (f64::from(level) / f64::from(per_unit)) as f32
}

/// The context levels (1 to 128, 0 = none) of the returns around one.
#[derive(Clone, Copy, Debug, Default)]
pub struct IntensityNeighbours {
    /// The last four returns of the row, nearest first.
    pub left: [u16; 4],
    /// In the row above: two columns left, one left, above, one right, two right.
    pub above: [u16; 5],
    /// Two rows above.
    pub above2: u16,
}

const VIEWS: usize = 5;
const OPINIONS: usize = 8;
/// Counters of each view: contexts share them by hashing.
const SLOT_BITS: u32 = 12;
const FEATURES: usize = 8;
/// Beams beyond this many share their contexts.
const ROW_CONTEXTS: usize = 128;
const ERROR_LEVELS: usize = 8;
const GRADIENT_LEVELS: usize = 8;
/// The level assumed where nothing is known.
const TYPICAL_LEVEL: u16 = 20;

/// What the coder has learned about intensities.
#[derive(Clone)]
pub struct IntensityModel {
    fits: Vec<LeastSquares<FEATURES>>,
    bits: MixedBits<VIEWS, OPINIONS>,
    levels: Levels<7>,
    exception: AdaptiveBit,
    off_grid: IntegerModel,
    /// Mean error along the row, and down each column.
    mean: f32,
    above: Vec<f32>,
    last_off_grid: u32,
}

impl Default for IntensityModel {
    fn default() -> Self {
        IntensityModel {
            fits: vec![LeastSquares::new(0.9995); 2],
            bits: MixedBits::new(
                [0; VIEWS],
                MOST_BITS as usize * ERROR_LEVELS * GRADIENT_LEVELS,
                0.25,
                0.0,
                0.003,
            ),
            levels: Levels::new(1.0, 1.8),
            exception: AdaptiveBit::default(),
            off_grid: IntegerModel::default(),
            mean: 4.0,
            above: Vec::new(),
            last_off_grid: 0,
        }
    }
}

impl IntensityModel {
    /// Begins a frame, or its strays, with `columns` columns.
    pub fn start_frame(&mut self, scale: &IntensityScale, columns: usize) {
        self.start_row();
        self.above.clear();
        self.above.resize(columns, 4.0);
        // A context has a counter for each place in the tree of a level's bits.
        if scale.per_unit > 0 {
            self.bits.grow(1 << (SLOT_BITS + scale.bits));
        }
    }

    /// Begins a row.
    pub fn start_row(&mut self) {
        self.mean = 4.0;
    }

    /// Codes one value. `row` and `column` only serve as contexts.
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        scale: &IntensityScale,
        near: &IntensityNeighbours,
        (row, column): (usize, usize),
        value: f32,
    ) -> f32 {
        if scale.per_unit == 0 {
            return self.code_off_grid(coder, value);
        }
        let level = level_of(value, scale.per_unit);
        if scale.exceptions && self.exception.code(coder, level.is_none()) {
            return self.code_off_grid(coder, value);
        }
        let level = self.code_level(coder, scale, near, (row, column), level.unwrap_or(0));
        value_of(level, scale.per_unit)
    }

    /// A value on no grid: the difference of its bits from the last one's.
    fn code_off_grid<C: BitCoder>(&mut self, coder: &mut C, value: f32) -> f32 {
        let difference = i64::from(value.to_bits()) - i64::from(self.last_off_grid);
        let difference = unzigzag(self.off_grid.code(coder, zigzag(difference)));
        self.last_off_grid = i64::from(self.last_off_grid).wrapping_add(difference) as u32;
        f32::from_bits(self.last_off_grid)
    }

    fn code_level<C: BitCoder>(
        &mut self,
        coder: &mut C,
        scale: &IntensityScale,
        near: &IntensityNeighbours,
        (row, column): (usize, usize),
        level: u32,
    ) -> u32 {
        let site = self.site(near, row, self.above[column]);
        let slots = site.views.map(|view| slot(view) << scale.bits);
        let mut node = 1usize;
        for i in (0..scale.bits).rev() {
            let set = i as usize * ERROR_LEVELS * GRADIENT_LEVELS + site.mixer_set;
            let places = slots.map(|slot| slot + node);
            let bit = self.bits.code_or_sure(coder, set, &places, level >> i & 1 == 1);
            node = node << 1 | usize::from(bit);
        }
        let level = node as u32 - (1 << scale.bits);
        self.learn(&site, column, f32::from((level >> scale.bits.saturating_sub(7)).min(127) as u16 + 1));
        level
    }

    fn site(&self, near: &IntensityNeighbours, row: usize, error_above: f32) -> Site {
        let or = |level: u16, other: u16| if level > 0 { level } else { other };
        let [_, nw, n, ne, nee] = near.above;
        let west = or(near.left[0], or(n, or(nw, or(ne, TYPICAL_LEVEL))));
        let west2 = or(near.left[1], west);
        let west4 = or(near.left[3], or(near.left[2], west2));
        let north = or(n, or(ne, or(nw, west)));
        let north_east = or(ne, north);
        let difference = |level: u16| f32::from(level) - f32::from(west);
        let features = [
            difference(west2),
            difference(north),
            difference(or(nw, north)),
            difference(north_east),
            difference(or(near.above2, north)),
            difference(or(near.left[2], west2)),
            difference(west4),
            difference(or(nee, north_east)),
        ];
        let fit = usize::from(near.above[2] > 0);
        let prediction = (f32::from(west) + self.fits[fit].predict(&features)).clamp(0.0, 127.0);
        let apart = |a: u16, b: u16| f32::from(a.abs_diff(b));
        let gradient = apart(west, north) + apart(west, west2) + apart(north, north_east);
        let error_level = self.levels.of(self.mean + 0.5 * error_above);
        let gradient_level = self.levels.of(gradient);
        let [w, ww] = [west, west2].map(usize::from);
        let row = row.min(ROW_CONTEXTS - 1);
        // In steps of 1.6 levels.
        let coarse = (prediction * 0.625) as usize;
        let mixer_set = error_level * GRADIENT_LEVELS + gradient_level;
        Site {
            views: [
                (w / 2) << 8 | ww / 2,
                w << 8 | ww,
                row << 8 | coarse,
                row << 8 | w,
                coarse << 6 | mixer_set,
            ],
            mixer_set,
            features,
            fit,
            west: f32::from(west),
            prediction,
        }
    }

    fn learn(&mut self, site: &Site, column: usize, level: f32) {
        let error = level - site.prediction;
        self.fits[site.fit].learn(&site.features, level - site.west, 1.0 / (9.0 + error * error));
        let magnitude = error.abs();
        self.mean = 0.6 * self.mean + 0.4 * magnitude;
        self.above[column] = 0.5 * self.above[column] + 0.5 * magnitude;
    }
}

/// A value to be coded.
#[derive(Clone)]
struct Site {
    views: [usize; VIEWS],
    mixer_set: usize,
    features: [f32; FEATURES],
    fit: usize,
    west: f32,
    prediction: f32,
}

/// The place of a context among the slots.
fn slot(view: usize) -> usize {
    ((view as u32).wrapping_mul(0x9e37_79b1) >> (32 - SLOT_BITS)) as usize
}

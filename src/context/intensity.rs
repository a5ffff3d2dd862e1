//! The intensities: levels of a grid such as hundredths, each bit of a level mixed from counters
//! in several contexts of the neighbours' levels.

use super::Depth;
use super::least_squares::LeastSquares;
use super::quantise::Levels;
use crate::entropy::{AdaptiveBit, BitCoder, Counter, IntegerModel, MixedBits};
use crate::range_image::Reference;
use crate::varint::{unzigzag, zigzag};

/// How many levels make 1.0, in the files of known scanners: hundredths (KITTI), 256ths
/// (KITTI-360), 255ths, whole numbers (nuScenes, many PCD files).
const SCALES: [u32; 4] = [100, 256, 255, 1];
/// Bits of such a number.
const SCALE_BITS: u32 = 16;
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
    /// Finds the grid of a frame's intensities, which may be one of `expected` levels a unit.
    pub fn of(intensity: &[f32], expected: Option<u32>) -> Self {
        let off_grid = |per_unit: u32| intensity.iter().filter(|v| level_of(**v, per_unit).is_none()).count();
        let mut best = (usize::MAX, 0);
        for per_unit in expected.into_iter().filter(|&levels| levels < 1 << SCALE_BITS).chain(SCALES) {
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

    /// Codes the grid itself, by what codes plain numbers of so many bits.
    pub fn code(&mut self, mut code_plain: impl FnMut(u32, u32) -> u32) {
        self.per_unit = code_plain(self.per_unit, SCALE_BITS);
        self.bits = code_plain(self.bits, 4).clamp(1, MOST_BITS);
        self.exceptions = code_plain(u32::from(self.exceptions), 1) == 1;
    }

    /// The level of a value, cut to 1 to 128, as a context; 1 for values off the grid.
    pub fn context_level(&self, value: f32) -> u16 {
        self.context_of(self.level_of(value).unwrap_or(0))
    }

    /// A level, cut to 1 to 128, as a context.
    #[inline]
    pub fn context_of(&self, level: u32) -> u16 {
        (level >> self.bits.saturating_sub(7)).min(127) as u16 + 1
    }

    /// The level of a value, if it is that of a level exactly.
    #[inline]
    pub fn level_of(&self, value: f32) -> Option<u32> {
        level_of(value, self.per_unit)
    }

    /// The value at a level.
    #[inline]
    pub fn value_of(&self, level: u32) -> f32 {
        value_of(level, self.per_unit)
    }

    /// Whether there is a grid at all.
    pub fn is_on_grid(&self) -> bool {
        self.per_unit > 0
    }

    /// Whether some values lie off the grid.
    pub fn has_exceptions(&self) -> bool {
        self.exceptions
    }

    /// Bits of the highest level: 1 to 9.
    pub fn bits(&self) -> u32 {
        self.bits
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
    /// In an earlier frame, if that has anything here.
    pub back: Option<IntensityReference>,
}

/// The context levels of an earlier frame around a return; 0 = none.
#[derive(Clone, Copy, Debug)]
pub struct IntensityReference {
    /// The same cell, and those to its left and right.
    pub same: [u16; 3],
    /// Where the surface seen here was then.
    pub moved: u16,
}

impl IntensityReference {
    /// Around a cell; none if no earlier frame has a return there.
    pub fn at(reference: &Reference, cell: (usize, usize)) -> Option<Self> {
        let same = [0, -1, 1].map(|right| reference.same.levels.beside(cell, 0, right));
        let moved = reference.moved.levels.beside(cell, 0, 0);
        (same[0] > 0 || moved > 0).then_some(IntensityReference { same, moved })
    }

    /// The same cell's, or else that of the moved surface.
    fn level(&self) -> u16 {
        if self.same[0] > 0 { self.same[0] } else { self.moved }
    }
}

const VIEWS: usize = 5;
const OPINIONS: usize = 8;
/// Counters of each view: contexts share them by hashing.
const SLOT_BITS: u32 = 12;
const FEATURES: usize = 8;
const REFERENCE_FEATURES: usize = 4;
const ALL_FEATURES: usize = FEATURES + REFERENCE_FEATURES;
/// Beams beyond this many share their contexts.
const ROW_CONTEXTS: usize = 128;
const ERROR_LEVELS: usize = 8;
const GRADIENT_LEVELS: usize = 8;
/// Least-squares fits: nothing above, and something.
const FITS: usize = 2;
/// Sets of weights; with a reference there are as many more.
const SETS: usize = MOST_BITS as usize * ERROR_LEVELS * GRADIENT_LEVELS;
/// The level assumed where nothing is known.
const TYPICAL_LEVEL: u16 = 20;

/// What the coder has learned about intensities.
#[derive(Clone)]
pub struct IntensityModel {
    fits: [LeastSquares<FEATURES>; FITS],
    /// The same with a reference, once there was one.
    reference_fits: Option<[LeastSquares<ALL_FEATURES>; FITS]>,
    bits: MixedBits<VIEWS, OPINIONS>,
    reference: Vec<Counter>,
    levels: Levels<7>,
    exception: AdaptiveBit,
    off_grid: IntegerModel,
    /// Mean error along the row, and down each column.
    mean: f32,
    above: Vec<f32>,
    last_off_grid: u32,
    /// How far to go; two views decide most bits if it is not far.
    depth: Depth,
}

/// Log odds from which on two views decide a bit: 1 to 33, or, to be quick, 1 to 2.7.
const SURE: f32 = 3.5;
const QUICKLY_SURE: f32 = 1.0;

impl Default for IntensityModel {
    fn default() -> Self {
        IntensityModel {
            fits: std::array::from_fn(|_| LeastSquares::new(0.9995)),
            reference_fits: None,
            bits: MixedBits::new([0; VIEWS], 2 * SETS, 0.25, 0.0, 0.003),
            reference: Vec::new(),
            levels: Levels::new(1.0, 1.8),
            exception: AdaptiveBit::default(),
            off_grid: IntegerModel::default(),
            mean: 4.0,
            above: Vec::new(),
            last_off_grid: 0,
            depth: Depth::default(),
        }
    }
}

impl IntensityModel {
    /// How far to go from now on.
    pub fn set_depth(&mut self, depth: Depth) {
        self.depth = depth;
    }

    /// Begins a frame, or its strays, with `columns` columns.
    pub fn start_frame(&mut self, scale: &IntensityScale, columns: usize) {
        self.start_row();
        self.above.clear();
        self.above.resize(columns, 4.0);
        // A context has a counter for each place in the tree of a level's bits.
        if scale.per_unit > 0 {
            let places = 1 << (SLOT_BITS + scale.bits);
            self.bits.grow(places);
            self.reference.resize(self.reference.len().max(places), Counter::default());
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
        if !scale.is_on_grid() {
            return self.code_off_grid(coder, value);
        }
        let level = scale.level_of(value);
        if scale.exceptions && self.exception.code(coder, level.is_none()) {
            return self.code_off_grid(coder, value);
        }
        let level = self.code_level(coder, scale, near, (row, column), level.unwrap_or(0));
        if C::ENCODES { value } else { scale.value_of(level) }
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
        if near.back.is_some() && self.reference_fits.is_none() {
            self.bits.spread_sets(SETS);
            self.reference_fits = Some(self.fits.each_ref().map(LeastSquares::widened));
        }
        let site = self.site(near, row, self.above[column]);
        let slots = site.views.map(|view| slot(view) << scale.bits);
        let reference = site.reference.as_ref().map(|reference| slot(reference.view) << scale.bits);
        let mut node = 1usize;
        for i in (0..scale.bits).rev() {
            let set = i as usize * ERROR_LEVELS * GRADIENT_LEVELS + site.mixer_set;
            let places = slots.map(|slot| slot + node);
            let bit = level >> i & 1 == 1;
            let sure = match (self.depth, i) {
                (Depth::Mixed | Depth::Deep, _) => SURE,
                // The lowest bit is all noise.
                (Depth::Quick, 0) => f32::NEG_INFINITY,
                (Depth::Quick, _) => QUICKLY_SURE,
            };
            let bit = match reference {
                None => self.bits.code_or_sure(coder, sure, set, &places, [], bit),
                Some(slot) => {
                    let extra = [&mut self.reference[slot + node]];
                    self.bits.code_or_sure(coder, sure, SETS + set, &places, extra, bit)
                }
            };
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
        let reference = near.back.map(|back| {
            let mut all = [0.0; ALL_FEATURES];
            all[..FEATURES].copy_from_slice(&features);
            let same = back.level();
            let [_, left, right] = back.same;
            let levels = [same, or(left, same), or(right, same), or(back.moved, same)];
            all[FEATURES..].copy_from_slice(&levels.map(difference));
            (all, same)
        });
        let change = match (&reference, &self.reference_fits) {
            (Some((all, _)), Some(fits)) => fits[fit].predict(all),
            _ => self.fits[fit].predict(&features),
        };
        let prediction = (f32::from(west) + change).clamp(0.0, 127.0);
        let apart = |a: u16, b: u16| f32::from(a.abs_diff(b));
        let gradient = apart(west, north) + apart(west, west2) + apart(north, north_east);
        let error_level = self.levels.of(self.mean + 0.5 * error_above);
        let gradient_level = self.levels.of(gradient);
        let [w, ww] = [west, west2].map(usize::from);
        let row = row.min(ROW_CONTEXTS - 1);
        // In steps of 1.6 levels.
        let coarse = (prediction * 0.625) as usize;
        let mixer_set = error_level * GRADIENT_LEVELS + gradient_level;
        let [pair, exact_pair, of_row, west_of_row, expected] =
            [(w / 2) << 8 | ww / 2, w << 8 | ww, row << 8 | coarse, row << 8 | w, coarse << 6 | mixer_set];
        // The first two are those that decide alone where they are sure.
        let views = match self.depth {
            Depth::Mixed | Depth::Deep => [pair, exact_pair, of_row, west_of_row, expected],
            Depth::Quick => [expected, pair, of_row, exact_pair, west_of_row],
        };
        Site {
            views,
            mixer_set,
            features,
            reference: reference
                .map(|(features, same)| SiteReference { features, view: usize::from(same) << 8 | coarse }),
            fit,
            west: f32::from(west),
            prediction,
        }
    }

    fn learn(&mut self, site: &Site, column: usize, level: f32) {
        let error = level - site.prediction;
        let (target, weight) = (level - site.west, 1.0 / (9.0 + error * error));
        match (&site.reference, &mut self.reference_fits) {
            (Some(reference), Some(fits)) => fits[site.fit].learn(&reference.features, target, weight),
            _ => self.fits[site.fit].learn(&site.features, target, weight),
        }
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
    reference: Option<SiteReference>,
    fit: usize,
    west: f32,
    prediction: f32,
}

/// What an earlier frame adds to it.
#[derive(Clone)]
struct SiteReference {
    /// Those of the site and of the reference.
    features: [f32; ALL_FEATURES],
    view: usize,
}

/// The place of a context among the slots.
fn slot(view: usize) -> usize {
    ((view as u32).wrapping_mul(0x9e37_79b1) >> (32 - SLOT_BITS)) as usize
}

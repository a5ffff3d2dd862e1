//! Finds the constants of single-precision arithmetic to their last bits, by maximising the share of points
//! that are reproduced exactly.
//!
//! No other criterion is as sharp: least squares treats rounding as noise, but each point reproduced exactly
//! is evidence that all its inputs are exact. z depends on the range alone, so it determines elevation, range
//! offset and height; x and y then determine the exact azimuths, and these the angle added to that of a tick,
//! and the tick from which the program counts.

use std::cmp::Reverse;
use std::f64::consts::TAU;
use std::ops::Range;

use pulp::NullaryFnOnce;

use super::Hdl64;
use super::beams::Point;
use super::heights::Heights;
use super::single_precision::{Refinement, SingleBeam};
use crate::ground::angle;
use crate::ground::floats::square;
use crate::ground::lanes::{dispatch, lanes};
use crate::scanner::{AT_ONCE, thinned};

/// Number of a beam's points that are used.
const SAMPLE: usize = 1500;
/// Minimum number of points for a conclusion.
const FEWEST_POINTS: usize = 100;
/// Azimuths, in degrees, whose float32 values are fine enough to determine the constants.
const SHARP: Range<f64> = 2.0..64.0;
/// The most informative azimuths, in degrees.
const FINEST: Range<f64> = 2.0..32.0;
/// Minimum share of points reproduced exactly; with fewer the arithmetic is not the file's.
const LEAST_SHARE: f64 = 0.5;

/// A point of a beam, and the integers from which it was computed.
#[derive(Clone, Copy)]
struct Site {
    tick: u32,
    /// The range before any offset is added.
    metres: f64,
    position: [f32; 3],
}

/// The refinements of the constants of beam `row` with which single-precision arithmetic reproduces its
/// points exactly. `None` if it does not.
pub(crate) fn sharpen(model: &Hdl64, row: usize, points: &[Point]) -> Option<Refinement> {
    let sites: Vec<Site> = thinned(points, SAMPLE).filter_map(|point| site(model, row, point)).collect();
    if sites.len() < FEWEST_POINTS {
        return None;
    }
    let rough = model.single_precision(row);
    let mut beam = rough;
    fit_height(&mut beam, &sites)?;
    let sharp: Vec<&Point> =
        points.iter().filter(|point| SHARP.contains(&point.azimuth.to_degrees())).collect();
    let sharp: Vec<Site> = thinned(&sharp, SAMPLE / 2).filter_map(|point| site(model, row, point)).collect();
    fit_azimuth(&mut beam, &sites, &sharp)?;
    Some(Refinement::between(&rough, &beam))
}

/// The site of a point that the f64 formula reproduces up to rounding.
fn site(model: &Hdl64, row: usize, point: &Point) -> Option<Site> {
    /// The largest effects of rounding, in metres along x, y and z.
    const NEAR: [f64; 3] = [1e-4, 1e-4, 2e-6];
    let (tick, steps) = model.invert(row, point.position)?;
    let formula = model.point(row, tick, steps);
    let near = (0..3).all(|axis| (formula[axis] - point.position[axis]).abs() < NEAR[axis]);
    let position = point.position.map(|v| v as f32);
    near.then(|| Site { tick, metres: model.metres(steps), position })
}

/// The centre of the values with the best score on a grid of `step` around `centre`, `reach` steps to each
/// side.
fn best_around(centre: f64, step: f64, reach: i32, mut score: impl FnMut(f64) -> usize) -> (usize, f64) {
    let (mut best, mut first, mut last) = (0, 0, 0);
    for place in -reach..=reach {
        let reached = score(centre + f64::from(place) * step);
        if reached > best {
            (best, first, last) = (reached, place, place);
        } else if reached == best {
            last = place;
        }
    }
    (best, centre + f64::from(first + last) / 2.0 * step)
}

/// Sets elevation, range offset and height so that z is exact.
fn fit_height(beam: &mut SingleBeam, sites: &[Site]) -> Option<()> {
    let sine = slope(sites) as f32;
    let cosine = (1.0 - f64::from(sine) * f64::from(sine)).sqrt() as f32;
    *beam = SingleBeam { cosine, range_offset: range_offset(sites), ..*beam };
    let heights = Heights::new(&sites.iter().map(|site| (site.metres, site.position[2])).collect::<Vec<_>>());
    let right = |beam: SingleBeam| {
        let heights = &heights;
        move |range_offset: f64| heights.right(&SingleBeam { range_offset, ..beam })
    };
    let of_sine = |ulps: i8| {
        let beam = SingleBeam { sine: moved(sine, ulps), ..*beam };
        let (reached, range_offset) = best_around(beam.range_offset, 4e-8, 6, right(beam));
        (reached, SingleBeam { range_offset, ..beam })
    };
    (_, *beam) = [-2, -1, 1, 2, 0].map(of_sine).into_iter().max_by_key(|(reached, _)| *reached)?;
    for (step, reach) in [(1e-8, 16), (2e-9, 10)] {
        beam.range_offset = best_around(beam.range_offset, step, reach, right(*beam)).1;
    }
    let best = |range_offset: f64| heights.best(&SingleBeam { range_offset, ..*beam });
    let (reached, range_offset) = best_around(beam.range_offset, 2.5e-10, 10, |offset| best(offset).0);
    beam.height = best(range_offset).1;
    beam.range_offset = range_offset;
    (reached as f64 >= LEAST_SHARE * sites.len() as f64).then_some(())
}

/// The float32 value `ulps` representable values after this one, away from zero.
#[inline(always)]
fn moved(value: f32, ulps: i8) -> f32 {
    f32::from_bits(value.to_bits().wrapping_add_signed(i32::from(ulps)))
}

/// The slope of z against the range.
fn slope(sites: &[Site]) -> f64 {
    let mut line = Line::default();
    sites.iter().for_each(|site| line.add(site.metres, f64::from(site.position[2]), 1.0));
    line.slope_and_offset().0
}

/// The mean range offset that x and y imply.
fn range_offset(sites: &[Site]) -> f64 {
    let mut line = Line::default();
    for Site { metres, position: [x, y, _], .. } in sites {
        // Rounding errors grow with the distance.
        line.add(*metres, libm::hypot(f64::from(*x), f64::from(*y)), 1.0 / (metres * metres));
    }
    let (cosine, offset) = line.slope_and_offset();
    offset / cosine
}

/// The information of x and y on the azimuths of some points: the interval of float32 azimuths that reproduce
/// them.
#[derive(Clone, Default)]
struct Azimuths {
    ticks: Vec<u32>,
    /// The distances along the beam.
    distances: Vec<f32>,
    lowest: Vec<f32>,
    highest: Vec<f32>,
}

impl Azimuths {
    /// The intervals of the points for which there is one.
    fn of(beam: &SingleBeam, sites: &[Site]) -> Self {
        let mut azimuths = Azimuths::default();
        for (site, [lowest, highest]) in sites.iter().zip(dispatch(Giving { beam, sites })) {
            if lowest <= highest {
                azimuths.ticks.push(site.tick);
                azimuths.distances.push(beam.distance(site.metres));
                azimuths.lowest.push(lowest);
                azimuths.highest.push(highest);
            }
        }
        azimuths
    }

    fn len(&self) -> usize {
        self.ticks.len()
    }

    /// These points followed by those of `others`.
    fn and(mut self, others: &Azimuths) -> Self {
        self.ticks.extend_from_slice(&others.ticks);
        self.distances.extend_from_slice(&others.distances);
        self.lowest.extend_from_slice(&others.lowest);
        self.highest.extend_from_slice(&others.highest);
        self
    }

    /// A sample of about `count` points.
    fn some(&self, count: usize) -> Self {
        Azimuths {
            ticks: thinned(&self.ticks, count).copied().collect(),
            distances: thinned(&self.distances, count).copied().collect(),
            lowest: thinned(&self.lowest, count).copied().collect(),
            highest: thinned(&self.highest, count).copied().collect(),
        }
    }

    fn degrees(&self, number: usize) -> f64 {
        (0.5 * (f64::from(self.lowest[number]) + f64::from(self.highest[number]))).to_degrees()
    }

    /// The error of the beam's azimuth, in degrees, if the beam is rotated by `turned` degrees before its
    /// sideways offset is applied.
    fn miss(&self, number: usize, beam: &SingleBeam, turned: f64) -> f64 {
        let miss = self.degrees(number) - (turned + beam.aside(self.distances[number]));
        miss - (miss / 360.0).round() * 360.0
    }

    /// Degrees by which a metre of sideways offset rotates the beam.
    fn slope(&self, number: usize, beam: &SingleBeam) -> f64 {
        beam.aside(self.distances[number]) / beam.side_offset
    }

    /// The angles by which the sideways offset rotates the beam, in degrees.
    fn sides(&self, beam: &SingleBeam) -> Vec<f64> {
        dispatch(Sides { beam, distances: &self.distances })
    }

    /// The number of points that are reproduced if the beam is rotated sideways by these angles.
    fn reproduced(&self, beam: &SingleBeam, sides: &[f64]) -> usize {
        dispatch(Reproduced { beam, azimuths: self, sides })
    }
}

/// The arguments of [`Azimuths::of`], for a function compiled for several vector units.
struct Giving<'a> {
    beam: &'a SingleBeam,
    sites: &'a [Site],
}

impl NullaryFnOnce for Giving<'_> {
    /// The lowest and the highest azimuth that reproduce each point; in reverse order if none does.
    type Output = Vec<[f32; 2]>;

    #[inline(always)]
    fn call(self) -> Vec<[f32; 2]> {
        let Giving { beam, sites } = self;
        let mut limits = vec![[0.0; 2]; sites.len()];
        let (blocks, rest) = sites.as_chunks::<AT_ONCE>();
        let (of_blocks, of_rest) = limits.as_chunks_mut::<AT_ONCE>();
        for (sites, limits) in blocks.iter().zip(of_blocks) {
            *limits = giving(beam, sites);
        }
        for (site, limits) in rest.iter().zip(of_rest) {
            [*limits] = giving(beam, std::array::from_ref(site));
        }
        limits
    }
}

#[inline(always)]
fn giving<const N: usize>(beam: &SingleBeam, sites: &[Site; N]) -> [[f32; 2]; N] {
    const REACH: i8 = 3;
    /// In radians: a little more than a turn.
    const LARGEST: f32 = 7.0;
    let [x, y]: [[f32; N]; 2] = [lanes(|i| sites[i].position[0]), lanes(|i| sites[i].position[1])];
    let distance: [f32; N] = lanes(|i| beam.distance(sites[i].metres));
    let near: [f32; N] = lanes(|i| {
        let turned = angle::atan2(f64::from(y[i]), f64::from(x[i]));
        (turned + if turned < 0.0 { TAU } else { 0.0 }) as f32
    });
    let (mut lowest, mut highest) = ([f32::INFINITY; N], [f32::NEG_INFINITY; N]);
    for ulps in -REACH..=REACH {
        let azimuth: [f32; N] = lanes(|i| moved(near[i], ulps));
        let formula: [[f32; 2]; N] = lanes(|i| beam.x_y(distance[i], azimuth[i]));
        let is_right: [bool; N] =
            lanes(|i| (azimuth[i] < LARGEST) & (formula[i][0] == x[i]) & (formula[i][1] == y[i]));
        lowest = lanes(|i| if is_right[i] & (azimuth[i] < lowest[i]) { azimuth[i] } else { lowest[i] });
        highest = lanes(|i| if is_right[i] & (azimuth[i] > highest[i]) { azimuth[i] } else { highest[i] });
    }
    lanes(|i| [lowest[i], highest[i]])
}

/// The arguments of [`Azimuths::sides`], for a function compiled for several vector units.
struct Sides<'a> {
    beam: &'a SingleBeam,
    distances: &'a [f32],
}

impl NullaryFnOnce for Sides<'_> {
    type Output = Vec<f64>;

    #[inline(always)]
    fn call(self) -> Vec<f64> {
        let beam = *self.beam;
        let mut sides = vec![0.0; self.distances.len()];
        for (side, distance) in sides.iter_mut().zip(self.distances) {
            *side = beam.aside(*distance);
        }
        sides
    }
}

/// The arguments of [`Azimuths::reproduced`], for a function compiled for several vector units.
struct Reproduced<'a> {
    beam: &'a SingleBeam,
    azimuths: &'a Azimuths,
    sides: &'a [f64],
}

impl NullaryFnOnce for Reproduced<'_> {
    type Output = usize;

    #[inline(always)]
    fn call(self) -> usize {
        let Reproduced { beam, azimuths: Azimuths { ticks, lowest, highest, .. }, sides } = self;
        let beam = *beam;
        let mut count = 0;
        for (((tick, side), lowest), highest) in ticks.iter().zip(sides).zip(lowest).zip(highest) {
            let azimuth = beam.azimuth(*tick, *side);
            count += u32::from((*lowest <= azimuth) & (azimuth <= *highest));
        }
        count as usize
    }
}

/// Sets the cosine, the sideways offset, the angle added to that of a tick, and the tick that counts as 0.
/// `sharp` are the sites with [`SHARP`] azimuths.
fn fit_azimuth(beam: &mut SingleBeam, sites: &[Site], sharp: &[Site]) -> Option<()> {
    /// Only correct constants give such a share of exact azimuths.
    const ENOUGH: f64 = 0.99;
    const ROUNDS: usize = 2;
    const SOME: usize = 600;
    let few: Vec<Site> = thinned(sites, 100).copied().collect();
    let right = |cosine: &f32| Azimuths::of(&SingleBeam { cosine: *cosine, ..*beam }, &few).len();
    beam.cosine = [1, -1, 0].map(|ulps| moved(beam.cosine, ulps)).into_iter().max_by_key(right)?;
    let (all, sharp) = (Azimuths::of(beam, sites), Azimuths::of(beam, sharp));
    if (all.len() as f64) < LEAST_SHARE * sites.len() as f64 || sharp.len() < FEWEST_POINTS {
        return None;
    }
    let all = all.and(&sharp);
    align_sideways(beam, &all);
    let some = all.some(SOME);
    let mut most = 0;
    for _ in 0..ROUNDS {
        for mut candidate in count_from(beam, &sharp) {
            turn(&mut candidate, &some, [1e-7, 1e-7], 16);
            turn(&mut candidate, &all, [1e-8, 2e-8], 12);
            let right = turn(&mut candidate, &all, [1e-9, 1e-8], 12);
            if right > most {
                (most, *beam) = (right, candidate);
            }
            if most as f64 > ENOUGH * all.len() as f64 {
                return Some(());
            }
        }
    }
    Some(())
}

/// Least squares for the sideways offset, before it is known how ticks are counted. Within an octave of the
/// azimuth all rounding errors may be to one side, so each octave has its own mean.
fn align_sideways(beam: &mut SingleBeam, azimuths: &Azimuths) {
    const OCTAVES: usize = 9;
    /// In degrees. Azimuths that wrap around are rounded like those near 360 degrees, although they are
    /// small.
    const SEAM: f64 = 16.0;
    let mut octaves = [Line::default(); OCTAVES];
    for number in (0..azimuths.len()).filter(|number| azimuths.degrees(*number) > SEAM) {
        let octave = (libm::log2(azimuths.degrees(number)) as usize).min(OCTAVES - 1);
        let formula = f64::from(azimuths.ticks[number]) * beam.tick_degrees + beam.azimuth_offset;
        octaves[octave].add(azimuths.slope(number, beam), azimuths.miss(number, beam, formula), 1.0);
    }
    let (mut product, mut square) = (0.0, 0.0);
    for (octave, line) in octaves.iter().enumerate().filter(|(_, line)| line.weight > 0.0) {
        let (of_octave, weight) = (line.moments(), weight(f64::from(1u32 << octave)));
        product += weight * of_octave.0;
        square += weight * of_octave.1;
    }
    if square > 0.0 {
        beam.side_offset += product / square;
    }
}

/// The weight of an azimuth (in degrees, above 0): rounding errors grow with the octave.
fn weight(degrees: f64) -> f64 {
    1.0 / square(degrees.max(SHARP.start))
}

/// Sums for the fit of a line by least squares.
#[derive(Clone, Copy, Default)]
struct Line {
    weight: f64,
    x: f64,
    y: f64,
    xx: f64,
    xy: f64,
}

impl Line {
    fn add(&mut self, x: f64, y: f64, weight: f64) {
        self.weight += weight;
        self.x += weight * x;
        self.y += weight * y;
        self.xx += weight * x * x;
        self.xy += weight * x * y;
    }

    /// Sums of (x - mean) * (y - mean), and of (x - mean)^2.
    fn moments(&self) -> (f64, f64) {
        (self.xy - self.x * self.y / self.weight, self.xx - self.x * self.x / self.weight)
    }

    /// Slope, and the value at x = 0.
    fn slope_and_offset(&self) -> (f64, f64) {
        let (product, square) = self.moments();
        let slope = product / square;
        (slope, (self.y - slope * self.x) / self.weight)
    }
}

/// Searches for the sideways offset and the added angle that make most azimuths exact, on a grid with these
/// steps in metres and degrees; returns the number of exact azimuths.
fn turn(beam: &mut SingleBeam, azimuths: &Azimuths, [length, angle]: [f64; 2], reach: i32) -> usize {
    // Calibration files contain decimals.
    let on_grid = |value: f64, step: f64| (value / step).round() * step;
    // A sideways offset rotates all azimuths, for which the added angle compensates.
    let slope = azimuths.sides(beam).iter().sum::<f64>() / (beam.side_offset * azimuths.len() as f64);
    let pivoted = |side_offset: f64| SingleBeam {
        side_offset,
        azimuth_offset: beam.azimuth_offset - (side_offset - beam.side_offset) * slope,
        ..*beam
    };
    let right = |side_offset: f64| {
        let beam = pivoted(side_offset);
        azimuths.reproduced(&beam, &azimuths.sides(&beam))
    };
    let (_, side_offset) = best_around(on_grid(beam.side_offset, length), length, reach, right);
    let sideways = pivoted(side_offset);
    let sides = azimuths.sides(&sideways);
    let right = |azimuth_offset: f64| azimuths.reproduced(&SingleBeam { azimuth_offset, ..sideways }, &sides);
    let (right, azimuth_offset) = best_around(on_grid(sideways.azimuth_offset, angle), angle, reach, right);
    *beam = SingleBeam { azimuth_offset, ..sideways };
    right
}

/// The ticks that may count as 0, each with the angle that is then added to the others: those that agree best
/// with how angles are rounded, the best first.
fn count_from(beam: &SingleBeam, azimuths: &Azimuths) -> Vec<SingleBeam> {
    /// Number of azimuths in a first pass, and number of ticks in a second.
    const SOME: usize = 300;
    const LIKELY: usize = 40;
    const CANDIDATES: usize = 4;
    const ANGLE_STEP: f64 = 1e-7;
    const REACH: i32 = 6;
    let formula = |number: usize| {
        (f64::from(azimuths.ticks[number]) - beam.first_tick as f64) * beam.tick_degrees + beam.azimuth_offset
    };
    let finest = (0..azimuths.len()).filter(|number| FINEST.contains(&azimuths.degrees(*number)));
    let mut misses: Vec<f64> = finest.map(|number| azimuths.miss(number, beam, formula(number))).collect();
    misses.sort_unstable_by(f64::total_cmp);
    let median = misses.get(misses.len() / 2).copied().unwrap_or(0.0);
    let counting_from = |first_tick: i64| {
        let turned = (first_tick - beam.first_tick) as f64 * beam.tick_degrees;
        SingleBeam { azimuth_offset: beam.azimuth_offset + median + turned, first_tick, ..*beam }
    };
    let some = azimuths.some(SOME);
    let (some_sides, sides) = (some.sides(beam), azimuths.sides(beam));
    let roughly = |tick: i64| (some.reproduced(&counting_from(tick), &some_sides), tick);
    // No scanner has beams with a larger sideways angle.
    let widest = i64::from(beam.ticks / 10);
    let mut ticks: Vec<(usize, i64)> = (-widest..=widest).map(roughly).collect();
    ticks.sort_unstable_by_key(|&(right, tick)| (Reverse(right), tick.abs()));
    let closely = |&(_, tick): &(usize, i64)| {
        let beam = counting_from(tick);
        let right = |azimuth_offset: f64| azimuths.reproduced(&SingleBeam { azimuth_offset, ..beam }, &sides);
        let (right, azimuth_offset) = best_around(beam.azimuth_offset, ANGLE_STEP, REACH, right);
        (right, SingleBeam { azimuth_offset, ..beam })
    };
    let mut candidates: Vec<(usize, SingleBeam)> = ticks.iter().take(LIKELY).map(closely).collect();
    candidates.sort_by_key(|(right, _)| Reverse(*right));
    candidates.into_iter().take(CANDIDATES).map(|(_, candidate)| candidate).collect()
}

//! Finds the constants of single-precision arithmetic to their last bits, by the share of points that they
//! give exactly.
//!
//! Nothing else can: least squares treats rounding as noise, but each point that comes out exactly proves
//! that everything that went into it is exact. z depends on the range alone, so it determines elevation,
//! range offset and height; x and y then determine the exact azimuths, and these the angle that is added to a
//! tick's, and the tick from which the program counts.

use std::cmp::Reverse;
use std::ops::Range;

use super::beams::{Point, thinned};
use super::single_precision::{Arithmetic, Refinement};
use crate::scanner::Hdl64;

/// Number of points of a beam that are used.
const SAMPLE: usize = 1500;
/// Fewer points are no evidence.
const FEWEST_POINTS: usize = 100;
/// Azimuths, in degrees, whose float32 values are fine enough to determine the constants.
const SHARP: Range<f64> = 2.0..64.0;
/// Azimuths, in degrees, that tell most.
const FINEST: Range<f64> = 2.0..32.0;
/// Arithmetic that gives a smaller share of the points exactly is not the file's.
const LEAST_SHARE: f64 = 0.5;

/// A point of a beam, and the integers from which it was computed.
struct Site {
    tick: u32,
    /// The range before any offset is added.
    metres: f64,
    position: [f32; 3],
}

/// The refinements of the constants of beam `row` with which single-precision arithmetic gives its points
/// exactly. `None` if it does not.
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

/// The site of a point that the f64 formula gives up to rounding.
fn site(model: &Hdl64, row: usize, point: &Point) -> Option<Site> {
    /// The largest effects of rounding, in metres along x, y and z.
    const NEAR: [f64; 3] = [1e-4, 1e-4, 2e-6];
    let (tick, steps) = model.invert(row, point.position)?;
    let formula = model.point(row, tick, steps);
    let near = (0..3).all(|axis| (formula[axis] - point.position[axis]).abs() < NEAR[axis]);
    let position = point.position.map(|v| v as f32);
    near.then(|| Site { tick, metres: model.metres(steps), position })
}

/// The centre of the best-scoring places on a grid of `step` around `centre`, `reach` steps to each side.
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
fn fit_height(beam: &mut Arithmetic, sites: &[Site]) -> Option<()> {
    let sine = slope(sites) as f32;
    let cosine = (1.0 - f64::from(sine) * f64::from(sine)).sqrt() as f32;
    *beam = Arithmetic { cosine, range_offset: range_offset(sites), ..*beam };
    let right = |beam: Arithmetic| {
        move |range_offset: f64| right_heights(&Arithmetic { range_offset, ..beam }, sites)
    };
    let of_sine = |ulps: i8| {
        let beam = Arithmetic { sine: moved(sine, ulps), ..*beam };
        let (reached, range_offset) = best_around(beam.range_offset, 4e-8, 6, right(beam));
        (reached, Arithmetic { range_offset, ..beam })
    };
    (_, *beam) = [-2, -1, 1, 2, 0].map(of_sine).into_iter().max_by_key(|(reached, _)| *reached)?;
    for (step, reach) in [(1e-8, 16), (2e-9, 10)] {
        beam.range_offset = best_around(beam.range_offset, step, reach, right(*beam)).1;
    }
    let exactly = |range_offset: f64| height(&Arithmetic { range_offset, ..*beam }, sites).0;
    let (reached, range_offset) = best_around(beam.range_offset, 2.5e-10, 10, exactly);
    beam.range_offset = range_offset;
    beam.height = height(beam, sites).1;
    (reached as f64 >= LEAST_SHARE * sites.len() as f64).then_some(())
}

/// The float32 value `ulps` places after this one, away from zero.
fn moved(value: f32, ulps: i8) -> f32 {
    f32::from_bits(value.to_bits().wrapping_add_signed(i32::from(ulps)))
}

/// The slope of z against the range.
fn slope(sites: &[Site]) -> f64 {
    let mut line = Line::default();
    sites.iter().for_each(|site| line.add(site.metres, f64::from(site.position[2]), 1.0));
    line.slope_and_offset().0
}

/// The average offset that x and y imply for the range.
fn range_offset(sites: &[Site]) -> f64 {
    let mut line = Line::default();
    for Site { metres, position: [x, y, _], .. } in sites {
        // Rounding errors grow with the distance.
        line.add(*metres, f64::from(*x).hypot(f64::from(*y)), 1.0 / (metres * metres));
    }
    let (cosine, offset) = line.slope_and_offset();
    offset / cosine
}

/// Half the distance to the next float32.
fn half_ulp(value: f32) -> f64 {
    let next = f32::from_bits(value.abs().to_bits() + 1);
    0.5 * (f64::from(next) - f64::from(value.abs()))
}

/// The height that remains for a point, and its tolerance.
fn remaining_height(beam: &Arithmetic, site: &Site) -> (f64, f64) {
    let z = site.position[2];
    (f64::from(z) - f64::from(beam.distance(site.metres) * beam.sine), half_ulp(z))
}

/// How many z are exact at the height that suits most of them, on a grid of heights.
fn right_heights(beam: &Arithmetic, sites: &[Site]) -> usize {
    /// In metres.
    const STEP: f64 = 2.5e-10;
    /// Number of heights on each side of the mean.
    const REACH: f64 = 800.0;
    let mean = sites.iter().map(|site| remaining_height(beam, site).0).sum::<f64>() / sites.len() as f64;
    // Number of points that become exact at a height, minus those that cease to be.
    let mut changes = [0i32; 2 * REACH as usize + 2];
    for site in sites {
        let (height, tolerance) = remaining_height(beam, site);
        let place = |height: f64| ((height - mean) / STEP + REACH).clamp(0.0, 2.0 * REACH + 1.0) as usize;
        changes[place(height - tolerance)] += 1;
        changes[place(height + tolerance)] -= 1;
    }
    let mut right = 0;
    let right_at = changes.iter().map(|change| {
        right += change;
        right
    });
    right_at.max().unwrap_or(0).unsigned_abs() as usize
}

/// The height at which most z are exact, and their number.
fn height(beam: &Arithmetic, sites: &[Site]) -> (usize, f64) {
    let ends = |site: &Site| {
        let (height, tolerance) = remaining_height(beam, site);
        [(height - tolerance, 1i32), (height + tolerance, -1)]
    };
    let mut ends: Vec<(f64, i32)> = sites.iter().flat_map(ends).collect();
    ends.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let (mut open, mut most, mut middle) = (0, 0, beam.height);
    for (place, (end, change)) in ends.iter().enumerate() {
        open += change;
        if open > most {
            let next = ends.get(place + 1).map_or(*end, |next| next.0);
            (most, middle) = (open, 0.5 * (end + next));
        }
    }
    (most.unsigned_abs() as usize, middle)
}

/// What x and y tell of the azimuth of a point: the float32 azimuths that give them.
#[derive(Clone, Copy)]
struct Azimuth {
    tick: u32,
    /// The distance along the beam.
    distance: f32,
    lowest: f32,
    highest: f32,
}

impl Azimuth {
    /// `None` if no azimuth does.
    fn new(beam: &Arithmetic, site: &Site) -> Option<Self> {
        const REACH: i8 = 3;
        let [x, y, _] = site.position;
        let distance = beam.distance(site.metres);
        let near = f64::from(y).atan2(f64::from(x)).rem_euclid(std::f64::consts::TAU) as f32;
        let mut right = (-REACH..=REACH)
            .map(|ulps| moved(near, ulps))
            .filter(|&azimuth| azimuth < 7.0 && beam.x_y(distance, azimuth) == [x, y]);
        let lowest = right.next()?;
        Some(Azimuth { tick: site.tick, distance, lowest, highest: right.next_back().unwrap_or(lowest) })
    }

    fn degrees(&self) -> f64 {
        (0.5 * (f64::from(self.lowest) + f64::from(self.highest))).to_degrees()
    }

    /// The error of the beam's azimuth, in degrees, if the beam is rotated by `turned` degrees before its
    /// sideways offset is applied.
    fn miss(&self, beam: &Arithmetic, turned: f64) -> f64 {
        let miss = self.degrees() - (turned + beam.aside(self.distance));
        miss - (miss / 360.0).round() * 360.0
    }

    /// Degrees by which a metre of sideways offset rotates the beam.
    fn slope(&self, beam: &Arithmetic) -> f64 {
        beam.aside(self.distance) / beam.side_offset
    }

    fn is_given(&self, beam: &Arithmetic, aside: f64) -> bool {
        let azimuth = beam.azimuth(self.tick, aside);
        self.lowest <= azimuth && azimuth <= self.highest
    }
}

/// Sets the cosine, the sideways offset, the angle added to that of a tick, and the tick that counts as 0.
/// `sharp` are the sites with [`SHARP`] azimuths.
fn fit_azimuth(beam: &mut Arithmetic, sites: &[Site], sharp: &[Site]) -> Option<()> {
    /// Only the right constants give such a share of exact azimuths.
    const ENOUGH: f64 = 0.99;
    const ROUNDS: usize = 2;
    const SOME: usize = 600;
    let few: Vec<&Site> = thinned(sites, 100).collect();
    let right = |cosine: &f32| {
        let beam = Arithmetic { cosine: *cosine, ..*beam };
        few.iter().filter(|site| Azimuth::new(&beam, site).is_some()).count()
    };
    beam.cosine = [1, -1, 0].map(|ulps| moved(beam.cosine, ulps)).into_iter().max_by_key(right)?;
    let azimuths =
        |sites: &[Site]| sites.iter().filter_map(|site| Azimuth::new(beam, site)).collect::<Vec<Azimuth>>();
    let (mut all, sharp) = (azimuths(sites), azimuths(sharp));
    if (all.len() as f64) < LEAST_SHARE * sites.len() as f64 || sharp.len() < FEWEST_POINTS {
        return None;
    }
    all.extend_from_slice(&sharp);
    align_sideways(beam, &all);
    let some: Vec<Azimuth> = thinned(&all, SOME).copied().collect();
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
/// azimuth all rounding errors may be to one side, so each octave has a mean of its own.
fn align_sideways(beam: &mut Arithmetic, azimuths: &[Azimuth]) {
    const OCTAVES: usize = 9;
    /// In degrees. Azimuths that wrap around are rounded like 360 degrees, although they are small.
    const SEAM: f64 = 16.0;
    let mut octaves = [Line::default(); OCTAVES];
    for azimuth in azimuths.iter().filter(|azimuth| azimuth.degrees() > SEAM) {
        let octave = (azimuth.degrees().log2() as usize).min(OCTAVES - 1);
        let formula = f64::from(azimuth.tick) * beam.tick_degrees + beam.azimuth_offset;
        octaves[octave].add(azimuth.slope(beam), azimuth.miss(beam, formula), 1.0);
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

/// The weight of an azimuth (in degrees, above 0): its rounding error grows with the octave.
fn weight(degrees: f64) -> f64 {
    (degrees.max(SHARP.start)).powi(-2)
}

/// Sums for fitting a line by least squares.
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

/// Searches for the sideways offset and the added angle that give most azimuths exactly, in the given steps
/// in metres and degrees; returns their number.
fn turn(beam: &mut Arithmetic, azimuths: &[Azimuth], [length, angle]: [f64; 2], reach: i32) -> usize {
    // Calibration files give decimals.
    let on_grid = |value: f64, step: f64| (value / step).round() * step;
    // A sideways offset rotates all azimuths, which the added angle compensates.
    let mut mean = Line::default();
    azimuths.iter().for_each(|azimuth| mean.add(azimuth.slope(beam), 0.0, 1.0));
    let slope = mean.x / mean.weight;
    let pivoted = |side_offset: f64| Arithmetic {
        side_offset,
        azimuth_offset: beam.azimuth_offset - (side_offset - beam.side_offset) * slope,
        ..*beam
    };
    let right = |side_offset: f64| {
        let beam = pivoted(side_offset);
        azimuths.iter().filter(|azimuth| azimuth.is_given(&beam, beam.aside(azimuth.distance))).count()
    };
    let (_, side_offset) = best_around(on_grid(beam.side_offset, length), length, reach, right);
    let sideways = pivoted(side_offset);
    let sides: Vec<f64> = azimuths.iter().map(|azimuth| sideways.aside(azimuth.distance)).collect();
    let right =
        |azimuth_offset: f64| count_given(&Arithmetic { azimuth_offset, ..sideways }, azimuths, &sides);
    let (right, azimuth_offset) = best_around(on_grid(sideways.azimuth_offset, angle), angle, reach, right);
    *beam = Arithmetic { azimuth_offset, ..sideways };
    right
}

/// How many azimuths are exact if the beam is rotated sideways by these angles.
fn count_given(beam: &Arithmetic, azimuths: &[Azimuth], sides: &[f64]) -> usize {
    azimuths.iter().zip(sides).filter(|(azimuth, side)| azimuth.is_given(beam, **side)).count()
}

/// The ticks that may count as 0, each with the angle that is then added to the others: those that agree best
/// with how angles are rounded, the best first.
fn count_from(beam: &Arithmetic, azimuths: &[Azimuth]) -> Vec<Arithmetic> {
    /// Number of azimuths for a first look, and number of ticks for a closer one.
    const SOME: usize = 300;
    const LIKELY: usize = 40;
    const CANDIDATES: usize = 4;
    const ANGLE_STEP: f64 = 1e-7;
    const REACH: i32 = 6;
    let formula = |azimuth: &Azimuth| {
        (f64::from(azimuth.tick) - beam.first_tick as f64) * beam.tick_degrees + beam.azimuth_offset
    };
    let finest = azimuths.iter().filter(|azimuth| FINEST.contains(&azimuth.degrees()));
    let mut misses: Vec<f64> = finest.map(|azimuth| azimuth.miss(beam, formula(azimuth))).collect();
    misses.sort_unstable_by(f64::total_cmp);
    let median = misses.get(misses.len() / 2).copied().unwrap_or(0.0);
    let counting_from = |first_tick: i64| {
        let turned = (first_tick - beam.first_tick) as f64 * beam.tick_degrees;
        Arithmetic { azimuth_offset: beam.azimuth_offset + median + turned, first_tick, ..*beam }
    };
    let sides = |azimuths: &[Azimuth]| -> Vec<f64> {
        azimuths.iter().map(|azimuth| beam.aside(azimuth.distance)).collect()
    };
    let some: Vec<Azimuth> = thinned(azimuths, SOME).copied().collect();
    let (some_sides, sides) = (sides(&some), sides(azimuths));
    let roughly = |tick: i64| (count_given(&counting_from(tick), &some, &some_sides), tick);
    // The beams of no scanner look farther sideways than this.
    let widest = i64::from(beam.ticks / 10);
    let mut ticks: Vec<(usize, i64)> = (-widest..=widest).map(roughly).collect();
    ticks.sort_unstable_by_key(|&(right, tick)| (Reverse(right), tick.abs()));
    let closely = |&(_, tick): &(usize, i64)| {
        let beam = counting_from(tick);
        let right =
            |azimuth_offset: f64| count_given(&Arithmetic { azimuth_offset, ..beam }, azimuths, &sides);
        let (right, azimuth_offset) = best_around(beam.azimuth_offset, ANGLE_STEP, REACH, right);
        (right, Arithmetic { azimuth_offset, ..beam })
    };
    let mut candidates: Vec<(usize, Arithmetic)> = ticks.iter().take(LIKELY).map(closely).collect();
    candidates.sort_by_key(|(right, _)| Reverse(*right));
    candidates.into_iter().take(CANDIDATES).map(|(_, candidate)| candidate).collect()
}

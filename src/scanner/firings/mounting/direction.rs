//! Finds the direction of azimuth 0 of a mounted scanner, and the recipe by which its points were rounded before they
//! were moved.
//!
//! Cones and ticks leave open by how many ticks a scanner is turned. The roundings tell it, as recipes round
//! positions before they are moved: a mounting that is fitted to the points of the right recipe in the right
//! direction reproduces nearly all coordinates; with others, a fifth to two thirds are missed. If the program did not
//! round positions, any direction is right.

use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::ops::Range;

use nalgebra::Vector3;
use rayon::prelude::*;

use super::numbers::{COARSE, FEW, Pair, least_squares, missed, unit_at};
use super::sums::{COMMON, SumsInSingle};
use super::{Mounting, TransformOrder};
use crate::ground::floats::{round_ties_even, square};
use crate::scanner::firings::arithmetic::{Arithmetic, TurnTable};
use crate::scanner::firings::recipe::Axes;
use crate::scanner::firings::{ANGLE_UNIT, Build, Firings, Laser, Recipe, THOUSANDTH};
use crate::scanner::{Return, median, thinned};

/// Number of points that are used for counting and comparing.
pub(super) const SAMPLE: usize = 8000;
/// A direction that misses no more than this part of what others miss is no chance.
pub(super) const WORTH: f64 = 0.91;

/// A measurement, and its position in the file.
pub(super) type Measurement = (Return, [f32; 3]);

/// Radians: how far the offsets of all lasers may be turned together.
const FARTHEST_OFFSET: f64 = 3.0 * PI / 180.0;

/// What the azimuth offsets of a scanner's lasers are multiples of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Offsets {
    /// Whole ticks.
    Ticks,
    /// Thousandths of degrees.
    Thousandths,
    /// Neither.
    Any,
}

impl Offsets {
    /// Radians by which all may be turned together: they remain multiples, or are rounded as before where a recipe
    /// adds angles in single precision.
    fn part(self) -> f64 {
        match self {
            Offsets::Ticks | Offsets::Thousandths => (THOUSANDTH as f64 * ANGLE_UNIT).to_radians(),
            Offsets::Any => COMMON,
        }
    }

    /// A laser, its offset so many parts greater.
    fn greater(self, laser: &Laser, parts: i32) -> Laser {
        let unit = self.part().to_degrees() / ANGLE_UNIT;
        Laser { azimuth: laser.azimuth + (f64::from(parts) * unit).round() as i64, ..*laser }
    }

    /// Number of parts of a tick that must be tried if any tick may be the first.
    fn parts(self, ticks: u32) -> i32 {
        match self {
            Offsets::Thousandths => (360e3 / f64::from(ticks)).ceil() as i32,
            Offsets::Ticks | Offsets::Any => 1,
        }
    }
}

/// Measurements of a scanner by their integers, up to the direction of azimuth 0.
pub(super) struct Seen {
    pub build: Build,
    pub lasers: Vec<Laser>,
    pub points: Vec<Measurement>,
    pub offsets: Offsets,
}

impl Seen {
    /// The scanner by a recipe, its azimuth offsets so many parts greater. The slots of its firings are not known
    /// yet.
    pub fn scanner(&self, recipe: Recipe, part: i32) -> Firings {
        let build = Build { recipe, ..self.build.clone() };
        let lasers = self.lasers.iter().map(|laser| self.offsets.greater(laser, part)).collect();
        Firings::new(build, lasers, (0..self.lasers.len() as u32).collect())
    }

    /// The measurements as positions.
    pub fn pairs(&self, scanner: &Firings) -> Vec<Pair> {
        self.points.iter().map(|(found, position)| (scanner.unrounded(found), *position)).collect()
    }

    /// The scanner by the recipe by which points were rounded before they were moved, the measurements with
    /// the ticks that it counts, and nearly its mounting. If the roundings tell no recipe, it is one in
    /// double precision.
    pub fn with_recipe(mut self, start: &Mounting) -> Option<(Firings, Self, Mounting)> {
        /// With one that misses no more than this part, no more recipes are tried.
        const SURE: f64 = 0.5;
        // Velodyne's offsets are whole ticks.
        let recipes = match (self.build.ticks, self.offsets) {
            (36_000, Offsets::Thousandths) => &OF_HESAI[..],
            (36_000, _) => &DIFFERENT,
            _ => &OF_OUSTER,
        };
        let mut tried: Vec<Direction> = Vec::new();
        let likely = if self.build.ticks == 36_000 { self.likely_ticks(start) } else { None };
        let likely = likely.unwrap_or_default();
        if self.offsets != Offsets::Ticks {
            let found = self.summed_in_single(&likely, start);
            if let Some((seen, direction)) = found.filter(|(_, found)| found.chance() < SURE) {
                self = seen;
                tried.push(direction);
            }
        }
        let parts = 0..self.offsets.parts(self.build.ticks);
        let all: Vec<u32> = (0..self.build.ticks).collect();
        for (ticks, &recipe) in
            [&likely, &all].into_iter().flat_map(|ticks| recipes.iter().map(move |recipe| (ticks, recipe)))
        {
            if tried.iter().any(|found| found.chance() < SURE) {
                break;
            }
            tried.extend(self.direction(recipe, (parts.clone(), ticks), start));
        }
        let double = tried.iter().find(|found| found.recipe == Recipe::DoubleYAhead);
        let double = double.map(|found| found.aligned(self.build.ticks));
        let best = tried.into_iter().min_by(|a, b| a.chance().total_cmp(&b.chance()));
        let best = best.filter(|best| best.chance() < WORTH).or(double)?;
        self = self.later(best.before.later);
        // Recipes that differ in a few roundings only have the same direction.
        let similar = Recipe::ALL
            .into_iter()
            .filter(|recipe| recipe.may_start_in_one_point() && recipe.axes() == best.recipe.axes());
        let few = thinned(&self.points, SAMPLE).copied().collect();
        let few = Seen { points: few, build: self.build.clone(), lasers: self.lasers.clone(), ..self };
        let similar = similar.filter_map(|recipe| {
            let scanner = few.scanner(recipe, best.before.part);
            let pairs = few.pairs(&scanner);
            let mounting = least_squares(&pairs, &best.mounting, &COARSE)?;
            let missed = missed(&mounting, &TransformOrder::ALL, thinned(&pairs, FEW).copied());
            Some((scanner, mounting, missed))
        });
        let (scanner, mounting, _) = similar.min_by_key(|(.., missed)| *missed)?;
        Some((scanner, self, mounting))
    }

    /// The same measurements by a scanner whose azimuth 0 is so many ticks before.
    pub fn later(mut self, later: u32) -> Self {
        self.points.iter_mut().for_each(|(found, _)| found.tick = (found.tick + later) % self.build.ticks);
        self
    }

    /// By how many ticks azimuth 0 of a recipe whose ticks are angles in single precision may be before that of
    /// the measurements, the likeliest first: the errors of these angles, of up to 2.4e-7 radians, show in the
    /// azimuths of the points, whatever the offsets of the lasers are. Empty if they do not.
    fn likely_ticks(&self, start: &Mounting) -> Option<Vec<u32>> {
        /// Metres: nearer points are not exact enough.
        const NEAREST: f64 = 1.0;
        /// By how many standard deviations a tick must be better than others. It is not more, as errors are much
        /// the same some ticks farther on.
        const CLEAR: f64 = 4.0;
        const MOST: usize = 16;
        let ticks = self.build.ticks;
        let scanner = self.scanner(Recipe::DoubleYAhead, 0);
        let few: Vec<Measurement> = thinned(&self.points, FEW).copied().collect();
        let pairs: Vec<Pair> =
            few.iter().map(|(found, position)| (scanner.unrounded(found), *position)).collect();
        let mounting = least_squares(&pairs, &start.turned(-FRAC_PI_2), &COARSE)?;
        // Of each point: its row, its tick, and by how many radians it is farther clockwise than these say.
        let errors = few.iter().zip(&pairs).filter_map(|((found, position), (point, _))| {
            let is_far = square(point[0]) + square(point[1]) > square(NEAREST);
            let off = mounting.off(point, position).filter(|_| is_far)?;
            Some((found.row as usize, found.tick, off.clockwise))
        });
        let mut errors: Vec<(usize, u32, f64)> = errors.collect();
        let mut of_rows = vec![(0.0, 0.0); self.lasers.len()];
        for (row, _, error) in &errors {
            of_rows[*row] = (of_rows[*row].0 + error, of_rows[*row].1 + 1.0);
        }
        for (row, _, error) in &mut errors {
            *error -= of_rows[*row].0 / of_rows[*row].1;
        }
        let rounding = |tick: u32| {
            let radians = f64::from(tick) * TAU / f64::from(ticks);
            f64::from(radians as f32) - radians
        };
        let roundings: Vec<f64> = (0..ticks).map(rounding).collect();
        let likeness = |first: u32| {
            let pairs =
                errors.iter().map(|(_, tick, error)| (roundings[((tick + first) % ticks) as usize], error));
            let (product, squares) = pairs.fold((0.0, 0.0), |(product, squares), (rounding, error)| {
                (product + rounding * error, squares + rounding * rounding)
            });
            product / squares.sqrt()
        };
        let by_tick: Vec<f64> = (0..ticks).into_par_iter().map(likeness).collect();
        let deviation = (by_tick.iter().map(|value| value * value).sum::<f64>() / f64::from(ticks)).sqrt();
        let mut likely: Vec<u32> =
            (0..ticks).filter(|&later| by_tick[later as usize] > CLEAR * deviation).collect();
        likely.sort_by(|&a, &b| by_tick[b as usize].total_cmp(&by_tick[a as usize]));
        likely.truncate(MOST);
        Some(likely)
    }

    /// The direction of azimuth 0 by a recipe that adds the angles of ticks and lasers in single precision, and the
    /// measurements with nearly the lasers. `likely`: ticks by which azimuth 0 may be before that of the
    /// measurements.
    fn summed_in_single(&self, likely: &[u32], start: &Mounting) -> Option<(Seen, Direction)> {
        /// Numbers of points, and of rounds, for each tick, and for the best.
        const EACH: (usize, usize) = (FEW, 3);
        const BEST: (usize, usize) = (2 * SAMPLE, 32);
        let of_ticks = likely.iter().filter_map(|&later| SumsInSingle::of(self, later, start, EACH));
        let best = of_ticks.min_by(|a, b| a.error.total_cmp(&b.error))?;
        let SumsInSingle { lasers, later, start: nearly, .. } =
            SumsInSingle::of(self, best.later, start, BEST)?;
        let with = |lasers: &[Laser], offsets| Seen {
            build: self.build.clone(),
            lasers: lasers.to_vec(),
            points: self.points.clone(),
            offsets,
        };
        let seen = with(&lasers, Offsets::Any);
        let most = (FARTHEST_OFFSET / seen.offsets.part()) as i32;
        let direction = seen.direction(Recipe::Nebula, (-most..most, &[later]), &nearly)?;
        if self.offsets == Offsets::Any {
            return Some((seen, direction));
        }
        // The same by thousandths of degrees, which are more accurate, if all offsets are.
        let greater = lasers.iter().zip(&self.lasers).map(|(laser, written)| {
            (seen.offsets.greater(laser, direction.before.part).azimuth - written.azimuth) as f64
        });
        let part = (median(greater) / THOUSANDTH as f64).round() as i32;
        let by_thousandths = self.direction(Recipe::Nebula, (part..part + 1, &[later]), start)?;
        if by_thousandths.missed > direction.missed {
            return Some((seen, direction));
        }
        let by_chance = direction.by_chance;
        Some((with(&self.lasers, self.offsets), Direction { by_chance, ..by_thousandths }))
    }

    /// Of some directions of azimuth 0, the one for which the points of a recipe reproduce the most coordinates
    /// of the file: `parts` and `laters` before that of the measurements.
    pub fn direction(
        &self,
        recipe: Recipe,
        (parts, laters): (Range<i32>, &[u32]),
        start: &Mounting,
    ) -> Option<Direction> {
        /// Numbers of points by which directions are compared, and the part of the directions that remains.
        const ROUNDS: [(usize, usize); 2] = [(16, 8), (40, 8)];
        /// Numbers of points to which a mounting is fitted for each of these, and by which they are compared; the
        /// number of the last directions, and of points for these.
        const FITTED: [usize; 2] = [128, 96];
        const LAST: usize = 24;
        const LAST_FITTED: [usize; 2] = [FEW, 1600];
        let few: Vec<Measurement> = thinned(&self.points, SAMPLE).copied().collect();
        let search = Search::new(self, &few, recipe, (parts.start, laters), start)?;
        let all: Vec<Before> =
            parts.flat_map(|part| laters.iter().map(move |&later| Before { part, later })).collect();
        let narrowed = ROUNDS.iter().fold(all, |directions, round| search.narrowed(directions, *round, LAST));
        let fitted = |directions: Vec<Before>, [points, compared]: [usize; 2]| {
            let fitted = directions.into_par_iter().filter_map(|before| {
                let mounting = search.fitted(before, points)?;
                let sample = search.sample(before.part, compared);
                let missed = missed(&mounting, &ROUNDING, search.pairs(&sample, before.later));
                Some(Direction { recipe, before, missed, by_chance: 0, mounting })
            });
            let mut fitted: Vec<Direction> = fitted.collect();
            fitted.sort_unstable_by_key(|found| (found.missed, found.before));
            fitted
        };
        let last = fitted(narrowed, FITTED).into_iter().take(LAST);
        let last = fitted(last.map(|found| found.before).collect(), LAST_FITTED);
        let by_chance = last.get(last.len() / 2)?.missed;
        Some(Direction { by_chance, ..last[0] })
    }
}

/// Orders of operations after whose roundings the direction can be told.
const ROUNDING: [TransformOrder; 6] = [
    TransformOrder::Double,
    TransformOrder::DoubleRoundedTwice,
    TransformOrder::SingleShiftFirst,
    TransformOrder::SingleShiftLast,
    TransformOrder::SingleFused,
    TransformOrder::SingleHalved,
];

/// By how many parts ([`Offsets::part`]) and ticks azimuth 0 is before that of the measurements.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Before {
    pub part: i32,
    pub later: u32,
}

/// A search for the direction of azimuth 0 by the roundings of one recipe.
struct Search<'s> {
    seen: &'s Seen,
    points: &'s [Measurement],
    recipe: Recipe,
    turn: TurnTable,
    /// The mounting if azimuth 0 is that of the measurements.
    start: Mounting,
    /// Ticks by which azimuth 0 may be before that, in order, and the mounting of each, for the first part that
    /// is tried. Recipes in single precision distort angles by up to 2.4e-7 radians, in the same way for ticks
    /// that are few degrees apart: with what is distorted in another direction, a mounting is off by 1e-7, and few
    /// coordinates are reproduced.
    of_sectors: Vec<(u32, Mounting)>,
    first: i32,
}

impl<'s> Search<'s> {
    fn new(
        seen: &'s Seen,
        points: &'s [Measurement],
        recipe: Recipe,
        (first, laters): (i32, &[u32]),
        start: &Mounting,
    ) -> Option<Self> {
        /// Number of sectors of a turn, and of points to which all mountings are fitted.
        const SECTORS: usize = 360;
        const POINTS: usize = 216_000;
        let quarter = if recipe.axes() == Axes::YAhead { FRAC_PI_2 } else { 0.0 };
        let search = Search {
            seen,
            points,
            recipe,
            turn: TurnTable::new(recipe, seen.build.ticks),
            start: start.turned(-quarter),
            of_sectors: Vec::new(),
            first,
        };
        let mut sectors = laters.to_vec();
        sectors.sort_unstable();
        let sectors: Vec<u32> = thinned(&sectors, SECTORS).copied().collect();
        let points = (POINTS / sectors.len().max(1)).min(FEW);
        let fitted = |later: u32| Some((later, search.fitted(Before { part: first, later }, points)?));
        let of_sectors = sectors.into_par_iter().map(fitted).collect::<Option<Vec<_>>>()?;
        Some(Search { of_sectors, ..search })
    }

    /// Some points, each with the arithmetic of its laser, whose offset is so many parts greater.
    fn sample(&self, part: i32, points: usize) -> Vec<(Arithmetic, Measurement)> {
        let Build { origin, ticks, .. } = self.seen.build;
        let with_laser = |point: &Measurement| {
            let laser = self.seen.offsets.greater(&self.seen.lasers[point.0.row as usize], part);
            (Arithmetic::new(self.recipe, &laser, origin, ticks), *point)
        };
        thinned(self.points, points).map(with_laser).collect()
    }

    /// The points of a sample by the recipe if azimuth 0 is so many ticks before, and their positions in the file.
    fn pairs<'a>(
        &'a self,
        sample: &'a [(Arithmetic, Measurement)],
        later: u32,
    ) -> impl Iterator<Item = Pair> + 'a {
        let Build { ticks, range_step_um, .. } = self.seen.build;
        sample.iter().map(move |(arithmetic, (found, position))| {
            let tick = (found.tick + later) % ticks;
            let point = arithmetic.position(&self.turn, tick, found.steps, range_step_um);
            (point.map(f64::from), *position)
        })
    }

    /// A mounting turned by so many parts and ticks.
    fn turned(&self, mounting: &Mounting, parts: i32, ticks: i64) -> Mounting {
        let of_parts = f64::from(parts) * self.seen.offsets.part();
        mounting.turned(of_parts + ticks as f64 * TAU / f64::from(self.seen.build.ticks))
    }

    /// The mounting with azimuth 0 in a direction, fitted to some points.
    fn fitted(&self, before: Before, points: usize) -> Option<Mounting> {
        let sample = self.sample(before.part, points);
        let pairs: Vec<Pair> = self.pairs(&sample, before.later).collect();
        least_squares(&pairs, &self.turned(&self.start, before.part, before.later.into()), &COARSE)
    }

    /// How many coordinates of a sample are missed in a direction, by the mounting of its sector.
    fn missed(&self, sample: &[(Arithmetic, Measurement)], before: Before) -> u32 {
        let after = self.of_sectors.partition_point(|(sector, _)| *sector <= before.later);
        let (ticks, count) = (i64::from(self.seen.build.ticks), self.of_sectors.len());
        let from = |at: usize| {
            let (sector, mounting) = &self.of_sectors[at % count];
            let ticks_from = i64::from(before.later) - i64::from(*sector) + ticks / 2;
            (ticks_from.rem_euclid(ticks) - ticks / 2, mounting)
        };
        let (one, other) = (from(after + count - 1), from(after));
        let (ticks, mounting) = if one.0.abs() < other.0.abs() { one } else { other };
        let mounting = self.turned(mounting, before.part - self.first, ticks);
        missed(&mounting, &ROUNDING, self.pairs(sample, before.later))
    }

    /// The directions that miss the fewest coordinates of some points: one of so many, and at least `fewest`.
    fn narrowed(
        &self,
        mut directions: Vec<Before>,
        (points, one_of): (usize, usize),
        fewest: usize,
    ) -> Vec<Before> {
        /// Number of directions that one thread tries at a time.
        const TOGETHER: usize = 1000;
        directions.sort_unstable();
        let of_part = |same: &[Before]| {
            let sample = self.sample(same[0].part, points);
            same.iter().map(|before| (self.missed(&sample, *before), *before)).collect::<Vec<_>>()
        };
        let together = directions.par_chunks(TOGETHER);
        let missed = together.flat_map_iter(|some| some.chunk_by(|a, b| a.part == b.part).flat_map(of_part));
        let mut missed: Vec<(u32, Before)> = missed.collect();
        missed.sort_unstable();
        missed.truncate((missed.len() / one_of).max(fewest));
        missed.into_iter().map(|(_, before)| before).collect()
    }
}

/// How far a point of a file is from where the integers of its measurement say.
pub(super) struct Off {
    /// In radians.
    pub clockwise: f64,
    pub up: f64,
    /// The less its coordinates are rounded, the more it counts.
    pub weight: f64,
}

impl Mounting {
    /// This mounting with the height that its other axes imply. Least squares cannot tell a stretched height
    /// from elevations that are too large.
    pub(super) fn rigid(mut self) -> Self {
        let [one, other] = [0, 1].map(|axis| Vector3::from(self.rows.map(|row| row[axis])).normalize());
        let up = one.cross(&other).normalize();
        self.rows.iter_mut().zip(up.iter()).for_each(|(row, up)| row[2] = *up);
        self
    }

    /// How far a position in the file is from a measured point. `None` if it belongs to another return, or to
    /// no azimuth.
    pub(super) fn off(&self, point: &[f64; 3], position: &[f32; 3]) -> Option<Off> {
        /// In metres.
        const FARTHEST: f64 = 1e-4;
        let ([x, y, z], there) = (*point, self.undone(position.map(f64::from)));
        let miss = [there[0] - x, there[1] - y, there[2] - z];
        let (flat, range) = (x * x + y * y, x * x + y * y + z * z);
        if miss.iter().any(|miss| miss.abs() > FARTHEST) || flat == 0.0 {
            return None;
        }
        let outward = (miss[0] * x + miss[1] * y) / flat.sqrt();
        Some(Off {
            clockwise: (miss[0] * y - miss[1] * x) / flat,
            up: (miss[2] * flat.sqrt() - z * outward) / range,
            weight: range / position.map(|metres| square(unit_at(metres))).iter().sum::<f64>(),
        })
    }
}

/// Recipes of which none rounds most points as another does.
const DIFFERENT: [Recipe; 8] = [
    Recipe::VelodyneRos,
    Recipe::DoubleYAhead,
    Recipe::SingleRangeXAhead,
    Recipe::Nebula,
    Recipe::NebulaJanuary2023,
    Recipe::NebulaVelodyne,
    Recipe::Pandar64,
    Recipe::Apollo,
];

/// Those of Hesai's scanners.
const OF_HESAI: [Recipe; 4] =
    [Recipe::DoubleYAhead, Recipe::Nebula, Recipe::NebulaJanuary2023, Recipe::Pandar64];

/// Those of scanners with other ticks than hundredths of degrees, such as Ouster's.
const OF_OUSTER: [Recipe; 3] = [Recipe::SingleRangeXAhead, Recipe::DoubleXAhead, Recipe::DoubleYAhead];

/// A direction of azimuth 0.
#[derive(Clone, Copy)]
pub(super) struct Direction {
    pub recipe: Recipe,
    /// By how much it is before that of the measurements.
    pub before: Before,
    /// How many coordinates are not reproduced, and how many are not in another direction.
    missed: u32,
    by_chance: u32,
    pub mounting: Mounting,
}

impl Direction {
    /// The part of the coordinates missed in another direction that are missed in this one.
    pub fn chance(&self) -> f64 {
        f64::from(self.missed) / f64::from(self.by_chance.max(1))
    }

    /// The whole tick nearest to the first axis of the file. Where points were not rounded before they were
    /// moved, any direction is as good as another, and this one is the likeliest.
    fn aligned(&self, ticks: u32) -> Self {
        let [a, b, ..] = self.mounting.rows[0];
        let tick = TAU / f64::from(ticks);
        let later = round_ties_even(libm::atan2(b, a) / tick);
        let ticks_before = i64::from(self.before.later) + later as i64;
        Direction {
            before: Before { later: ticks_before.rem_euclid(i64::from(ticks)) as u32, ..self.before },
            mounting: self.mounting.turned(later * tick),
            ..*self
        }
    }
}

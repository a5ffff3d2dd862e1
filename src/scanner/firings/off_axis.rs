//! Finds scanners whose beams start away from the axis, where their manufacturer's driver says: RoboSense's
//! and LSLiDAR's.

use std::f64::consts::TAU;

use rayon::prelude::*;

use super::blur::Blur;
use super::constants::{Point, TRIED, best_of, reproduced_points};
use super::fit::{ON_CONE, ScanFacts, elevations, fewest_of, narrow_heaps, phase, range_step, strength};
use super::order::{FiringOrder, lines, order};
use super::projection::{Place, nearest};
use super::{ANGLE_UNIT, Build, Firings, Laser, Origin, Recipe, Timing};
use crate::ground::angle;
use crate::ground::floats::round_ties_even;
use crate::scan::{Channel, PointCloud};
use crate::scanner::{CoordinateGrid, PLAUSIBLE_LASERS, REACH, Return, median, thinned};

/// A manufacturer's scanner whose beams start away from the axis.
struct Maker {
    recipe: Recipe,
    origin: Origin,
    /// The azimuth offset of all lasers, in hundredths of degrees, if it is the same for all.
    offset: Option<i32>,
}

const fn robosense(along_um: i32, up_um: i32) -> Maker {
    Maker { recipe: Recipe::RoboSense, origin: Origin { along_um, up_um }, offset: None }
}

const fn lslidar(along_um: i32, offset: i32) -> Maker {
    Maker { recipe: Recipe::LsLidar, origin: Origin { along_um, up_um: 0 }, offset: Some(offset) }
}

/// The constants in the manufacturers' drivers.
const MAKERS: [Maker; 14] = [
    robosense(34_980, 0),
    robosense(16_190, 95_710),
    robosense(14_730, 94_270),
    robosense(38_250, 0),
    robosense(39_970, 0),
    robosense(36_150, 0),
    robosense(28_920, 0),
    robosense(7500, 45_320),
    robosense(19_520, 45_000),
    lslidar(36_100, 2025),
    lslidar(35_000, 2180),
    lslidar(20_900, 2776),
    lslidar(43_100, 1468),
    lslidar(49_400, 1298),
];

/// Ticks per turn of all these scanners.
const OFF_AXIS_TICKS: u32 = 36_000;

impl Maker {
    /// Whether its beams start about this far from the axis and at about this height, in metres.
    fn is_like(&self, [along, up]: [f64; 2]) -> bool {
        let [_, own_up] = self.origin.metres();
        (0.96..1.01).contains(&(along / self.along())) && (up - own_up).abs() < 1e-3
    }

    /// A range step, in metres, of which the range steps of all its scanners are multiples.
    fn least_step_m(&self) -> f64 {
        if self.recipe == Recipe::RoboSense { 0.0025 } else { 0.002 }
    }

    /// The distance from the axis at which a beam's line crosses the height of its start, if its azimuth
    /// offset is small.
    fn along(&self) -> f64 {
        let turned = f64::from(self.offset.unwrap_or(0)) * 0.01;
        self.origin.metres()[0] * libm::cos(turned.to_radians())
    }
}

/// The points of each laser.
struct Rows<'p> {
    points: Vec<Vec<Point<'p>>>,
    /// Where the lines of the beams cross: the distance from the axis, and the height, in metres.
    start: [f64; 2],
}

impl<'p> Rows<'p> {
    fn of(points: Vec<Vec<Point<'p>>>) -> Option<Self> {
        let start = line_start(&points)?;
        Some(Rows { points, start })
    }
}

impl ScanFacts<'_> {
    /// Scanners whose beams start away from the axis and that may have measured the scan.
    pub(super) fn off_axis(&self) -> Option<Vec<Firings>> {
        let scanner = self.of_best_maker()?;
        let (sequence, rows, ticks) = (self.sequence(&scanner), scanner.rows(), scanner.build.ticks);
        match order(&sequence, rows, ticks, self.slack(ticks)) {
            Some(order) => Some(self.in_order(scanner, order)),
            None => lines(&sequence, rows, ticks).map(|lines| vec![scanner.line_by_line(lines)]),
        }
    }

    /// The scanner of the manufacturer whose scanner reproduces the most points, whatever the order in which
    /// its lasers fire.
    fn of_best_maker(&self) -> Option<Firings> {
        /// Number of points by which the manufacturer is determined.
        const SAMPLED: usize = 6000;
        /// Number of points that show where no beams start.
        const FEW: usize = 16_000;
        let sample: Vec<&Point> = thinned(&self.points, SAMPLED).collect();
        let positions: Vec<[f32; 3]> =
            sample.iter().map(|point| point.position.map(|metres| metres as f32)).collect();
        // How points were moved may not be known to the last bit yet.
        let are_moved = sample.iter().any(|point| point.moved.is_some());
        let by_channel = self.rows_by_channel().map(Rows::of);
        let candidates = MAKERS.par_iter().filter_map(|maker| {
            let by_elevation;
            let Rows { points: rows, start } = match &by_channel {
                Some(by_channel) => by_channel.as_ref()?,
                None => {
                    let few = Rows::of(self.rows_by_elevation(maker, FEW)?)?;
                    if !maker.is_like(few.start) {
                        return None;
                    }
                    by_elevation = Rows::of(self.rows_by_elevation(maker, usize::MAX)?)?;
                    &by_elevation
                }
            };
            if !maker.is_like(*start) {
                return None;
            }
            let judged = |scanner: Firings| {
                let reach = 0.5 * scanner.range_step_m() + 1e-5;
                let places = scanner.places(&positions, reach);
                let is_exact = |place: &&Place| {
                    let found =
                        Return { row: place.row, column: 0, tick: place.tick, steps: place.steps, echo: 0 };
                    sample[place.point as usize].is_reproduced_by(&scanner, &found, 0..3)
                };
                let exact = places.iter().filter(is_exact).count();
                let placed = places.len();
                (scanner, exact, placed)
            };
            let of_recipe = |recipe: Recipe| Some(judged(self.of_maker(maker, recipe, rows)?));
            let usual = of_recipe(maker.recipe)?;
            let (_, exact, placed) = usual;
            let is_robosense = maker.recipe == Recipe::RoboSense;
            // Fused operations change only some of the last bits, so nearly the same constants are right.
            let fused = |(scanner, exact, placed): &(Firings, usize, usize), recipe: Recipe| {
                let may_be_fused = || {
                    let build = Build { recipe, ..scanner.build.clone() };
                    let fused = Firings::new(build, scanner.lasers.clone(), scanner.rows_of_slots.clone());
                    20 * exact < 19 * placed && judged(fused).1 > *exact
                };
                (is_robosense && may_be_fused()).then(|| of_recipe(recipe)).flatten()
            };
            let is_early = is_robosense && 2 * exact < placed;
            let early = is_early.then(|| of_recipe(Recipe::RoboSenseEarly)).flatten();
            let early_fused = early.as_ref().and_then(|early| fused(early, Recipe::RoboSenseEarlyFused));
            let others = [early_fused, early, fused(&usual, Recipe::RoboSenseFused)];
            let better = others.into_iter().flatten();
            let better = better.filter(|(_, other, _)| *other > exact && (!are_moved || 10 * other > placed));
            Some(better.max_by_key(|(_, other, _)| *other).unwrap_or(usual))
        });
        let candidates: Vec<(Firings, usize, usize)> = candidates.collect();
        // A scanner that reproduces no more than one point in ten is rejected.
        let best = candidates.into_iter().max_by_key(|(_, exact, placed)| (*exact, *placed));
        let (scanner, ..) = best.filter(|(_, exact, placed)| match are_moved {
            true => 2 * placed > sample.len(),
            false => 10 * exact > sample.len(),
        })?;
        Some(scanner)
    }

    /// A scanner whose lasers fire in this order, with the timings that may be its own.
    fn in_order(&self, scanner: Firings, order: FiringOrder) -> Vec<Firings> {
        let rows = scanner.rows();
        let scanner = Firings::new(scanner.build, scanner.lasers, order.rows_of_slots);
        let lagging = scanner.clone().lagging(vec![0; rows]);
        let starts = [0].iter().chain(&order.other_starts).chain(&order.half_start);
        let begun: Vec<Firings> = starts.map(|&start| scanner.clone().begun_at(start)).collect();
        // A timing that is known need not be estimated.
        let published = match scanner.build.recipe {
            Recipe::LsLidar => Vec::new(),
            _ => Timing::of_robosense(rows),
        };
        let of_start = |scanner: &Firings| {
            let timed = published.iter().map(|timing| scanner.clone().with_timing(timing.clone()));
            timed.collect::<Vec<_>>()
        };
        // Lasers with few returns do not show their place in the order; most scanners' fire downwards.
        let downwards =
            Firings::new(scanner.build.clone(), scanner.lasers.clone(), (0..rows as u32).collect());
        let mut all = begun.iter().chain([&downwards]).flat_map(of_start);
        if let Some(known) = all.find(|timed| self.shows_timing_of(timed)) {
            return vec![known];
        }
        let begun = begun.iter().cloned().chain([lagging]);
        begun.flat_map(|scanner| self.with_timings(scanner, false)).collect()
    }

    /// Rows and ticks of the points in file order, without echoes.
    pub(super) fn sequence(&self, scanner: &Firings) -> Vec<(usize, u32)> {
        let places = scanner.places(&self.cloud.positions, REACH + 0.5 * scanner.range_step_m());
        let mut sequence: Vec<(usize, u32)> =
            places.iter().map(|place| (place.row as usize, place.tick)).collect();
        sequence.dedup();
        sequence
    }

    /// The points of each laser, if a channel identifies the lasers.
    pub(super) fn rows_by_channel(&self) -> Option<Vec<Vec<Point<'_>>>> {
        /// In radians: points of a laser are nearer than this to their median elevation.
        const SPREAD: f64 = 0.06;
        let of = |channel: &Channel| {
            let width = channel.field.width();
            let mut keyed: Vec<(&[u8], usize)> = self
                .numbers
                .iter()
                .enumerate()
                .filter_map(|(place, record)| {
                    Some((channel.bytes.get(record * width..)?.get(..width)?, place))
                })
                .collect();
            keyed.sort_unstable();
            let groups = keyed.chunk_by(|a, b| a.0 == b.0);
            if !PLAUSIBLE_LASERS.contains(&groups.clone().take(PLAUSIBLE_LASERS.end() + 1).count()) {
                return None;
            }
            let rows: Vec<Vec<Point>> =
                groups.map(|group| group.iter().map(|(_, place)| self.points[*place]).collect()).collect();
            let (mut near, mut all) = (0, 0);
            for row in &rows {
                let elevations = row.iter().filter(|point| point.range > 2.0).map(|point| point.elevation);
                let middle = median(elevations.clone());
                all += elevations.clone().count();
                near += elevations.filter(|elevation| (*elevation - middle).abs() < SPREAD).count();
            }
            (all > 0 && near * 10 > all * 9).then_some(rows)
        };
        let channels = self.cloud.channels.iter();
        channels.filter(|channel| channel.field.width() <= 4 && !channel.field.name.is_empty()).find_map(of)
    }

    /// The points of each laser, among at most about `most`: narrow clusters of elevations as seen from where a
    /// maker's beams start.
    fn rows_by_elevation(&self, maker: &Maker, most: usize) -> Option<Vec<Vec<Point<'_>>>> {
        /// In metres: points that are nearer do not count, in one attempt after the other. In the last, lasers
        /// are found that see nothing but what they are mounted in.
        const NEAREST: [f64; 5] = [0.5, 1.0, 2.0, 4.0, 0.0];
        /// Of the points that are left, at least one in this number is of each laser.
        const PART: usize = 40;
        let (along, [_, up]) = (maker.along(), maker.origin.metres());
        let points = || thinned(&self.points, most);
        let moved: Vec<Point> = points()
            .map(|point| {
                let [x, y, z] = point.position;
                let rho = (x * x + y * y).sqrt() - along;
                Point { elevation: libm::atan2(z - up, rho), ..*point }
            })
            .collect();
        let mut elevations = elevations(&moved, self.on_cone())?;
        let fewest = fewest_of(moved.len());
        // Near points blur the clusters of lasers that see little else.
        for least in NEAREST {
            let is_left = |point: &&Point| {
                let row = nearest(&elevations, point.elevation);
                point.range > least && (elevations[row] - point.elevation).abs() >= 10.0 * ON_CONE
            };
            let mut left: Vec<f64> = moved.iter().filter(is_left).map(|point| point.elevation).collect();
            left.sort_unstable_by(|a, b| b.total_cmp(a));
            elevations.extend(narrow_heaps(&left, self.on_cone(), fewest.max(left.len() / PART)).1);
            elevations.sort_unstable_by(|a, b| b.total_cmp(a));
        }
        let mut rows = vec![Vec::new(); elevations.len()];
        for (point, moved) in points().zip(&moved) {
            let row = nearest(&elevations, moved.elevation);
            if (elevations[row] - moved.elevation).abs() < 10.0 * ON_CONE {
                rows[row].push(*point);
            }
        }
        Some(rows)
    }

    /// The scanner of a maker by a recipe, with constants determined from the points of its lasers.
    fn of_maker(&self, maker: &Maker, recipe: Recipe, rows: &[Vec<Point>]) -> Option<Firings> {
        /// Lasers with fewer points are ignored.
        const FEWEST: usize = 4;
        let rows: Vec<&Vec<Point>> = rows.iter().filter(|row| row.len() >= FEWEST).collect();
        let lasers: Vec<Vec<Laser>> = rows.par_iter().map(|row| lasers_off_axis(maker, row)).collect();
        let mut ranges = Vec::new();
        for (row, laser) in rows.iter().zip(&lasers).filter_map(|(row, lasers)| Some((row, lasers.first()?)))
        {
            let step = (row.len() / TRIED).max(1);
            let offset = (laser.azimuth_degrees() * 100.0).round() as i32;
            let elevation = laser.elevation_degrees().to_radians();
            let [_, up] = maker.origin.metres();
            ranges.extend(row.iter().step_by(step).map(|point| {
                let (flat, _) = maker.undo(point, offset);
                flat * libm::cos(elevation) + (point.position[2] - up) * libm::sin(elevation)
            }));
        }
        let range_step_um = range_step(ranges.into_iter(), self.blur)?;
        let build = Build {
            recipe,
            ticks: OFF_AXIS_TICKS,
            range_step_um,
            coordinates: self.coordinates,
            origin: maker.origin,
            timing: Timing::Together,
            mounting: None,
        };
        let bare = Firings::without_lasers(build.clone());
        let pairs = lasers.par_iter().zip(&rows);
        let mut lasers: Vec<Laser> =
            pairs.filter_map(|(lasers, row)| sharpened(&bare, lasers, row)).collect();
        if lasers.is_empty() {
            return None;
        }
        lasers.sort_unstable_by_key(|laser| -laser.elevation);
        lasers.dedup_by_key(|laser| laser.elevation);
        let rows_of_slots = (0..lasers.len() as u32).collect();
        Some(Firings::new(build, lasers, rows_of_slots))
    }
}

impl Maker {
    /// The horizontal distance of a point from the start of its beam, in metres, and the azimuth of the beam,
    /// in radians, if the beam is turned by `offset` hundredths of degrees from the direction of its start.
    fn undo(&self, point: &Point, offset: i32) -> (f64, f64) {
        let [x, y, _] = point.position;
        let turned = (f64::from(offset) * 0.01).to_radians();
        let [along, _] = self.origin.metres();
        let (beside, ahead) = (along * libm::sin(turned), along * libm::cos(turned));
        let flat = (x * x + y * y - beside * beside).max(0.0).sqrt() - ahead;
        (flat, self.recipe.azimuth(x, y) + angle::atan2(beside, flat + ahead))
    }
}

/// In hundredths of degrees: the largest offset that is tried.
const FARTHEST: i32 = 6000;
/// Where the beams of a manufacturer's scanner start that start this far from the axis, in metres, and by how
/// many radians the azimuths of its lasers are more than whole ticks. The points are seen from the height at
/// which the lines of the beams cross. `None` if there is no such scanner.
pub(super) fn known_start(points: &[Point], along: f64) -> Option<(Origin, f64)> {
    /// Number of lasers, and of points of each, by which azimuths are compared.
    const ROWS: usize = 8;
    const POINTS: usize = 60;
    /// Hundredths of degrees between offsets that are tried at first.
    const COARSE: i32 = 10;
    /// In metres: azimuths of nearer points are less accurate.
    const NEAREST: f64 = 1.0;
    /// Smallest mean coherence of a laser's azimuths with ticks.
    const COHERENT: f64 = 0.7;
    let known = MAKERS.par_iter().filter(|maker| maker.is_like([along, maker.origin.metres()[1]]));
    let starts = known.filter_map(|maker| {
        let [_, up] = maker.origin.metres();
        let raised = points.iter().filter_map(|point| {
            let [x, y, z] = point.position;
            Point::new([x, y, z + up], None)
        });
        let cloud = PointCloud::default();
        let facts = ScanFacts {
            cloud: &cloud,
            numbers: Vec::new().into(),
            points: raised.collect::<Vec<_>>().into(),
            measured: points.len(),
            coordinates: CoordinateGrid::Float32,
            blur: Blur::default(),
            nearest: 0.0,
            mean_offset: 0.0,
        };
        let mut rows = facts.rows_by_elevation(maker, usize::MAX)?;
        rows.iter_mut().for_each(|row| row.retain(|point| point.range > NEAREST));
        rows.sort_by_key(|row| std::cmp::Reverse(row.len()));
        let of_rows = rows.iter().take(ROWS).map(|row| {
            let few: Vec<&Point> = thinned(row, POINTS).collect();
            let of_offset =
                |offset: i32| phase(few.iter().map(|point| maker.undo(point, offset).1 * IN_TICKS));
            let best = |offsets: &mut dyn Iterator<Item = i32>| {
                let tried = offsets.map(|offset| (offset, of_offset(offset)));
                tried.max_by(|a, b| a.1.1.total_cmp(&b.1.1)).unwrap_or_default()
            };
            match maker.offset {
                Some(offset) => of_offset(offset),
                None => {
                    let (near, _) = best(&mut (-FARTHEST..=FARTHEST).step_by(COARSE as usize));
                    best(&mut (near - COARSE..=near + COARSE)).1
                }
            }
        });
        let of_rows: Vec<(f64, f64)> = of_rows.collect();
        let coherence =
            of_rows.iter().map(|(_, strength)| strength).sum::<f64>() / of_rows.len().max(1) as f64;
        let (common, _) = phase(of_rows.iter().map(|(phase, _)| *phase));
        Some((coherence, maker.origin, common))
    });
    let best = starts.max_by(|a, b| a.0.total_cmp(&b.0)).filter(|(coherence, ..)| *coherence > COHERENT)?;
    Some((best.1, best.2 / IN_TICKS))
}

/// A hundredth of a degree, in [`ANGLE_UNIT`].
const HUNDREDTH: i64 = (0.01 / ANGLE_UNIT) as i64;
/// Ticks of a radian.
const IN_TICKS: f64 = OFF_AXIS_TICKS as f64 / TAU;

/// Lasers, best first, for which the azimuths of the points lie on whole ticks and their ranges on whole
/// steps.
fn lasers_off_axis(maker: &Maker, points: &[Point]) -> Vec<Laser> {
    const MOST: usize = 120;
    /// Number of points on which all offsets are tried, and the largest number of offsets that are examined
    /// further.
    const FEW: usize = 24;
    const MOST_OFFSETS: usize = 600;
    /// Number of lasers that are returned.
    const CANDIDATES: usize = 60;
    let mut sorted: Vec<&Point> = points.iter().collect();
    sorted.sort_by(|a, b| a.range.total_cmp(&b.range));
    // Near points are the most informative.
    sorted.truncate((2 * sorted.len() / 3).max(MOST.min(points.len())));
    let few = |most: usize| -> Vec<&Point> {
        sorted.iter().step_by((sorted.len() / most).max(1)).copied().collect()
    };
    if let Some(offset) = maker.offset {
        return vec![maker.laser(&few(MOST), offset).1];
    }
    let offsets = maker.coherent_offsets(&few(FEW));
    let more = few(MOST / 3);
    let step = (offsets.len() / MOST_OFFSETS).max(1);
    let mut found: Vec<(f64, Laser)> =
        offsets.into_iter().step_by(step).map(|offset| maker.laser(&more, offset)).collect();
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.truncate(CANDIDATES);
    found.into_iter().map(|(_, laser)| laser).collect()
}

impl Maker {
    /// The laser with an offset, in hundredths of degrees, and the coherence of its points with ticks and
    /// range steps.
    fn laser(&self, points: &[&Point], offset: i32) -> (f64, Laser) {
        /// Minimum coherence with ticks.
        const COHERENT: f64 = 0.5;
        let [_, up] = self.origin.metres();
        let undone: Vec<(f64, f64, f64)> = points
            .iter()
            .map(|point| {
                let (flat, azimuth) = self.undo(point, offset);
                (azimuth * IN_TICKS, flat, point.position[2] - up)
            })
            .collect();
        let of_ticks = strength(undone.iter().map(|(ticks, _, _)| *ticks), 0.0);
        if of_ticks < COHERENT {
            return (-1.0, Laser::default());
        }
        let mut elevations: Vec<f64> =
            undone.iter().map(|(_, flat, high)| libm::atan2(*high, *flat)).collect();
        elevations.sort_by(f64::total_cmp);
        let elevation = round_ties_even(elevations[elevations.len() / 2].to_degrees() * 100.0);
        let (sin, cos) = libm::sincos((elevation * 0.01).to_radians());
        let ranges = undone.iter().map(|(_, flat, high)| (flat * cos + high * sin) / self.least_step_m());
        let laser = Laser { elevation: elevation as i64 * HUNDREDTH, azimuth: i64::from(offset) * HUNDREDTH };
        (of_ticks + strength(ranges, 0.0), laser)
    }

    /// The offsets, in hundredths of degrees, with which the azimuths of points lie on ticks. Azimuths alone
    /// exclude most offsets, and quickly.
    fn coherent_offsets(&self, points: &[&Point]) -> Vec<i32> {
        /// The coherence above which an offset is returned.
        const COHERENT: f64 = 0.8;
        let horizontal = |point: &&Point| {
            let [x, y, _] = point.position;
            (libm::hypot(x, y), self.recipe.azimuth(x, y))
        };
        let (flat, azimuths): (Vec<f64>, Vec<f64>) = points.iter().map(horizontal).unzip();
        let [along, _] = self.origin.metres();
        let is_coherent = |offset: &i32| {
            let beside = along * libm::sin((f64::from(*offset) * 0.01).to_radians());
            let ticks = |(flat, azimuth): (&f64, &f64)| {
                // The arc sine; a series if the argument is small.
                let slope = beside / flat;
                let square = slope * slope;
                let turned = if slope.abs() > 0.1 {
                    libm::asin(slope.clamp(-1.0, 1.0))
                } else {
                    slope * (1.0 + square * (1.0 / 6.0 + square * (3.0 / 40.0)))
                };
                (azimuth + turned) * IN_TICKS
            };
            // Few offsets remain possible for long.
            let (least, mut possible) = (COHERENT * flat.len() as f64, flat.len() as f64);
            flat.iter().zip(&azimuths).all(|point| {
                possible -= 1.0 - angle::rough_sine(ticks(point) + 0.25);
                possible > least
            })
        };
        (-FARTHEST..=FARTHEST).filter(is_coherent).collect()
    }
}

/// Of some lasers and their neighbours, the one that reproduces the most points to the last bit. `None` if
/// there are none.
fn sharpened(bare: &Firings, lasers: &[Laser], points: &[Point]) -> Option<Laser> {
    /// Number of points by which lasers are preselected.
    const FEW: usize = 12;
    let some = |most: usize| -> Vec<Point> {
        points.iter().step_by((points.len() / most).max(1)).copied().collect()
    };
    let (few, more) = (some(FEW), some(TRIED));
    let moved = |laser: &Laser, azimuth: i64, elevation: i64| Laser {
        elevation: laser.elevation + elevation * HUNDREDTH,
        azimuth: laser.azimuth + azimuth * HUNDREDTH,
    };
    let mut best = (0, *lasers.first()?);
    for laser in lasers.iter().flat_map(|laser| (-1..=1).map(move |off| moved(laser, off, 0))) {
        let exact = reproduced_points(bare, laser, &few, 0..3, best.0 + 1);
        if exact > best.0 {
            best = (exact, laser);
        }
        if exact == few.len() {
            break;
        }
    }
    let beside = (-2..=2).flat_map(|azimuth| (-1..=1).map(move |elevation| (azimuth, elevation)));
    let beside = beside.map(|(azimuth, elevation)| moved(&best.1, azimuth, elevation));
    Some(best_of(bare, std::iter::once(best.1).chain(beside), &more, (best.1, 0)).0)
}

/// The distance from the axis and the height at which the lines of the lasers cross, in metres; `None` if
/// there are too few lines.
fn line_start(rows: &[Vec<Point>]) -> Option<[f64; 2]> {
    /// Steeper lines are ignored.
    const STEEPEST: f64 = 2.0;
    const FEWEST: usize = 50;
    let lines = rows.iter().filter(|row| row.len() >= FEWEST).filter_map(|row| beam_line(row));
    let lines = lines.filter(|[slope, _]| slope.abs() < STEEPEST);
    let lines: Vec<[f64; 2]> = lines.map(|[slope, height]| [-slope, height]).collect();
    // height = up - slope * along.
    steady_line(&lines)
}

/// The line on which the points of a beam lie: its slope, and its height at the axis in metres. `None` if
/// there are too few points.
pub(super) fn beam_line(points: &[Point]) -> Option<[f64; 2]> {
    const FEWEST: usize = 12;
    /// A sufficient number of points.
    const MOST: usize = 2000;
    if points.len() < FEWEST {
        return None;
    }
    let pair = |point: &Point| [libm::hypot(point.position[0], point.position[1]), point.position[2]];
    let pairs: Vec<[f64; 2]> = points.iter().step_by(points.len().div_ceil(MOST)).map(pair).collect();
    steady_line(&pairs)
}

/// The line through some pairs without outliers: its slope, and its height at 0.
fn steady_line(pairs: &[[f64; 2]]) -> Option<[f64; 2]> {
    let (slope, height) = line(pairs.iter())?;
    let off = |pair: &&[f64; 2]| (slope * pair[0] + height - pair[1]).abs();
    let limit = 3.0 * median(pairs.iter().map(|pair| off(&pair))) + 1e-7;
    line(pairs.iter().filter(|pair| off(pair) <= limit)).map(|(slope, height)| [slope, height])
}

/// The line through some pairs, by least squares: its slope, and its height at 0.
pub(super) fn line<'p>(pairs: impl Iterator<Item = &'p [f64; 2]> + Clone) -> Option<(f64, f64)> {
    let count = pairs.clone().count() as f64;
    let sum = |of: fn(&[f64; 2]) -> f64| pairs.clone().map(of).sum::<f64>() / count.max(1.0);
    let (x, y) = (sum(|p| p[0]), sum(|p| p[1]));
    let (mut xx, mut xy) = (0.0, 0.0);
    for pair in pairs.clone() {
        xx += (pair[0] - x) * (pair[0] - x);
        xy += (pair[0] - x) * (pair[1] - y);
    }
    let slope = xy / xx;
    (count >= 3.0 && slope.is_finite()).then_some((slope, y - slope * x))
}

//! Finds scanners whose beams start away from the axis: RoboSense's and LSLiDAR's, whose drivers define a few
//! origins, and Ouster's, each unit of which has an origin of its own.

use std::f64::consts::TAU;

use rayon::prelude::*;

use super::constants::{Point, TRIED, best_of, exact_points};
use super::fit::{Found, ON_CONE, RecordGrid, elevations, narrow_heaps, phase, range_step, strength};
use super::order::{lines, order};
use super::projection::{Place, nearest};
use super::{ANGLE_UNIT, Build, Firings, Laser, Origin, Recipe, Timing};
use crate::ground::angle;
use crate::ground::rounding::round_ties_even;
use crate::scan::Channel;
use crate::scanner::{REACH, Return};

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

    /// The distance from the axis at which a beam's line crosses the height of its start, if its azimuth offset is
    /// small.
    fn along(&self) -> f64 {
        let turned = f64::from(self.offset.unwrap_or(0)) * 0.01;
        self.origin.metres()[0] * libm::cos(turned.to_radians())
    }
}

impl Found<'_> {
    /// Scanners whose beams start away from the axis and that may have measured the scan: those of the manufacturer
    /// whose scanner reproduces the most points.
    pub(super) fn off_axis(&self) -> Option<Vec<Firings>> {
        /// Number of points by which the manufacturer is determined.
        const SAMPLED: usize = 6000;
        let step = (self.points.len() / SAMPLED).max(1);
        let positions = &self.scan.cloud.positions;
        let sample: Vec<[f32; 3]> = positions.iter().step_by(step).copied().collect();
        let by_key = self.rows_by_channel();
        let candidates = MAKERS.par_iter().filter_map(|maker| {
            let rows = match &by_key {
                Some(rows) => rows.clone(),
                None => self.rows_by_elevation(maker)?,
            };
            if !maker.is_like(line_start(&rows)?) {
                return None;
            }
            let scanner = self.of_maker(maker, rows)?;
            let reach = 0.5 * scanner.range_step_m() + 1e-5;
            let places = scanner.places(&sample, reach);
            let is_exact = |place: &&Place| {
                let found =
                    Return { row: place.row, column: 0, tick: place.tick, steps: place.steps, echo: 0 };
                scanner.gives(&found, &sample[place.point as usize].map(f64::from), 0..3)
            };
            let exact = places.iter().filter(is_exact).count();
            Some((scanner, exact))
        });
        let candidates: Vec<(Firings, usize)> = candidates.collect();
        // A scanner that reproduces no more than one point in ten is rejected.
        let best = candidates.into_iter().max_by_key(|(_, exact)| *exact);
        let best = best.filter(|(_, exact)| 10 * exact > sample.len());
        let Some((scanner, _)) = best else { return self.ouster().map(|scanner| vec![scanner]) };
        let (sequence, rows, ticks) = (self.sequence(&scanner), scanner.rows(), scanner.build.ticks);
        if let Some(order) = order(&sequence, rows, ticks) {
            let scanner = Firings::new(scanner.build, scanner.lasers, order.rows_of_slots);
            return Some(self.with_timings(scanner, false));
        }
        lines(&sequence, rows, ticks).map(|lines| vec![scanner.line_by_line(lines)])
    }

    /// Rows and ticks of the points in file order, without echoes.
    fn sequence(&self, scanner: &Firings) -> Vec<(usize, u32)> {
        let places = scanner.places(&self.scan.cloud.positions, REACH + 0.5 * scanner.range_step_m());
        let mut sequence: Vec<(usize, u32)> =
            places.iter().map(|place| (place.row as usize, place.tick)).collect();
        sequence.dedup();
        sequence
    }

    /// An Ouster with the order of a file that holds only returns: column by column, staggered or not, or row by
    /// row. `None` if the file is in neither order.
    fn in_order_of_returns(&self, scanner: Firings) -> Option<Firings> {
        let (sequence, ticks) = (self.sequence(&scanner), scanner.build.ticks);
        let within_turn = |ahead: f64| (-ahead as i64).rem_euclid(i64::from(ticks)) as u32;
        if let Some(order) = order(&sequence, scanner.rows(), ticks) {
            let is_staggered = order.shifts.iter().all(|shift| *shift == 0.0);
            let lags = order.shifts.iter().map(|shift| within_turn(*shift));
            let lags = if is_staggered { Vec::new() } else { lags.collect() };
            return Some(Firings::new(scanner.build, scanner.lasers, order.rows_of_slots).lagging(lags));
        }
        let lines = lines(&sequence, scanner.rows(), ticks)?;
        // A column holds the points of one direction.
        let in_ticks = |laser: &Laser| round_ties_even(laser.azimuth_degrees() / 360.0 * f64::from(ticks));
        let lags = scanner.lasers.iter().map(|laser| within_turn(-in_ticks(laser))).collect();
        let rows_of_slots = (0..scanner.rows() as u32).collect();
        let scanner = Firings::new(scanner.build, scanner.lasers, rows_of_slots);
        Some(scanner.line_by_line(lines).lagging(lags))
    }

    /// The points of each laser, if a channel identifies the lasers.
    fn rows_by_channel(&self) -> Option<Vec<Vec<Point>>> {
        const LASERS: std::ops::RangeInclusive<usize> = 4..=512;
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
            if !LASERS.contains(&groups.clone().take(LASERS.end() + 1).count()) {
                return None;
            }
            let rows: Vec<Vec<Point>> =
                groups.map(|group| group.iter().map(|(_, place)| self.points[*place]).collect()).collect();
            let (mut near, mut all) = (0, 0);
            for row in &rows {
                let mut elevations: Vec<f64> =
                    row.iter().filter(|point| point.range > 2.0).map(|point| point.elevation).collect();
                elevations.sort_by(f64::total_cmp);
                let middle = elevations.get(elevations.len() / 2).copied().unwrap_or(0.0);
                all += elevations.len();
                near += elevations.iter().filter(|elevation| (*elevation - middle).abs() < SPREAD).count();
            }
            (all > 0 && near * 10 > all * 9).then_some(rows)
        };
        let channels = self.scan.cloud.channels.iter();
        channels.filter(|channel| channel.field.width() <= 4 && !channel.field.name.is_empty()).find_map(of)
    }

    /// The points of each laser: narrow clusters of elevations as seen from where a maker's beams start.
    fn rows_by_elevation(&self, maker: &Maker) -> Option<Vec<Vec<Point>>> {
        let (along, [_, up]) = (maker.along(), maker.origin.metres());
        let moved: Vec<Point> = self
            .points
            .iter()
            .map(|point| {
                let [x, y, z] = point.position;
                let rho = (x * x + y * y).sqrt() - along;
                Point { elevation: libm::atan2(z - up, rho), ..*point }
            })
            .collect();
        let elevations = elevations(&moved)?;
        let mut rows = vec![Vec::new(); elevations.len()];
        for (point, moved) in self.points.iter().zip(&moved) {
            let row = nearest(&elevations, moved.elevation);
            if (elevations[row] - moved.elevation).abs() < 10.0 * ON_CONE {
                rows[row].push(*point);
            }
        }
        Some(rows)
    }

    /// The scanner of a maker, with constants determined from the points of its lasers.
    fn of_maker(&self, maker: &Maker, rows: Vec<Vec<Point>>) -> Option<Firings> {
        /// Lasers with fewer points are ignored.
        const FEWEST: usize = 4;
        let rows: Vec<Vec<Point>> = rows.into_iter().filter(|row| row.len() >= FEWEST).collect();
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
        let range_step_um = range_step(ranges.into_iter())?;
        let build = Build {
            recipe: maker.recipe,
            ticks: OFF_AXIS_TICKS,
            range_step_um,
            coordinates: self.coordinates,
            origin: maker.origin,
            timing: Timing::Together,
        };
        let any = Firings::new(build.clone(), Vec::new(), Vec::new());
        let pairs = lasers.par_iter().zip(&rows);
        let mut lasers: Vec<Laser> = pairs.map(|(lasers, row)| sharpened(&any, lasers, row)).collect();
        lasers.sort_unstable_by_key(|laser| -laser.elevation);
        lasers.dedup_by_key(|laser| laser.elevation);
        let rows_of_slots = (0..lasers.len() as u32).collect();
        Some(Firings::new(build, lasers, rows_of_slots))
    }
}

impl Maker {
    /// The horizontal distance of a point from the start of its beam, in metres, and the azimuth of the beam, in
    /// radians, if the beam is turned by `offset` hundredths of degrees from the direction of its start.
    fn undo(&self, point: &Point, offset: i32) -> (f64, f64) {
        let [x, y, _] = point.position;
        let turned = (f64::from(offset) * 0.01).to_radians();
        let [along, _] = self.origin.metres();
        let (beside, ahead) = (along * libm::sin(turned), along * libm::cos(turned));
        let flat = (x * x + y * y - beside * beside).max(0.0).sqrt() - ahead;
        (flat, self.recipe.azimuth(x, y) + angle::atan2(beside, flat + ahead))
    }
}

/// Lasers, best first, for which the azimuths of the points lie on whole ticks and their ranges on whole steps.
fn lasers_off_axis(maker: &Maker, points: &[Point]) -> Vec<Laser> {
    /// In hundredths of degrees: the largest offset that is tried.
    const FARTHEST: i32 = 6000;
    const MOST: usize = 120;
    /// Number of points on which all offsets are tried; the coherence above which an offset is examined further;
    /// the largest number of offsets that are examined.
    const FEW: usize = 24;
    const COHERENT_TICKS: f64 = 0.8;
    const MOST_OFFSETS: usize = 600;
    /// Number of lasers that are returned.
    const CANDIDATES: usize = 60;
    let mut sorted: Vec<&Point> = points.iter().collect();
    sorted.sort_by(|a, b| a.range.total_cmp(&b.range));
    // Near points are the most informative.
    sorted.truncate((2 * sorted.len() / 3).max(MOST.min(points.len())));
    let few = |most: usize| sorted.iter().step_by((sorted.len() / most).max(1));
    let in_ticks = f64::from(OFF_AXIS_TICKS) / TAU;
    let hundredth = (0.01 / ANGLE_UNIT) as i64;
    let [_, up] = maker.origin.metres();
    // The coherence of the points for an offset, and the laser with that offset.
    let tried = |offset: i32, most: usize| {
        let undone: Vec<(f64, f64, f64)> = few(most)
            .map(|point| {
                let (flat, azimuth) = maker.undo(point, offset);
                (azimuth * in_ticks, flat, point.position[2] - up)
            })
            .collect();
        let of_ticks = strength(undone.iter().map(|(ticks, _, _)| *ticks), 0.0);
        if of_ticks < 0.5 {
            return (-1.0, Laser::default());
        }
        let mut elevations: Vec<f64> =
            undone.iter().map(|(_, flat, high)| libm::atan2(*high, *flat)).collect();
        elevations.sort_by(f64::total_cmp);
        let elevation = round_ties_even(elevations[elevations.len() / 2].to_degrees() * 100.0);
        let (sin, cos) = libm::sincos((elevation * 0.01).to_radians());
        let ranges = undone.iter().map(|(_, flat, high)| (flat * cos + high * sin) / maker.least_step_m());
        let laser = Laser { elevation: elevation as i64 * hundredth, azimuth: i64::from(offset) * hundredth };
        (of_ticks + strength(ranges, 0.0), laser)
    };
    if let Some(offset) = maker.offset {
        return vec![tried(offset, MOST).1];
    }
    // Azimuths alone exclude most of the offsets, and quickly.
    let (flat, azimuths): (Vec<f64>, Vec<f64>) = few(FEW)
        .map(|point| {
            let [x, y, _] = point.position;
            (x.hypot(y), maker.recipe.azimuth(x, y))
        })
        .unzip();
    let [along, _] = maker.origin.metres();
    let coherent = |offset: &i32| {
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
            (azimuth + turned) * in_ticks
        };
        // Few offsets remain possible for long.
        let (least, mut possible) = (COHERENT_TICKS * flat.len() as f64, flat.len() as f64);
        flat.iter().zip(&azimuths).all(|point| {
            possible -= 1.0 - angle::rough_sine(ticks(point) + 0.25);
            possible > least
        })
    };
    let offsets: Vec<i32> = (-FARTHEST..=FARTHEST).filter(coherent).collect();
    let step = (offsets.len() / MOST_OFFSETS).max(1);
    let mut found: Vec<(f64, Laser)> =
        offsets.into_iter().step_by(step).map(|offset| tried(offset, MOST / 3)).collect();
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.truncate(CANDIDATES);
    found.into_iter().map(|(_, laser)| laser).collect()
}

/// Of some lasers and their neighbours, the one that reproduces the most points to the last bit.
fn sharpened(any: &Firings, lasers: &[Laser], points: &[Point]) -> Laser {
    /// Number of points by which lasers are preselected.
    const FEW: usize = 12;
    let some = |most: usize| -> Vec<Point> {
        points.iter().step_by((points.len() / most).max(1)).copied().collect()
    };
    let (few, more) = (some(FEW), some(TRIED));
    let hundredth = (0.01 / ANGLE_UNIT) as i64;
    let moved = |laser: &Laser, azimuth: i64, elevation: i64| Laser {
        elevation: laser.elevation + elevation * hundredth,
        azimuth: laser.azimuth + azimuth * hundredth,
    };
    let mut best = (0, lasers[0]);
    for laser in lasers.iter().flat_map(|laser| (-1..=1).map(move |off| moved(laser, off, 0))) {
        let exact = exact_points(any, laser, &few, 0..3, best.0 + 1);
        if exact > best.0 {
            best = (exact, laser);
        }
        if exact == few.len() {
            break;
        }
    }
    let beside = (-2..=2).flat_map(|azimuth| (-1..=1).map(move |elevation| (azimuth, elevation)));
    let beside = beside.map(|(azimuth, elevation)| moved(&best.1, azimuth, elevation));
    best_of(any, std::iter::once(best.1).chain(beside), &more, best.1).0
}

/// The distance from the axis and the height at which the lines of the lasers cross, in metres; `None` if there are
/// too few lines.
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

/// Widths of Ouster's images, which equal the ticks per turn.
const WIDTHS: [u32; 4] = [512, 1024, 2048, 4096];

/// The points of each laser with their record numbers, and the lines of the file if it holds a record for each cell.
struct Rows {
    points: Vec<Vec<Point>>,
    records: Vec<Vec<usize>>,
    grid: Option<RecordGrid>,
}

impl Found<'_> {
    /// An Ouster whose beams start away from the axis: for a range r, elevation E, azimuth offset O and a beam that
    /// starts at a distance n from the axis, `rho^2 = ((r - n) cos E)^2 + 2 (r - n) cos E n cos O + n^2` and
    /// `z = (r - n) sin E + up`.
    fn ouster(&self) -> Option<Firings> {
        /// The range step of the low data rate profile, and that of all others.
        const RANGE_STEPS_UM: [u32; 2] = [8000, 1000];
        let rows = self.ouster_rows()?;
        let lines: Vec<Option<[f64; 2]>> = rows.points.iter().map(|row| beam_line(row)).collect();
        let far: Vec<Vec<Point>> = rows.points.iter().map(|row| far_half(row)).collect();
        let ticks = WIDTHS.into_iter().find(|&ticks| ticks_are_coherent(&far, ticks))?;
        RANGE_STEPS_UM.into_iter().find_map(|range_step_um| {
            let origin = ouster_origin(&rows.points, &lines, f64::from(range_step_um) * 1e-6)?;
            let recipes = [Recipe::Ouster, Recipe::OusterRos].into_iter();
            let tried = recipes.map(|recipe| {
                let build = Build {
                    recipe,
                    ticks,
                    range_step_um,
                    coordinates: self.coordinates,
                    origin,
                    timing: Timing::Together,
                };
                self.ouster_of(&build, &rows, &lines)
            });
            let best = tried.flatten().rev().max_by_key(|(_, exact)| *exact);
            best.map(|(scanner, _)| scanner)
        })
    }

    /// The scanner of this build with the lasers found for it, and how many of a sample of points it reproduces.
    fn ouster_of(&self, build: &Build, rows: &Rows, lines: &[Option<[f64; 2]>]) -> Option<(Firings, usize)> {
        let build = &Build { origin: sharpened_origin(build, &rows.points, lines), ..build.clone() };
        let any = Firings::new(build.clone(), Vec::new(), Vec::new());
        let found: Vec<Option<(Laser, usize)>> = rows
            .points
            .par_iter()
            .zip(lines)
            .map(|(points, line)| line.map(|[slope, _]| ouster_laser(&any, slope, points)))
            .collect();
        let exact = found.iter().flatten().map(|(_, exact)| exact).sum::<usize>();
        if exact == 0 {
            return None;
        }
        // Lasers with too few points come after all others.
        let lowest = found.iter().flatten().map(|(laser, _)| laser.elevation).min()?;
        let unseen = (0.1 / ANGLE_UNIT) as i64;
        let lasers = (1..).zip(&found).map(|(number, found)| match found {
            Some((laser, _)) => *laser,
            None => Laser { elevation: lowest - number * unseen, azimuth: 0 },
        });
        let mut lasers: Vec<(usize, Laser)> = lasers.enumerate().collect();
        lasers.sort_by_key(|(_, laser)| -laser.elevation);
        let (lines, lasers): (Vec<usize>, Vec<Laser>) = lasers.into_iter().unzip();
        let scanner = Firings::new(any.build, lasers, (0..lines.len() as u32).collect());
        let scanner = match &rows.grid {
            Some(grid) => rows.in_order_of_image(scanner, grid, &lines),
            None => self.in_order_of_returns(scanner)?,
        };
        Some((scanner, exact))
    }

    /// The points of each laser, by the lines of a file that has a record for each cell, by a channel, or by
    /// elevation.
    fn ouster_rows(&self) -> Option<Rows> {
        const LASERS: [usize; 5] = [8, 16, 32, 64, 128];
        /// In metres: the largest distance of a laser's points from a line.
        const NEAR: f64 = 1e-3;
        /// The minimum share of the points within that distance.
        const LEAST: f64 = 0.9;
        let records = self.scan.cloud.positions.len();
        let is_width = |lines: usize| WIDTHS.iter().any(|&width| records == lines * width as usize);
        let grids = LASERS.into_iter().filter(|lines| is_width(*lines));
        let grids = grids.flat_map(|lines| [(lines, true), (lines, false)]);
        let mut found = grids.filter_map(|(lines, by_lines)| {
            let width = records / lines;
            let (mut points, mut of_points) = (vec![Vec::new(); lines], vec![Vec::new(); lines]);
            for (point, &record) in self.points.iter().zip(&self.numbers) {
                let line = if by_lines { record / width } else { record % lines };
                points[line].push(*point);
                of_points[line].push(record);
            }
            let (mut near, mut all) = (0, 0);
            for row in &points {
                all += row.len();
                if let Some([slope, height]) = beam_line(row) {
                    let is_near = |point: &&Point| {
                        let [x, y, z] = point.position;
                        (slope * x.hypot(y) + height - z).abs() < NEAR
                    };
                    near += row.iter().filter(is_near).count();
                }
            }
            let grid = RecordGrid { lines: (0..lines as u32).collect(), by_lines, width };
            (near as f64 > LEAST * all as f64).then_some(Rows {
                points,
                records: of_points,
                grid: Some(grid),
            })
        });
        found.next().or_else(|| {
            let points = self.rows_by_channel().or_else(|| self.rows_by_start())?;
            Some(Rows { records: vec![Vec::new(); points.len()], points, grid: None })
        })
    }
}

/// Distances from the axis at which the beams of Ouster's scanners start, in metres, and their heights in the frame
/// of the scanner's case or of its lens. Individual scanners differ by some hundredths of a millimetre.
const OUSTER_ALONG: [f64; 6] = [0.027_67, 0.027_116, 0.015_806, 0.016_721, 0.012_163, 0.013_762];
const OUSTER_UP: [f64; 5] = [0.036_18, 0.038_195, 0.074_296, 0.078_296, 0.0];

impl Found<'_> {
    /// The points of each laser of an Ouster: narrow clusters of elevations as seen from where its beams start.
    /// `None` if no known start gives clusters with enough of the points.
    fn rows_by_start(&self) -> Option<Vec<Vec<Point>>> {
        /// In metres: the elevations of nearer points also depend on the azimuth of the laser.
        const NEAREST: f64 = 4.0;
        const SAMPLED: usize = 10_000;
        /// The minimum share of the points in the clusters.
        const LEAST: f64 = 0.9;
        let elevation = |point: &Point, [along, up]: [f64; 2]| {
            let [x, y, z] = point.position;
            libm::atan2(z - up, x.hypot(y) - along)
        };
        let far: Vec<&Point> = self.points.iter().filter(|point| point.range > NEAREST).collect();
        let step = (far.len() / SAMPLED).max(1);
        let starts = OUSTER_ALONG.iter().flat_map(|&along| OUSTER_UP.map(|up| [along, up]));
        let tried = starts.collect::<Vec<_>>().into_par_iter().map(|start| {
            let mut sample: Vec<f64> =
                far.iter().step_by(step).map(|point| elevation(point, start)).collect();
            sample.sort_unstable_by(|a, b| b.total_cmp(a));
            let (inside, heaps) = narrow_heaps(&sample);
            (inside as f64 / sample.len().max(1) as f64, heaps, start)
        });
        let tried: Vec<_> = tried.collect();
        let best = tried.into_iter().rev().max_by(|a, b| a.0.total_cmp(&b.0));
        let (_, heaps, start) = best.filter(|(share, ..)| *share > LEAST)?;
        let mut rows = vec![Vec::new(); heaps.len()];
        for point in &self.points {
            let elevation = elevation(point, start);
            let row = nearest(&heaps, elevation);
            if (heaps[row] - elevation).abs() < 10.0 * ON_CONE {
                rows[row].push(*point);
            }
        }
        Some(rows)
    }
}

impl Rows {
    /// A scanner with the order of a file that holds an image; `lines` has the line of each row. The direction of a
    /// laser in a column gives the lag of its row.
    fn in_order_of_image(&self, scanner: Firings, grid: &RecordGrid, lines: &[usize]) -> Firings {
        let ticks = scanner.build.ticks;
        let column =
            |record: usize| if grid.by_lines { record % grid.width } else { record / grid.lines.len() };
        let lag = |(row, &line): (usize, &usize)| {
            let lags = self.points[line].iter().zip(&self.records[line]).filter_map(|(point, record)| {
                let (_, tick) = scanner.locate(row, point.position)?;
                Some((column(*record) as u32 % ticks + ticks - tick) % ticks)
            });
            let mut lags: Vec<u32> = lags.collect();
            lags.sort_unstable();
            lags.chunk_by(|a, b| a == b).max_by_key(|same| same.len()).map_or(0, |same| same[0])
        };
        let lags: Vec<u32> = lines.iter().enumerate().map(lag).collect();
        // The lag of the first row is where the image begins.
        let first = lags.first().copied().unwrap_or(0);
        let is_staggered = lags.iter().all(|&lag| lag == first);
        let lags = lags.into_iter().map(|lag| (lag + ticks - first) % ticks);
        let lags = if is_staggered { Vec::new() } else { lags.collect() };
        let mut row_of_line = vec![0u32; lines.len()];
        (0u32..).zip(lines).for_each(|(row, &line)| row_of_line[line] = row);
        let by_lines = if grid.by_lines { row_of_line.clone() } else { Vec::new() };
        Firings::new(scanner.build, scanner.lasers, row_of_line).line_by_line(by_lines).lagging(lags)
    }
}

/// The line on which the points of a beam lie: its slope, and its height at the axis in metres. `None` if there are
/// too few points.
fn beam_line(points: &[Point]) -> Option<[f64; 2]> {
    const FEWEST: usize = 12;
    /// A sufficient number of points.
    const MOST: usize = 2000;
    if points.len() < FEWEST {
        return None;
    }
    let pair = |point: &Point| [point.position[0].hypot(point.position[1]), point.position[2]];
    let pairs: Vec<[f64; 2]> = points.iter().step_by(points.len().div_ceil(MOST)).map(pair).collect();
    steady_line(&pairs)
}

/// The line through some pairs without outliers: its slope, and its height at 0.
fn steady_line(pairs: &[[f64; 2]]) -> Option<[f64; 2]> {
    let (slope, height) = line(pairs.iter())?;
    let off = |pair: &&[f64; 2]| (slope * pair[0] + height - pair[1]).abs();
    let mut all: Vec<f64> = pairs.iter().map(|pair| off(&pair)).collect();
    all.sort_by(f64::total_cmp);
    let limit = 3.0 * all[all.len() / 2] + 1e-7;
    line(pairs.iter().filter(|pair| off(pair) <= limit)).map(|(slope, height)| [slope, height])
}

/// The farther half of some points.
fn far_half(points: &[Point]) -> Vec<Point> {
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| b.range.total_cmp(&a.range));
    sorted.truncate(points.len().div_ceil(2).min(10 * TRIED));
    sorted
}

/// Whether the azimuths of most rows lie on multiples of 1/`ticks` of a turn, each row with a phase of its own.
fn ticks_are_coherent(rows: &[Vec<Point>], ticks: u32) -> bool {
    const COHERENT: f64 = 0.8;
    let of_row = |points: &Vec<Point>| {
        let azimuth = |point: &Point| Recipe::Ouster.azimuth(point.position[0], point.position[1]);
        let (_, strength) = phase(points.iter().map(|point| azimuth(point) / TAU * f64::from(ticks)));
        (strength * points.len() as f64, points.len() as f64)
    };
    let (sum, count) = rows.iter().map(of_row).fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
    sum > COHERENT * f64::max(count, 1.0)
}

/// The origin of the beams, from the lines of the beams and the phases of their ranges: `z / sin E` is a whole number
/// of steps, less n, plus `up / sin E`.
fn ouster_origin(rows: &[Vec<Point>], lines: &[Option<[f64; 2]>], range_step_m: f64) -> Option<Origin> {
    /// The heights of less steep beams do not determine their ranges.
    const STEEP: f64 = 0.15;
    /// In micrometres: the largest errors of the lines, as azimuth offsets make the distance from the axis seem
    /// shorter. Phases determine it up to whole steps.
    const ALONG: std::ops::Range<i32> = -250..750;
    const UP: std::ops::Range<i32> = -60..60;
    /// The first search takes every n-th of these, the second one the neighbours of the best.
    const COARSE: [i32; 2] = [20, 5];
    const COHERENT: f64 = 0.9;
    /// In metres: no Ouster's beams start farther from the axis.
    const FARTHEST: f64 = 0.1;
    let known = || lines.iter().flatten();
    let pairs: Vec<[f64; 2]> = known().map(|[slope, height]| [-slope, *height]).collect();
    let (along, up) = line(pairs.iter())?;
    if !(0.002..FARTHEST).contains(&along) {
        return None;
    }
    // For each beam: one over the sine of its elevation, the phase of its apparent ranges, and its weight.
    let mut phases = Vec::new();
    for (points, [slope, _]) in
        rows.iter().zip(lines).filter_map(|(points, line)| Some((points, line.as_ref()?)))
    {
        let sine = libm::sin(rounded_elevation(*slope));
        if sine.abs() > STEEP {
            let step = points.len().div_ceil(TRIED);
            let seeming = |point: &Point| point.position[2] / sine / range_step_m;
            let (phase, strength) = phase(points.iter().step_by(step).map(seeming));
            phases.push((1.0 / sine, phase, strength * points.len().div_ceil(step) as f64));
        }
    }
    let total: f64 = phases.iter().map(|(_, _, weight)| weight).sum();
    let strength = |along_um: i32, up_um: i32| {
        let [along, up] = [along_um, up_um].map(|um| f64::from(um) * 1e-6 / range_step_m);
        let fits = phases
            .iter()
            .map(|(of_height, phase, weight)| weight * libm::cos((phase + along - up * of_height) * TAU));
        fits.sum::<f64>()
    };
    let [along, up] = [along, up].map(|metres| round_ties_even(metres * 1e6) as i32);
    let best_of = |pairs: &mut dyn Iterator<Item = (i32, i32)>| {
        let tried = pairs.map(|(along, up)| (strength(along, up), (along, up)));
        tried.max_by(|a, b| a.0.total_cmp(&b.0))
    };
    let [every_along, every_up] = COARSE;
    let ups = UP.step_by(every_up as usize);
    let coarse =
        ALONG.step_by(every_along as usize).flat_map(|off| ups.clone().map(move |above| (off, above)));
    let (_, (along, up)) = best_of(&mut coarse.map(|(off, above)| (along + off, up + above)))?;
    let ups = up - every_up..=up + every_up;
    let mut fine =
        (along - every_along..=along + every_along).flat_map(|along| ups.clone().map(move |up| (along, up)));
    let (best, (along_um, up_um)) = best_of(&mut fine)?;
    (best > COHERENT * total && total > 0.0).then_some(Origin { along_um, up_um })
}

/// The origin near that of `build` with which the most heights are reproduced to the last bit.
fn sharpened_origin(build: &Build, rows: &[Vec<Point>], lines: &[Option<[f64; 2]>]) -> Origin {
    /// Micrometres to either side.
    const ALONG: i32 = 6;
    const UP: i32 = 3;
    /// Number of lasers by which it is determined, among those with the most points.
    const FEW: usize = 6;
    let known = rows.iter().zip(lines).filter_map(|(row, line)| Some((row, (*line)?)));
    let mut known: Vec<(&Vec<Point>, [f64; 2])> = known.collect();
    known.sort_by_key(|(row, _)| std::cmp::Reverse(row.len()));
    known.truncate((known.len() / 2).max(FEW));
    let few = known.iter().step_by((known.len() / FEW).max(1)).map(|(row, [slope, _])| {
        let elevation = (rounded_elevation(*slope).to_degrees() / ANGLE_UNIT).round() as i64;
        let points: Vec<Point> = row.iter().step_by(row.len().div_ceil(TRIED)).copied().collect();
        (Laser { elevation, azimuth: 0 }, points)
    });
    let few: Vec<(Laser, Vec<Point>)> = few.collect();
    let from_middle = |most: i32| std::iter::once(0).chain((1..=most).flat_map(|off| [off, -off]));
    let origins = from_middle(ALONG).flat_map(|along| {
        from_middle(UP)
            .map(move |up| Origin { along_um: build.origin.along_um + along, up_um: build.origin.up_um + up })
    });
    let counted = origins.map(|origin| {
        let any = Firings::new(Build { origin, ..build.clone() }, Vec::new(), Vec::new());
        (few.iter().map(|(laser, points)| exact_points(&any, *laser, points, 2..3, 0)).sum::<usize>(), origin)
    });
    // The first one wins ties.
    counted.fold((0, build.origin), |best, next| if next.0 > best.0 { next } else { best }).1
}

/// The elevation of a slope, in radians, rounded to three digits in degrees.
fn rounded_elevation(slope: f64) -> f64 {
    (round_ties_even(libm::atan(slope).to_degrees() * 1e3) * 1e-3).to_radians()
}

/// The laser with this slope that reproduces the most points, and how many of a sample.
fn ouster_laser(any: &Firings, slope: f64, points: &[Point]) -> (Laser, usize) {
    /// In degrees: the largest azimuth offset of an Ouster's beam.
    const FARTHEST: f64 = 15.0;
    /// Number of points by which lasers are preselected.
    const FEW: usize = 12;
    const ROUNDS: usize = 3;
    let some = |most: usize| -> Vec<Point> {
        points.iter().step_by((points.len() / most).max(1)).copied().collect()
    };
    let (few, more) = (some(FEW), some(TRIED));
    let thousandth = (1e-3 / ANGLE_UNIT) as i64;
    let elevation = round_ties_even(rounded_elevation(slope).to_degrees() * 1e3) as i64 * thousandth;
    let (sin, cos) = libm::sincos((elevation as f64 * ANGLE_UNIT).to_radians());
    let [along, up] = any.build.origin.metres();
    let tick = 360.0 / f64::from(any.build.ticks);
    // The degrees by which whole ticks are missed with an azimuth offset.
    let missed = |offset: f64| {
        let (ahead, beside) =
            (along * libm::cos(offset.to_radians()), along * libm::sin(offset.to_radians()));
        let ticks = few.iter().map(|point| {
            let [x, y, z] = point.position;
            // If the beam is steep, the height gives the horizontal distance more accurately than x and y do.
            let flat = match sin.abs() > cos {
                true => (z - up) / sin * cos,
                false => (x * x + y * y - beside * beside).max(0.0).sqrt() - ahead,
            };
            let turned = libm::atan2(
                flat * libm::sin(offset.to_radians()),
                flat * libm::cos(offset.to_radians()) + along,
            );
            (any.build.recipe.azimuth(x, y) - turned).to_degrees() / tick
        });
        phase(ticks).0 * tick
    };
    let whole = (FARTHEST / tick) as i32;
    let candidates = (0..=whole).flat_map(|number| [number, -number]).map(|number| {
        let mut offset = f64::from(number) * tick;
        (0..ROUNDS).for_each(|_| offset += missed(offset));
        let azimuth = round_ties_even(offset * 1e3) as i64 * thousandth;
        let laser = Laser { elevation, azimuth };
        (exact_points(any, laser, &few, 0..3, 0), laser)
    });
    let mut candidates: Vec<(usize, Laser)> = candidates.collect();
    candidates.sort_by_key(|(exact, laser)| (std::cmp::Reverse(*exact), laser.azimuth.abs()));
    candidates.truncate(3);
    // The angles of newer scanners have two digits.
    let around = |angle: i64| {
        let hundredth = round_ties_even(angle as f64 / (10 * thousandth) as f64) as i64 * 10 * thousandth;
        [angle, hundredth, angle - thousandth, angle + thousandth]
    };
    let near = candidates.into_iter().flat_map(|(_, laser)| {
        let elevations = around(laser.elevation).into_iter();
        elevations
            .flat_map(move |elevation| around(laser.azimuth).map(|azimuth| Laser { elevation, azimuth }))
    });
    best_of(any, near, &more, Laser { elevation, azimuth: 0 })
}

/// The line through some pairs, by least squares: its slope, and its height at 0.
fn line<'p>(pairs: impl Iterator<Item = &'p [f64; 2]> + Clone) -> Option<(f64, f64)> {
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

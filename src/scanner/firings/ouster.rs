//! Finds Ouster's scanners whose beams start away from the axis, each unit's at a place of its own.

use std::f64::consts::TAU;

use rayon::prelude::*;

use super::constants::{Point, TRIED, best_of, reproduced_points};
use super::fit::{GridShape, ON_CONE, RecordGrid, ScanFacts, fewest_of, narrow_heaps, phase};
use super::off_axis::{beam_line, line};
use super::order::{lines, order};
use super::projection::nearest;
use super::{ANGLE_UNIT, Bearing, Build, Firings, Laser, Origin, Recipe, Timing};
use crate::ground::floats::round_ties_even;

/// Widths of Ouster's images, which equal the ticks per turn.
const WIDTHS: [u32; 4] = [512, 1024, 2048, 4096];

/// Distances from the axis at which the beams of Ouster's scanners start, in metres, and their heights in the
/// frame of the scanner's case or of its lens. Individual scanners differ by some hundredths of a millimetre.
const OUSTER_ALONG: [f64; 6] = [0.027_67, 0.027_116, 0.015_806, 0.016_721, 0.012_163, 0.013_762];
const OUSTER_UP: [f64; 5] = [0.036_18, 0.038_195, 0.074_296, 0.078_296, 0.0];

/// The points of each laser with their record numbers, and the lines of the file if it holds a record for
/// each cell.
struct Rows<'m> {
    points: Vec<Vec<Point<'m>>>,
    records: Vec<Vec<usize>>,
    grid: Option<RecordGrid>,
}

impl ScanFacts<'_> {
    /// An Ouster whose beams start away from the axis: for a range r, elevation E, azimuth offset O and a
    /// beam that starts at a distance n from the axis, `rho^2 = ((r - n) cos E)^2 + 2 (r - n) cos E n cos O +
    /// n^2` and `z = (r - n) sin E + up`. In the first of these, early drivers have -n in place of n.
    pub(super) fn ouster(&self) -> Option<Firings> {
        /// The range step of the low data rate profile, and that of all others.
        const RANGE_STEPS_UM: [u32; 2] = [8000, 1000];
        let rows = self.ouster_rows()?;
        let lines: Vec<Option<[f64; 2]>> = rows.points.iter().map(|row| beam_line(row)).collect();
        let far: Vec<Vec<Point>> = rows.points.iter().map(|row| far_half(row)).collect();
        let ticks = WIDTHS.into_iter().find(|&ticks| ticks_are_coherent(&far, ticks))?;
        // Rounding hides steps that are no coarser than its own, and the phases of ranges.
        let steps = if self.blur.is_any() { vec![self.blur.step_um()] } else { RANGE_STEPS_UM.to_vec() };
        steps.into_iter().find_map(|range_step_um| {
            let recipes = [Recipe::Ouster, Recipe::OusterRos, Recipe::OusterEarly].into_iter();
            let tried = recipes.map(|recipe| {
                let origin = match self.blur.is_any() {
                    true => origin_of_lines(&lines, recipe)?,
                    false => origin_of_phases(&rows.points, &lines, recipe, range_step_um)?,
                };
                let build = Build {
                    recipe,
                    ticks,
                    range_step_um,
                    coordinates: self.coordinates,
                    origin,
                    timing: Timing::Together,
                    mounting: None,
                };
                self.ouster_of(&build, &rows, &lines)
            });
            let best = tried.flatten().rev().max_by_key(|(_, exact)| *exact);
            best.map(|(scanner, _)| scanner)
        })
    }

    /// The scanner of this build with the lasers found for it, and how many of a sample of points it
    /// reproduces.
    fn ouster_of(&self, build: &Build, rows: &Rows, lines: &[Option<[f64; 2]>]) -> Option<(Firings, usize)> {
        let build = &Build { origin: sharpened_origin(build, &rows.points, lines), ..build.clone() };
        let bare = Firings::without_lasers(build.clone());
        let found: Vec<Option<(Laser, usize)>> = rows
            .points
            .par_iter()
            .zip(lines)
            .map(|(points, line)| line.map(|[slope, _]| ouster_laser(&bare, slope, points)))
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
        let scanner = Firings::new(bare.build, lasers, (0..lines.len() as u32).collect());
        let scanner = match &rows.grid {
            Some(grid) => rows.in_order_of_image(scanner, grid, &lines),
            None => self.in_order_of_returns(scanner)?,
        };
        Some((scanner, exact))
    }

    /// An Ouster with the order of a file that holds only returns: column by column, staggered or not, or row
    /// by row. `None` if the file is in neither order.
    fn in_order_of_returns(&self, scanner: Firings) -> Option<Firings> {
        let (sequence, ticks) = (self.sequence(&scanner), scanner.build.ticks);
        let within_turn = |ahead: f64| (-ahead as i64).rem_euclid(i64::from(ticks)) as u32;
        if let Some(order) = order(&sequence, scanner.rows(), ticks, self.slack(ticks)) {
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

    /// The points of each laser, by the lines of a file that has a record for each cell, by a channel, or by
    /// elevation.
    fn ouster_rows(&self) -> Option<Rows<'_>> {
        const LASERS: [usize; 5] = [8, 16, 32, 64, 128];
        /// In metres: the largest distance of a laser's points from a line.
        const NEAR: f64 = 1e-3;
        /// The minimum share of the points within that distance.
        const LEAST: f64 = 0.9;
        let records = self.cloud.positions.len();
        // Several scans may have been joined.
        let is_grid = |lines: &usize| records.is_multiple_of(lines * WIDTHS[0] as usize);
        let grids = LASERS.into_iter().filter(is_grid);
        let grids = grids.flat_map(|lines| [(lines, true), (lines, false)]);
        let mut found = grids.filter_map(|(lines, by_lines)| {
            let shape = GridShape { lines, width: records / lines, by_lines };
            let (mut points, mut of_points) = (vec![Vec::new(); lines], vec![Vec::new(); lines]);
            for (point, &record) in self.points.iter().zip(self.numbers.iter()) {
                let line = shape.line(record);
                points[line].push(*point);
                of_points[line].push(record);
            }
            let (mut near, mut all) = (0, 0);
            for row in &points {
                all += row.len();
                if let Some([slope, height]) = beam_line(row) {
                    let is_near = |point: &&Point| {
                        let [x, y, z] = point.position;
                        (slope * libm::hypot(x, y) + height - z).abs() < NEAR + 2.0 * self.blur.reach()
                    };
                    near += row.iter().filter(is_near).count();
                }
            }
            let grid = RecordGrid { lines: (0..lines as u32).collect(), shape };
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

    /// The points of each laser of an Ouster: narrow clusters of elevations as seen from where its beams
    /// start. `None` if no known start gives clusters with enough of the points.
    fn rows_by_start(&self) -> Option<Vec<Vec<Point<'_>>>> {
        /// In metres: the nearer a point is, the more its elevation also depends on the azimuth of the laser.
        /// Points beyond these distances are examined one after the other, the first at least as many as
        /// `FEWEST`.
        const BEYOND: [f64; 4] = [4.0, 2.0, 1.0, 0.5];
        const FEWEST: usize = 1000;
        const SAMPLED: usize = 10_000;
        /// The minimum share of the points in the clusters.
        const LEAST: f64 = 0.9;
        let elevation = |point: &Point, [along, up]: [f64; 2]| {
            let [x, y, z] = point.position;
            libm::atan2(z - up, libm::hypot(x, y) - along)
        };
        let beyond = |metres: f64| self.points.iter().filter(move |point| point.range > metres);
        let first = BEYOND.into_iter().position(|metres| beyond(metres).count() >= FEWEST)?;
        let far: Vec<&Point> = beyond(BEYOND[first]).collect();
        let step = (far.len() / SAMPLED).max(1);
        let on_cone = |metres: f64| BEYOND[0] / metres * self.on_cone();
        let starts = OUSTER_ALONG.iter().flat_map(|&along| OUSTER_UP.map(|up| [along, up]));
        let tried = starts.collect::<Vec<_>>().into_par_iter().map(|start| {
            let mut sample: Vec<f64> =
                far.iter().step_by(step).map(|point| elevation(point, start)).collect();
            sample.sort_unstable_by(|a, b| b.total_cmp(a));
            let (inside, heaps) = narrow_heaps(&sample, on_cone(BEYOND[first]), fewest_of(sample.len()));
            (inside as f64 / sample.len().max(1) as f64, heaps, start)
        });
        let tried: Vec<_> = tried.collect();
        let best = tried.into_iter().rev().max_by(|a, b| a.0.total_cmp(&b.0));
        let (_, mut heaps, start) = best.filter(|(share, ..)| *share > LEAST)?;
        // Lasers that see nothing far away, such as those that look at the ground.
        for metres in BEYOND.into_iter().skip(first + 1) {
            let is_apart = |elevation: &f64| {
                (heaps[nearest(&heaps, *elevation)] - elevation).abs() > 10.0 * BEYOND[0] / metres * ON_CONE
            };
            let near = beyond(metres).map(|point| elevation(point, start));
            let mut others: Vec<f64> = near.filter(is_apart).collect();
            others.sort_unstable_by(|a, b| b.total_cmp(a));
            heaps.extend(narrow_heaps(&others, on_cone(metres), fewest_of(others.len())).1);
            heaps.sort_unstable_by(|a, b| b.total_cmp(a));
        }
        let mut rows = vec![Vec::new(); heaps.len()];
        for point in self.points.iter() {
            let elevation = elevation(point, start);
            let row = nearest(&heaps, elevation);
            if (heaps[row] - elevation).abs() < 10.0 * ON_CONE {
                rows[row].push(*point);
            }
        }
        Some(rows)
    }
}

impl Rows<'_> {
    /// A scanner with the order of a file that holds an image; `lines` has the line of each row. The
    /// direction of a laser in a column gives the lag of its row.
    fn in_order_of_image(&self, scanner: Firings, grid: &RecordGrid, lines: &[usize]) -> Firings {
        let ticks = scanner.build.ticks;
        let lag = |(row, &line): (usize, &usize)| {
            let lags = self.points[line].iter().zip(&self.records[line]).filter_map(|(point, record)| {
                let (_, tick) = scanner.locate(row, point.position)?;
                Some((grid.shape.column(*record) as u32 % ticks + ticks - tick) % ticks)
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
        let by_lines = if grid.shape.by_lines { row_of_line.clone() } else { Vec::new() };
        Firings::new(scanner.build, scanner.lasers, row_of_line).line_by_line(by_lines).lagging(lags)
    }
}

/// The farther half of some points.
fn far_half<'m>(points: &[Point<'m>]) -> Vec<Point<'m>> {
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| b.range.total_cmp(&a.range));
    sorted.truncate(points.len().div_ceil(2).min(10 * TRIED));
    sorted
}

/// Whether the azimuths of most rows lie on multiples of 1/`ticks` of a turn, each row with a phase of its
/// own.
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

/// The origin of the beams from their lines: heights fall with slopes by the distance from the axis.
fn origin_of_lines(lines: &[Option<[f64; 2]>], recipe: Recipe) -> Option<Origin> {
    /// In metres: no Ouster's beams start farther from the axis.
    const FARTHEST: f64 = 0.1;
    let pair = |[slope, height]: &[f64; 2]| match recipe {
        Recipe::OusterEarly => [slope - 2.0 * slope / libm::hypot(*slope, 1.0), *height],
        _ => [-slope, *height],
    };
    let pairs: Vec<[f64; 2]> = lines.iter().flatten().map(pair).collect();
    let (along, up) = line(pairs.iter())?;
    if !(0.002..FARTHEST).contains(&along) {
        return None;
    }
    let along = recipe.crossing(along);
    let [along_um, up_um] = [along, up].map(|metres| round_ties_even(metres * 1e6) as i32);
    Some(Origin { along_um, up_um })
}

/// The origin of the beams, from the lines of the beams and the phases of their ranges: `z / sin E` is a
/// whole number of steps, less n, plus `up / sin E`.
fn origin_of_phases(
    rows: &[Vec<Point>],
    lines: &[Option<[f64; 2]>],
    recipe: Recipe,
    range_step_um: u32,
) -> Option<Origin> {
    /// The heights of less steep beams do not determine their ranges.
    const STEEP: f64 = 0.15;
    /// In micrometres: the largest errors of the lines, as azimuth offsets make beams seem to start farther
    /// back. Phases determine where up to whole steps.
    const ALONG: std::ops::Range<i32> = -250..750;
    const UP: std::ops::Range<i32> = -60..60;
    /// The first search takes every n-th of these, the second one the neighbours of the best.
    const COARSE: [i32; 2] = [20, 5];
    const COHERENT: f64 = 0.9;
    let Origin { along_um: along, up_um: up } = origin_of_lines(lines, recipe)?;
    let range_step_m = f64::from(range_step_um) * 1e-6;
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
        let along = recipe.crossing(along);
        let fits = phases
            .iter()
            .map(|(of_height, phase, weight)| weight * libm::cos((phase + along - up * of_height) * TAU));
        fits.sum::<f64>()
    };
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
        let bare = Firings::without_lasers(Build { origin, ..build.clone() });
        (
            few.iter()
                .map(|(laser, points)| reproduced_points(&bare, *laser, points, 2..3, 0))
                .sum::<usize>(),
            origin,
        )
    });
    // The first one wins ties.
    counted.fold((0, build.origin), |best, next| if next.0 > best.0 { next } else { best }).1
}

/// The elevation of a slope, in radians, rounded to three digits in degrees.
fn rounded_elevation(slope: f64) -> f64 {
    (round_ties_even(libm::atan(slope).to_degrees() * 1e3) * 1e-3).to_radians()
}

/// The laser with this slope that reproduces the most points, and how many of a sample.
fn ouster_laser(bare: &Firings, slope: f64, points: &[Point]) -> (Laser, usize) {
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
    let Bearing { cos, sin, up, .. } =
        Bearing::new(bare.build.recipe, &Laser { elevation, azimuth: 0 }, bare.build.origin);
    let [along, _] = bare.build.origin.metres();
    let tick = 360.0 / f64::from(bare.build.ticks);
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
            (bare.build.recipe.azimuth(x, y) - turned).to_degrees() / tick
        });
        phase(ticks).0 * tick
    };
    let whole = (FARTHEST / tick) as i32;
    let candidates = (0..=whole).flat_map(|number| [number, -number]).map(|number| {
        let mut offset = f64::from(number) * tick;
        (0..ROUNDS).for_each(|_| offset += missed(offset));
        let azimuth = round_ties_even(offset * 1e3) as i64 * thousandth;
        let laser = Laser { elevation, azimuth };
        (reproduced_points(bare, laser, &few, 0..3, 0), laser)
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
    best_of(bare, near, &more, (Laser { elevation, azimuth: 0 }, 0))
}

//! The axes of the map, estimated only from the lattices of float32 values on which the points lie along
//! them: the coarsest lattice first, from close pairs of points to pairs increasingly far apart, which
//! determine its direction increasingly well.

use std::f64::consts::{PI, TAU};

use nalgebra::Matrix4;
use pulp::NullaryFnOnce;

use super::SLOTS;
use super::sweep::{Matrix, Vector};
use crate::ground::floats::round_ties_even;
use crate::ground::lanes::{dispatch, lanes};
use crate::ground::random::Rng;

/// The axes as rows, and the steps of the lattices along the first two, in metres.
pub struct Axes {
    pub rows: Matrix,
    pub steps: [f64; 2],
}

/// The distance between points of a sample, in metres, and the sample.
type Level = (f64, Sample);

/// The sine of phases in turns, to within a thousandth.
#[inline(always)]
fn sine<const N: usize>(turns: [f64; N]) -> [f64; N] {
    lanes(|lane| {
        let part = turns[lane] - round_ties_even(turns[lane]);
        let rough = 8.0 * part - 16.0 * part * part.abs();
        0.225 * (rough * rough.abs() - rough) + rough
    })
}

/// A sample of points, each coordinate in a list of its own.
struct Sample([Vec<f64>; 3]);

impl Sample {
    /// At random, at most `most` of the points.
    fn new(points: &[Vector], most: usize, random: &mut Rng) -> Self {
        let chosen: Vec<Vector> = match points.len() <= most {
            true => points.to_vec(),
            false => (0..most).map(|_| points[random.below(points.len())]).collect(),
        };
        Sample(std::array::from_fn(|axis| chosen.iter().map(|point| point[axis]).collect()))
    }

    fn len(&self) -> usize {
        self.0[0].len()
    }

    /// How well the points are on a lattice of this step along a direction: 1 if all are.
    fn coherence(&self, direction: &Vector, step: f64) -> f64 {
        dispatch(Coherence { sample: self, along: direction / step })
    }
}

/// Computes the coherence of a sample; `along` is the lattice's direction divided by its step.
struct Coherence<'a> {
    sample: &'a Sample,
    along: Vector,
}

impl NullaryFnOnce for Coherence<'_> {
    type Output = f64;

    #[inline(always)]
    fn call(self) -> f64 {
        /// Loops over fewer are unrolled into pairs instead of filling vector units.
        const LANES: usize = 32;
        let [x, y, z] = &self.sample.0;
        let along = self.along;
        let mut sums = [[0.0; LANES]; 2];
        let [xs, ys, zs] = [x, y, z].map(|all| all.as_chunks::<LANES>());
        for ((x, y), z) in xs.0.iter().zip(ys.0).zip(zs.0) {
            let turns = lanes(|lane| x[lane] * along.x + y[lane] * along.y + z[lane] * along.z);
            let [cos, sin] = [sine(lanes(|lane| turns[lane] + 0.25)), sine::<LANES>(turns)];
            sums = [lanes(|lane| sums[0][lane] + cos[lane]), lanes(|lane| sums[1][lane] + sin[lane])];
        }
        for ((x, y), z) in xs.1.iter().zip(ys.1).zip(zs.1) {
            let turns = x * along.x + y * along.y + z * along.z;
            let [cos, sin] = sine([turns + 0.25, turns]);
            sums[0][0] += cos;
            sums[1][0] += sin;
        }
        let [re, im] = sums.map(|lanes| lanes.iter().sum::<f64>());
        (re * re + im * im).sqrt() / self.sample.len().max(1) as f64
    }
}

/// Two directions perpendicular to `direction` and to each other.
fn beside(direction: &Vector) -> [Vector; 2] {
    let across = direction.cross(&Vector::z()).normalize();
    [across, direction.cross(&across)]
}

/// The samples in which lattices are searched for.
struct Samples {
    /// Differences of records of the same slot, with their lengths.
    pairs: Vec<(f64, Vector)>,
    points: Vec<(f64, Vector)>,
    levels: Vec<Level>,
    near_levels: Vec<Level>,
    far: Sample,
    random: Rng,
}

impl Samples {
    fn new(points: &[Vector], is_none: &[bool], pairs_of_none: bool) -> Self {
        /// Minimum number of points in a [`Level`].
        const FEWEST: usize = 100;
        const FEWEST_NEAR: usize = 60;
        const MANY: usize = 1200;
        const MANY_NEAR: usize = 1500;
        let mut random = Rng::keyed(0, &[]);
        // One record without a return carries as much information as all those of a firing.
        let mut is_kept: Vec<bool> = is_none.iter().map(|none| !none).collect();
        for firing in 0..points.len() / SLOTS {
            if let Some(first) = (firing * SLOTS..(firing + 1) * SLOTS).find(|&record| is_none[record]) {
                is_kept[first] = true;
            }
        }
        let with_length = |v: Vector| (v.norm(), v);
        let pairs = |apart: &[usize], reach: f64| {
            let mut pairs = Vec::new();
            for apart in apart {
                for record in apart * SLOTS..points.len() {
                    let [a, b] = [record, record - apart * SLOTS];
                    let is_near = || points[a].norm() < reach && points[b].norm() < reach;
                    let is_pair = pairs_of_none || !is_none[a] && !is_none[b];
                    if is_kept[a] && is_kept[b] && is_pair && is_near() {
                        pairs.push(with_length(points[a] - points[b]));
                    }
                }
            }
            pairs
        };
        let (all_pairs, near_pairs) =
            (pairs(&[1, 2, 4, 8, 16, 32], f64::INFINITY), pairs(&[1, 2, 4, 8, 16, 32, 64], 1.0));
        let kept: Vec<(f64, Vector)> =
            points.iter().zip(&is_kept).filter(|(_, kept)| **kept).map(|(p, _)| with_length(*p)).collect();
        let between = |all: &[(f64, Vector)], low: f64, high: f64| -> Vec<Vector> {
            all.iter().filter(|(length, _)| (low..high).contains(length)).map(|(_, v)| *v).collect()
        };
        let mut levels = Vec::new();
        let mut near_levels = Vec::new();
        for reach in [0.003, 0.006, 0.012, 0.025, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.0] {
            levels.push((reach, Sample::new(&between(&all_pairs, reach / 6.0, reach), MANY, &mut random)));
        }
        for reach in [6.0, 12.0, 25.0, 50.0] {
            levels.push((reach, Sample::new(&between(&kept, 0.0, reach), MANY, &mut random)));
        }
        levels.retain(|(_, points)| points.len() > FEWEST);
        for reach in [0.004, 0.01, 0.03, 0.06] {
            near_levels.push((
                reach,
                Sample::new(&between(&near_pairs, reach / 8.0, reach), MANY_NEAR, &mut random),
            ));
        }
        for reach in [0.15, 0.3, 0.45] {
            near_levels.push((reach, Sample::new(&between(&kept, 0.0, reach), MANY_NEAR, &mut random)));
        }
        near_levels.retain(|(_, points)| points.len() > FEWEST_NEAR);
        let far = Sample::new(&between(&kept, 0.0, 30.0), 2000, &mut random);
        Samples { pairs: all_pairs, points: kept, levels, near_levels, far, random }
    }

    /// The coarsest step of the lattice along a direction, which has a lattice of `step`.
    fn coarsest(&self, direction: &Vector, mut step: f64) -> f64 {
        while step < COARSEST && self.far.coherence(direction, 2.0 * step) > 0.9 {
            step *= 2.0;
        }
        step
    }

    /// The direction of the coarsest lattice, nearly horizontal, and its step.
    fn first(&mut self) -> Option<(Vector, f64)> {
        /// Largest distance, in metres, between the points of the first sample: the first value that gives
        /// enough.
        const STARTS: [f64; 3] = [0.006, 0.012, 0.025];
        const FEWEST: usize = 150;
        const MANY: usize = 600;
        for exponent in 11..18 {
            let step = power_of_two(-exponent);
            let near = |start: f64| {
                let is_near = |(length, v): &&(f64, Vector)| {
                    *length < start && *length > (2.0 * step).max(0.0003) && v.z.abs() < 10.0 * step
                };
                let near: Vec<Vector> = self.pairs.iter().filter(is_near).map(|(_, v)| *v).collect();
                (near.len() >= FEWEST).then_some((start, near))
            };
            let Some((start, near)) = STARTS.into_iter().find_map(near) else { continue };
            let near = Sample::new(&near, MANY, &mut self.random);
            let yaw_step = 0.4 * step / start;
            let mut found = Vec::new();
            for tilt in [-0.06, -0.03, 0.0, 0.03, 0.06] {
                let yaws = (0..(PI / yaw_step) as usize).map(|number| number as f64 * yaw_step);
                let mut of_tilt: Vec<(f64, Vector)> = yaws
                    .map(|yaw| {
                        let direction = Vector::new(libm::cos(yaw), libm::sin(yaw), tilt).normalize();
                        (near.coherence(&direction, step), direction)
                    })
                    .collect();
                of_tilt.sort_by(|a, b| b.0.total_cmp(&a.0));
                found.extend(of_tilt.into_iter().take(4));
            }
            found.sort_by(|a, b| b.0.total_cmp(&a.0));
            for (_, direction) in found.into_iter().take(8) {
                if let Some(direction) = self.sharpened(direction, step, [yaw_step * 1.5, 0.03]) {
                    let step = self.coarsest(&direction, step);
                    return Some((self.polished(direction, step), step));
                }
            }
        }
        None
    }

    /// Improves a direction by going from close to distant points. `span`: the uncertainty, in radians,
    /// horizontally and vertically.
    fn sharpened(&self, mut direction: Vector, step: f64, mut span: [f64; 2]) -> Option<Vector> {
        /// Minimum coherence, which is not reached by chance.
        const LEAST: f64 = 0.55;
        for (reach, points) in &self.levels {
            for round in 0..2 {
                let [across, up] = beside(&direction);
                let count =
                    |span: f64| (2.0 * span * reach / step * 2.5).ceil().clamp(7.0, 241.0) as usize | 1;
                let [wide, high] = span.map(count);
                let mut best = (0.0, direction);
                for i in 0..wide {
                    for j in 0..high {
                        let part = |i: usize, n: usize| 2.0 * i as f64 / (n - 1) as f64 - 1.0;
                        let off = across * (part(i, wide) * span[0]) + up * (part(j, high) * span[1]);
                        let tried = (direction + off).normalize();
                        let found = points.coherence(&tried, step);
                        if found > best.0 {
                            best = (found, tried);
                        }
                    }
                }
                direction = best.1;
                if best.0 < LEAST {
                    return None;
                }
                let limits = if round == 0 {
                    [(span[0], wide), (span[1], high)].map(|(span, n)| 2.0 * span / (n - 1) as f64 * 1.2)
                } else {
                    [0.5 * step / reach; 2]
                };
                span = std::array::from_fn(|i| span[i].min(limits[i]).max(0.03 * step / reach));
            }
            span = [0.5 * step / reach; 2];
        }
        Some(direction)
    }

    /// Least squares of the distances to the planes of the lattice.
    fn polished(&self, mut direction: Vector, step: f64) -> Vector {
        const REACH: f64 = 60.0;
        let points: Vec<Vector> =
            self.points.iter().filter(|(length, _)| *length < REACH).map(|(_, v)| *v).collect();
        let (mut re, mut im) = (0.0, 0.0);
        for point in &points {
            let (sin, cos) = libm::sincos(point.dot(&direction) / step * TAU);
            re += cos;
            im += sin;
        }
        let mut phase = libm::atan2(im, re) / TAU * step;
        for _ in 0..6 {
            let mut normal = Matrix4::identity() * 1e-12;
            let mut right = nalgebra::Vector4::zeros();
            for point in &points {
                let off = point.dot(&direction) - phase;
                let off = off - round_ties_even(off / step) * step;
                if off.abs() < 0.2 * step {
                    let row = nalgebra::Vector4::new(point.x, point.y, point.z, -1.0);
                    normal += row * row.transpose();
                    right -= row * off;
                }
            }
            let Some(cholesky) = normal.cholesky() else { break };
            let change = cholesky.solve(&right);
            direction = (direction + change.fixed_rows::<3>(0)).normalize();
            phase += change[3];
        }
        direction
    }

    /// The direction of a lattice of this step perpendicular to another.
    fn second(&self, first: &Vector, step: f64, levels: &[Level], least: f64) -> Option<Vector> {
        const MOST_TRIED: usize = 30_001;
        let [a, b] = beside(first);
        let (mut angle, mut span) = (0.0, 0.08f64);
        let direction = |angle: f64| a * libm::cos(angle) + b * libm::sin(angle);
        for (reach, points) in levels {
            let count = ((12.0 * span * reach / step) as usize | 1).max(9);
            if count > MOST_TRIED {
                return None;
            }
            let angles = (0..count).map(|i| angle + (2.0 * i as f64 / (count - 1) as f64 - 1.0) * span);
            let found = angles.map(|angle| (points.coherence(&direction(angle), step), angle));
            let best = found.max_by(|a, b| a.0.total_cmp(&b.0))?;
            if best.0 < least {
                return None;
            }
            angle = best.1;
            span = span.min(step / reach);
        }
        (!levels.is_empty()).then(|| direction(angle))
    }
}

fn power_of_two(exponent: i32) -> f64 {
    libm::ldexp(1.0, exponent)
}

/// The step of the coarsest lattice that is searched for, in metres: that of float32 at 8 km.
const COARSEST: f64 = 1.0 / 2048.0;
/// Below this the scanner's noise hides the lattice of distant points.
pub const FINE: f64 = 1.0 / 65536.0;

/// Finds the axes of the map; none if the points are on no lattice.
///
/// The pairs of records without a return all lie along the path of the car, and carry no information across
/// it: they are used only if there are too few others.
pub fn find(points: &[Vector], is_none: &[bool]) -> Option<Axes> {
    [false, true].into_iter().find_map(|pairs_of_none| {
        let mut samples = Samples::new(points, is_none, pairs_of_none);
        let (first, step) = samples.first().filter(|(_, step)| *step >= FINE)?;
        samples.completed(first, step)
    })
}

impl Samples {
    /// All axes, given the first and its step.
    fn completed(&self, first: Vector, first_step: f64) -> Option<Axes> {
        let of_far = (11..18).find_map(|exponent| {
            let step = power_of_two(-exponent);
            let direction = self.second(&first, step, &self.levels, 0.5)?;
            Some((direction, self.coarsest(&direction, step)))
        });
        let of_near = || {
            (15..23).find_map(|exponent| {
                let step = power_of_two(-exponent);
                Some((self.second(&first, step, &self.near_levels, 0.7)?, step))
            })
        };
        let (mut second, second_step) = of_far.or_else(of_near)?;
        if second_step >= FINE {
            second = self.polished(second, second_step);
            second = (second - first * first.dot(&second)).normalize();
        }
        let mut up = first.cross(&second);
        if up.z < 0.0 {
            (second, up) = (-second, -up);
        }
        let rows = Matrix::from_rows(&[first.transpose(), second.transpose(), up.transpose()]);
        Some(Axes { rows, steps: [first_step, second_step] })
    }
}

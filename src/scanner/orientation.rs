//! Which axes of a file are the scanner's. Formulas have z up along the axis of rotation; a file may have the
//! axes in another order or reversed, such as y up or z ahead. No bit of a coordinate but its sign changes
//! from one to the other. FORMAT.md 3.1.

use std::f64::consts::TAU;
use std::fmt;
use std::ops::Neg;

use super::{median, thinned};
use crate::ground::angle;
use crate::ground::error::{Error, Result};
use crate::ground::floats::round_ties_even;

/// For each axis of the scanner, the axis of the file and whether it is reversed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Orientation([(usize, bool); 3]);

/// The orders of three axes, by their numbers in the stream.
const ORDERS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];

impl fmt::Display for Orientation {
    /// The axes of the file that are the scanner's x, y and z, such as `x, -z, y`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = |(axis, is_reversed): (usize, bool)| {
            format!("{}{}", if is_reversed { "-" } else { "" }, ["x", "y", "z"][axis])
        };
        f.write_str(&self.0.map(name).join(", "))
    }
}

impl Default for Orientation {
    /// That of a file with the scanner's axes.
    fn default() -> Self {
        Orientation([0, 1, 2].map(|axis| (axis, false)))
    }
}

impl Orientation {
    /// The orientation of this number in the stream.
    ///
    /// # Errors
    /// If there is none.
    pub fn from_number(number: u64) -> Result<Self> {
        let order = usize::try_from(number / 8).ok().and_then(|order| ORDERS.get(order));
        let order = order.ok_or_else(|| Error::corrupt(format!("scanner: no orientation {number}")))?;
        Ok(Orientation([0, 1, 2].map(|axis| (order[axis], number >> axis & 1 == 1))))
    }

    /// Its number in the stream.
    pub fn number(self) -> u64 {
        let order = self.0.map(|(axis, _)| axis);
        let order = ORDERS.iter().position(|known| *known == order).unwrap_or_default() as u64;
        (0..3).fold(8 * order, |number, axis| number | u64::from(self.0[axis].1) << axis)
    }

    /// Whether the file has the scanner's axes.
    pub fn is_default(self) -> bool {
        self == Orientation::default()
    }

    /// A position of the file along the axes of the scanner.
    pub fn to_scanner<T: Copy + Neg<Output = T>>(self, position: [T; 3]) -> [T; 3] {
        self.0.map(|(axis, is_reversed)| signed(position[axis], is_reversed))
    }

    /// A position along the axes of the scanner as in the file.
    pub fn to_file<T: Copy + Neg<Output = T>>(self, position: [T; 3]) -> [T; 3] {
        let mut of_file = position;
        for ((axis, is_reversed), value) in self.0.into_iter().zip(position) {
            of_file[axis] = signed(value, is_reversed);
        }
        of_file
    }

    /// Brings positions of the file to the axes of the scanner.
    pub fn turn_to_scanner(self, positions: &mut [[f32; 3]]) {
        if !self.is_default() {
            positions.iter_mut().for_each(|position| *position = self.to_scanner(*position));
        }
    }

    /// Brings positions along the axes of the scanner to those of the file.
    pub fn turn_to_file(self, positions: &mut [[f32; 3]]) {
        if !self.is_default() {
            positions.iter_mut().for_each(|position| *position = self.to_file(*position));
        }
    }

    /// This orientation of files whose axes are turned by another one already.
    pub fn after(self, first: Orientation) -> Self {
        Orientation(self.0.map(|(axis, is_reversed)| (first.0[axis].0, is_reversed != first.0[axis].1)))
    }

    /// The orientation after a quarter of a turn about the axis of rotation.
    fn turned(self) -> Self {
        let [(x, is_x_reversed), y, z] = self.0;
        Orientation([y, (x, !is_x_reversed), z])
    }

    /// The likely orientation of a file of which the rows of an HDL-64E come one after the other: the highest
    /// first, each counterclockwise from straight ahead. `None` if there are no such rows.
    pub fn of_rows(positions: &[[f32; 3]]) -> Option<Self> {
        const FEWEST_ROWS: f64 = 15.0;
        /// Number of points by whose heights the first rows are compared with the last ones.
        const SAMPLE: usize = 8000;
        /// How many times as great as those elsewhere steps from row to row are at least.
        const CLEAR: f64 = 2.0;
        let axis = axis_of_rotation(positions)?;
        let turns = turns(positions, axis);
        if turns.abs() < FEWEST_ROWS {
            return None;
        }
        let height =
            |part: &[[f32; 3]]| thinned(part, SAMPLE).map(|position| sine(position, axis)).sum::<f64>();
        let quarter = positions.len() / 4;
        let is_reversed = height(&positions[..quarter]) < height(&positions[positions.len() - quarter..]);
        let candidates = Self::around((axis, is_reversed), (turns > 0.0) != is_reversed);
        let steps = candidates.map(|orientation| orientation.step_ahead(positions));
        let most = (0..4).max_by(|&a, &b| steps[a].total_cmp(&steps[b]))?;
        let is_clear = (0..4).all(|other| other == most || steps[most] > CLEAR * steps[other]);
        is_clear.then_some(candidates[most])
    }

    /// The orientations of a file in which a scanner turns clockwise, the likely ones first: four that are a
    /// quarter of a turn apart, with the ground below the scanner, and the same upside down. Either four are
    /// mirror images. Empty if nothing turns.
    pub fn of_firings(positions: &[[f32; 3]]) -> Vec<[Self; 4]> {
        const LEAST_TURNS: f64 = 0.1;
        /// Number of points by which the ground is found, and the largest distance of these, in metres.
        const SAMPLE: usize = 8000;
        const NEAR: f32 = 10.0;
        let Some(axis) = axis_of_rotation(positions) else { return Vec::new() };
        let turns = turns(positions, axis);
        if turns.abs() < LEAST_TURNS {
            return Vec::new();
        }
        let is_near = |position: &&[f32; 3]| position.iter().all(|metres| metres.abs() < NEAR);
        let near = thinned(positions, SAMPLE).filter(is_near);
        let is_reversed = near.map(|position| sine(position, axis)).sum::<f64>() > 0.0;
        let both = [is_reversed, !is_reversed];
        let around = |is_reversed| Self::around((axis, is_reversed), (turns > 0.0) == is_reversed);
        both.map(around).to_vec()
    }

    /// The median change of elevation, as a sine, from one point to the next where this passes the direction
    /// straight ahead; 0 if none does.
    fn step_ahead(self, positions: &[[f32; 3]]) -> f64 {
        // Few pairs pass, and all are looked at four times: only the signs of two of their coordinates.
        let along = |position: &[f32; 3], axis: usize| {
            let (of_file, is_reversed) = self.0[axis];
            signed(position[of_file], is_reversed)
        };
        let passes = |pair: &&[[f32; 3]]| {
            let is_ahead = || pair.iter().all(|position| along(position, 0) > 0.0);
            along(&pair[0], 1) < 0.0 && along(&pair[1], 1) >= 0.0 && is_ahead()
        };
        let height = |position: &[f32; 3]| sine(&self.to_scanner(*position), 2);
        let step = |pair: &[[f32; 3]]| (height(&pair[1]) - height(&pair[0])).abs();
        let pairs = positions.windows(2);
        let mut steps = pairs.filter(passes).map(step).peekable();
        if steps.peek().is_some() { median(steps) } else { 0.0 }
    }

    /// Those with this axis of the file up, or down if it is reversed, and axes that make a right-handed
    /// system, or otherwise a left-handed one: four, a quarter of a turn apart.
    fn around(up: (usize, bool), is_right_handed: bool) -> [Self; 4] {
        let [x, y] = [(up.0 + 1) % 3, (up.0 + 2) % 3];
        let first = Orientation([(x, false), (y, is_right_handed == up.1), up]);
        let second = first.turned();
        [first, second, second.turned(), second.turned().turned()]
    }
}

/// A value, with the other sign if `is_reversed`. No bit but the sign changes, whatever the value.
fn signed<T: Neg<Output = T>>(value: T, is_reversed: bool) -> T {
    if is_reversed { -value } else { value }
}

/// The sine of the elevation of a point above the plane across an axis; 0 for the origin.
fn sine(position: &[f32; 3], axis: usize) -> f64 {
    let [x, y, z] = position.map(f64::from);
    let distance = (x * x + y * y + z * z).sqrt();
    if distance > 0.0 { f64::from(position[axis]) / distance } else { 0.0 }
}

/// The axis about which the scanner turned: the one about which the most points have one of a few elevations.
/// `None` if it is not clear.
fn axis_of_rotation(positions: &[[f32; 3]]) -> Option<usize> {
    const SAMPLE: usize = 8000;
    /// In metres: the beams of nearer points may start too far from the axis.
    const NEAREST: f32 = 5.0;
    /// Number of elevations that are told apart, and of those that count: a scanner's lasers.
    const ELEVATIONS: usize = 3600;
    const LASERS: usize = 128;
    /// Minimum share of the points at these elevations, and how many times that about another axis it is.
    const LEAST: f64 = 0.3;
    const CLEAR: f64 = 1.5;
    let is_far = |position: &&[f32; 3]| {
        let [x, y, z] = **position;
        let square = x * x + y * y + z * z;
        square.is_finite() && square > NEAREST * NEAREST
    };
    let far: Vec<&[f32; 3]> = thinned(positions, 4 * SAMPLE).filter(is_far).collect();
    let far: Vec<&[f32; 3]> = thinned(&far, SAMPLE).copied().collect();
    if far.is_empty() {
        return None;
    }
    let share = |axis: usize| {
        let mut counts = [0_u32; ELEVATIONS + 1];
        for position in &far {
            let [x, y] = [position[(axis + 1) % 3], position[(axis + 2) % 3]].map(f64::from);
            let elevation = angle::atan2(f64::from(position[axis]), (x * x + y * y).sqrt());
            counts[((elevation / TAU * 2.0 + 0.5) * ELEVATIONS as f64) as usize] += 1;
        }
        counts.sort_unstable_by(|a, b| b.cmp(a));
        f64::from(counts[..LASERS].iter().sum::<u32>()) / far.len() as f64
    };
    let shares = [0, 1, 2].map(share);
    let most = (0..3).max_by(|&a, &b| shares[a].total_cmp(&shares[b]))?;
    let is_clear = (0..3).all(|other| other == most || shares[most] > CLEAR * shares[other]);
    (shares[most] >= LEAST && is_clear).then_some(most)
}

/// How many turns points make about an axis of the file, one after the other; counterclockwise is positive.
fn turns(positions: &[[f32; 3]], axis: usize) -> f64 {
    /// Number of points that show the turns of a scan.
    const SAMPLE: usize = 32_768;
    let [x, y] = [(axis + 1) % 3, (axis + 2) % 3];
    let is_beside = |position: &&[f32; 3]| position[x] != 0.0 || position[y] != 0.0;
    let azimuth = |position: &[f32; 3]| angle::atan2(f64::from(position[y]), f64::from(position[x])) / TAU;
    let mut azimuths =
        thinned(positions, SAMPLE).filter(is_beside).map(azimuth).filter(|turns| turns.is_finite());
    let Some(mut last) = azimuths.next() else { return 0.0 };
    let step = |next: f64| {
        let step = next - std::mem::replace(&mut last, next);
        step - round_ties_even(step)
    };
    azimuths.map(step).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    const COUNT: u64 = 8 * ORDERS.len() as u64;

    fn all() -> impl Iterator<Item = Orientation> {
        (0..COUNT).map(|number| Orientation::from_number(number).unwrap())
    }

    #[test]
    fn numbers_tell_orientations_apart() {
        for (number, orientation) in (0..).zip(all()) {
            assert_eq!(orientation.number(), number);
            assert!(all().take(number as usize).all(|other| other != orientation));
        }
        assert!(Orientation::from_number(0).unwrap().is_default());
        assert!(Orientation::from_number(COUNT).is_err());
        assert!(Orientation::from_number(u64::MAX).is_err());
    }

    #[test]
    fn one_after_another_is_one() {
        let position = [1.0, 2.0, 3.0];
        for (first, second) in all().zip(all().skip(5).chain(all())) {
            let both = second.to_scanner(first.to_scanner(position));
            assert_eq!(second.after(first).to_scanner(position), both);
        }
    }

    #[test]
    fn positions_come_back_to_the_bit() {
        let odd = [f32::from_bits(0x7fc0_1234), -0.0, f32::NEG_INFINITY];
        for orientation in all() {
            let back = orientation.to_file(orientation.to_scanner(odd));
            assert_eq!(back.map(f32::to_bits), odd.map(f32::to_bits));
        }
    }

    /// The points of 16 lasers, each at 1000 azimuths, in the order of firings, or otherwise row by row from
    /// the highest, counterclockwise.
    fn points(are_firings: bool) -> Vec<[f32; 3]> {
        let point = |row: usize, column: usize, sense: f64| {
            let elevation = 0.2 - 0.03 * row as f64;
            let azimuth = sense * (column as f64 + 0.5) * TAU / 1000.0;
            let range = 10.0 + ((row * 7 + column * 3) % 50) as f64;
            let rho = range * libm::cos(elevation);
            [rho * libm::cos(azimuth), rho * libm::sin(azimuth), range * libm::sin(elevation)]
                .map(|metres| metres as f32)
        };
        let place = |place: usize| match are_firings {
            true => point(place % 16, place / 16, -1.0),
            false => point(place / 1000, place % 1000, 1.0),
        };
        (0..16_000).map(place).collect()
    }

    #[test]
    fn rows_show_the_orientation() {
        let points = points(false);
        for orientation in all() {
            let file: Vec<[f32; 3]> = points.iter().map(|point| orientation.to_file(*point)).collect();
            assert_eq!(Orientation::of_rows(&file), Some(orientation), "{}", orientation.number());
        }
    }

    #[test]
    fn firings_show_the_orientation_but_for_quarters_of_a_turn() {
        let points = points(true);
        for orientation in all() {
            let file: Vec<[f32; 3]> = points.iter().map(|point| orientation.to_file(*point)).collect();
            let found = Orientation::of_firings(&file);
            assert!(found[0].contains(&orientation), "{}", orientation.number());
            assert!(!found[1].contains(&orientation), "{}", orientation.number());
            assert_eq!(Orientation::of_rows(&file), None);
        }
    }

    #[test]
    fn points_without_a_scanner_show_none() {
        let scattered: Vec<[f32; 3]> = (0..9000)
            .map(|i| [(i * 37 % 101) as f32 - 50.0, (i * 53 % 97) as f32 - 48.0, (i * 71 % 89) as f32 - 44.0])
            .collect();
        for positions in [&scattered[..], &[], &[[f32::NAN; 3]; 100], &[[f32::MAX; 3]; 100], &[[0.0; 3]; 9]] {
            assert_eq!(Orientation::of_rows(positions), None);
            assert!(Orientation::of_firings(positions).is_empty());
        }
    }
}

//! For an encoder: which point is the one before each point in its trail. The decoder is told.
//!
//! Files of most scanners hold firing after firing, so the point before is about as many points back as there
//! are lasers, a few more or less where lasers see nothing. The likeliest sequence of such lags is found as
//! one path through all points (Viterbi's algorithm).

use std::collections::{HashMap, HashSet};

use pulp::NullaryFnOnce;

use crate::ground::angle::atan2;
use crate::ground::lanes::{dispatch, lanes};
use crate::scan::Channel;

/// The longest lag.
const LONGEST: usize = 260;
/// The cost of a point that has none before it, of a lag that has nothing to do with the last one, and of one
/// that differs by 1, 2 or 3.
const NONE: f32 = 24.0;
const JUMP: f32 = 7.0;
const CHANGES: [f32; 3] = [2.2, 2.9, 3.6];
/// The largest cost of the directions of two points of a trail.
const MOST_APART: f32 = 8.0;

/// The directions of points, in degrees.
struct Directions {
    azimuths: Vec<f32>,
    elevations: Vec<f32>,
}

impl Directions {
    fn of(positions: impl Iterator<Item = [f32; 3]>) -> Self {
        let degrees = |[x, y, z]: [f64; 3]| {
            let elevation = atan2(z, (x * x + y * y).sqrt());
            (atan2(y, x).to_degrees() as f32, elevation.to_degrees() as f32)
        };
        let (azimuths, elevations) = positions.map(|position| degrees(super::finite(position))).unzip();
        Directions { azimuths, elevations }
    }

    fn len(&self) -> usize {
        self.azimuths.len()
    }

    /// How unlikely it is that a laser turns from the direction of one point to that of another, in bits.
    fn cost(&self, before: usize, point: usize) -> f32 {
        let of = |point: usize| (self.azimuths[point], self.elevations[point]);
        cost(of(before), of(point))
    }
}

/// That cost, of an azimuth and an elevation each.
#[inline(always)]
fn cost(before: (f32, f32), (azimuth, elevation): (f32, f32)) -> f32 {
    let turned = (azimuth - before.0).abs();
    let turned = turned.min((360.0 - turned).abs()) * 2.5;
    let raised = (elevation - before.1) * 25.0;
    2.0 * rough_log2(1.0 + raised * raised + turned * turned)
}

/// The binary logarithm of a positive number, to within a tenth.
fn rough_log2(value: f32) -> f32 {
    let bits = value.to_bits();
    (bits >> 23) as f32 - 127.0 + (bits & 0x7f_ffff) as f32 / 8_388_608.0
}

/// For each point of `own`, the index in `own` of its predecessor on the same trail: once by each channel
/// that may tell which laser measured the points.
pub fn by_channels(channels: &[Channel], points: usize, own: &[usize]) -> Vec<Vec<Option<usize>>> {
    let lasers = channels.iter().filter_map(|channel| lasers(channel, points, own));
    let by_laser = lasers.map(|lasers| {
        let mut last = HashMap::new();
        lasers.into_iter().enumerate().map(|(point, laser)| last.insert(laser, point)).collect()
    });
    by_laser.collect()
}

/// The values of a channel for some of the points, if there are as few of them as a scanner has lasers.
fn lasers<'a>(channel: &'a Channel, points: usize, own: &[usize]) -> Option<Vec<&'a [u8]>> {
    const MOST: usize = 256;
    let width = channel.field.width();
    if width == 0 || channel.bytes.len() != points * width {
        return None;
    }
    let mut values = HashSet::new();
    let value = |&index: &usize| {
        let value = &channel.bytes[index * width..][..width];
        values.insert(value);
        (values.len() <= MOST).then_some(value)
    };
    let values: Option<Vec<&[u8]>> = own.iter().map(value).collect();
    values.filter(|values| values.iter().any(|value| *value != values[0]))
}

/// For each point of `own`, the index in `own` of its predecessor on the same trail, found from the order of
/// the points. The result for the first n points, n a multiple of [`BLOCK`], does not depend on those after
/// them.
pub fn by_order(positions: &[[f32; 3]], own: &[usize]) -> Vec<Option<usize>> {
    /// Points before a trail's end that are looked at where the likeliest lag leads nowhere.
    const REACH: usize = 3 * LONGEST;
    let directions = Directions::of(own.iter().map(|&index| positions[index]));
    // The points that end a trail, so far.
    let mut ends: Vec<usize> = Vec::new();
    let mut found = Vec::with_capacity(own.len());
    for (point, lag) in likeliest_lags(&directions).into_iter().enumerate() {
        let too_far = ends.partition_point(|&end| end + REACH < point);
        ends.drain(..too_far);
        let cost = |end: usize| directions.cost(ends[end], point);
        let likeliest = point.checked_sub(lag).filter(|_| lag > 0);
        let likeliest = likeliest.and_then(|before| ends.binary_search(&before).ok());
        let end = likeliest.filter(|&end| cost(end) < MOST_APART).or_else(|| {
            let costs = (0..ends.len()).map(|end| (cost(end), end));
            let near = costs.filter(|(cost, _)| *cost < MOST_APART);
            near.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, end)| end)
        });
        found.push(end.map(|end| ends.remove(end)));
        ends.push(point);
    }
    found
}

/// Points whose lags are decided together.
pub const BLOCK: usize = 4096;

/// The lag of each point, 0 where it has no point before it.
fn likeliest_lags(directions: &Directions) -> Vec<usize> {
    let mut costs = Costs::default();
    let mut lags = Vec::with_capacity(directions.len());
    for start in (0..directions.len()).step_by(BLOCK) {
        let end = directions.len().min(start + BLOCK);
        let steps = dispatch(Advance { costs: &mut costs, directions, start, end });
        let mut lag = costs.least().0;
        lags.resize(end, 0);
        for (own, from) in lags[start..].iter_mut().zip(steps).rev() {
            *own = lag;
            lag = match from.changes[lag] {
                JUMPED => from.best,
                change => lag.wrapping_add_signed(change.into()),
            };
        }
    }
    lags
}

/// The number of lags, 0 too, filled up to whole vectors. Those above [`LONGEST`] have infinite costs.
const LAGS: usize = (LONGEST + 1).next_multiple_of(LANES);
/// Values in the widest vector.
const LANES: usize = 16;
/// Beside the lags' costs, so that each has neighbours.
const BESIDE: usize = CHANGES.len();
/// Stands for any change of the lag.
const JUMPED: i8 = i8::MAX;

/// The costs of the paths to a point, by its lag, with infinite ones at both ends.
struct Costs([f32; LAGS + 2 * BESIDE]);

impl Default for Costs {
    fn default() -> Self {
        let mut costs = [f32::INFINITY; LAGS + 2 * BESIDE];
        costs[BESIDE..][..LONGEST + 1].fill(0.0);
        Costs(costs)
    }
}

/// How the paths to a point come from the last point.
struct Step {
    /// For each lag, by how much that of the last point is larger, or `JUMPED`.
    changes: [i8; LAGS],
    /// The lag of the last point, where the path jumps.
    best: usize,
}

/// Goes on from point to point, compiled for several vector units.
struct Advance<'a> {
    costs: &'a mut Costs,
    directions: &'a Directions,
    start: usize,
    end: usize,
}

impl NullaryFnOnce for Advance<'_> {
    type Output = Vec<Step>;

    #[inline(always)]
    fn call(self) -> Vec<Step> {
        let mut steps = Vec::with_capacity(self.end - self.start);
        for point in self.start..self.end {
            steps.push(self.costs.advance(self.directions, point));
        }
        steps
    }
}

impl Costs {
    /// Goes on to a point: from the costs of the paths to the last point to those of the paths to this one.
    #[inline(always)]
    fn advance(&mut self, directions: &Directions, point: usize) -> Step {
        let (best, least) = self.least();
        let (mut costs, mut changes) = ([0.0f32; LAGS], [0i32; LAGS]);
        for lag in 0..LAGS {
            let at = lag + BESIDE;
            let (mut cost, mut came) = (self.0[at], 0);
            for change in 1..=BESIDE {
                let more = CHANGES[change - 1];
                let fewer = self.0[at - change] + more;
                came = if fewer < cost { -(change as i32) } else { came };
                cost = if fewer < cost { fewer } else { cost };
                let further = self.0[at + change] + more;
                came = if further < cost { change as i32 } else { came };
                cost = if further < cost { further } else { cost };
            }
            let jump = least + JUMP;
            changes[lag] = if jump < cost { JUMPED.into() } else { came };
            costs[lag] = if jump < cost { jump } else { cost } - least;
        }
        costs[0] += NONE;
        // Lags from 1 on lead to the points before, the latest first.
        let first = point.saturating_sub(LONGEST);
        let own = (directions.azimuths[point], directions.elevations[point]);
        let azimuths = directions.azimuths[first..point].iter().rev();
        let before = azimuths.zip(directions.elevations[first..point].iter().rev());
        for (total, (&azimuth, &elevation)) in costs[1..].iter_mut().zip(before) {
            *total += cost((azimuth, elevation), own);
        }
        costs[1 + point - first..].fill(f32::INFINITY);
        self.0[BESIDE..][..LAGS].copy_from_slice(&costs);
        Step { changes: lanes(|lag| changes[lag] as i8), best }
    }

    /// The lag of the cheapest path, and its cost.
    #[inline(always)]
    fn least(&self) -> (usize, f32) {
        let costs = &self.0[BESIDE..][..LAGS];
        let mut leasts = [f32::INFINITY; LANES];
        for some in costs.as_chunks::<LANES>().0 {
            leasts = lanes(|lane| if some[lane] < leasts[lane] { some[lane] } else { leasts[lane] });
        }
        let least = leasts.into_iter().fold(f32::INFINITY, f32::min);
        let mut first = u32::MAX;
        for (lag, &cost) in (0..).zip(costs) {
            first = first.min(if cost == least { lag } else { u32::MAX });
        }
        (if first == u32::MAX { 0 } else { first as usize }, least)
    }
}

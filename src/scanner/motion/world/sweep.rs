//! The measurements of the scanner: the HDL-32E's formula in single precision, its records without a return,
//! its ticks.

use std::f64::consts::PI;

use nalgebra::{Matrix3, Vector3};

use super::SLOTS;
use crate::ground::angle::shorter_way;
use crate::ground::floats::round_ties_even;

pub type Vector = Vector3<f64>;
pub type Matrix = Matrix3<f64>;

/// Elevations in degrees, in the order of the records of a firing.
const ELEVATIONS: [f64; SLOTS] = [
    -30.67, -29.33, -28.0, -26.66, -25.33, -24.0, -22.67, -21.33, -20.0, -18.67, -17.33, -16.0, -14.67,
    -13.33, -12.0, -10.67, -9.33, -8.0, -6.66, -5.33, -4.0, -2.67, -1.33, 0.0, 1.33, 2.67, 4.0, 5.33, 6.67,
    8.0, 9.33, 10.67,
];
/// Metres per range step.
const RANGE_STEP: f64 = 0.002;
/// Ticks in a turn, and radians per tick.
pub const TURN: i64 = 36_000;
const TICK: f64 = PI / 18_000.0;
/// Number of range steps from which on a point's own tick is accurate.
pub const FAR_STEPS: u32 = 1000;

/// The formula of the HDL-32E.
pub struct Hdl32e {
    elevations: [[f32; 2]; SLOTS],
    turn: Vec<[f32; 2]>,
}

/// The reading of a record: range steps, and the tick, from 0 to a turn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Reading {
    pub steps: u32,
    pub tick: i64,
}

impl Hdl32e {
    pub fn new() -> Self {
        let cos_sin = |angle: f64| [libm::cos(angle) as f32, libm::sin(angle) as f32];
        Hdl32e {
            elevations: ELEVATIONS.map(|degrees| cos_sin(degrees * (PI / 180.0))),
            turn: (0..TURN).map(|tick| cos_sin(tick as f64 * TICK)).collect(),
        }
    }

    /// The coordinates of a reading.
    pub fn position(&self, slot: usize, reading: Reading) -> [f32; 3] {
        let [cos_v, sin_v] = self.elevations[slot];
        let [cos, sin] = self.turn[reading.tick.rem_euclid(TURN) as usize];
        let metres = reading.steps as f32 * RANGE_STEP as f32;
        let flat = metres * cos_v;
        [flat * cos, -(flat * sin), metres * sin_v]
    }

    /// The coordinates as a vector.
    pub fn vector(&self, slot: usize, reading: Reading) -> Vector {
        Vector::from(self.position(slot, reading).map(f64::from))
    }

    /// The steps nearest to a range in metres.
    pub fn steps(range: f64) -> u32 {
        round_ties_even((range / RANGE_STEP).min(1e6)) as u32
    }

    /// The reading nearest to a point in the scanner's coordinates.
    pub fn reading(point: &Vector) -> Reading {
        let tick = round_ties_even(-libm::atan2(point.y, point.x) / TICK) as i64;
        Reading { steps: Self::steps(point.norm()), tick: tick.rem_euclid(TURN) }
    }
}

/// Ticks from one tick to another, the shorter way round.
pub fn turned(from: i64, to: i64) -> i64 {
    shorter_way(to - from, TURN)
}

/// The position of the scanner at each firing, as given by records without a return; and which records these
/// are.
pub struct Returnless {
    pub places: Vec<Vector>,
    pub is_none: Vec<bool>,
}

/// A position that several records of a firing share to the last bit, which shows that they have no return;
/// and their number.
pub fn shared_place(firing: &[[f32; 3]]) -> Option<([f32; 3], usize)> {
    /// Metres: more than any car drives in a turn.
    const FARTHEST: f32 = 8.0;
    let may_be = |position: &&[f32; 3]| {
        position.iter().all(|metres| metres.abs() < FARTHEST) && position.iter().any(|metres| *metres != 0.0)
    };
    let places: Vec<&[f32; 3]> = firing.iter().filter(may_be).collect();
    let count = |place: &&[f32; 3]| places.iter().filter(|other| **other == *place).count();
    let best = places.iter().map(|place| (**place, count(place))).max_by_key(|(_, count)| *count);
    best.filter(|(_, count)| *count > 1)
}

/// Finds the records without a return; none if hardly any firing has two.
pub fn returnless(positions: &[[f32; 3]]) -> Option<Returnless> {
    /// Metres: a record this near to the scanner's position has no return.
    const NEAR: f64 = 1e-3;
    /// The minimum share of firings with such records.
    const LEAST: f64 = 0.2;
    let vector = |position: &[f32; 3]| Vector::from(position.map(f64::from));
    let firings: Vec<&[[f32; 3]]> = positions.chunks_exact(SLOTS).collect();
    let mut known: Vec<Option<Vector>> =
        firings.iter().map(|firing| shared_place(firing).map(|(place, _)| vector(&place))).collect();
    if (known.iter().flatten().count() as f64) < LEAST * firings.len() as f64 {
        return None;
    }
    let mut places = filled(&known);
    let mut is_none = vec![false; positions.len()];
    for round in 0..2 {
        for (record, position) in positions.iter().enumerate() {
            let firing = record / SLOTS;
            is_none[record] = (vector(position) - places[firing]).norm() < NEAR;
            if is_none[record] && known[firing].is_none() {
                known[firing] = Some(vector(position));
            }
        }
        if round == 0 {
            places = filled(&known);
        }
    }
    Some(Returnless { places, is_none })
}

/// Fills gaps by linear interpolation.
fn filled(known: &[Option<Vector>]) -> Vec<Vector> {
    let there: Vec<(usize, Vector)> =
        known.iter().enumerate().filter_map(|(number, place)| Some((number, (*place)?))).collect();
    let mut next = 0;
    (0..known.len())
        .map(|number| {
            while next < there.len() && there[next].0 < number {
                next += 1;
            }
            match (next.checked_sub(1).and_then(|last| there.get(last)), there.get(next)) {
                (Some((from, a)), Some((to, b))) => {
                    a + (b - a) * ((number - from) as f64 / (to - from) as f64)
                }
                (Some((_, only)), None) | (None, Some((_, only))) => *only,
                (None, None) => Vector::zeros(),
            }
        })
        .collect()
}

/// The ticks of all records according to the rule of the scanner's driver.
pub struct Ticks {
    pub ticks: Vec<i64>,
    /// The last firing of the first packet.
    pub border: usize,
    /// The share of the points whose own tick agrees.
    pub share: f64,
}

/// The temporal position of a slot: the lasers fire alternately from the bottom and from the middle.
fn place_in_time(slot: usize) -> i64 {
    if slot < SLOTS / 2 { 2 * slot as i64 } else { 2 * slot as i64 - 31 }
}

/// Ticks that pass before a slot fires, of `span` ticks in a firing; a firing takes 40 temporal positions.
fn passed(span: i64, slot: usize) -> i64 {
    (2 * span * place_in_time(slot) + 40).div_euclid(80)
}

/// Finds the driver's rule: A + passed(D), where D is the difference of A to the next firing, or in the last
/// firing of a packet the preceding difference. `own` are the points' own ticks, where they are accurate.
pub fn ticks(own: &[Option<i64>]) -> Ticks {
    const SPANS: std::ops::Range<i64> = 30..38;
    const USUAL: i64 = 33;
    let firings = own.len() / SLOTS;
    let mut starts: Vec<Option<i64>> = Vec::with_capacity(firings);
    for firing in own.chunks_exact(SLOTS) {
        let at_start =
            firing.iter().enumerate().filter_map(|(slot, tick)| Some((*tick)? - passed(USUAL, slot)));
        let all: Vec<i64> = at_start.collect();
        let mut off: Vec<i64> = all.iter().map(|start| turned(all[0], *start)).collect();
        off.sort_unstable();
        starts.push(off.get(off.len() / 2).map(|middle| all[0] + middle));
    }
    let starts = unwrapped(&starts);
    let slots_of: Vec<[i64; SLOTS]> =
        SPANS.map(|span| std::array::from_fn(|slot| passed(span, slot))).collect();
    let best = |(firing, &start): (usize, &i64)| {
        // Far from any tick, so that a record without a tick of its own agrees with none.
        let since = |own: &Option<i64>| own.map_or(-TURN, |own| turned(start, own));
        let since: Vec<i64> = own[firing * SLOTS..][..SLOTS].iter().map(since).collect();
        let tried = (-3..=3).flat_map(|off| slots_of.iter().map(move |passed| (off, passed)));
        let hits = |&(off, passed): &(i64, &[i64; SLOTS])| {
            since.iter().zip(passed).filter(|&(since, passed)| *since == off + passed).count()
        };
        // The first of equally good ones.
        tried.rev().max_by_key(hits).map_or(start, |(off, _)| start + off)
    };
    let starts: Vec<i64> = starts.iter().enumerate().map(best).collect();
    let steps: Vec<i64> = starts.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let of_border = |border: usize| {
        let mut given = Vec::with_capacity(own.len());
        for firing in 0..firings {
            let is_last = firing >= border.max(1) && (firing - border).is_multiple_of(super::PACKET)
                || firing + 1 == firings;
            let span = steps.get(if is_last { firing - 1 } else { firing }).copied().unwrap_or(USUAL);
            given.extend((0..SLOTS).map(|slot| (starts[firing] + passed(span, slot)).rem_euclid(TURN)));
        }
        let known = own.iter().zip(&given).filter_map(|(own, given)| Some((*own)? == *given));
        let (right, all) = known.fold((0u32, 0u32), |(right, all), hit| (right + u32::from(hit), all + 1));
        Ticks { ticks: given, border, share: f64::from(right) / f64::from(all.max(1)) }
    };
    let all = (0..super::PACKET).map(of_border);
    all.rev().max_by(|a, b| a.share.total_cmp(&b.share)).unwrap_or(Ticks {
        ticks: Vec::new(),
        border: 0,
        share: 0.0,
    })
}

/// Ticks that continue across full turns, with gaps filled by linear interpolation.
fn unwrapped(starts: &[Option<i64>]) -> Vec<i64> {
    let mut last = None;
    let going_on: Vec<Option<Vector>> = starts
        .iter()
        .map(|start| {
            let now = start.map(|start| last.map_or(start, |last| last + turned(last, start)));
            last = now.or(last);
            now.map(|now| Vector::new(now as f64, 0.0, 0.0))
        })
        .collect();
    filled(&going_on).iter().map(|start| round_ties_even(start.x) as i64).collect()
}

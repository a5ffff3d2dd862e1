//! Maps that refine an estimate by the outcomes of similar estimates: from log odds to log odds, one map per
//! context, piecewise linear between learned points (Mahoney's adaptive probability maps). FORMAT.md 6.5.

use super::Logistic;

/// Points of a map, and points per unit of log odds.
const POINTS: usize = 33;
const FINENESS: f32 = 2.0;
/// The log odds of the outermost points.
const REACH: f32 = (POINTS - 1) as f32 / (2.0 * FINENESS);
const RATE: f32 = 0.08;

/// One map for each context.
#[derive(Clone)]
pub struct Refinement {
    maps: Vec<[f32; POINTS]>,
    tables: &'static Logistic,
}

/// The position of an estimate between two points of a map.
#[derive(Clone, Copy, Debug)]
pub struct Refined {
    context: usize,
    point: usize,
    /// Its distance from that point as a fraction of the distance to the next, from 0 to 1.
    part: f32,
    /// The refined log odds.
    odds: f32,
}

impl Refinement {
    /// Creates maps for `contexts` contexts, which start as the identity.
    pub fn new(contexts: usize) -> Self {
        let identity = std::array::from_fn(|i| i as f32 / FINENESS - REACH);
        Refinement { maps: vec![identity; contexts], tables: Logistic::tables() }
    }

    /// The refined log odds of an estimate in a context.
    #[inline]
    pub fn refine(&self, context: usize, odds: f32) -> (Refined, f32) {
        // In a sum with 2^23 the lowest bit has the value 1, and subtracting one half makes rounding go down.
        // A place on a point may count as the end of the part below it, which gives the same odds.
        const UNIT: f32 = (1 << 23) as f32;
        let place = (odds.clamp(-REACH, REACH) + REACH) * FINENESS;
        let rounded = (place - 0.5).max(0.0) + UNIT;
        let point = (rounded.to_bits() as usize % POINTS.next_power_of_two()).min(POINTS - 2);
        let part = place - point as i32 as f32;
        let map = &self.maps[context];
        let odds = map[point] * (1.0 - part) + map[point + 1] * part;
        (Refined { context, point, part, odds }, odds)
    }

    /// Moves both points towards the bit that was coded, by their shares in the refined odds.
    #[inline]
    pub fn learn(&mut self, refined: Refined, bit: bool) {
        let target = if bit { 65536 } else { 0 };
        let pull = RATE * ((target - self.tables.squash(refined.odds) as i32) as f32 / 65536.0);
        let map = &mut self.maps[refined.context];
        map[refined.point] += pull * (1.0 - refined.part);
        map[refined.point + 1] += pull * refined.part;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_estimate_that_is_too_sure_is_taken_back() {
        let mut maps = Refinement::new(2);
        for i in 0..4000 {
            let (refined, _) = maps.refine(1, 3.2);
            maps.learn(refined, i % 4 > 0);
        }
        // Log odds of 3 to 1.
        assert!((maps.refine(1, 3.2).1 - 1.1).abs() < 0.2, "{}", maps.refine(1, 3.2).1);
        assert!((maps.refine(0, 3.2).1 - 3.2).abs() < 1e-5);
        assert!(maps.refine(0, f32::NAN).1.is_nan() && maps.refine(0, 1e9).1 == REACH);
    }
}

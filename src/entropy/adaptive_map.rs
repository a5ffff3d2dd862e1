//! Probabilities corrected by what became of such probabilities before (the adaptive probability maps, or
//! secondary symbol estimation, of Mahoney's PAQ).

use super::Logistic;

/// Points on the axis of log odds, from -8 to 8; between them the map is a straight line.
const POINTS: usize = 33;
const POINTS_A_UNIT: f32 = 2.0;
/// How far a point moves towards a bit.
const RATE: f32 = 0.01;

/// For each of some contexts, a map from log odds to the share of ones that followed.
#[derive(Clone)]
pub struct AdaptiveMap(Vec<[f32; POINTS]>);

/// Log odds as a place between two points.
#[derive(Clone, Copy)]
pub struct MapPlace {
    point: usize,
    /// The share of the next point, 0 to 1.
    beyond: f32,
}

impl AdaptiveMap {
    /// Maps that change nothing as yet.
    pub fn new(contexts: usize) -> Self {
        let middle = (POINTS / 2) as f32;
        let odds = |point: usize| (point as f32 - middle) / POINTS_A_UNIT;
        let tables = Logistic::tables();
        AdaptiveMap(vec![std::array::from_fn(|point| tables.squash(odds(point)) as f32 / 65536.0); contexts])
    }

    /// The place of log odds in any map.
    #[inline]
    pub fn place(odds: f32) -> MapPlace {
        let last = (POINTS - 1) as f32;
        let place = (odds * POINTS_A_UNIT + last * 0.5).clamp(0.0, last - 0.001);
        MapPlace { point: place as usize, beyond: place - (place as usize) as f32 }
    }

    /// The probability that a context's map gives.
    #[inline]
    pub fn probability(&self, context: usize, MapPlace { point, beyond }: MapPlace) -> f32 {
        let map = &self.0[context];
        map[point] * (1.0 - beyond) + map[point + 1] * beyond
    }

    /// Moves the nearer point towards a bit, 0 or 1.
    #[inline]
    pub fn learn(&mut self, context: usize, MapPlace { point, beyond }: MapPlace, bit: f32) {
        let near = &mut self.0[context][point + usize::from(beyond > 0.5)];
        *near += RATE * (bit - *near);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_starts_as_it_is_and_learns_what_follows() {
        let mut map = AdaptiveMap::new(2);
        for odds in [-20.0, -7.9, -1.25, 0.0, 0.3, 3.0, 20.0f32] {
            let place = AdaptiveMap::place(odds);
            let expected = 1.0 / (1.0 + (-odds.clamp(-8.0, 8.0)).exp());
            assert!((map.probability(1, place) - expected).abs() < 0.01, "{odds}");
        }
        let place = AdaptiveMap::place(2.0);
        (0..1000).for_each(|i| map.learn(1, place, f32::from(u8::from(i % 4 == 0))));
        assert!((map.probability(1, place) - 0.25).abs() < 0.05);
        assert!((map.probability(0, place) - 0.88).abs() < 0.01);
    }
}

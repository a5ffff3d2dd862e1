//! The intensity levels around a return, with gaps filled from their neighbours.
//! FORMAT.md 8.5, "Levels, if `coder` is 1".

use crate::models::intensity::neighbours::{IntensityNeighbours, TYPICAL_LEVEL};

/// Features of the least-squares fit.
pub const FEATURES: usize = 16;
/// The context level of an intensity of 0.
const ZERO: u16 = 1;
/// The constant feature.
const CONSTANT: f32 = 4.0;

/// Context levels around a return.
#[derive(Clone, Copy, Debug)]
pub struct Surroundings {
    /// The last three levels of the row, nearest first, and the one above; none of them is 0.
    pub west: u16,
    pub west2: u16,
    pub west3: u16,
    pub north: u16,
    /// The level of the same cell in an earlier frame, and that of its moved surface; 0 = none.
    pub same: u16,
    pub moved: u16,
    /// One bit for each neighbour, set if its level is [`ZERO`].
    pub zeros: usize,
    /// The base of the features: the best neighbour that is neither missing nor 0.
    base: u16,
    features: [f32; FEATURES],
    gradient: f32,
    /// The index of the fit that applies.
    fit: usize,
}

/// The first level, or the other if the first is unknown.
fn or(level: u16, other: u16) -> u16 {
    if level > 0 { level } else { other }
}

impl Surroundings {
    /// The surroundings of a return.
    pub fn new(near: &IntensityNeighbours) -> Self {
        let [w, ww, www, wwww] = near.left;
        let [nww, nw, n, ne, nee] = near.above;
        let [nnw, nn, nne] = near.above2;
        let ([same, same_west, same_east], moved) =
            near.back.map_or(([0; 3], 0), |back| (back.same, back.moved));
        let zeros = [w, n, ne, nw, same, moved, ww, nn, www, nee, same_east, same_west];
        let zeros = zeros.iter().enumerate().fold(0, |bits, (i, l)| bits | usize::from(*l == ZERO) << i);
        let west = or(w, or(n, or(nw, or(ne, TYPICAL_LEVEL))));
        let west2 = or(ww, west);
        let filled = Surroundings {
            west,
            west2,
            west3: or(www, west2),
            north: or(n, or(ne, or(nw, west))),
            same,
            moved,
            zeros,
            base: 0,
            features: [0.0; FEATURES],
            gradient: 0.0,
            fit: usize::from(n > 0) | usize::from(near.back.is_some()) << 1 | usize::from(w > 0) << 2,
        };

        // A level of 0 carries no information about the surface, so it counts as a gap here.
        let [w, ww, www, wwww, nww, nw, n, ne, nee, nnw, nn, nne, same, same_west, same_east, moved] =
            [w, ww, www, wwww, nww, nw, n, ne, nee, nnw, nn, nne, same, same_west, same_east, moved]
                .map(|level| if level == ZERO { 0 } else { level });
        let base = [w, n, nw, ne, ww, www, nn, same].into_iter().fold(0, or);
        let base = or(base, TYPICAL_LEVEL);
        let ww = or(ww, base);
        let www = or(www, ww);
        let n = or(n, or(ne, or(nw, base)));
        let [nw, ne, nn] = [nw, ne, nn].map(|level| or(level, n));
        let difference = |level: u16| f32::from(level) - f32::from(base);
        let mut features = [0.0; FEATURES];
        let alone =
            [ww, n, nw, ne, nn, www, or(wwww, www), or(nee, ne), or(nww, nw), or(nnw, nn), or(nne, nn)];
        features[..alone.len()].copy_from_slice(&alone.map(difference));
        features[alone.len()] = CONSTANT;
        if near.back.is_some() {
            let here = or(same, or(moved, base));
            let back = [here, or(same_west, here), or(same_east, here), or(moved, here)];
            features[alone.len() + 1..].copy_from_slice(&back.map(difference));
        }
        let apart = |a: u16, b: u16| f32::from(a.abs_diff(b));
        let gradient = apart(base, n) + apart(base, ww) + apart(n, ne);
        Surroundings { base, features, gradient, ..filled }
    }

    /// Whether an earlier frame has a return here.
    pub fn has_reference(&self) -> bool {
        self.same > 0 || self.moved > 0
    }

    /// The index of the fit that applies, 0 to 7: whether there is a level above, in an earlier frame, and to
    /// the left.
    pub fn fit(&self) -> usize {
        self.fit
    }

    /// The base of the features.
    pub fn base(&self) -> f32 {
        f32::from(self.base)
    }

    /// Differences between the levels around and the base.
    pub fn features(&self) -> &[f32; FEATURES] {
        &self.features
    }

    /// A measure of the differences among the surrounding levels.
    pub fn gradient(&self) -> f32 {
        self.gradient
    }

    /// The levels to the left and above, in steps of four: 0 to 1023.
    pub fn pair(&self) -> usize {
        let step = |level: u16| usize::from(level.saturating_sub(1) / 4).min(31);
        step(self.west) * 32 + step(self.north)
    }
}

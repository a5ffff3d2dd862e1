//! The ranges around a cell. FORMAT.md 8.6, "Neighbours".

use super::{ACTIVITY_LEVELS, FEATURE_REACH, FEATURES, TYPICAL_RANGE};

/// The coded ranges that the prediction of a cell uses; 0 where there is no return.
pub struct Window {
    /// The current row and the two above, with margins of empty cells.
    rows: [Vec<f64>; 3],
    /// The last returns of the row, nearest first.
    left: [f64; 5],
}

impl Window {
    /// Empty cells on either side.
    const MARGIN: usize = 2;

    /// Creates the window for an image of `width` columns.
    pub fn new(width: usize) -> Self {
        Window { rows: std::array::from_fn(|_| vec![0.0; width + 2 * Self::MARGIN]), left: [0.0; 5] }
    }

    /// Starts the next row.
    pub fn start_row(&mut self) {
        self.rows.rotate_right(1);
        self.rows[0].fill(0.0);
        self.left = [0.0; 5];
    }

    /// Adds a return.
    pub fn push(&mut self, column: usize, range: f64) {
        self.rows[0][column + Self::MARGIN] = range;
        self.left.rotate_right(1);
        self.left[0] = range;
    }

    /// The ranges around a cell of the current row.
    #[inline]
    pub fn around(&self, column: usize) -> Neighbourhood {
        let or = |range: f64, other: f64| if range > 0.0 { range } else { other };
        let &[nww, nw, n, ne, nee] = self.rows[1][column..].first_chunk().unwrap_or(&[0.0; 5]);
        let &[_, nnw, nn, nne, _] = self.rows[2][column..].first_chunk().unwrap_or(&[0.0; 5]);
        let west = or(self.left[0], or(n, or(nw, or(ne, TYPICAL_RANGE.into()))));
        let west2 = or(self.left[1], west);
        let west3 = or(self.left[2], west2);
        let north = or(n, or(ne, or(nw, west)));
        let north_west = or(nw, north);
        let north_east = or(ne, north);
        let north_east2 = or(nee, north_east);
        let north2 = or(nn, north);
        let west4 = or(self.left[3], west3);
        let farther = [or(self.left[4], west4), or(nww, north_west), or(nnw, north2), or(nne, north2)];
        Neighbourhood {
            west,
            west2,
            west3,
            west4,
            north,
            north_west,
            north_east,
            north_east2,
            north2,
            farther,
        }
    }
}

/// The ranges around a cell, with missing ones replaced by the next best.
pub struct Neighbourhood {
    pub west: f64,
    pub west2: f64,
    west3: f64,
    west4: f64,
    pub north: f64,
    north_west: f64,
    pub north_east: f64,
    north_east2: f64,
    north2: f64,
    /// The fifth to the left, the second to the left of the one above, and those beside the second above.
    farther: [f64; 4],
}

impl Neighbourhood {
    /// Differences to the left neighbour.
    pub fn features(&self) -> [f32; FEATURES] {
        [
            self.west2,
            self.west3,
            self.west4,
            self.north,
            self.north_west,
            self.north_east,
            self.north_east2,
            self.north2,
        ]
        .map(|range| self.feature(range))
    }

    /// The differences to the left neighbour for the farther ranges.
    pub fn farther_features(&self) -> [f32; 4] {
        self.farther.map(|range| self.feature(range))
    }

    /// A range as its difference to the left neighbour.
    #[inline]
    pub fn feature(&self, range: f64) -> f32 {
        (range - self.west).clamp(-f64::from(FEATURE_REACH), FEATURE_REACH.into()) as f32
    }

    /// The roughness of the surroundings, in octaves.
    pub fn activity_level(&self) -> usize {
        let activity = (self.west - self.west2).abs()
            + (self.north - self.north_west).abs()
            + (self.north - self.north_east).abs();
        let octaves = (activity as u32).checked_ilog2().map_or(0, |octave| octave as usize + 1);
        octaves.min(ACTIVITY_LEVELS - 1)
    }
}

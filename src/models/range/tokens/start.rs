//! The assumed distribution of misses before any has occurred, so that small scans need not transmit tables:
//! a bell with long tails, as wide as the miss that the context expects. FORMAT.md 8.16, "Initial tables".

use std::sync::LazyLock;

use super::prediction::{MISS_LEVELS, RANGE_CONTEXTS, least_miss_of};
use crate::entropy::{Counts, StartTables, numbers_of_token};
use crate::models::quantise::magnitude_of_level;

/// Numbers from this on are escaped until one has occurred.
const FARTHEST: u64 = 1 << 18;
/// Number of points at which the density is evaluated for a token of many numbers.
const POINTS: u64 = 4;
/// The approximate sum of the counts of a context.
const SUM: f64 = 4096.0;

/// The tables of typical token counts, by context: for ranges predicted by least squares if `fitted`,
/// otherwise from their left neighbours.
pub fn start_tables(fitted: bool) -> &'static StartTables {
    static FITTED: LazyLock<StartTables> = LazyLock::new(|| {
        let width = |context| 1.5 + least_miss_of(context) / 48.0;
        StartTables::of((0..RANGE_CONTEXTS).map(|context| bell(width(context))).collect())
    });
    static WEST: LazyLock<StartTables> = LazyLock::new(|| {
        let width = |level| 2.0 + f64::from(magnitude_of_level(level)) / 9.0;
        StartTables::of((0..MISS_LEVELS).map(|level| bell(width(level))).collect())
    });
    if fitted { &FITTED } else { &WEST }
}

/// Counts of misses proportional to 1 / (1 + (miss / width)^2).
fn bell(width: f64) -> Counts {
    let at = |miss: f64| {
        let part = miss / width;
        1.0 / (1.0 + part * part)
    };
    let weight = |token: usize| match numbers_of_token(token as u8) {
        (first, _) if first >= FARTHEST => 0.0,
        (number, 1) => at(number.div_ceil(2) as f64),
        (first, numbers) => {
            let points = (0..POINTS).map(|i| at((first + numbers * (2 * i + 1) / (2 * POINTS)) as f64 / 2.0));
            points.sum::<f64>() * (numbers / POINTS) as f64
        }
    };
    let weights: [f64; 255] = std::array::from_fn(weight);
    let sum = weights.iter().sum::<f64>();
    std::array::from_fn(|token| weights.get(token).map_or(0, |weight| (SUM * weight / sum) as u32))
}

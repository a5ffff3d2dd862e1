//! Models of scanners: the formula that turns integers (beam, tick, range steps) into the coordinates of a
//! file, and the fit of its constants to a sequence.

pub mod firings;
pub mod hdl64;
pub mod motion;

mod coordinates;
mod family;
mod ideal;
mod orientation;
mod range_image;

use std::ops::RangeInclusive;

use crate::scan::Channel;

pub use coordinates::{CoordinateGrid, nearest_millimetre};
pub use family::{ColumnModels, Family, LEAST_EXPLAINED, Scanner};
pub use ideal::{ideal, ideal_of};
pub use orientation::Orientation;
pub use range_image::{
    Echo, FLOAT_RANGES, LEAST_RANGE_BITS, MOST_RANGE_STEP_UM, MOST_ROWS, MOST_STEPS, MOST_TICKS, Projection,
    REACH, RangeImage, Return,
};

/// Numbers of lasers that a scanner may have.
pub(crate) const PLAUSIBLE_LASERS: RangeInclusive<usize> = 4..=512;

/// The first channel of small integers with a plausible number of values for the lasers of a scanner.
pub(crate) fn channel_of_lasers(channels: &[Channel]) -> Option<&Channel> {
    channels.iter().filter(|channel| channel.field.count == 1 && channel.field.width() <= 2).find(|channel| {
        let mut values: Vec<&[u8]> = channel.bytes.chunks_exact(channel.field.width()).collect();
        values.sort_unstable();
        values.dedup();
        PLAUSIBLE_LASERS.contains(&values.len())
    })
}

/// Number of points that are computed at once: a few vectors of any processor.
pub(crate) const AT_ONCE: usize = 8;

/// The median of some values; infinite if there are none.
pub(crate) fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    let middle = values.len() / 2;
    if values.is_empty() { f64::INFINITY } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

/// At most about `count` of the values, evenly spaced.
pub(crate) fn thinned<T>(values: &[T], count: usize) -> impl Iterator<Item = &T> {
    values.iter().step_by(values.len().div_ceil(count.max(1)).max(1))
}

//! Files whose records were sorted by a channel although they were in order already, by a sort that is not
//! stable. FORMAT.md 8.21.
//!
//! Programs that collect the points of a turn sort them by time. The points usually are in that order, but a
//! scanner gives all points of a packet the same time stamp, and an unstable sort shuffles these. The
//! permutation depends only on where one time stamp ends and the next begins, so the *order of arrival* can
//! be recovered from the file alone.

use super::{Channel, PointCloud};

/// Ranges of at most this many records are not partitioned further.
const SHORT: usize = 16;

/// For each position in the file, the index of its record in the order of arrival: the permutation that C++'s
/// `std::sort`, as implemented by libstdc++, applies to records whose keys do not decrease. Keys are compared
/// by their bytes.
pub fn file_order(keys: &Channel) -> Vec<u32> {
    let mut run = 0;
    let mut last = None;
    let records = keys.bytes.chunks_exact(keys.field.width()).zip(0u32..).map(|(key, record)| {
        run += u32::from(last.is_some_and(|last| last != key));
        last = Some(key);
        (run, record)
    });
    let mut records: Vec<(u32, u32)> = records.collect();
    let depth = 2 * records.len().checked_ilog2().unwrap_or(0);
    divide(&mut records, depth);
    // That sort ends with an insertion sort, which is stable.
    records.sort_by_key(|(key, _)| *key);
    records.into_iter().map(|(_, record)| record).collect()
}

/// Partitions a range by a key, and both parts again, until they are short or `depth` is used up, which does
/// not happen for sorted keys.
fn divide(mut records: &mut [(u32, u32)], mut depth: u32) {
    while records.len() > SHORT && depth > 0 {
        depth -= 1;
        let last = records.len() - 1;
        let places = [1, records.len() / 2, last];
        let [one, middle, end] = places.map(|place| records[place].0);
        let median = match (one < middle, middle < end, one < end) {
            (true, true, _) => 1,
            (true, false, true) => 2,
            (true, false, false) => 0,
            (false, _, true) => 0,
            (false, true, false) => 2,
            (false, false, false) => 1,
        };
        records.swap(0, places[median]);
        let key = records[0].0;
        // The median of three guarantees a key on either side that stops these loops.
        let (mut from, mut to) = (1, records.len());
        let cut = loop {
            while records[from].0 < key {
                from += 1;
            }
            to -= 1;
            while key < records[to].0 {
                to -= 1;
            }
            if from >= to {
                break from;
            }
            records.swap(from, to);
            from += 1;
        };
        let (low, high) = records.split_at_mut(cut);
        divide(high, depth);
        records = low;
    }
}

/// The channel by which a file's records were sorted, and its points in the order of arrival. None if that
/// order is not more regular.
pub fn in_order_of_arrival(cloud: &PointCloud) -> Option<(usize, PointCloud)> {
    /// Required improvement of the prediction of each point's elevation from that of the point before.
    const BETTER: f64 = 1.2;
    let may_be_key = |(_, channel): &(usize, &Channel)| is_rising_in_runs(channel);
    let mut candidates = cloud.channels.iter().enumerate().filter(may_be_key).peekable();
    // Most files have no such channel, and computing slopes takes time.
    candidates.peek()?;
    let slopes = Slopes::of(&cloud.positions)?;
    let predictable_as_is = slopes.predictable((0..cloud.positions.len() as u32).map(|place| place as usize));
    for (number, channel) in candidates {
        let order = file_order(channel);
        let mut arrival = vec![0; order.len()];
        (0u32..).zip(&order).for_each(|(place, &record)| arrival[record as usize] = place);
        let predictable = slopes.predictable(arrival.iter().map(|&place| place as usize));
        if predictable as f64 > BETTER * predictable_as_is as f64 {
            return Some((number, cloud.select(&arrival)));
        }
    }
    None
}

/// Whether the values of a channel never decrease, and most equal the one before.
fn is_rising_in_runs(channel: &Channel) -> bool {
    /// Minimum mean length of a run of equal values, in records: shorter runs are not shuffled.
    const FEWEST: usize = 4;
    let scalar = channel.field.scalar;
    if channel.field.count != 1 || scalar.size() < 4 {
        return false;
    }
    let values = channel.bytes.chunks_exact(scalar.size() as usize);
    let (records, mut runs) = (values.len(), 1);
    let mut pairs = values.clone().zip(values.skip(1));
    let does_not_fall = pairs.all(|(one, next)| {
        runs += usize::from(one != next);
        // Also false as soon as there are too many runs.
        one == next || runs * FEWEST <= records && scalar.number(one) < scalar.number(next)
    });
    does_not_fall && runs > 1
}

/// The class of each point's elevation.
struct Slopes {
    classes: Vec<u8>,
}

/// Number of elevation classes, which have equally many points.
const CLASSES: usize = 64;

impl Slopes {
    /// None if there are too few points.
    fn of(positions: &[[f32; 3]]) -> Option<Self> {
        /// Number of points from which the class boundaries are estimated.
        const SAMPLE: usize = 2048;
        const FEWEST: usize = 1024;
        if positions.len() < FEWEST {
            return None;
        }
        let slope = |[x, y, z]: &[f32; 3]| z / (x * x + y * y).sqrt();
        let sample = positions.iter().step_by(positions.len().div_ceil(SAMPLE)).map(slope);
        let mut sample: Vec<f32> = sample.collect();
        sample.sort_unstable_by(f32::total_cmp);
        let ends: [f32; CLASSES - 1] =
            std::array::from_fn(|class| sample[(class + 1) * sample.len() / CLASSES]);
        let class = |position| {
            let slope = slope(position);
            ends.partition_point(|end| *end < slope) as u8
        };
        Some(Slopes { classes: positions.iter().map(class).collect() })
    }

    /// The number of points whose class is the one that most often follows the class of the point before
    /// them.
    fn predictable(&self, order: impl Iterator<Item = usize>) -> u32 {
        let mut counts = vec![[0u32; CLASSES]; CLASSES];
        order.fold(None, |last: Option<u8>, place| {
            let class = self.classes[place];
            if let Some(last) = last {
                counts[usize::from(last)][usize::from(class)] += 1;
            }
            Some(class)
        });
        counts.iter().map(|counts| counts.iter().max().copied().unwrap_or(0)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::{Field, ScalarType};

    fn channel(keys: &[u32]) -> Channel {
        let bytes = keys.iter().flat_map(|key| f64::from(*key).to_le_bytes()).collect();
        Channel { field: Field::new("time", ScalarType::F64), bytes }
    }

    /// The permutation by GCC 12's `std::sort` of 40 records with five keys of eight records each.
    const EIGHTS: [u32; 40] = [
        1, 0, 7, 6, 5, 4, 3, 2, 8, 9, 10, 11, 12, 13, 14, 15, 23, 22, 21, 20, 18, 17, 16, 19, 30, 31, 29, 28,
        27, 26, 25, 24, 32, 33, 34, 35, 36, 37, 38, 39,
    ];
    /// The same for 24 records with equal keys.
    const EQUAL: [u32; 24] =
        [12, 23, 22, 21, 20, 19, 18, 17, 16, 15, 14, 13, 0, 11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1];

    #[test]
    fn the_order_is_that_of_the_standard_library() {
        let eights: Vec<u32> = (0..40).map(|record| record / 8).collect();
        assert_eq!(file_order(&channel(&eights)), EIGHTS);
        assert_eq!(file_order(&channel(&[7; 24])), EQUAL);
        assert_eq!(file_order(&channel(&[3; 16])), (0..16).collect::<Vec<_>>(), "too few to be divided");
        assert_eq!(file_order(&channel(&[])), [0; 0]);
    }
}

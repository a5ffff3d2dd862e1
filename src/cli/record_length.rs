//! Estimates the record length of headerless files from their bytes: nothing else gives it, and with a wrong
//! record length a file takes many times the bytes.

use crate::backend;
use crate::files::{HeaderlessLayout, Kind, is_nclt};

/// Number of bytes of each file that are examined, from the front.
pub const SAMPLE: u64 = 32 << 10;
/// Bytes of a float32.
const WORD: usize = 4;
/// Number of values in a record: from x, y and z alone to these and nine more.
const WORDS: std::ops::RangeInclusive<usize> = 3..=12;
/// Another record length is suggested only if it shrinks the sample to 90 %; of several, the shortest within
/// 10 % of the best.
const GAIN: f64 = 0.9;
/// Minimum share of values that are plausible coordinates.
const PLAUSIBLE: f64 = 0.9;
/// Minimum share of records that are seen in about the direction of the record before, if the record length
/// is right.
const STEADY: f64 = 0.7;

/// The beginning of a file.
#[derive(Clone, Debug)]
pub struct Sample {
    /// Its name.
    pub name: String,
    /// At most [`SAMPLE`] bytes.
    pub start: Vec<u8>,
    /// Bytes of the whole file.
    pub size: u64,
}

/// Whether the bytes are consistent with a layout.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The bytes are consistent with the layout.
    Agrees,
    /// The bytes look like float32 values in records of this layout instead.
    Rather(HeaderlessLayout),
    /// The bytes are not float32 coordinates, whatever the record length.
    NoFloats,
    /// The files are no whole number of records of this many bytes, which the layout demands.
    OtherLength(u64),
}

/// Compares headerless files with the layout; `None`: the default for their kind.
pub fn examine(samples: &[Sample], layout: Option<&HeaderlessLayout>) -> Verdict {
    let of_kind = |kind| samples.iter().filter(move |s| Kind::of(&s.name).is_some_and(|(k, _)| k == kind));
    let kitti: Vec<_> = of_kind(Kind::Kitti).filter(|sample| sample.start.len() >= 1 << 10).collect();
    // A single layout cannot be suggested for files of two kinds; those of nuScenes are as their name says.
    if kitti.is_empty() || of_kind(Kind::NuScenes).next().is_some() {
        return Verdict::Agrees;
    }
    if layout.is_none() && kitti.iter().all(|sample| is_nclt(&sample.start)) {
        return Verdict::Agrees;
    }
    let assumed = match layout.map_or(HeaderlessLayout::kitti().layout(), HeaderlessLayout::layout) {
        Some(layout) => layout.stride(),
        None => return Verdict::Agrees,
    };
    let fits = |stride: usize| kitti.iter().all(|sample| sample.size.is_multiple_of(stride as u64));
    // The first value of a record may be its time.
    let first = |stride| usize::from(rises(&kitti, stride));
    let is_steady = |stride| steadiness(&kitti, stride, first(stride)) >= STEADY;
    if layout.is_none() && (first(assumed) > 0 || !is_steady(assumed)) {
        let mut lengths = WORDS.map(|words| words * WORD).filter(|&stride| fits(stride));
        if let Some(stride) = lengths.find(|&stride| is_steady(stride) && !are_several(&kitti, stride)) {
            return floats(&kitti, stride, first(stride)).map_or(Verdict::NoFloats, Verdict::Rather);
        }
    }
    let cost = |stride: usize| kitti.iter().map(|sample| cost(&sample.start, stride)).sum::<usize>() as f64;
    let candidates = WORDS.map(|words| words * WORD).filter(|&stride| fits(stride));
    let costs: Vec<_> = candidates.map(|stride| (stride, cost(stride))).collect();
    let least = costs.iter().map(|(_, cost)| *cost).fold(f64::INFINITY, f64::min);
    // Multiples of the right length are about as good.
    let best = costs.into_iter().find(|(_, cost)| GAIN * cost <= least);
    match best {
        Some((stride, least)) if stride != assumed && least < GAIN * cost(assumed) => {
            match floats(&kitti, stride, 0) {
                Some(found) => Verdict::Rather(found),
                None if layout.is_none() => Verdict::NoFloats,
                None if !fits(assumed) => Verdict::OtherLength(assumed as u64),
                None => Verdict::Agrees,
            }
        }
        _ if layout.is_some() && !fits(assumed) => Verdict::OtherLength(assumed as u64),
        _ if layout.is_none() && floats(&kitti, assumed, 0).is_none() => Verdict::NoFloats,
        _ => Verdict::Agrees,
    }
}

/// The size of a sample when the values of each field are grouped and compressed, given the record length.
fn cost(bytes: &[u8], stride: usize) -> usize {
    let planes: Vec<u8> =
        (0..stride).flat_map(|at| bytes.chunks_exact(stride).map(move |record| record[at])).collect();
    backend::compress_quickly(&planes).map_or(usize::MAX, |coded| coded.len())
}

/// The share of records whose azimuth is about that of the record before, if records have `stride` bytes, and
/// x and y are the values number `first` and `first + 1`: scanners turn slowly, whether files hold firing
/// after firing or row after row.
fn steadiness(samples: &[&Sample], stride: usize, first: usize) -> f64 {
    /// In degrees: more than the offsets of a scanner's lasers.
    const NEAR: f32 = 8.0;
    let azimuth = |record: &[u8]| {
        let [x, y] = [first, first + 1].map(|at| f32_at(record, at));
        (x.is_normal() && y.is_normal()).then(|| libm::atan2f(y, x).to_degrees())
    };
    let (mut near, mut all) = (0u32, 0u32);
    for sample in samples {
        let azimuths: Vec<f32> = sample.start.chunks_exact(stride).filter_map(azimuth).collect();
        let turns = azimuths.windows(2).map(|pair| (pair[1] - pair[0]).abs());
        near += turns.filter(|turn| turn.min(360.0 - turn) < NEAR).count() as u32;
        // Records without a direction show nothing, but few may be among those of a scan.
        all += azimuths.len().max(sample.start.len() / stride / 4) as u32;
    }
    f64::from(near) / f64::from(all.max(1))
}

/// Whether records of `stride` bytes are several shorter ones, one after the other: then x, y and z are about
/// as large in each. Such records may be steady although single ones are not, if lasers far apart take turns.
fn are_several(samples: &[&Sample], stride: usize) -> bool {
    /// Largest factor between medians.
    const ALIKE: f32 = 4.0;
    let size = |at: usize| {
        let records = samples.iter().flat_map(|sample| sample.start.chunks_exact(stride));
        let mut sizes: Vec<f32> = records.map(|record| f32_at(record, at).abs()).collect();
        sizes.sort_unstable_by(f32::total_cmp);
        sizes.get(sizes.len() / 2).copied().unwrap_or(0.0)
    };
    let are_alike = |at: usize, words: usize| {
        let [one, other] = [at, at + words].map(size);
        one > 0.0 && (one / ALIKE..=one * ALIKE).contains(&other)
    };
    WORDS
        .filter(|&words| words * WORD < stride && stride.is_multiple_of(words * WORD))
        .any(|words| (0..3).all(|at| are_alike(at, words)))
}

/// Whether the first value of each record is a time: it hardly ever falls, if records have `stride` bytes and
/// room for coordinates behind it. In four values, these may be x of sorted points and their intensity, which
/// is never negative, unlike z.
fn rises(samples: &[&Sample], stride: usize) -> bool {
    /// At most one value in this number is smaller than the one before.
    const RARE: usize = 20;
    let values = |sample: &Sample, at: usize| {
        let records = sample.start.chunks_exact(stride);
        records.map(|record| f32_at(record, at)).collect::<Vec<f32>>()
    };
    let has_intensity = |sample: &&Sample| {
        stride == 4 * WORD && values(sample, 3).iter().all(|value| (0.0..=65535.0).contains(value))
    };
    let rises = |sample: &&Sample| {
        let values = values(sample, 0);
        let falls = values.windows(2).filter(|pair| pair[1] < pair[0] || pair[1].is_nan()).count();
        falls * RARE < values.len()
    };
    stride > 3 * WORD && samples.iter().all(rises) && !samples.iter().all(has_intensity)
}

fn f32_at(record: &[u8], at: usize) -> f32 {
    f32::from_le_bytes(std::array::from_fn(|n| record[WORD * at + n]))
}

/// The layout of records of `stride` bytes whose coordinates begin with the value number `first`; `None` if
/// these are no coordinates. A value before them is a time.
fn floats(samples: &[&Sample], stride: usize, first: usize) -> Option<HeaderlessLayout> {
    let share = |at: usize, is: &dyn Fn(f32) -> bool| {
        let records = samples.iter().flat_map(|sample| sample.start.chunks_exact(stride));
        let (count, found) = records.fold((0, 0), |(count, found), record| {
            (count + 1, found + u32::from(is(f32_at(record, first + at))))
        });
        f64::from(found) / f64::from(count.max(1))
    };
    // Metres, blanks, and possible coordinates of a map.
    let is_coordinate = |v: f32| v == 0.0 || v.is_nan() || (1e-5..1e7).contains(&v.abs());
    let is_intensity = |v: f32| v == 0.0 || (1e-5..=65535.0).contains(&v);
    if (0..3).any(|at| share(at, &is_coordinate) < PLAUSIBLE) {
        return None;
    }
    let has_intensity = stride > (first + 3) * WORD && share(3, &is_intensity) >= PLAUSIBLE;
    let mut letters = "t".repeat(first) + if has_intensity { "xyzi" } else { "xyz" };
    letters.push_str(&"_".repeat(stride / WORD - letters.len()));
    letters.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Records of `words` values, as from a rotating scanner.
    fn file(words: usize) -> Sample {
        let record = |n: u32| {
            let angle = n as f32 * 0.01;
            let range = 10.0 + (n.wrapping_mul(2_654_435_761) >> 24) as f32 * 0.004;
            let rest = [(n % 97) as f32 / 100.0, (n % 16) as f32, n as f32 * 1e-6, 0.0, 1.0];
            let values = [range * angle.cos(), range * angle.sin(), range * 0.1].into_iter().chain(rest);
            values.cycle().take(words).collect::<Vec<_>>()
        };
        let bytes: Vec<u8> = (0..3001).flat_map(record).flat_map(f32::to_le_bytes).collect();
        let size = bytes.len() as u64;
        Sample { name: "0.bin".to_owned(), start: bytes[..bytes.len().min(SAMPLE as usize)].to_vec(), size }
    }

    #[test]
    fn records_are_as_long_as_their_fields_repeat() {
        for (words, letters) in [(3, "xyz"), (5, "xyzi_"), (6, "xyzi__"), (8, "xyzi____")] {
            let found: HeaderlessLayout = letters.parse().unwrap();
            assert_eq!(examine(&[file(words)], None), Verdict::Rather(found.clone()), "{words}");
            assert_eq!(examine(&[file(words)], Some(&found)), Verdict::Agrees);
            // Two records taken for one take no more bytes, which is not detected.
            if words % 4 != 0 {
                assert_eq!(examine(&[file(4)], Some(&found)), Verdict::Rather(HeaderlessLayout::kitti()));
            }
        }
        assert_eq!(examine(&[file(4)], None), Verdict::Agrees);
        assert_eq!(examine(&[], None), Verdict::Agrees);
    }

    #[test]
    fn lasers_far_apart_may_take_turns() {
        // As of a scanner that lies on its side: x and y as seen are x and z, of two lasers in turn.
        let record = |n: u32| {
            let (sin, cos) = (n as f32 * 0.003).sin_cos();
            let range = 10.0 + (n.wrapping_mul(2_654_435_761) >> 24) as f32 * 0.004;
            [range * cos, if n.is_multiple_of(2) { -range * 0.2 } else { range * 0.2 }, range * sin, 0.5]
        };
        let start: Vec<u8> = (0..2000).flat_map(record).flat_map(f32::to_le_bytes).collect();
        let sample = Sample { name: "0.bin".to_owned(), size: start.len() as u64, start };
        assert!(steadiness(&[&sample], 16, 0) < STEADY && steadiness(&[&sample], 32, 0) >= STEADY);
        assert_eq!(examine(&[sample], None), Verdict::Agrees);
    }

    #[test]
    fn a_time_may_come_first() {
        let of_points = file(4);
        let records = of_points.start.chunks_exact(16).zip(0u16..);
        let timed =
            records.flat_map(|(record, n)| [&(f32::from(n) * 1e-5).to_le_bytes()[..], record].concat());
        let start: Vec<u8> = timed.collect();
        let timed = Sample { size: start.len() as u64, start, ..of_points };
        assert_eq!(examine(&[timed], None), Verdict::Rather("txyzi".parse().unwrap()));
    }

    #[test]
    fn a_file_that_was_cut_off_is_still_of_its_kind() {
        let mut cut = file(4);
        cut.size -= 4;
        assert!(cut.size.is_multiple_of(12));
        assert_eq!(examine(&[cut], None), Verdict::Agrees);
    }

    #[test]
    fn sorted_points_are_no_times() {
        let mut sorted = file(4);
        let mut records: Vec<[u8; 16]> = sorted.start.as_chunks().0.to_vec();
        records.sort_by(|a, b| f32_at(a, 0).total_cmp(&f32_at(b, 0)));
        sorted.start = records.concat();
        sorted.size = sorted.start.len() as u64;
        assert_eq!(examine(&[sorted], None), Verdict::Agrees);
    }

    #[test]
    fn records_of_nclt_are_known() {
        let record = |n: u16| [20_000 + n, 20_100, 19_800].map(u16::to_le_bytes).concat();
        let start: Vec<u8> =
            (0..400).flat_map(|n| [record(n), vec![n as u8, n as u8 % 32]].concat()).collect();
        let sample = Sample { name: "0.bin".to_owned(), size: start.len() as u64, start };
        assert_eq!(examine(std::slice::from_ref(&sample), None), Verdict::Agrees);
        let inverted = Sample { start: sample.start.iter().map(|byte| !byte).collect(), ..sample };
        assert_eq!(examine(&[inverted], None), Verdict::NoFloats);
    }

    #[test]
    fn other_bytes_are_no_floats() {
        let mut noise = file(4);
        noise
            .start
            .iter_mut()
            .enumerate()
            .for_each(|(n, byte)| *byte = (n as u32).wrapping_mul(2_654_435_761).to_le_bytes()[3]);
        assert_eq!(examine(&[noise.clone()], None), Verdict::NoFloats);
        let whole = "x:u16,y:u16,z:u16,i:u8,r:u8,_:u8*3".parse().unwrap();
        assert_eq!(examine(&[noise.clone()], Some(&whole)), Verdict::OtherLength(11));
        // A layout given by the user is trusted.
        assert_eq!(examine(&[noise], Some(&"x:u16,y:u16,z:u16,i:u8,r:u8".parse().unwrap())), Verdict::Agrees);
    }
}

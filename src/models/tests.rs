use super::quantise::{magnitude_level, magnitude_of_level};
use super::*;
use crate::entropy::{
    ArithmeticDecoder, ArithmeticEncoder, TokenCoder, TokenReader, TokenTables, TokenWriter,
};
use crate::ground::grid::Grid;
use crate::ground::random::Rng;
use crate::models::IntensityScale;
use crate::scan::{Channel, Field, ScalarType, squared_distance};
use crate::scanner::CoordinateGrid;
use proptest::prelude::*;

/// Codes a section twice, as two frames of a group. Returns the encoder's values after the second time, and
/// the decoded ones.
fn round_trip<T: Clone>(
    contexts: usize,
    full: &T,
    empty: &T,
    write: impl Fn(&mut TokenWriter, &mut T),
    read: impl Fn(&mut TokenReader<'_>, &mut T),
) -> (T, T) {
    let (mut written, mut known) = (TokenTables::default(), TokenTables::default());
    let (mut encoded, mut decoded) = (full.clone(), empty.clone());
    for _ in 0..2 {
        let mut writer = TokenWriter::new(contexts);
        encoded = full.clone();
        write(&mut writer, &mut encoded);
        let payload = writer.finish(&mut written).unwrap();
        let mut reader = TokenReader::new(&payload, contexts, &mut known).unwrap();
        decoded = empty.clone();
        read(&mut reader, &mut decoded);
        assert!(!reader.is_exhausted());
        let counts = reader.into_counts();
        known.learn(&counts);
    }
    (encoded, decoded)
}

/// A grid of 9 rows with these values, each cell occupied or not.
fn grid<T: Clone + Default>(values: &[T]) -> Grid<T> {
    let mut grid = Grid::new(9, values.len() / 9);
    grid.cells_mut().iter_mut().zip(values).for_each(|(cell, value)| *cell = value.clone());
    grid
}

/// Returns these tokens and bits, whatever is requested.
struct Given(std::vec::IntoIter<(u8, u32)>);

impl TokenCoder for Given {
    const ENCODES: bool = false;

    fn token(&mut self, _: usize, _: u8) -> u8 {
        self.0.next().map_or(0, |(token, _)| token)
    }

    fn bits(&mut self, _: u64, count: u32) -> u64 {
        let bits = self.0.as_slice().first().map_or(0, |(_, bits)| *bits);
        u64::from(bits) & ((1 << count) - 1)
    }
}

proptest! {
    #[test]
    fn cells_come_back(filled in proptest::collection::vec(any::<bool>(), 0..400)) {
        let occupancy = grid(&filled);
        let empty = Grid::new(occupancy.rows(), occupancy.columns());
        let read = |coder: &mut TokenReader<'_>, cells: &mut Grid<bool>| code_occupancy(coder, cells);
        let (encoded, decoded) = round_trip(OCCUPANCY_CONTEXTS, &occupancy, &empty, code_occupancy, read);
        prop_assert_eq!(&decoded, &occupancy);
        prop_assert_eq!(encoded, decoded);
    }

    #[test]
    fn ranges_come_back_to_within_half_a_bin(
        ranges in proptest::collection::vec((any::<bool>(), 1u32..1 << 24), 0..400),
        range_bits in 16u32..=24,
        bin in prop_oneof![Just(1u32), 1u32..2000],
        fitted in any::<bool>(),
        refers in any::<bool>(),
        smooth in any::<bool>(),
        moved in 0u32..100,
    ) {
        let range_of = |range: u32| 1 + (if smooth { 5000 + range % 50 } else { range }) % ((1 << range_bits) - 1);
        let occupancy = grid(&ranges.iter().map(|(filled, _)| *filled).collect::<Vec<_>>());
        let steps = grid(&ranges.iter().map(|(filled, range)| u32::from(*filled) * range_of(*range)).collect::<Vec<_>>());
        // Some cells of the frame before are occupied, and some of these have the same range.
        let before = |range: &u32| if range.is_multiple_of(5) { 0 } else { range.saturating_sub(moved * (range % 3)) };
        let same = steps.map(before);
        let levels = steps.map(|range| (range % 129) as u16);
        let known = KnownCells { occupancy: &occupancy, fitted, expected: refers.then_some(&same), levels: &levels };
        let scale = RangeScale { bits: range_bits, bin };
        let (encoded, decoded) = round_trip(
            RANGE_CONTEXTS,
            &steps,
            &Grid::new(steps.rows(), steps.columns()),
            |coder, steps| RangeTokens::default().code(coder, &known, scale, steps),
            |coder, steps| RangeTokens::default().code(coder, &known, scale, steps),
        );
        prop_assert_eq!(&encoded, &decoded);
        for (range, decoded) in steps.cells().iter().zip(decoded.cells()) {
            prop_assert!(range.abs_diff(*decoded) <= bin / 2);
        }
    }

    #[test]
    fn any_tokens_decode_to_ranges(
        tokens in proptest::collection::vec((any::<u8>(), any::<u32>()), 60),
        range_bits in 16u32..=24,
        bin in prop_oneof![Just(1u32), 1u32..1 << 20],
        fitted in any::<bool>(),
        refers in any::<bool>(),
        before in proptest::collection::vec(0u32..1 << 24, 63),
    ) {
        let occupancy = grid(&vec![true; tokens.len()]);
        let mut steps = Grid::new(occupancy.rows(), occupancy.columns());
        let tokens_len = tokens.len();
        let mut coder = Given(tokens.into_iter());
        let same = grid(&before[..tokens_len]);
        let levels = same.map(|range| (range % 129) as u16);
        let known = KnownCells { occupancy: &occupancy, fitted, expected: refers.then_some(&same), levels: &levels };
        let scale = RangeScale { bits: range_bits, bin };
        RangeTokens::default().code(&mut coder, &known, scale, &mut steps);
        prop_assert!(steps.cells().iter().all(|range| (1..1 << range_bits).contains(range)));
    }

    #[test]
    fn intensities_come_back(
        levels in proptest::collection::vec((0u32..512, 0u16..40), 1..300),
        per_unit in prop_oneof![Just(100u32), Just(255), Just(511)],
        exceptions in any::<bool>(),
    ) {
        let value = |&(level, odd): &(u32, u16)| {
            let on_grid = (f64::from(level % (per_unit + 1)) / f64::from(per_unit)) as f32;
            if exceptions && odd == 0 { f32::from_bits(level.wrapping_mul(0x0123_4567)) } else { on_grid }
        };
        let values: Vec<f32> = levels.iter().map(value).collect();
        let scale = IntensityScale::of(&values, Some(per_unit));
        let empty = vec![0.0f32; values.len()];
        fn code<C: TokenCoder>(coder: &mut C, scale: &IntensityScale, values: &mut [f32]) {
            let (mut model, mut west) = (IntensityTokens::default(), 0);
            for (index, value) in values.iter_mut().enumerate() {
                west = model.code(coder, scale, (west, (index % 129) as u16), value);
            }
        }
        let (encoded, decoded) = round_trip(
            INTENSITY_CONTEXTS,
            &values,
            &empty,
            |coder, values| code(coder, &scale, values),
            |coder, values| code(coder, &scale, values),
        );
        let bits = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        prop_assert_eq!(bits(&decoded), bits(&values));
        prop_assert_eq!(bits(&encoded), bits(&values));
    }

    #[test]
    fn packed_ranges_come_back_to_within_half_a_bin(
        ranges in proptest::collection::vec(any::<u32>(), 0..200),
        range_bits in 16u32..=24,
        bin in prop_oneof![Just(1u32), 1u32..2000],
        smooth in any::<bool>(),
    ) {
        let most = (1 << range_bits) - 1;
        let range_of = |range: &u32| 1 + (if smooth { 5000 + range % 50 } else { *range }) % most;
        let ranges: Vec<u32> = ranges.iter().map(range_of).collect();
        let scale = RangeScale { bits: range_bits, bin };
        let (encoded, decoded) = round_trip(
            PACKED_RANGE_CONTEXTS,
            &ranges,
            &vec![0; ranges.len()],
            |coder, ranges| code_packed_ranges(coder, scale, ranges),
            |coder, ranges| code_packed_ranges(coder, scale, ranges),
        );
        prop_assert_eq!(&encoded, &decoded);
        prop_assert!(ranges.iter().zip(&decoded).all(|(range, decoded)| range.abs_diff(*decoded) <= bin / 2));
    }

    #[test]
    fn any_tokens_decode_to_packed_ranges(
        tokens in proptest::collection::vec((any::<u8>(), any::<u32>()), 40),
        range_bits in 16u32..=24,
        bin in prop_oneof![Just(1u32), 1u32..1 << 20],
    ) {
        let mut ranges = [0; 99];
        code_packed_ranges(&mut Given(tokens.into_iter()), RangeScale { bits: range_bits, bin }, &mut ranges);
        prop_assert!(ranges.iter().all(|range| (1..1 << range_bits).contains(range)));
    }

    #[test]
    fn packed_intensities_come_back(
        levels in proptest::collection::vec((0u32..512, 0u16..40), 0..300),
        per_unit in prop_oneof![Just(100u32), Just(255), Just(511)],
        odd_values in prop_oneof![Just(0u32), Just(1), Just(9)],
    ) {
        // None, a few or most of the values are not on a grid.
        let value = |&(level, kind): &(u32, u16)| {
            let on_grid = (f64::from(level % (per_unit + 1)) / f64::from(per_unit)) as f32;
            let is_odd = u32::from(kind) < odd_values * 4;
            if is_odd { f32::from_bits(level.wrapping_mul(0x0123_4567)) } else { on_grid }
        };
        let values: Vec<f32> = levels.iter().map(value).collect();
        let scale = IntensityScale::of(&values, Some(per_unit));
        let (encoded, decoded) = round_trip(
            PACKED_INTENSITY_CONTEXTS,
            &values,
            &vec![0.0; values.len()],
            |coder, values| code_packed_intensities(coder, &scale, values),
            |coder, values| code_packed_intensities(coder, &scale, values),
        );
        let bits = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        prop_assert_eq!(bits(&decoded), bits(&values));
        prop_assert_eq!(bits(&encoded), bits(&values));
    }

    #[test]
    fn positions_come_back(
        points in proptest::collection::vec(
            (-50_000i32..50_000, prop_oneof![4 => Just(0i32), 1 => -900i32..900]), 0..200),
        millimetres in any::<bool>(),
        bounded in any::<bool>(),
        with_blanks in any::<bool>(),
    ) {
        let grid = if millimetres { CoordinateGrid::Millimetre } else { CoordinateGrid::Float32 };
        let formula = |point: usize| [0, 1, 2].map(|axis| f64::from(points[point].0 + axis) * 1.00037e-3);
        let near: Vec<_> = (0..points.len()).map(|point| formula(point).map(|v| grid.nearest(v))).collect();
        let off = |point: usize, axis: i32| {
            let formula = formula(point)[axis as usize];
            grid.value(grid.unit_of(formula) + i64::from(points[point].1 * (axis + 1)), formula)
        };
        let positions = (0..points.len()).map(|point| [0, 1, 2].map(|axis| off(point, axis)));
        let wanted: Vec<[f32; 3]> = positions.collect();
        let max_error = bounded.then_some(0.002);
        let is_blank = |point: u32| with_blanks && point % 3 == 1;
        let returns: Vec<u32> = (0..points.len() as u32).filter(|&point| !is_blank(point)).collect();
        let returns = with_blanks.then_some(&returns[..]);
        let (encoded, decoded) = round_trip(
            CORRECTION_CONTEXTS,
            &near,
            &near,
            |coder, near| correct_positions(coder, grid, formula, (&wanted, max_error), (near, returns)),
            |coder, near| correct_positions(coder, grid, formula, (&[], max_error), (near, returns)),
        );
        prop_assert_eq!(&encoded, &decoded);
        for (point, (wanted, decoded)) in wanted.iter().zip(&decoded).enumerate() {
            let same = wanted.map(f32::to_bits) == decoded.map(f32::to_bits);
            let within = *decoded == near[point]
                && max_error.is_some_and(|max| squared_distance(wanted, decoded).sqrt() <= max);
            if is_blank(point as u32) {
                prop_assert_eq!(decoded, &near[point]);
                continue;
            }
            prop_assert!(same || within, "{point}: {wanted:?} {decoded:?}");
        }
    }
}

#[test]
fn levels_rise_with_the_magnitude() {
    let levels: Vec<usize> = (0..9000).map(|magnitude| magnitude_level(magnitude, 40)).collect();
    assert!(levels.is_sorted());
    assert_eq!((levels[0], levels[1], levels[8999]), (0, 1, 39));
    for level in 0..40 {
        let least = magnitude_of_level(level);
        assert_eq!(magnitude_level(least, 40), level);
        assert!(least == 0 || magnitude_level(least - 1, 40) == level - 1);
    }
}

/// The bytes that points take without a scanner, which come back.
fn size_of_points(points: &[[f32; 3]]) -> usize {
    size_of_points_with(points, &[])
}

/// The same, if these are their channels.
fn size_of_points_with(points: &[[f32; 3]], channels: &[Channel]) -> usize {
    let mut encoder = ArithmeticEncoder::default();
    let analysis = PointModel::default().analyse(None, points, channels);
    let known = PointModel::default().code(&mut encoder, None, &mut points.to_vec(), &analysis);
    let bytes = encoder.finish();
    let mut decoded = vec![[0.0; 3]; points.len()];
    let mut decoder = ArithmeticDecoder::new(&bytes);
    let found = PointModel::default().code(&mut decoder, None, &mut decoded, &Analysis::default());
    assert_eq!(found, known);
    let bits = |points: &[[f32; 3]]| points.as_flattened().iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    assert!(bits(&decoded) == bits(points));
    bytes.len()
}

/// Firings of 16 lasers around a point beside the origin and `above` it, with noise, and without some
/// returns. Each point has the number of its laser.
fn firings_beside_the_origin(above: f64) -> Vec<([f32; 3], u8)> {
    let mut random = Rng::keyed(5, &[]);
    let firing = |firing: usize| {
        let lasers = (0..16u8).filter(|_| random.between(0.0, 1.0) < 0.9).collect::<Vec<_>>();
        let point = |laser: u8| {
            let azimuth = firing as f64 * 0.0035 + f64::from(laser % 4) * 0.02;
            let noise = random.between(-0.02, 0.02);
            let range = 8.0 + 2.0 * libm::sin(5.0 * azimuth) + f64::from(laser) * 0.7 + noise;
            let elevation = f64::from(laser) * 0.035 - 0.26;
            let (along, height) = (range * libm::cos(elevation), range * libm::sin(elevation) + above);
            let position = [along * libm::cos(azimuth) + 0.9, along * libm::sin(azimuth) - 0.4, height];
            (position.map(|v| v as f32), laser)
        };
        lasers.into_iter().map(point).collect::<Vec<_>>()
    };
    (0..600).flat_map(firing).collect()
}

#[test]
fn points_are_predicted_along_their_trails() {
    let in_order = firings_beside_the_origin(0.0);
    let positions =
        |points: &[([f32; 3], u8)]| points.iter().map(|(position, _)| *position).collect::<Vec<_>>();
    let rings = |points: &[([f32; 3], u8)]| {
        let bytes = points.iter().map(|(_, laser)| *laser).collect();
        [Channel { field: Field::new("ring", ScalarType::U8), bytes }]
    };
    let trailed = size_of_points(&positions(&in_order));
    let bits = 8.0 * trailed as f64 / in_order.len() as f64;
    // Of 96 bits. The noise of the ranges alone takes some 17.
    assert!(bits < 40.0, "{bits} bits a point");

    let mut random = Rng::keyed(6, &[]);
    let mut chaos = positions(&in_order);
    for last in (1..chaos.len()).rev() {
        chaos.swap(last, random.between(0.0, last as f64 + 0.999) as usize);
    }
    let chaos = size_of_points(&chaos);
    assert!(3 * trailed < 2 * chaos, "{trailed} and {chaos} bytes");

    // High above the origin, the elevation of a laser changes with the distance of its points. Its number
    // does not.
    let high = firings_beside_the_origin(1.7);
    let [without, with] =
        [&[][..], &rings(&high)].map(|channels| size_of_points_with(&positions(&high), channels));
    assert!(with < without, "{with} and {without} bytes");
}

/// Differences of a map's coordinates in single precision are multiples of a power of two, another one along
/// each axis.
#[test]
fn axes_have_grids_of_their_own_and_points_may_be_off_them() {
    let points: Vec<[f32; 3]> =
        firings_beside_the_origin(0.0).into_iter().map(|(position, _)| position).collect();
    let scanner = [1000.3f32, -12_345.6, 80.1];
    let through_map =
        |point: &[f32; 3]| std::array::from_fn(|axis| (point[axis] + scanner[axis]) - scanner[axis]);
    let moved: Vec<[f32; 3]> = points.iter().map(through_map).collect();
    assert_eq!(CoordinateGrid::of_most(&moved), [14, 10, 17].map(CoordinateGrid::Binary));
    let bits = |points: &[[f32; 3]]| 8 * size_of_points(points) / points.len();
    assert!(bits(&moved) + 15 < bits(&points), "{} and {} bits a point", bits(&moved), bits(&points));

    let mut some = points.clone();
    let most = 9 * some.len() / 10;
    some[..most].copy_from_slice(&moved[..most]);
    assert!(bits(&some) < bits(&moved) + 5, "{} and {} bits a point", bits(&some), bits(&moved));
    some.iter_mut().step_by(7).for_each(|point| point[1] = f32::NAN);
    size_of_points(&some);
}

#[test]
fn more_trails_than_a_ring_holds_come_back() {
    // Each point begins a trail, as none is near another.
    let mut random = Rng::keyed(8, &[]);
    let points: Vec<_> = (0..700).map(|_| [0; 3].map(|_| random.between(-90.0, 90.0) as f32)).collect();
    assert!(size_of_points(&points) < 12 * points.len());
    let few = &points[..3];
    (0..=few.len()).for_each(|count| assert!(size_of_points(&few[..count]) < 80));
}

#[test]
fn repeated_points_cost_little() {
    let mut random = Rng::keyed(7, &[]);
    let mut point = || [0; 3].map(|_| random.between(-50.0, 50.0) as f32);
    let points: Vec<_> = (0..6000).map(|_| point()).collect();
    let once = size_of_points(&points);
    // Each column of some 60 lasers a second time, one column later.
    let columns = points.chunk_by(|_, next| next[0] < 48.0);
    let twice: Vec<_> = columns.flat_map(|column| [column, column].concat()).collect();
    let runs = size_of_points(&twice) - once;
    assert!(runs < 1000, "{runs} bytes for {} columns", points.len() / 50);
    // Every third point without a return, whatever stands for that.
    let nan = f32::from_bits(0x7fc0_1234);
    for nothing in [[nan; 3], [nan, 0.0, f32::INFINITY], [0.0; 3]] {
        let mut n = 0;
        let with = points.iter().flat_map(|point| {
            n = (n * 5 + 1) % 997;
            if n % 3 == 0 { vec![nothing, *point] } else { vec![*point] }
        });
        let with: Vec<_> = with.collect();
        let places = size_of_points(&with) - once;
        let bits = 8.0 * places as f64 / (with.len() - points.len()) as f64;
        assert!(bits < 6.0, "{bits} bits for each place without a return");
    }
    assert!(size_of_points(&[[nan; 3]; 9000]) < 100);
}

#[test]
fn blanks_of_two_kinds_in_turn_cost_about_a_bit() {
    const BLANKS: usize = 8000;
    let mut random = Rng::keyed(5, &[]);
    let mut blank = |_| if random.chance(0.5) { [0.0; 3] } else { [f32::NAN; 3] };
    let positions: Vec<[f32; 3]> = (0..BLANKS).map(&mut blank).collect();
    let formula = [-0.0, 0.0, 0.0];
    let mut written = positions.clone();
    let mut encoder = ArithmeticEncoder::default();
    BlankModel::default().code(&mut encoder, |_| formula, &mut written);
    let bytes = encoder.finish();
    assert!(bytes.len() < BLANKS / 8 * 11 / 10, "{} bytes", bytes.len());
    let mut decoded = vec![[1.0; 3]; BLANKS];
    BlankModel::default().code(&mut ArithmeticDecoder::new(&bytes), |_| formula, &mut decoded);
    let bits =
        |positions: &[[f32; 3]]| positions.as_flattened().iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&decoded), bits(&positions));
}

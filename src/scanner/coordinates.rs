//! The grid of coordinates: whole millimetres, any float32 values, or, where an error is allowed, a coarser
//! grid. FORMAT.md 3.4.

use crate::ground::decimal;
use crate::ground::floats::{of_rank, rank, round_ties_even};
use crate::scanner::thinned;

/// The grid of the coordinates. A *unit* is the distance between neighbouring values of that grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CoordinateGrid {
    /// `float32(k / 1000)`, k whole millimetres: KITTI raw.
    Millimetre,
    /// Any float32: KITTI-360. Units count the representable values in ascending order.
    Float32,
    /// `float32(k * step)`: coordinates that were rounded to this grid.
    Lattice {
        /// The step in nanometres.
        step_nm: u64,
    },
    /// The float32 values nearest to decimal numbers with this many significant digits, 1 to 9: text (`%g`).
    /// Units count those numbers in ascending order.
    Digits(u8),
    /// Half-precision numbers, with 11 significant bits. Units count the float32 values whose other 13 bits
    /// are 0.
    Half,
    /// Multiples of a power of two, with this many binary places, 1 to 30: differences of large float32 values,
    /// as where a map's coordinates were moved to the frame of a vehicle in single precision (Waymo).
    Binary(u8),
}

impl CoordinateGrid {
    /// The grid of some coordinates (metres): millimetres if nearly all are whole millimetres. Those that are
    /// not finite stand for no place and do not count.
    pub fn of<'a>(values: impl Iterator<Item = &'a f32>) -> Self {
        let (mut on_grid, mut total) = (0usize, 0usize);
        for value in values.filter(|value| value.is_finite()) {
            total += 1;
            on_grid += usize::from(CoordinateGrid::Millimetre.unit_in_file(*value).is_some());
        }
        if on_grid * 100 > total * 95 { CoordinateGrid::Millimetre } else { CoordinateGrid::Float32 }
    }

    /// The coarsest grid that contains all of some coordinates (metres): decimal places, decimal digits, or
    /// any float32.
    pub fn finest_of(values: &[f32]) -> Self {
        let lattice = |step_nm: u64| CoordinateGrid::Lattice { step_nm };
        let [centimetre, others @ ..] = [10_000_000, 100_000, 10_000, 1000].map(lattice);
        let places = [centimetre, CoordinateGrid::Millimetre].into_iter().chain(others);
        let digits = (4..=8).map(CoordinateGrid::Digits);
        let mut grids = places.chain(digits);
        let holds = |grid: &CoordinateGrid| values.iter().all(|value| grid.unit_in_file(*value).is_some());
        grids.find(holds).filter(|_| !values.is_empty()).unwrap_or(CoordinateGrid::Float32)
    }

    /// Whether positions (metres) were rounded, as far as a sample of them tells.
    pub fn are_rounded(positions: &[[f32; 3]]) -> bool {
        const SAMPLE: usize = 2000;
        let values: Vec<f32> = thinned(positions, SAMPLE).flatten().copied().collect();
        Self::finest_of(&values) != CoordinateGrid::Float32
    }

    /// The grids on which most of some positions (metres) lie and take the fewest bits, the widest ones: the
    /// same for all axes, unless one for each axis is worth more than what it takes to say so. Zeros are on all
    /// grids.
    pub fn of_most(positions: &[[f32; 3]]) -> [Self; 3] {
        /// Number of positions that are compared, at most.
        const SAMPLE: usize = 500;
        /// Bits that grids of their own take in the stream.
        const OWN: f64 = 100.0;
        /// Finer steps than this, in metres, near zero, say nothing about the grid.
        const FINEST: f64 = 1e-9;
        /// What it costs each coordinate, in bits, that those off the grid are coded by the same models.
        const MIXED: f64 = 1.0;
        /// Steps of lattices in nanometres, which programs round to.
        const STEPS: [u64; 12] = [
            100_000_000,
            50_000_000,
            20_000_000,
            10_000_000,
            5_000_000,
            4_000_000,
            2_000_000,
            500_000,
            250_000,
            200_000,
            100_000,
            10_000,
        ];
        let every = positions.len() / SAMPLE + 1;
        let of_axis = |axis: usize| -> Vec<f32> {
            let values = positions.iter().step_by(every).map(|position| position[axis]);
            values.filter(|value| value.is_finite() && *value != 0.0).collect()
        };
        let axes = [0, 1, 2].map(of_axis);
        // Bits of a coordinate, beside one whose residual is a metre.
        let bits = |step: f64| -libm::log2(step.max(FINEST));
        let size = |grid: &CoordinateGrid, values: &[f32]| {
            let mut on_grid = 0usize;
            let of_value = |&value: &f32| match grid.unit_in_file(value) {
                Some(unit) => {
                    on_grid += 1;
                    bits(f64::from(grid.value(unit.wrapping_add(1), 0.0)) - f64::from(value))
                }
                None => bits(f64::from(value.next_up()) - f64::from(value)),
            };
            let of_values: f64 = values.iter().map(of_value).sum();
            let mixed = if on_grid < values.len() { MIXED * values.len() as f64 } else { 0.0 };
            of_values + bits_of_choices(on_grid, values.len()) + mixed
        };
        let grids = [CoordinateGrid::Float32, CoordinateGrid::Millimetre].into_iter();
        let grids = grids
            .chain(STEPS.map(|step_nm| CoordinateGrid::Lattice { step_nm }))
            .chain((4..=8).map(CoordinateGrid::Digits))
            .chain([CoordinateGrid::Half])
            .chain((4..=20).map(CoordinateGrid::Binary));
        let sizes: Vec<(CoordinateGrid, [f64; 3])> =
            grids.map(|grid| (grid, [0, 1, 2].map(|axis| size(&grid, &axes[axis])))).collect();
        let least = |of_axes: &dyn Fn(&[f64; 3]) -> f64| {
            let sizes = sizes.iter().map(|(grid, sizes)| (of_axes(sizes), *grid));
            sizes.min_by(|(a, _), (b, _)| a.total_cmp(b)).unwrap_or((0.0, CoordinateGrid::Float32))
        };
        let (common_size, common) = least(&|sizes| sizes.iter().sum());
        let own = [0, 1, 2].map(|axis| least(&|sizes| sizes[axis]));
        let own_size: f64 = own.iter().map(|(size, _)| size).sum();
        let saved = (common_size - own_size) * every as f64;
        if saved > OWN { own.map(|(_, grid)| grid) } else { [common; 3] }
    }

    /// The numbers of a grid in a stream: its kind and its step. FORMAT.md 3.4.
    pub fn to_numbers(self) -> (u32, u32) {
        match self {
            CoordinateGrid::Float32 => (0, 0),
            CoordinateGrid::Millimetre => (1, 0),
            CoordinateGrid::Lattice { step_nm } => (2, step_nm as u32),
            CoordinateGrid::Digits(digits) => (3, digits.into()),
            CoordinateGrid::Half => (4, 0),
            CoordinateGrid::Binary(places) => (5, places.into()),
        }
    }

    /// The inverse of [`to_numbers`](Self::to_numbers); `None` if the numbers do not fit together.
    pub fn from_numbers(kind: u32, step: u32) -> Option<Self> {
        match (kind, step) {
            (0, 0) => Some(CoordinateGrid::Float32),
            (1, 0) => Some(CoordinateGrid::Millimetre),
            (2, 1..=LARGEST_STEP) => Some(CoordinateGrid::Lattice { step_nm: step.into() }),
            (3, 1..=9) => Some(CoordinateGrid::Digits(step as u8)),
            (4, 0) => Some(CoordinateGrid::Half),
            (5, 1..=30) => Some(CoordinateGrid::Binary(step as u8)),
            _ => None,
        }
    }

    /// About the binary logarithm of the distance, in metres, from a value to the next one on the grid.
    pub fn step_exponent(self, metres: f64) -> i32 {
        let exponent = |value: f64| (value.to_bits() >> 52 & 0x7ff) as i32 - 1023;
        match self {
            CoordinateGrid::Millimetre => -10,
            CoordinateGrid::Lattice { step_nm } => exponent(lattice_step(step_nm)),
            CoordinateGrid::Float32 => exponent(metres).clamp(-126, 127) - 23,
            // A digit has 10 / 3 bits.
            CoordinateGrid::Digits(digits) => exponent(metres).clamp(-126, 127) - i32::from(digits) * 10 / 3,
            CoordinateGrid::Half => exponent(metres).clamp(-126, 127) - 10,
            CoordinateGrid::Binary(places) => -i32::from(places),
        }
    }

    /// The unit nearest to a value of the formula in metres: below 2^40, and 0 for NaN.
    pub fn unit_of(self, metres: f64) -> i64 {
        match self {
            _ if metres.is_nan() => 0,
            CoordinateGrid::Millimetre => round_ties_even((metres * 1000.0).clamp(-1e12, 1e12)) as i64,
            CoordinateGrid::Float32 => rank(metres as f32),
            CoordinateGrid::Lattice { step_nm } => {
                round_ties_even((metres / lattice_step(step_nm)).clamp(-1e12, 1e12)) as i64
            }
            CoordinateGrid::Digits(digits) => decimal_unit(metres, digits),
            CoordinateGrid::Half => half_unit(metres as f32),
            CoordinateGrid::Binary(places) => {
                round_ties_even((metres * steps_per_metre(places)).clamp(-1e12, 1e12)) as i64
            }
        }
    }

    /// The coordinate at `unit`. The millimetre grid has two zeros: the sign is that of `formula`, the value
    /// before rounding.
    pub fn value(self, unit: i64, formula: f64) -> f32 {
        match self {
            CoordinateGrid::Float32 => of_rank(unit),
            _ if unit == 0 => zero_of(formula),
            CoordinateGrid::Millimetre => (unit as f64 / 1000.0) as f32,
            CoordinateGrid::Lattice { step_nm } => (unit as f64 * lattice_step(step_nm)) as f32,
            CoordinateGrid::Digits(digits) => decimal_value(unit, digits),
            CoordinateGrid::Half => half_value(unit),
            CoordinateGrid::Binary(places) => (unit as f64 / steps_per_metre(places)) as f32,
        }
    }

    /// The coordinate nearest to `formula`, in metres: [`value`](Self::value) of [`unit_of`](Self::unit_of).
    #[inline]
    pub fn nearest(self, formula: f64) -> f32 {
        if self == CoordinateGrid::Float32 {
            // The same result without the conversion to a unit.
            return if formula.is_nan() { 0.0 } else { formula as f32 };
        }
        self.value(self.unit_of(formula), formula)
    }

    /// Whether a coordinate of the file is on the grid, and has the sign that [`value`](Self::value) gives if
    /// it is zero.
    #[inline]
    pub fn holds(self, value: f32, formula: f64) -> bool {
        match self {
            // Beyond 1,000 km the grid is finer than float32, and no scanner has such ranges.
            CoordinateGrid::Millimetre => {
                let own = f64::from(value);
                let signed = if value == 0.0 { f64::from(zero_of(formula)) } else { own };
                (nearest_millimetre(own.abs().copysign(signed)).to_bits() == value.to_bits())
                    & (own.abs() < 1e6)
            }
            _ => self.unit_in_file(value).is_some() && (value != 0.0 || self.keeps_zero(value, formula)),
        }
    }

    /// Whether [`holds`](Self::holds) is true for all these values.
    #[inline(always)]
    pub fn holds_all<const N: usize>(self, values: &[f64; N], formula: &[f64; N]) -> bool {
        if self == CoordinateGrid::Millimetre {
            // A shortcut for the most frequent case: values on the grid other than 0, whose sign need not be
            // checked.
            let mut all = true;
            for &value in values {
                let near = (round_ties_even(value * 1000.0) * 0.001) as f32;
                all &= (f64::from(near) == value) & (value != 0.0) & (value.abs() < 1e6);
            }
            if all {
                return true;
            }
        }
        (0..N).all(|i| self.holds(values[i] as f32, formula[i]))
    }

    /// The unit of any float32 on the grid of all float32 values.
    pub fn unit_of_float(value: f32) -> i64 {
        rank(value)
    }

    /// Whether [`value`](Self::value) returns a zero with the sign of this zero.
    fn keeps_zero(self, zero: f32, formula: f64) -> bool {
        match self {
            CoordinateGrid::Float32 => true,
            _ => zero.to_bits() == zero_of(formula).to_bits(),
        }
    }

    /// The unit of a coordinate of the file, if the grid contains exactly that value.
    pub fn unit_in_file(self, value: f32) -> Option<i64> {
        match self {
            CoordinateGrid::Millimetre => {
                // Beyond 1,000 km the grid is finer than float32, and no scanner has such ranges.
                let unit = self.unit_of(f64::from(value));
                let on_grid = value.abs() < 1e6 && (unit as f64 / 1000.0) as f32 == value;
                on_grid.then_some(unit)
            }
            CoordinateGrid::Float32 => value.is_finite().then(|| rank(value)),
            CoordinateGrid::Lattice { .. }
            | CoordinateGrid::Digits(_)
            | CoordinateGrid::Half
            | CoordinateGrid::Binary(_) => {
                let unit = self.unit_of(f64::from(value));
                let near = self.value(unit, f64::from(value));
                (value.is_finite() && near.to_bits() == value.to_bits()).then_some(unit)
            }
        }
    }
}

/// Number of bits of a float32's significand that half precision lacks.
const HALF: u32 = 13;

/// The signed index of the number nearest to a value among the float32 values whose last 13 bits are 0. 0
/// stands for 0 and for values nearer to it than to the least such number.
fn half_unit(value: f32) -> i64 {
    let magnitude = value.to_bits() & (u32::MAX >> 1);
    let unit = i64::from((magnitude + (1 << (HALF - 1))) >> HALF);
    if value.is_sign_negative() { -unit } else { unit }
}

/// The inverse of [`half_unit`], for any integer except 0.
fn half_value(unit: i64) -> f32 {
    let bits = unit.unsigned_abs().min(u64::from(f32::MAX.to_bits() >> HALF)) as u32;
    let value = f32::from_bits(bits << HALF);
    if unit < 0 { -value } else { value }
}

/// The largest step of a lattice in a stream, in nanometres.
const LARGEST_STEP: u32 = 1_000_000_000;

/// Added to decimal exponents, so that those of all float32 values are positive.
const DECIMAL_EXPONENTS: i64 = 46;
/// A bound above the magnitude of all float64 exponents.
const MOST_EXPONENT: i64 = 400;

/// The signed index of the decimal number with `digits` significant digits that is nearest to a value, among
/// all such numbers. 0 stands for 0 and for all values nearer to it than to the least such number.
fn decimal_unit(value: f64, digits: u8) -> i64 {
    let value = if value.is_finite() { value } else { 0.0 };
    let digits = digits.clamp(1, 9);
    let quick = decimal::significant(value.abs(), digits.into());
    let Some((number, exponent)) = quick.or_else(|| written_out(value.abs(), digits)) else { return 0 };
    let least = 10i64.pow(u32::from(digits) - 1);
    let exponent = i64::from(exponent) + DECIMAL_EXPONENTS;
    let number = number as i64;
    if number < least || exponent < 0 {
        return 0;
    }
    let unit = exponent * 9 * least + number - least + 1;
    if value < 0.0 { -unit } else { unit }
}

/// The integer of `digits` digits nearest to a number scaled by a power of ten, and the decimal exponent of
/// the number's first digit.
#[cold]
fn written_out(value: f64, digits: u8) -> Option<(u64, i32)> {
    use std::io::Write;
    let mut text = [0u8; 32];
    let mut rest = &mut text[..];
    // Rounds exact decimal expansions half to even, as C does. The text always fits the buffer.
    write!(rest, "{:.*e}", usize::from(digits) - 1, value).ok()?;
    let length = 32 - rest.len();
    let (mantissa, exponent) = std::str::from_utf8(&text[..length]).ok()?.split_once('e')?;
    let digits = mantissa.bytes().filter(u8::is_ascii_digit);
    let number = digits.fold(0, |number, digit| number * 10 + u64::from(digit - b'0'));
    Some((number, exponent.parse().unwrap_or(0)))
}

/// The inverse of [`decimal_unit`], as float32, for any integer except 0.
fn decimal_value(unit: i64, digits: u8) -> f32 {
    let least = 10u64.pow(u32::from(digits.clamp(1, 9)) - 1);
    let place = unit.unsigned_abs().saturating_sub(1);
    let exponent = ((place / (9 * least)).min(2 * MOST_EXPONENT as u64)) as i64 - DECIMAL_EXPONENTS;
    let number = place % (9 * least) + least;
    let exponent = exponent - i64::from(digits.clamp(1, 9)) + 1;
    let quick = i32::try_from(exponent).ok().and_then(|exponent| decimal::single(number, exponent));
    let value: f32 = quick.unwrap_or_else(|| format!("{number}e{exponent}").parse().unwrap_or(0.0));
    if unit < 0 { -value } else { value }
}

/// The step in metres.
fn lattice_step(step_nm: u64) -> f64 {
    step_nm as f64 * 1e-9
}

/// The bits that it takes to say which `some` of `all` values are of one kind, if their order is random.
fn bits_of_choices(some: usize, all: usize) -> f64 {
    let bits = |part: usize| match part {
        0 => 0.0,
        _ => part as f64 * libm::log2(all as f64 / part as f64),
    };
    bits(some) + bits(all - some)
}

/// The reciprocal of the step of a grid with this many binary places.
fn steps_per_metre(places: u8) -> f64 {
    (1u64 << places.min(63)) as f64
}

/// The millimetre nearest to `formula`, in metres, with the sign kept even for zero: up to 2,000 km the same
/// as [`CoordinateGrid::nearest`], but without a division.
#[inline]
pub fn nearest_millimetre(formula: f64) -> f32 {
    let unit = round_ties_even((formula * 1000.0).clamp(-1e12, 1e12));
    // As a float32 this equals unit / 1000, which up to that distance is at least 1e-13 away from the
    // midpoint between two float32 values.
    let value = (unit * 0.001).copysign(formula) as f32;
    if formula.is_nan() { 0.0 } else { value }
}

/// The zero with the sign of `formula`. NaN counts as positive, because its sign differs between processors.
fn zero_of(formula: f64) -> f32 {
    if !formula.is_nan() && formula.is_sign_negative() { -0.0 } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn float_units_count_the_representable_values() {
        for value in [0.0f32, -0.0, 1.0, -1.5, 1e-40, -3e38, 80.123] {
            let unit = CoordinateGrid::Float32.unit_in_file(value).unwrap();
            assert_eq!(CoordinateGrid::Float32.value(unit, 0.0).to_bits(), value.to_bits());
        }
        assert_eq!(rank(0.0) - rank(-0.0), 1);
        assert_eq!(rank(1.0f32.next_up()) - rank(1.0), 1);
        assert_eq!(CoordinateGrid::Float32.unit_in_file(f32::NAN), None);
    }

    #[test]
    fn half_precision_has_eleven_bits() {
        let half = CoordinateGrid::Half;
        for value in [1.0f32, -1.5, 2047.0, -2046.0, 4094.0, 2f32.powi(-24), 65504.0, 3e38] {
            let value = half.nearest(value.into());
            let unit = half.unit_in_file(value).unwrap();
            assert_eq!(half.value(unit, 0.0), value);
            assert!(value.to_bits().trailing_zeros() >= 13, "{value}");
        }
        for value in [2049.0f32, -4095.0, 0.1, f32::INFINITY, f32::NAN] {
            assert_eq!(half.unit_in_file(value), None, "{value}");
        }
        assert_eq!(half.nearest(2048.9), 2048.0);
        assert_eq!([0.0f32, -0.0].map(|zero| half.unit_in_file(zero)), [Some(0); 2]);
        let values =
            (1..200).map(|i| [0.3711, -0.1373, 0.0117].map(|step| half.nearest(step * f64::from(i))));
        assert_eq!(CoordinateGrid::of_most(&values.collect::<Vec<_>>()), [half; 3]);
    }

    #[test]
    fn the_nearest_millimetre_is_a_thousandth_as_float32() {
        // All values below 300 m, and some up to 2,000 km.
        for unit in (0..300_000).chain((300_000..2_000_000_000).step_by(9_973)) {
            let expected = (f64::from(unit) / 1000.0) as f32;
            assert_eq!(nearest_millimetre(f64::from(unit) / 1000.0 + 1e-4), expected, "{unit}");
        }
    }

    #[test]
    fn the_quick_ways_to_round_and_to_look_agree_with_the_others() {
        let values =
            [0.0, -0.0, 1e-4, -1e-4, 5e-4, -5e-4, 1.0005, -80.1234, 1e9, -1e30, f64::INFINITY, f64::NAN];
        for grid in [
            CoordinateGrid::Millimetre,
            CoordinateGrid::Float32,
            CoordinateGrid::Lattice { step_nm: 20_000_000 },
        ] {
            for formula in values {
                if grid == CoordinateGrid::Millimetre && (formula.abs() < 2e6 || formula.is_nan()) {
                    assert_eq!(
                        nearest_millimetre(formula).to_bits(),
                        grid.nearest(formula).to_bits(),
                        "{formula}"
                    );
                }
                for value in values.map(|value| value as f32) {
                    let holds = grid.unit_in_file(value).is_some()
                        && (value != 0.0 || grid.keeps_zero(value, formula));
                    assert_eq!(grid.holds(value, formula), holds, "{value} near {formula} on {grid:?}");
                    let all = grid.holds_all(&[f64::from(value); 2], &[formula; 2]);
                    assert_eq!(all, holds, "{value} near {formula} on {grid:?}");
                }
            }
        }
    }

    #[test]
    fn decimal_grids_hold_what_text_holds() {
        for digits in 4..=8u8 {
            let grid = CoordinateGrid::Digits(digits);
            let mut last = i64::MIN;
            for value in [
                -3e38f32,
                -12.5,
                -1e-3,
                -1e-44,
                0.0,
                1e-44,
                0.099_999_99,
                0.1,
                9.999_999,
                10.0,
                123.456_79,
                3e38,
            ] {
                let text = format!("{:.*e}", usize::from(digits) - 1, value);
                let near: f32 = text.parse().unwrap();
                let unit = grid.unit_in_file(near).unwrap_or_else(|| panic!("{text} with {digits} digits"));
                assert_eq!(grid.value(unit, f64::from(near)).to_bits(), near.to_bits());
                assert!(unit >= last);
                last = unit;
            }
        }
        let nan = f32::NAN;
        assert_eq!(CoordinateGrid::of([1.234, nan, nan, -2.5, nan].iter()), CoordinateGrid::Millimetre);
        assert_eq!(CoordinateGrid::of([1.0 / 3.0, nan, nan, nan].iter()), CoordinateGrid::Float32);
        assert_eq!(
            CoordinateGrid::finest_of(&[1.5, -20.25]),
            CoordinateGrid::Lattice { step_nm: 10_000_000 }
        );
        let centimetres = CoordinateGrid::finest_of(&[1.25, -0.0, 0.0]);
        assert_eq!(centimetres, CoordinateGrid::Lattice { step_nm: 10_000_000 });
        assert_eq!(centimetres.value(0, -1e-3).to_bits(), (-0.0f32).to_bits());
        assert_eq!(CoordinateGrid::finest_of(&[1.501, -20.25]), CoordinateGrid::Millimetre);
        assert_eq!(CoordinateGrid::finest_of(&[12.3456, -0.012_345_6]), CoordinateGrid::Digits(6));
        let mut neighbours: Vec<f32> = (0..64).map(|i| f32::from_bits(120f32.to_bits() + i)).collect();
        neighbours.push(0.123_456_79);
        assert_eq!(CoordinateGrid::finest_of(&neighbours), CoordinateGrid::Float32);
        assert_eq!(CoordinateGrid::Digits(6).unit_in_file(f32::INFINITY), None);
        for unit in [i64::MIN, i64::MAX, -1, 1] {
            assert!(!CoordinateGrid::Digits(8).value(unit, 0.0).is_nan());
        }
    }

    #[test]
    fn most_points_tell_their_grid() {
        let lattice = |step_nm: u64| CoordinateGrid::Lattice { step_nm };
        let grids =
            [lattice(100_000_000), lattice(10_000_000), lattice(5_000_000), CoordinateGrid::Binary(8)];
        let others = [CoordinateGrid::Millimetre, CoordinateGrid::Digits(5), CoordinateGrid::Float32];
        for grid in grids.into_iter().chain(others) {
            let on_grid = |metres: f64| grid.nearest(metres);
            let angle = |i: i32| f64::from(i) * 0.618_034;
            let far = |i: i32| 3.0 + f64::from(i % 700) * 0.071_3;
            let point = |i: i32| {
                [far(i) * angle(i).cos(), far(i) * angle(i).sin(), far(i) * 0.051_234_567_8].map(on_grid)
            };
            let mut points: Vec<_> = (0..5000).map(point).collect();
            assert_eq!(CoordinateGrid::of_most(&points), [grid; 3]);
            // Nearly all suffice.
            points.iter_mut().step_by(50).for_each(|point| point[0] = f32::NAN);
            points.iter_mut().skip(1).step_by(50).for_each(|point| point[0] = 1.234_567_8);
            assert_eq!(CoordinateGrid::of_most(&points), [grid; 3]);
            let (kind, step) = grid.to_numbers();
            assert_eq!(CoordinateGrid::from_numbers(kind, step), Some(grid));
        }
        // Far from the origin float32 itself is a coarser grid than millimetres.
        let map: Vec<_> = (0..3000).map(|i| [5e5 + 0.37 * i as f32, 4e6, 123.0]).collect();
        assert_eq!(CoordinateGrid::of_most(&map)[0], CoordinateGrid::Float32);
        assert_eq!(CoordinateGrid::of_most(&[]), [CoordinateGrid::Float32; 3]);
        assert_eq!(CoordinateGrid::from_numbers(2, 0), None);
    }

    #[test]
    fn the_millimetre_grid_holds_thousandths_and_both_zeros() {
        let grid = CoordinateGrid::Millimetre;
        for k in (-120_000i64..120_000).step_by(7) {
            let value = (k as f64 / 1000.0) as f32;
            assert_eq!(grid.unit_in_file(value), Some(k));
            assert_eq!(grid.value(k, k as f64), value);
        }
        assert_eq!(grid.unit_in_file(0.001f32.next_up()), None);
        assert_eq!(grid.unit_in_file(f32::INFINITY), None);
        assert_eq!(grid.value(0, -1e-5).to_bits(), (-0.0f32).to_bits());
    }
}

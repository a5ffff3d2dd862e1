//! Values as integers: integer types as they are, floating-point values as multiples of a step if they are
//! such, otherwise as their rank among all floating-point numbers. FORMAT.md 8.9, "Scale".

use byteorder::{ByteOrder, LittleEndian};

use crate::ground::floats::{bits_of_rank32, bits_of_rank64, rank32, rank64, round_ties_even};
use crate::scan::ScalarType;

/// How values become integers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Scale {
    /// 0: integers as they are, floating-point values by their rank among all numbers. Otherwise 1 + 10 * the
    /// number of a form + a decimal exponent; the numbers above these stand for the entries of [`LEVELS`].
    code: u8,
}

const EXPONENTS: u8 = 10;
const FORMS: u8 = 6;
/// Further quotients: the number of levels into which 1 is divided.
const LEVELS: [u32; 4] = [255, 256, 65_535, 65_536];

/// How an integer n becomes a floating-point number.
#[derive(Clone, Copy, Debug)]
enum Form {
    /// n / 10^k, in double precision, then rounded.
    Quotient,
    /// n * 10^-k, in double precision, then rounded.
    Product,
    /// n * (m * 10^-k), both factors and the product in single precision.
    Single(f64),
    /// n / a number of levels, in double precision, then rounded.
    Levels(f64),
    /// n * 10^-k degrees, converted to radians in double precision, then rounded.
    Degrees,
}

impl Scale {
    /// Integers as they are, or floating-point values by their rank among all numbers.
    pub const RANK: Scale = Scale { code: 0 };

    /// The number in the stream.
    pub fn to_code(self) -> u8 {
        self.code
    }

    /// The scale with this number.
    pub fn from_code(code: u8) -> Option<Self> {
        (code <= FORMS * EXPONENTS + LEVELS.len() as u8).then_some(Scale { code })
    }

    /// The scale that suits nearly all of these values best: the coarsest grid on which they lie.
    pub fn of(scalar: ScalarType, values: &[u8]) -> Self {
        /// Approximate number of values that are tested before all are.
        const SAMPLES: usize = 200;
        /// At most one value in this number may lie off the grid.
        const RARE: usize = 64;
        if !scalar.is_float() {
            return Scale::RANK;
        }
        let size = scalar.size() as usize;
        let step = (values.len() / size / SAMPLES).max(1);
        let some = values.chunks_exact(size).step_by(step).collect::<Vec<_>>().concat();
        let suits = |scale: Scale, values: &[u8]| {
            let most = values.len() / size / RARE;
            scale.grid(scalar).misses(values, most) <= most
        };
        let highest = match scalar {
            ScalarType::F32 => {
                highest(values.as_chunks().0.iter().map(|value| f32::from_le_bytes(*value).into()))
            }
            _ => highest(values.as_chunks().0.iter().map(|value| f64::from_le_bytes(*value))),
        };
        let resolution = highest * if scalar == ScalarType::F32 { 1.2e-7 } else { 2.3e-16 };
        let mut scales: Vec<Scale> =
            (1..=FORMS * EXPONENTS + LEVELS.len() as u8).map(|code| Scale { code }).collect();
        scales.retain(|scale| scale.step() > resolution);
        scales.sort_by(|a, b| b.step().total_cmp(&a.step()));
        scales.into_iter().find(|&scale| suits(scale, &some) && suits(scale, values)).unwrap_or(Scale::RANK)
    }

    fn form(self) -> Option<(Form, i32)> {
        let code = self.code.checked_sub(1)?;
        if let Some(levels) = code.checked_sub(FORMS * EXPONENTS).and_then(|at| LEVELS.get(usize::from(at))) {
            return Some((Form::Levels(f64::from(*levels)), 0));
        }
        let form = match code / EXPONENTS {
            0 => Form::Quotient,
            1 => Form::Product,
            2 => Form::Single(1.0),
            3 => Form::Single(5.0),
            4 => Form::Single(25.0),
            _ => Form::Degrees,
        };
        Some((form, i32::from(code % EXPONENTS)))
    }

    /// The value of one step.
    pub fn step(self) -> f64 {
        match self.form() {
            None => 1.0,
            Some((Form::Quotient | Form::Product, exponent)) => 1.0 / power(exponent),
            Some((Form::Levels(levels), _)) => 1.0 / levels,
            Some((Form::Single(factor), exponent)) => factor / power(exponent),
            Some((Form::Degrees, exponent)) => 1.0 / power(exponent) * (std::f64::consts::PI / 180.0),
        }
    }

    /// The values of a type on this scale.
    pub fn grid(self, scalar: ScalarType) -> NumberGrid {
        let (form, exponent) = self.form().map_or((None, 0), |(form, exponent)| (Some(form), exponent));
        NumberGrid { scalar, form, power: power(exponent), step: self.step() }
    }
}

/// The values of a type on a [`Scale`].
#[derive(Clone, Copy, Debug)]
pub struct NumberGrid {
    scalar: ScalarType,
    form: Option<Form>,
    /// 10^k.
    power: f64,
    step: f64,
}

impl NumberGrid {
    /// The integer of a value; `None` if the value is off the grid.
    #[inline]
    pub fn integer(&self, value: &[u8]) -> Option<i64> {
        self.integer_of(self.scalar, value)
    }

    /// [`integer`](Self::integer) of a value of the type of the grid.
    #[inline(always)]
    fn integer_of(&self, scalar: ScalarType, value: &[u8]) -> Option<i64> {
        let Some(form) = self.form else { return Some(rank(scalar, value)) };
        let number = number(scalar, value);
        let count = rounded(number / self.step);
        // Larger integers are not exact, and NaN has none.
        if !count.is_finite() || count.abs() >= 9e15 {
            return None;
        }
        let integer = count as i64;
        let again = self.number_of(form, integer);
        let is_same = match scalar {
            ScalarType::F32 => (again as f32).to_bits() == (number as f32).to_bits(),
            _ => again.to_bits() == number.to_bits(),
        };
        is_same.then_some(integer)
    }

    /// Passes the integer of each value to `take`, until that refuses one.
    #[inline(always)]
    fn each(&self, values: &[u8], mut take: impl FnMut(Option<i64>) -> bool) {
        // The loop is compiled for each of the most common types.
        match self.scalar {
            ScalarType::U8 => {
                values.chunks_exact(1).all(|value| take(self.integer_of(ScalarType::U8, value)))
            }
            ScalarType::U16 => {
                values.chunks_exact(2).all(|value| take(self.integer_of(ScalarType::U16, value)))
            }
            ScalarType::F32 => {
                values.chunks_exact(4).all(|value| take(self.integer_of(ScalarType::F32, value)))
            }
            ScalarType::F64 => {
                values.chunks_exact(8).all(|value| take(self.integer_of(ScalarType::F64, value)))
            }
            scalar => values.chunks_exact(scalar.size() as usize).all(|value| take(self.integer(value))),
        };
    }

    /// The integer of each of these values; `None` for those off the grid.
    pub fn integers(&self, values: &[u8]) -> Vec<Option<i64>> {
        let mut integers = Vec::with_capacity(values.len() / self.scalar.size() as usize);
        self.each(values, |integer| {
            integers.push(integer);
            true
        });
        integers
    }

    /// The number of these values that are off the grid, counted up to `most` + 1.
    fn misses(&self, values: &[u8], most: usize) -> usize {
        let mut misses = 0;
        self.each(values, |integer| {
            misses += usize::from(integer.is_none());
            misses <= most
        });
        misses
    }

    /// Whether some of these values are off the grid.
    pub fn misses_any(&self, values: &[u8]) -> bool {
        self.form.is_some() && self.misses(values, 0) > 0
    }

    /// Writes the value of an integer.
    #[inline]
    pub fn write(&self, integer: i64, value: &mut [u8]) {
        let Some(form) = self.form else { return write_rank(self.scalar, integer, value) };
        let number = self.number_of(form, integer);
        match self.scalar {
            ScalarType::F32 => LittleEndian::write_f32(value, number as f32),
            _ => LittleEndian::write_f64(value, number),
        }
    }

    /// The number that an integer stands for, before it is rounded to the type.
    #[inline(always)]
    fn number_of(&self, form: Form, integer: i64) -> f64 {
        let count = integer as f64;
        match form {
            Form::Quotient => count / self.power,
            Form::Product => count * (1.0 / self.power),
            Form::Levels(levels) => count / levels,
            Form::Single(factor) => f64::from(count as f32 * (factor / self.power) as f32),
            Form::Degrees => count * (1.0 / self.power) * std::f64::consts::PI / 180.0,
        }
    }

    /// The integer nearest to a number.
    pub fn nearest(&self, number: f64) -> i64 {
        match (self.form, self.scalar) {
            // Processors differ in the bits of a NaN that they compute.
            _ if number.is_nan() => 0,
            (None, ScalarType::F32) => rank32((number as f32).to_bits()),
            (None, ScalarType::F64) => rank64(number.to_bits()),
            _ => rounded(number / self.step) as i64,
        }
    }
}

/// The highest magnitude of the finite numbers, at least 0.
#[inline(always)]
fn highest(numbers: impl Iterator<Item = f64>) -> f64 {
    numbers.map(f64::abs).filter(|number| number.is_finite()).fold(0.0, f64::max)
}

/// The nearest whole number, halves to even.
#[inline]
fn rounded(value: f64) -> f64 {
    const MOST: f64 = (1u64 << 51) as f64;
    if value.abs() < MOST { round_ties_even(value) } else { libm::rint(value) }
}

/// 10^k; exact.
fn power(exponent: i32) -> f64 {
    (0..exponent).fold(1.0, |power, _| power * 10.0)
}

/// The value as a number.
pub fn number(scalar: ScalarType, value: &[u8]) -> f64 {
    match scalar {
        ScalarType::F32 => LittleEndian::read_f32(value).into(),
        ScalarType::F64 => LittleEndian::read_f64(value),
        ScalarType::U64 => LittleEndian::read_u64(value) as f64,
        _ => rank(scalar, value) as f64,
    }
}

/// Writes the value of a type that is nearest to a number.
pub fn write_number(scalar: ScalarType, number: f64, value: &mut [u8]) {
    match scalar {
        // Processors differ in the bits of a NaN that is converted to another precision.
        ScalarType::F32 if number.is_nan() => LittleEndian::write_u32(value, 0x7fc0_0000),
        ScalarType::F64 if number.is_nan() => LittleEndian::write_u64(value, 0x7ff8_0000_0000_0000),
        ScalarType::F32 => LittleEndian::write_f32(value, number as f32),
        ScalarType::F64 => LittleEndian::write_f64(value, number),
        ScalarType::U64 => LittleEndian::write_u64(value, number as u64),
        _ => write_rank(scalar, number as i64, value),
    }
}

/// An integer as it is; a floating-point value as its rank among all numbers, 0 being the rank of 0.
#[inline(always)]
fn rank(scalar: ScalarType, value: &[u8]) -> i64 {
    match scalar {
        ScalarType::F32 => rank32(LittleEndian::read_u32(value)),
        ScalarType::F64 => rank64(LittleEndian::read_u64(value)),
        ScalarType::U8 => value[0].into(),
        ScalarType::I8 => (value[0] as i8).into(),
        ScalarType::U16 => LittleEndian::read_u16(value).into(),
        ScalarType::I16 => LittleEndian::read_i16(value).into(),
        ScalarType::U32 => LittleEndian::read_u32(value).into(),
        ScalarType::I32 => LittleEndian::read_i32(value).into(),
        ScalarType::U64 | ScalarType::I64 => LittleEndian::read_i64(value),
    }
}

/// The inverse of [`rank`].
#[inline]
fn write_rank(scalar: ScalarType, rank: i64, value: &mut [u8]) {
    let bits = match scalar {
        ScalarType::F32 => u64::from(bits_of_rank32(rank)),
        ScalarType::F64 => bits_of_rank64(rank),
        _ => rank as u64,
    };
    // Copies of a size known at compile time are single moves.
    match scalar.size() {
        1 => value[0] = bits as u8,
        2 => LittleEndian::write_u16(value, bits as u16),
        4 => LittleEndian::write_u32(value, bits as u32),
        _ => LittleEndian::write_u64(value, bits),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn singles(values: impl Iterator<Item = f32>) -> Vec<u8> {
        values.flat_map(f32::to_le_bytes).collect()
    }

    #[test]
    fn grids_are_found() {
        let n = || (0..1000u32).map(|n| f64::from(n * 7 % 1001));
        let find = |value: &dyn Fn(f64) -> f32| Scale::of(ScalarType::F32, &singles(n().map(value))).step();
        assert_eq!(find(&|n| n as f32), 1.0);
        assert_eq!(find(&|n| (n / 100.0) as f32), 0.01);
        assert_eq!(find(&|n| n as f32 * 0.0025f32), 0.0025);
        assert!((find(&|n| (n * 0.01 * std::f64::consts::PI / 180.0) as f32) - 1.745e-4).abs() < 1e-6);
        let times: Vec<u8> = n().flat_map(|n| ((1.6e15 + n) / 1e6).to_le_bytes()).collect();
        assert_eq!(Scale::of(ScalarType::F64, &times).step(), 1e-6);
        let rough = singles((1..1000).map(|n| libm::sqrtf(n as f32)));
        assert_eq!(Scale::of(ScalarType::F32, &rough), Scale::RANK);
    }

    proptest! {
        #[test]
        fn every_value_has_a_rank(bits: u64, number in 0usize..10) {
            let scalar = ScalarType::from_number(number as u8).unwrap();
            let value = &bits.to_le_bytes()[..scalar.size() as usize];
            let mut again = [0; 8];
            write_rank(scalar, rank(scalar, value), &mut again);
            prop_assert_eq!(&again[..value.len()], value);
        }

        #[test]
        fn what_is_on_a_grid_comes_back(bits: u64, small in -1000i64..1000, code in 0u8..=64, double: bool) {
            let scalar = if double { ScalarType::F64 } else { ScalarType::F32 };
            let grid = Scale::from_code(code).unwrap().grid(scalar);
            let size = scalar.size() as usize;
            let mut value = bits.to_le_bytes();
            if bits % 3 > 0 {
                grid.write(small, &mut value);
            }
            if let Some(integer) = grid.integer(&value[..size]) {
                let mut again = [0; 8];
                grid.write(integer, &mut again);
                prop_assert_eq!(&again[..size], &value[..size]);
            }
            grid.nearest(f64::from_bits(bits));
        }

        #[test]
        fn ranks_are_in_order(a: f32, b: f32) {
            let (a, b) = if a < b { (a, b) } else { (b, a) };
            // NaN has no rank in this order, and zeros of both signs have the same.
            if a >= b || a.is_nan() || b.is_nan() {
                return Ok(());
            }
            prop_assert!(rank32(a.to_bits()) < rank32(b.to_bits()));
            prop_assert!(rank64(f64::from(a).to_bits()) < rank64(f64::from(b).to_bits()));
        }
    }
}

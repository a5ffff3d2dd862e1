//! Formulas on several float64 values side by side. A formula that is generic over [`Real`] is written once
//! for single values, for arrays and for vectors, with the same results. Arrays leave the choice of vectors to
//! the compiler, which sometimes forms them of unlike values, such as x and y of one point, and then spends
//! its time on permuting them; [`Doubles`] names the vectors.

use std::ops::{Add, BitAnd, Div, Mul, Sub};

use pulp::{Simd, bytemuck};

use super::floats;
use super::lanes::lanes;

/// What formulas compute with: a float64 value or several.
pub trait Real:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Add<f64, Output = Self>
    + Sub<f64, Output = Self>
    + Mul<f64, Output = Self>
{
    /// The square root.
    fn sqrt(self) -> Self;

    /// The nearest whole number, halves to even; for magnitudes below 2^51.
    #[inline(always)]
    fn round_ties_even(self) -> Self {
        self + floats::ONES - floats::ONES
    }
}

/// [`Real`] values that can be compared, so that formulas choose between results instead of branching.
pub trait Choose: Real {
    /// What holds for which of the values.
    type Mask: Copy + BitAnd<Output = Self::Mask>;

    /// Copies of one value, as many as this has.
    fn splat(self, value: f64) -> Self;

    /// The magnitudes.
    fn abs(self) -> Self;

    /// These magnitudes, with the signs of other values.
    fn copysign(self, signs: Self) -> Self;

    /// Where the values are less than others, or equal; nowhere for NaN.
    fn is_at_most(self, other: Self) -> Self::Mask;

    /// Where the values are less than `most`; nowhere for NaN.
    fn is_below(self, most: f64) -> Self::Mask;

    /// Where the values are more than `least`; nowhere for NaN.
    fn is_above(self, least: f64) -> Self::Mask;

    /// The first values where the mask holds, the second ones elsewhere.
    fn select(mask: Self::Mask, holds: Self, elsewhere: Self) -> Self;

    /// Whether it holds for any.
    fn any(mask: Self::Mask) -> bool;

    /// A function of each value.
    fn map(self, function: impl Fn(f64) -> f64) -> Self;
}

impl Real for f64 {
    #[inline(always)]
    fn sqrt(self) -> f64 {
        f64::sqrt(self)
    }
}

impl Choose for f64 {
    type Mask = bool;

    #[inline(always)]
    fn splat(self, value: f64) -> f64 {
        value
    }

    #[inline(always)]
    fn abs(self) -> f64 {
        f64::abs(self)
    }

    #[inline(always)]
    fn copysign(self, signs: f64) -> f64 {
        f64::copysign(self, signs)
    }

    #[inline(always)]
    fn is_at_most(self, other: f64) -> bool {
        self <= other
    }

    #[inline(always)]
    fn is_below(self, most: f64) -> bool {
        self < most
    }

    #[inline(always)]
    fn is_above(self, least: f64) -> bool {
        self > least
    }

    #[inline(always)]
    fn select(mask: bool, holds: f64, elsewhere: f64) -> f64 {
        if mask { holds } else { elsewhere }
    }

    #[inline(always)]
    fn any(mask: bool) -> bool {
        mask
    }

    #[inline(always)]
    fn map(self, function: impl Fn(f64) -> f64) -> f64 {
        function(self)
    }
}

/// `N` float64 values, the choice of whose vectors is left to the compiler.
#[derive(Clone, Copy)]
pub struct Array<const N: usize>(pub [f64; N]);

impl<const N: usize> Real for Array<N> {
    #[inline(always)]
    fn sqrt(self) -> Self {
        Array(lanes(|i| self.0[i].sqrt()))
    }
}

/// As many float64 values as a vector of `S` holds.
#[derive(Clone, Copy)]
pub struct Doubles<S: Simd> {
    simd: S,
    values: S::f64s,
}

/// What holds for which of [`Doubles`].
#[derive(Clone, Copy)]
pub struct Mask<S: Simd> {
    simd: S,
    values: S::m64s,
}

impl<S: Simd> Doubles<S> {
    /// A vector whose lanes are computed one by one. To fill an array first and load that would be slower: the
    /// processor waits until all values are in the cache.
    #[inline(always)]
    pub fn of(simd: S, value: impl Fn(usize) -> f64) -> Self {
        let mut values = simd.splat_f64s(0.0);
        let lanes: &mut [f64] = bytemuck::cast_slice_mut(std::slice::from_mut(&mut values));
        for (lane, place) in lanes.iter_mut().enumerate() {
            *place = value(lane);
        }
        Doubles { simd, values }
    }

    /// The vector number `part` of an array, whose length must be a multiple of that of a vector.
    #[inline(always)]
    pub fn load<const N: usize>(simd: S, values: &[f64; N], part: usize) -> Self {
        const { assert!(N.is_multiple_of(S::F64_LANES)) };
        Doubles { simd, values: S::as_simd_f64s(values).0[part] }
    }

    /// Writes to the vector number `part` of an array.
    #[inline(always)]
    pub fn store<const N: usize>(self, values: &mut [f64; N], part: usize) {
        const { assert!(N.is_multiple_of(S::F64_LANES)) };
        S::as_mut_simd_f64s(values).0[part] = self.values;
    }
}

impl<S: Simd> Real for Doubles<S> {
    #[inline(always)]
    fn sqrt(self) -> Self {
        Doubles { values: self.simd.sqrt_f64s(self.values), ..self }
    }
}

impl<S: Simd> Choose for Doubles<S> {
    type Mask = Mask<S>;

    #[inline(always)]
    fn splat(self, value: f64) -> Self {
        Doubles { values: self.simd.splat_f64s(value), ..self }
    }

    #[inline(always)]
    fn abs(self) -> Self {
        Doubles { values: self.simd.abs_f64s(self.values), ..self }
    }

    #[inline(always)]
    fn copysign(self, signs: Self) -> Self {
        let Doubles { simd, values } = self;
        let sign = simd.splat_f64s(-0.0);
        let magnitude = simd.and_f64s(simd.not_f64s(sign), values);
        Doubles { values: simd.or_f64s(magnitude, simd.and_f64s(sign, signs.values)), ..self }
    }

    #[inline(always)]
    fn is_at_most(self, other: Self) -> Mask<S> {
        let Doubles { simd, values } = self;
        Mask { simd, values: simd.less_than_or_equal_f64s(values, other.values) }
    }

    #[inline(always)]
    fn is_below(self, most: f64) -> Mask<S> {
        let Doubles { simd, values } = self;
        Mask { simd, values: simd.less_than_f64s(values, simd.splat_f64s(most)) }
    }

    #[inline(always)]
    fn is_above(self, least: f64) -> Mask<S> {
        let Doubles { simd, values } = self;
        Mask { simd, values: simd.less_than_f64s(simd.splat_f64s(least), values) }
    }

    #[inline(always)]
    fn select(mask: Mask<S>, holds: Self, elsewhere: Self) -> Self {
        Doubles { values: holds.simd.select_f64s(mask.values, holds.values, elsewhere.values), ..holds }
    }

    #[inline(always)]
    fn any(mask: Mask<S>) -> bool {
        let Mask { simd, values } = mask;
        let ones = simd.select_f64s(values, simd.splat_f64s(1.0), simd.splat_f64s(0.0));
        simd.reduce_max_f64s(ones) > 0.0
    }

    #[inline(always)]
    fn map(self, function: impl Fn(f64) -> f64) -> Self {
        let Doubles { simd, mut values } = self;
        let lanes: &mut [f64] = bytemuck::cast_slice_mut(std::slice::from_mut(&mut values));
        lanes.iter_mut().for_each(|value| *value = function(*value));
        Doubles { simd, values }
    }
}

impl<S: Simd> Mask<S> {
    /// Whether it holds for all.
    #[inline(always)]
    pub fn all(self) -> bool {
        let Mask { simd, values } = self;
        let ones = simd.select_f64s(values, simd.splat_f64s(1.0), simd.splat_f64s(0.0));
        simd.reduce_min_f64s(ones) > 0.0
    }
}

impl<S: Simd> BitAnd for Mask<S> {
    type Output = Self;

    #[inline(always)]
    fn bitand(self, other: Self) -> Self {
        Mask { values: self.simd.and_m64s(self.values, other.values), ..self }
    }
}

/// Implements an operator, between vectors and with a value on the right.
macro_rules! operator {
    ($operator:ident, $function:ident, $of_vectors:ident) => {
        impl<const N: usize> $operator for Array<N> {
            type Output = Self;

            #[inline(always)]
            fn $function(self, other: Self) -> Self {
                Array(lanes(|i| self.0[i].$function(other.0[i])))
            }
        }

        impl<const N: usize> $operator<f64> for Array<N> {
            type Output = Self;

            #[inline(always)]
            fn $function(self, other: f64) -> Self {
                Array(lanes(|i| self.0[i].$function(other)))
            }
        }

        impl<S: Simd> $operator for Doubles<S> {
            type Output = Self;

            #[inline(always)]
            fn $function(self, other: Self) -> Self {
                Doubles { values: self.simd.$of_vectors(self.values, other.values), ..self }
            }
        }

        impl<S: Simd> $operator<f64> for Doubles<S> {
            type Output = Self;

            #[inline(always)]
            fn $function(self, other: f64) -> Self {
                let other = self.simd.splat_f64s(other);
                Doubles { values: self.simd.$of_vectors(self.values, other), ..self }
            }
        }
    };
}

operator!(Add, add, add_f64s);
operator!(Sub, sub, sub_f64s);
operator!(Mul, mul, mul_f64s);
operator!(Div, div, div_f64s);

#[cfg(test)]
mod tests {
    use pulp::WithSimd;

    use super::*;
    use crate::ground::angle;
    use crate::ground::lanes::dispatch;

    const N: usize = 8;
    const VALUES: [f64; N] = [0.0, -0.5, 1.5, 2.5, -7.25, 1e9 + 0.1, f64::INFINITY, f64::NAN];

    fn formula<V: Real>(x: V, y: V) -> V {
        ((x * y - 2.0) / (x + 3.0) + y * 0.1).sqrt() - x.round_ties_even()
    }

    /// The formula for the values and their reverse, and for which values all comparisons hold.
    struct Formula;

    impl WithSimd for Formula {
        type Output = ([f64; N], [bool; N]);

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
            let reverse: [f64; N] = std::array::from_fn(|i| VALUES[N - 1 - i]);
            let mut results = [0.0; N];
            for part in 0..N / S::F64_LANES {
                let [x, y] = [&VALUES, &reverse].map(|values| Doubles::load(simd, values, part));
                formula(x, y).store(&mut results, part);
            }
            let holds = VALUES.map(|value| {
                let x = Doubles::load(simd, &[value; N], 0);
                (x.is_above(-1.0) & x.is_below(2.5)).all() && !x.abs().is_above(1.0).all()
            });
            (results, holds)
        }
    }

    #[test]
    fn vectors_give_what_single_values_give() {
        let singly: [f64; N] = std::array::from_fn(|i| formula(VALUES[i], VALUES[N - 1 - i]));
        let bits = |values: [f64; N]| values.map(|v| if v.is_nan() { 0 } else { v.to_bits() });
        assert!(singly.iter().any(|value| value.is_finite()));
        let reverse: [f64; N] = std::array::from_fn(|i| VALUES[N - 1 - i]);
        assert_eq!(bits(formula(Array(VALUES), Array(reverse)).0), bits(singly));
        for (results, holds) in [dispatch(Formula), Formula.with_simd(pulp::Scalar::new())] {
            assert_eq!(bits(results), bits(singly));
            assert_eq!(holds, [true, true, false, false, false, false, false, false]);
        }
    }

    /// Of two values, what formulas choose: some of it through each function of [`Choose`].
    fn chosen<V: Choose>(x: V, y: V) -> [V; 3] {
        let less = V::select(x.is_at_most(y), x.copysign(y), y.abs());
        let near = V::select(x.is_above(-1.0) & y.is_below(2.0), x.splat(7.0), x.map(|value| 3.0 * value));
        [less, near, angle::atan2(y, x)]
    }

    /// The choices for each pair of [`VALUES`], and whether any of the values is above 2 and above infinity.
    struct Chosen;

    impl WithSimd for Chosen {
        type Output = (Vec<[f64; N]>, [bool; 2]);

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
            let mut results = vec![[0.0; N]; 3 * N];
            let mut any = [false; 2];
            for part in 0..N / S::F64_LANES {
                let x = Doubles::load(simd, &VALUES, part);
                any[0] |= Doubles::any(x.is_above(2.0));
                any[1] |= Doubles::any(x.is_above(f64::INFINITY));
                for (turn, results) in results.chunks_exact_mut(3).enumerate() {
                    let y = Doubles::of(simd, |i| VALUES[(part * S::F64_LANES + i + turn) % N]);
                    let values = chosen(x, y);
                    (0..3).for_each(|i| values[i].store(&mut results[i], part));
                }
            }
            (results, any)
        }
    }

    #[test]
    fn vectors_choose_as_single_values_do() {
        let bits = |value: f64| if value.is_nan() { 0 } else { value.to_bits() };
        for (results, any) in [dispatch(Chosen), Chosen.with_simd(pulp::Scalar::new())] {
            assert_eq!(any, [true, false]);
            for (turn, results) in results.chunks_exact(3).enumerate() {
                for i in 0..N {
                    let singly = chosen(VALUES[i], VALUES[(i + turn) % N]);
                    let found = [0, 1, 2].map(|result| results[result][i]);
                    assert_eq!(found.map(bits), singly.map(bits), "{} {turn}", VALUES[i]);
                }
            }
        }
    }

    /// Whether each mask of one wrong value holds for all.
    struct OneWrong;

    impl WithSimd for OneWrong {
        type Output = bool;

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> bool {
            (0..S::F64_LANES).any(|wrong| {
                let values: [f64; N] = std::array::from_fn(|i| if i == wrong { 1.0 } else { 0.0 });
                Doubles::load(simd, &values, 0).is_below(1.0).all()
            })
        }
    }

    #[test]
    fn one_wrong_value_is_seen() {
        assert!(!dispatch(OneWrong));
    }
}

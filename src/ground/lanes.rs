//! Computation on several values side by side, as in vector units, and the choice of the vector unit.

use std::sync::atomic::{AtomicBool, Ordering};

use pulp::{Arch, Scalar, WithSimd};

/// Whether this process is restricted to instructions that every processor of the target has.
static IS_PLAIN: AtomicBool = AtomicBool::new(false);

/// From now on, code compiled for optional vector units is not used in this process. The results are the
/// same: `verify --deep` confirms it.
#[cfg(feature = "cli")]
pub fn keep_to_plain_code() {
    IS_PLAIN.store(true, Ordering::Relaxed);
}

/// Runs a function compiled for several vector units, in the version for the widest that this processor has.
pub fn dispatch<F: WithSimd>(function: F) -> F::Output {
    match IS_PLAIN.load(Ordering::Relaxed) {
        true => function.with_simd(Scalar::new()),
        false => Arch::new().dispatch(function),
    }
}

/// An array with one value for each lane. Unlike `std::array::from_fn`, it is compiled for the vector unit of
/// its caller.
#[inline(always)]
pub fn lanes<T: Copy + Default, const N: usize>(value: impl Fn(usize) -> T) -> [T; N] {
    let mut values = [T::default(); N];
    for lane in 0..N {
        values[lane] = value(lane);
    }
    values
}

/// Number of values that a vector unit of any processor computes with at once.
pub const LANES: usize = 4;

/// `start` plus the products, lane by lane: in the same order on every processor.
#[inline(always)]
pub fn sum_of_products<const N: usize>(start: f32, a: &[f32; N], b: &[f32; N]) -> f32 {
    let mut sums = [0.0; LANES];
    sums[0] = start;
    for i in 0..N {
        sums[i % LANES] += a[i] * b[i];
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3])
}

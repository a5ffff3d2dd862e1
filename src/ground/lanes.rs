//! Several values side by side, as vector units compute them, and which unit computes.

use std::sync::atomic::{AtomicBool, Ordering};

use pulp::{Arch, NullaryFnOnce};

/// Whether this process keeps to the instructions that every processor of its kind has.
static IS_PLAIN: AtomicBool = AtomicBool::new(false);

/// From now on, nothing in this process is computed by code made for a vector unit that not every processor has. The
/// results are the same: `verify --deep` shows it.
#[cfg(feature = "cli")]
pub fn keep_to_plain_code() {
    IS_PLAIN.store(true, Ordering::Relaxed);
}

/// Runs a function that is compiled for several vector units: for the widest that this processor has.
pub fn dispatch<F: NullaryFnOnce>(function: F) -> F::Output {
    if IS_PLAIN.load(Ordering::Relaxed) { function.call() } else { Arch::new().dispatch(function) }
}

/// One value for each lane. Unlike `std::array::from_fn`, this is compiled for the vector unit of its caller.
#[inline(always)]
pub fn lanes<T: Copy + Default, const N: usize>(value: impl Fn(usize) -> T) -> [T; N] {
    let mut values = [T::default(); N];
    for lane in 0..N {
        values[lane] = value(lane);
    }
    values
}

//! Several values side by side, as vector units compute them.

/// One value for each lane. Unlike `std::array::from_fn`, this is compiled for the vector unit of its caller.
#[inline(always)]
pub fn lanes<T: Copy + Default, const N: usize>(value: impl Fn(usize) -> T) -> [T; N] {
    let mut values = [T::default(); N];
    for lane in 0..N {
        values[lane] = value(lane);
    }
    values
}

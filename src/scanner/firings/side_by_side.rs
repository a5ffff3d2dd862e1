//! The positions of many returns in the frame of the scanner, several at a time in vector units: by the
//! [arithmetic](super::arithmetic) of the recipes of most scanners. FORMAT.md 3.3.

use pulp::{Simd, WithSimd};

use super::arithmetic::{Arithmetic, Directions, Double, Near, Single, TurnTable};
use crate::ground::doubles::Doubles;
use crate::ground::lanes::{dispatch, lanes};
use crate::ground::lazy_table::{BLOCK, LazyTable};
use crate::scanner::Return;

/// Number of returns at a time.
const N: usize = 8;

/// The positions of returns by [`Arithmetic::position`], with 0 in place of what is not a number.
pub(super) fn positions(
    lasers: &[Arithmetic],
    turn: &TurnTable,
    returns: &[Return],
    range_step_um: u32,
) -> Vec<[f32; 3]> {
    let step = f64::from(range_step_um) * 1e-6;
    let exactly = |found: &Return| {
        lasers[found.row as usize].position(turn, found.tick, found.steps, range_step_um).map(or_zero)
    };
    let singles = lasers.iter().map(|laser| match laser {
        Arithmetic::Single(single) if !single.is_turned && !single.in_double => Some(single),
        _ => None,
    });
    let doubles = lasers.iter().map(|laser| match laser {
        Arithmetic::Double(double) => Some(double),
        _ => None,
    });
    if let (Some(lasers), TurnTable::Tables(table)) = (singles.collect(), turn) {
        return dispatch(Filling { returns, step, formula: InSingle { lasers, table }, exactly });
    }
    if let (Some(lasers), TurnTable::Degrees(_, table)) = (doubles.collect(), turn) {
        return dispatch(Filling { returns, step, formula: InDouble { lasers, table }, exactly });
    }
    returns.iter().map(exactly).collect()
}

/// The formula of a recipe, and what it uses of each laser and tick.
trait Formula {
    /// Computes the positions of returns; `step` is one range step in metres. Returns whether they are right:
    /// otherwise they must be computed one by one.
    fn fill<S: Simd>(&self, simd: S, returns: &[Return; N], step: f64, positions: &mut [[f32; 3]; N])
    -> bool;
}

/// The computation of all positions, as a type so that it can be compiled for several vector units.
struct Filling<'a, F, E> {
    returns: &'a [Return],
    step: f64,
    formula: F,
    /// The position of one return.
    exactly: E,
}

impl<F: Formula, E: Fn(&Return) -> [f32; 3]> WithSimd for Filling<'_, F, E> {
    type Output = Vec<[f32; 3]>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Vec<[f32; 3]> {
        let mut positions = vec![[0.0; 3]; self.returns.len()];
        let (blocks, rest) = self.returns.as_chunks::<N>();
        let (filled, last) = positions.as_chunks_mut::<N>();
        for (returns, positions) in blocks.iter().zip(filled) {
            if !self.formula.fill(simd, returns, self.step, positions) {
                one_by_one(returns, &self.exactly, positions);
            }
        }
        one_by_one(rest, &self.exactly, last);
        positions
    }
}

/// Computes positions of returns; not compiled for each vector unit.
#[inline(never)]
fn one_by_one(returns: &[Return], exactly: impl Fn(&Return) -> [f32; 3], positions: &mut [[f32; 3]]) {
    returns.iter().zip(positions).for_each(|(found, position)| *position = exactly(found));
}

/// A recipe in single precision.
struct InSingle<'a> {
    lasers: Vec<&'a Single>,
    table: &'a LazyTable<[f32; 2]>,
}

impl Formula for InSingle<'_> {
    #[inline(always)]
    fn fill<S: Simd>(&self, _: S, returns: &[Return; N], step: f64, positions: &mut [[f32; 3]; N]) -> bool {
        let ticks: [u32; N] = lanes(|i| returns[i].tick);
        let Some(table) = self.table.block_of(&ticks) else { return false };
        let mut lasers = [self.lasers[returns[0].row as usize]; N];
        for i in 1..N {
            lasers[i] = self.lasers[returns[i].row as usize];
        }
        let of_tick = |i: usize| &table[ticks[i] as usize % BLOCK];
        let turned = [lanes(|i| of_tick(i)[0]), lanes(|i| of_tick(i)[1])];
        let metres: [f32; N] = lanes(|i| returns[i].steps as f32 * step as f32);
        let [x, y, z] = Single::positions(&lasers, turned, metres);
        for i in 0..N {
            positions[i] = [or_zero(x[i]), or_zero(-y[i]), or_zero(z[i])];
        }
        true
    }
}

/// A recipe in double precision.
struct InDouble<'a> {
    lasers: Vec<&'a Double>,
    table: &'a LazyTable<[f64; 2]>,
}

impl Formula for InDouble<'_> {
    #[inline(always)]
    fn fill<S: Simd>(
        &self,
        simd: S,
        returns: &[Return; N],
        step: f64,
        positions: &mut [[f32; 3]; N],
    ) -> bool {
        let ticks: [u32; N] = lanes(|i| returns[i].tick);
        let (Some(table), Some(first)) = (self.table.block_of(&ticks), self.lasers.first()) else {
            return false;
        };
        // The least and the greatest that x and y may be.
        let (mut x, mut y, mut z) = ([[0.0; N]; 2], [[0.0; N]; 2], [0.0; N]);
        for part in 0..N / S::F64_LANES {
            let at = |lane: usize| &returns[part * S::F64_LANES + lane];
            let of_tick = |value: usize| Doubles::of(simd, |i| table[at(i).tick as usize % BLOCK][value]);
            let of_laser =
                |value: fn(&Double) -> f64| Doubles::of(simd, |i| value(self.lasers[at(i).row as usize]));
            let directions = Directions {
                cos_v: of_laser(|laser| laser.cos_v),
                sin_v: of_laser(|laser| laser.sin_v),
                offset: [of_laser(|laser| laser.offsets[0]), of_laser(|laser| laser.offsets[1])],
            };
            let metres = match first.single_range {
                true => Doubles::of(simd, |i| f64::from(at(i).steps as f32 * step as f32)),
                false => Doubles::of(simd, |i| f64::from(at(i).steps)) * step,
            };
            let Near { point, error, has_signs } =
                directions.nearly(first.axes, [of_tick(0), of_tick(1)], metres);
            if !has_signs.all() {
                return false;
            }
            (point[0] - error).store(&mut x[0], part);
            (point[0] + error).store(&mut x[1], part);
            (point[1] - error).store(&mut y[0], part);
            (point[1] + error).store(&mut y[1], part);
            point[2].store(&mut z, part);
        }
        let single = |values: [f64; N]| -> [f32; N] { lanes(|i| values[i] as f32) };
        let ([low_x, high_x], [low_y, high_y]) = ([single(x[0]), single(x[1])], [single(y[0]), single(y[1])]);
        let z = single(z);
        // Signs are certain, so that equal numbers are the same bits.
        let mut are_sure = true;
        for i in 0..N {
            are_sure &= (low_x[i] == high_x[i]) & (low_y[i] == high_y[i]);
            positions[i] = [or_zero(low_x[i]), or_zero(low_y[i]), or_zero(z[i])];
        }
        are_sure
    }
}

/// A number, 0 in place of none.
#[inline(always)]
pub(super) fn or_zero(metres: f32) -> f32 {
    if metres.is_nan() { 0.0 } else { metres }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ground::random::Rng;
    use crate::scanner::firings::Laser;
    use crate::scanner::firings::recipe::{Origin, Recipe};

    #[test]
    fn positions_side_by_side_are_those_of_each_return() {
        const LASERS: usize = 8;
        let mut random = Rng::keyed(2, &[]);
        for recipe in Recipe::ALL {
            let turn = TurnTable::new(recipe, 36_000);
            let origin = Origin { along_um: 20_000, up_um: 30_000 };
            // None, some or all of the lasers have an offset.
            for offsets in [0, 4, LASERS] {
                let lasers: [Arithmetic; LASERS] = std::array::from_fn(|i| {
                    let azimuth = if i < offsets { 1_042_000_000 + i as i64 } else { 0 };
                    let laser = Laser { elevation: 2_000_000_000 * i as i64, azimuth };
                    Arithmetic::new(recipe, &laser, origin, 36_000)
                });
                for _ in 0..40 {
                    // Ticks are often in one block of the table. Sometimes the tick and the range are 0, so
                    // that coordinates are zeros of either sign.
                    let near = random.below(36_000);
                    let mut number = |most: usize| random.below(most).saturating_sub(most / 8) as u32;
                    let returns: Vec<Return> = (0..5 * N + 3)
                        .map(|i| Return {
                            row: number(LASERS),
                            tick: if i < 3 * N {
                                (near as u32 + number(20)) % 36_000
                            } else {
                                number(36_000)
                            },
                            steps: number(60_000),
                            column: 0,
                            echo: 0,
                        })
                        .collect();
                    let together = positions(&lasers, &turn, &returns, 2000);
                    for (found, together) in returns.iter().zip(together) {
                        let laser = &lasers[found.row as usize];
                        let alone = laser.position(&turn, found.tick, found.steps, 2000);
                        assert_eq!(
                            together.map(f32::to_bits),
                            alone.map(f32::to_bits),
                            "{recipe:?} {found:?}"
                        );
                    }
                }
            }
        }
    }
}

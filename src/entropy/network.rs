//! A small neural network that learns while it codes: one hidden layer, whose inputs are rows of tables,
//! selected by contexts, and numbers. For each bit of a decision tree it gives an opinion, which is mixed
//! with others. Counters learn each context by itself; the network learns what a context means together with
//! other inputs. FORMAT.md 6.7.

use pulp::NullaryFnOnce;

use super::{Logistic, hash};
use crate::ground::lanes::{dispatch, lanes, sum_of_products};

/// Number of hidden units.
const UNITS: usize = 32;
/// One number for each hidden unit. Aligned so that a vector does not cross two cache lines.
#[derive(Clone, Copy)]
#[repr(align(64))]
struct Units([f32; UNITS]);

impl Units {
    const ZERO: Self = Units([0.0; UNITS]);
}

/// The range of the initial weights of small tables and of numbers, around 0.
const FIRST_RANGE: f32 = 0.1;
/// Tables of at least this many rows start as zeros: most of their contexts are rare, and should have no say
/// before they have been seen.
const LARGE: usize = 1 << 12;

/// A network with `T` tables, `D` numbers, and `O` outputs that are added up for each opinion.
#[derive(Clone)]
pub struct Network<const T: usize, const D: usize, const O: usize> {
    /// The weights of the numbers, a row for each, then the rows of all tables.
    rows: Vec<Units>,
    /// Index of each table's first row.
    tables: [usize; T],
    outputs: Vec<Output>,
    rates: NetworkRates,
    logistic: &'static Logistic,
}

/// The learning rates of a network's weights.
#[derive(Clone, Copy, Debug)]
pub struct NetworkRates {
    /// The rate of the tables' rows.
    pub rows: f32,
    /// The rate of the numbers' weights.
    pub numbers: f32,
    /// The rate of the outputs' weights.
    pub outputs: f32,
}

/// The weights of one output.
#[derive(Clone, Copy)]
struct Output {
    weights: Units,
    bias: f32,
}

impl Output {
    const ZERO: Self = Output { weights: Units::ZERO, bias: 0.0 };
}

/// The hidden layer for a symbol that is being coded.
#[derive(Clone, Copy)]
pub struct Activations<const T: usize, const D: usize> {
    /// Index of each table's row.
    rows: [usize; T],
    numbers: [f32; D],
    sums: Units,
    hidden: Units,
    /// The weights of the last opinion.
    weights: Units,
    /// The direction in which the hidden units should have been different, so far.
    gradient: Units,
}

impl<const T: usize, const D: usize, const O: usize> Network<T, D, O> {
    /// Creates tables with these numbers of rows, and `outputs` outputs.
    pub fn new(sizes: [usize; T], outputs: usize, rates: NetworkRates) -> Self {
        let mut drawn = 0;
        let mut first = || -> Units {
            Units(std::array::from_fn(|_| {
                drawn += 1;
                let draw = hash(0, drawn - 1) >> 8;
                (draw as f32 / (1 << 24) as f32 - 0.5) * FIRST_RANGE
            }))
        };
        let mut end = D;
        let tables = sizes.map(|size| {
            end += size;
            end - size
        });
        let mut rows = vec![Units::ZERO; end];
        rows[..D].iter_mut().for_each(|row| *row = first());
        for (start, size) in tables.into_iter().zip(sizes).filter(|(_, size)| *size < LARGE) {
            rows[start..start + size].iter_mut().for_each(|row| *row = first());
        }
        let outputs = vec![Output::ZERO; outputs];
        Network { rows, tables, outputs, rates, logistic: Logistic::tables() }
    }

    /// The hidden layer for these contexts, one of each table, and numbers.
    #[inline]
    pub fn activate(&self, contexts: &[usize; T], numbers: &[f32; D]) -> Activations<T, D> {
        let rows = lanes(|table| self.tables[table] + contexts[table]);
        dispatch(Activating { network: self, rows, numbers })
    }

    /// The log odds of a 1, by the sum of these outputs.
    #[inline]
    pub fn odds(&self, activations: &mut Activations<T, D>, outputs: [usize; O]) -> f32 {
        let mut sum = Output::ZERO;
        for output in outputs {
            let Output { weights, bias } = &self.outputs[output];
            for unit in 0..UNITS {
                sum.weights.0[unit] += weights.0[unit];
            }
            sum.bias += bias;
        }
        activations.weights = sum.weights;
        sum_of_products(sum.bias, &sum.weights.0, &activations.hidden.0)
    }

    /// Adapts the outputs of the last opinion to the bit, to which it gave these log odds.
    #[inline]
    pub fn learn_bit(
        &mut self,
        activations: &mut Activations<T, D>,
        outputs: [usize; O],
        odds: f32,
        bit: bool,
    ) {
        let error = ((i32::from(bit) << 16) - self.logistic.squash(odds) as i32) as f32 / 65536.0;
        let by = error * self.rates.outputs;
        let mut changes = [0.0; UNITS];
        for unit in 0..UNITS {
            activations.gradient.0[unit] += error * activations.weights.0[unit];
            changes[unit] = by * activations.hidden.0[unit];
        }
        for output in outputs {
            let Output { weights, bias } = &mut self.outputs[output];
            for unit in 0..UNITS {
                weights.0[unit] += changes[unit];
            }
            *bias += by;
        }
    }

    /// Adapts the hidden layer after the last bit of a symbol.
    #[inline]
    pub fn learn(&mut self, activations: &Activations<T, D>) {
        dispatch(Learning { network: self, activations });
    }
}

struct Activating<'a, const T: usize, const D: usize, const O: usize> {
    network: &'a Network<T, D, O>,
    rows: [usize; T],
    numbers: &'a [f32; D],
}

impl<const T: usize, const D: usize, const O: usize> NullaryFnOnce for Activating<'_, T, D, O> {
    type Output = Activations<T, D>;

    #[inline(always)]
    fn call(self) -> Activations<T, D> {
        let Activating { network, rows, numbers } = self;
        let mut sums = [0.0; UNITS];
        for row in rows {
            let Units(row) = &network.rows[row];
            for unit in 0..UNITS {
                sums[unit] += row[unit];
            }
        }
        for (Units(weights), number) in network.rows.iter().zip(numbers) {
            for unit in 0..UNITS {
                sums[unit] += weights[unit] * number;
            }
        }
        let hidden = lanes(|unit| sums[unit] / (1.0 + sums[unit].abs()));
        Activations {
            rows,
            numbers: *numbers,
            sums: Units(sums),
            hidden: Units(hidden),
            weights: Units::ZERO,
            gradient: Units::ZERO,
        }
    }
}

struct Learning<'a, const T: usize, const D: usize, const O: usize> {
    network: &'a mut Network<T, D, O>,
    activations: &'a Activations<T, D>,
}

impl<const T: usize, const D: usize, const O: usize> NullaryFnOnce for Learning<'_, T, D, O> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Learning { network, activations } = self;
        let NetworkRates { rows: row_rate, numbers: number_rate, .. } = network.rates;
        let gradient: [f32; UNITS] = lanes(|unit| {
            // The derivative of x / (1 + |x|).
            let slope = 1.0 + activations.sums.0[unit].abs();
            activations.gradient.0[unit] / (slope * slope)
        });
        let change: [f32; UNITS] = lanes(|unit| gradient[unit] * row_rate);
        // Copies, which nothing that is written can alias.
        let Activations { rows, numbers, .. } = *activations;
        for row in rows {
            let Units(row) = &mut network.rows[row];
            for unit in 0..UNITS {
                row[unit] += change[unit];
            }
        }
        // By index, which is checked: LLVM would compute this loop across numbers instead of units.
        for index in 0..D {
            let rate = numbers[index] * number_rate;
            let Units(weights) = &mut network.rows[index];
            for unit in 0..UNITS {
                weights[unit] += rate * gradient[unit];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The mean number of bits that each of the last thousand bits of `truth` takes, which is told the rows of
    /// a small and of a large table and the number.
    fn bits_per_bit(truth: impl Fn(usize, usize, f32) -> bool) -> f64 {
        let rates = NetworkRates { rows: 0.05, numbers: 0.05, outputs: 0.02 };
        let mut network = Network::<2, 1, 1>::new([8, LARGE], 3, rates);
        let mut bits = 0.0;
        for i in 0..20_000usize {
            let draw = hash(1, i as u32) as usize;
            let (small, large) = (draw % 8, draw % 7);
            let number = (draw >> 8) as f32 / (1 << 23) as f32 - 1.0;
            let mut activations = network.activate(&[small, large], &[number]);
            let odds = network.odds(&mut activations, [2]);
            let bit = truth(small, large, number);
            if i >= 19_000 {
                let p = f64::from(Logistic::tables().squash(odds)) / 65536.0;
                bits -= if bit { p } else { 1.0 - p }.log2();
            }
            network.learn_bit(&mut activations, [2], odds, bit);
            network.learn(&activations);
        }
        bits / 1000.0
    }

    #[test]
    fn a_law_of_contexts_and_numbers_is_learned() {
        assert!(bits_per_bit(|small, _, number| number > small as f32 * 0.25 - 0.9) < 0.1);
        assert!(bits_per_bit(|small, _, _| small % 2 == 1) < 0.01);
        // Rows of large tables are 0 at first, so that outputs alone cannot tell them apart.
        assert!(bits_per_bit(|_, large, _| large % 2 == 1) < 0.01);
    }

    #[test]
    fn what_the_inputs_do_not_tell_is_not_learned() {
        let noise = std::cell::Cell::new(0);
        let bits = bits_per_bit(|_, _, _| {
            noise.set(noise.get() + 1);
            hash(2, noise.get()) >> 31 == 1
        });
        assert!((0.99..1.1).contains(&bits), "{bits}");
    }
}

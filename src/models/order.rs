//! The order of the points in the file, where it differs from the one that the range image implies.
//! FORMAT.md 8.8.
//!
//! In the implied order, strays take the positions that are listed for them, and the returns of the image
//! fill the others in file order. A return elsewhere is *moved*: it is listed with its position, and the
//! others close the gap.

use std::borrow::Cow;

use crate::entropy::{BitCoder, IntegerModel};
use crate::ground::error::{Error, Result};
use crate::ground::varint::saturated;

/// The differences between the order of the file and the implied one. Elements 0 to `returns` (exclusive) are
/// the returns in file order; the following ones are the strays in their order.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct OrderExceptions {
    /// The positions of the strays in the file, ascending.
    pub stray_places: Vec<u64>,
    /// The moved returns, ascending.
    pub moved: Vec<u64>,
    /// The position of each moved return among the returns.
    pub move_places: Vec<u64>,
}

impl OrderExceptions {
    /// The exceptions of an order, given each element's position in the file; the positions of the strays
    /// must be ascending.
    pub fn of_places(places: &[u32], returns: usize) -> Self {
        let (of_returns, of_strays) = places.split_at(returns);
        if of_returns.is_sorted() {
            let stray_places = of_strays.iter().map(|&place| place.into()).collect();
            return OrderExceptions { stray_places, ..OrderExceptions::default() };
        }
        let mut order = vec![0u32; places.len()];
        (0u32..).zip(places).for_each(|(element, &place)| order[place as usize] = element);
        Self::of(&order, returns)
    }

    /// The exceptions of an order: `order[i]` is the element at position i of the file.
    fn of(order: &[u32], returns: usize) -> Self {
        let sequence: Vec<u32> = order.iter().copied().filter(|&e| (e as usize) < returns).collect();
        let moved = moved_elements(&sequence);
        let mut place_of = Vec::new();
        if !moved.is_empty() {
            place_of.resize(returns, 0u64);
            (0u64..).zip(&sequence).for_each(|(place, &e)| place_of[e as usize] = place);
        }
        OrderExceptions {
            stray_places: places(order, |e| e as usize >= returns),
            move_places: moved.iter().map(|&e| place_of[e as usize]).collect(),
            moved: moved.into_iter().map(u64::from).collect(),
        }
    }

    /// Arranges the values of returns and strays in the order of the file.
    ///
    /// # Errors
    /// As [`order`](Self::order).
    pub fn arranged<'a, T: Copy + 'a>(
        &self,
        of_returns: impl Into<Cow<'a, [T]>>,
        of_strays: &[T],
    ) -> Result<Vec<T>> {
        let of_returns = of_returns.into();
        if self.moved.is_empty() && self.stray_places.is_empty() && of_strays.is_empty() {
            return Ok(of_returns.into_owned());
        }
        let is_rising = self.stray_places.is_sorted_by(|a, b| a < b);
        if !self.moved.is_empty() || !is_rising || of_strays.len() != self.stray_places.len() {
            let of = |element: u32| match (element as usize).checked_sub(of_returns.len()) {
                None => Some(of_returns[element as usize]),
                Some(stray) => of_strays.get(stray).copied(),
            };
            let values: Option<Vec<T>> = self.order(of_returns.len())?.into_iter().map(of).collect();
            return values.ok_or_else(not_a_permutation);
        }
        let mut values = Vec::with_capacity(of_returns.len() + of_strays.len());
        let mut rest = &*of_returns;
        for (place, stray) in self.stray_places.iter().zip(of_strays) {
            let before = usize::try_from(*place).ok().and_then(|place| place.checked_sub(values.len()));
            values.extend_from_slice(
                before.and_then(|count| rest.split_off(..count)).ok_or_else(not_a_permutation)?,
            );
            values.push(*stray);
        }
        values.extend_from_slice(rest);
        Ok(values)
    }

    /// The order of `returns` returns and the strays: for each position in the file, its element.
    ///
    /// # Errors
    /// If it is not a permutation.
    pub fn order(&self, returns: usize) -> Result<Vec<u32>> {
        let sequence = merge(&self.moved, &self.move_places, returns).ok_or_else(not_a_permutation)?;
        let strays = (returns as u64..).zip(self.stray_places.iter().copied());
        interleave(strays, sequence.into_iter(), returns + self.stray_places.len())
            .ok_or_else(not_a_permutation)
    }
}

fn not_a_permutation() -> Error {
    Error::corrupt("order: not a permutation")
}

/// The adaptive models of order.
#[derive(Clone, Default)]
pub struct OrderModel {
    counts: IntegerModel,
    stray_gaps: IntegerModel,
    move_gaps: IntegerModel,
}

impl OrderModel {
    /// Codes the exceptions for `returns` returns and `strays` strays.
    ///
    /// # Errors
    /// If the stream lists more moved returns than there are returns.
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        exceptions: &mut OrderExceptions,
        returns: usize,
        strays: usize,
    ) -> Result<()> {
        exceptions.stray_places.resize(strays, 0);
        code_rising(coder, &mut self.stray_gaps, &mut exceptions.stray_places, returns + strays);
        let moves = saturated(self.counts.code(coder, exceptions.moved.len() as u64));
        if moves > returns {
            return Err(Error::corrupt("order: more moved returns than there are"));
        }
        exceptions.moved.resize(moves, 0);
        exceptions.move_places.resize(moves, 0);
        code_rising(coder, &mut self.move_gaps, &mut exceptions.moved, returns);
        let bits = u64::BITS - (returns as u64).leading_zeros();
        exceptions.move_places.iter_mut().for_each(|place| *place = coder.code_plain(*place, bits));
        Ok(())
    }
}

/// The positions of elements of one kind.
fn places(order: &[u32], kind: impl Fn(u32) -> bool) -> Vec<u64> {
    (0u64..).zip(order).filter(|(_, e)| kind(**e)).map(|(place, _)| place).collect()
}

/// Codes ascending numbers below `end` as the gaps between them. Decoded numbers may exceed `end`.
fn code_rising<C: BitCoder>(coder: &mut C, gaps: &mut IntegerModel, numbers: &mut [u64], end: usize) {
    if numbers.len() == end {
        // If there are as many numbers as positions, there are no gaps.
        (0..).zip(numbers).for_each(|(place, number)| *number = place);
        return;
    }
    let mut next = 0u64;
    for number in numbers {
        if coder.is_exhausted() {
            return;
        }
        *number = next.saturating_add(gaps.code(coder, number.wrapping_sub(next)));
        next = number.saturating_add(1);
    }
}

/// The sequence of the returns, given the moved ones and their positions.
fn merge(moved: &[u64], places: &[u64], returns: usize) -> Option<Vec<u64>> {
    let mut is_moved = vec![false; returns];
    for &element in moved {
        *is_moved.get_mut(saturated(element))? = true;
    }
    let staying = (0..returns as u64).filter(|&e| !is_moved[e as usize]);
    let sequence = interleave(moved.iter().copied().zip(places.iter().copied()), staying, returns)?;
    Some(sequence.into_iter().map(u64::from).collect())
}

/// Puts each placed element at its position and fills the other positions in order. `None` if a position is
/// taken or out of range, or if the elements do not fill `total` positions.
fn interleave(
    placed: impl Iterator<Item = (u64, u64)>,
    mut fill: impl Iterator<Item = u64>,
    total: usize,
) -> Option<Vec<u32>> {
    const FREE: u32 = u32::MAX;
    let mut order = vec![FREE; total];
    for (element, place) in placed {
        let slot = order.get_mut(usize::try_from(place).ok()?)?;
        if *slot != FREE {
            return None;
        }
        *slot = element as u32;
    }
    for slot in order.iter_mut().filter(|slot| **slot == FREE) {
        *slot = fill.next()? as u32;
    }
    fill.next().is_none().then_some(order)
}

/// The smallest set of elements, ascending, without which the rest of the sequence is ascending: all except a
/// longest increasing subsequence (patience sorting).
fn moved_elements(sequence: &[u32]) -> Vec<u32> {
    if sequence.is_sorted() {
        return Vec::new();
    }
    // For each length, the index of the smallest last element of an increasing subsequence.
    let mut last: Vec<usize> = Vec::new();
    let mut before: Vec<Option<usize>> = Vec::with_capacity(sequence.len());
    for (index, &element) in sequence.iter().enumerate() {
        // Most elements are greater than all before.
        let is_greatest = last.last().is_none_or(|&l| sequence[l] < element);
        let length = if is_greatest { last.len() } else { last.partition_point(|&l| sequence[l] < element) };
        before.push(length.checked_sub(1).map(|l| last[l]));
        if length == last.len() {
            last.push(index);
        } else {
            last[length] = index;
        }
    }
    let mut stays = vec![false; sequence.len()];
    let mut index = last.last().copied();
    while let Some(i) = index {
        stays[i] = true;
        index = before[i];
    }
    let mut moved: Vec<u32> =
        sequence.iter().zip(stays).filter(|(_, stays)| !stays).map(|(e, _)| *e).collect();
    moved.sort_unstable();
    moved
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::entropy::{ArithmeticDecoder, ArithmeticEncoder};
    use proptest::prelude::*;

    fn round_trip(order: &[u32], returns: usize) -> usize {
        let strays = order.len() - returns;
        let mut exceptions = OrderExceptions::of(order, returns);
        let mut places = vec![0; order.len()];
        (0..).zip(order).for_each(|(place, &element)| places[element as usize] = place);
        assert_eq!(OrderExceptions::of_places(&places, returns), exceptions);
        let mut encoder = ArithmeticEncoder::default();
        OrderModel::default().code(&mut encoder, &mut exceptions, returns, strays).unwrap();
        let bytes = encoder.finish();
        let mut decoded = OrderExceptions::default();
        OrderModel::default()
            .code(&mut ArithmeticDecoder::new(&bytes), &mut decoded, returns, strays)
            .unwrap();
        assert_eq!(decoded, exceptions);
        assert_eq!(decoded.order(returns).unwrap(), order);
        let elements: Vec<u32> = (0..order.len() as u32).collect();
        assert_eq!(decoded.arranged(&elements[..returns], &elements[returns..]).unwrap(), order);
        bytes.len()
    }

    proptest! {
        #[test]
        fn any_permutation_comes_back(order in proptest::collection::vec(any::<u32>(), 0..300), share in 0.0..=1.0f64) {
            let mut keys: Vec<_> = order.iter().copied().zip(0u32..).collect();
            keys.sort_unstable();
            let returns = (keys.len() as f64 * share) as usize;
            // The strays are in the order of the file.
            let mut stray = returns as u32;
            let order: Vec<u32> = keys.into_iter().map(|(_, element)| {
                if element < returns as u32 { element } else { stray += 1; stray - 1 }
            }).collect();
            round_trip(&order, returns);
        }

        #[test]
        fn any_bytes_decode_to_a_permutation_or_an_error(bytes: Vec<u8>, returns in 0usize..50, strays in 0usize..50) {
            let mut exceptions = OrderExceptions::default();
            let mut decoder = ArithmeticDecoder::new(&bytes);
            let decoded = OrderModel::default().code(&mut decoder, &mut exceptions, returns, strays);
            let elements: Vec<u32> = (0..(returns + exceptions.stray_places.len()) as u32).collect();
            let arranged = exceptions.arranged(&elements[..returns], &elements[returns..]);
            if let Ok(mut order) = decoded.and_then(|()| exceptions.order(returns)) {
                prop_assert_eq!(arranged.unwrap(), order.clone());
                order.sort_unstable();
                prop_assert!(order.iter().copied().eq(0..(returns + strays) as u32));
            }
        }
    }

    #[test]
    fn the_implied_order_takes_next_to_nothing() {
        let order: Vec<u32> = (0..100_000).collect();
        assert!(round_trip(&order, 100_000) <= 8);
        assert!(round_trip(&order, 0) <= 8);
    }
}

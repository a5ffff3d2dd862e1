//! A table whose values are computed when they are first needed.

use std::fmt;
use std::sync::OnceLock;

use super::lanes::lanes;

/// Number of values that are computed together.
pub const BLOCK: usize = 256;

/// Values by index, computed in blocks when one of the block's values is requested. Thus a long table
/// announced by a stream costs neither time nor memory beyond what the frames use.
pub struct LazyTable<T> {
    blocks: Box<[OnceLock<Box<[T]>>]>,
    length: u32,
    make: Box<dyn Fn(u32) -> T + Send + Sync>,
}

impl<T> LazyTable<T> {
    /// A table of `length` values, computed from their indices.
    pub fn new(length: u32, make: impl Fn(u32) -> T + Send + Sync + 'static) -> Self {
        let blocks = (length as usize).div_ceil(BLOCK);
        LazyTable { blocks: (0..blocks).map(|_| OnceLock::new()).collect(), length, make: Box::new(make) }
    }

    /// Number of values.
    pub fn len(&self) -> u32 {
        self.length
    }

    /// The value at an index below [`len`](Self::len).
    #[inline(always)]
    pub fn get(&self, place: u32) -> &T {
        let (block, within) = (place as usize / BLOCK, place as usize % BLOCK);
        match self.blocks[block].get() {
            Some(values) => &values[within],
            None => &self.make_block(block)[within],
        }
    }

    /// The values at these indices, all of which are below [`len`](Self::len). Indices in the same block are
    /// looked up together.
    #[inline(always)]
    pub fn at<const N: usize>(&self, places: [u32; N]) -> [T; N]
    where
        T: Copy + Default,
    {
        match self.block_of(&places) {
            Some(values) => lanes(|i| values[places[i] as usize % BLOCK]),
            None => lanes(|i| *self.get(places[i])),
        }
    }

    /// The block of all these indices, if they have one, and it is whole and has been computed.
    #[inline(always)]
    pub fn block_of<const N: usize>(&self, places: &[u32; N]) -> Option<&[T; BLOCK]> {
        let block = |place: u32| place as usize / BLOCK;
        let first = places.first().map_or(0, |place| block(*place));
        let is_one_block = places.iter().fold(true, |all, place| all & (block(*place) == first));
        let values = self.blocks.get(first).and_then(OnceLock::get);
        values.and_then(|values| values.first_chunk()).filter(|_| is_one_block)
    }

    #[cold]
    fn make_block(&self, block: usize) -> &[T] {
        let first = (block * BLOCK) as u32;
        let end = self.length.min(first + BLOCK as u32);
        self.blocks[block].get_or_init(|| (first..end).map(&self.make).collect())
    }

    /// Number of values computed so far.
    #[cfg(test)]
    pub fn made(&self) -> usize {
        self.blocks.iter().filter_map(OnceLock::get).map(|block| block.len()).sum()
    }
}

impl<T> fmt::Debug for LazyTable<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("LazyTable").field("length", &self.length).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_is_used_is_made() {
        let table = LazyTable::new(1000, |place| place * place);
        assert_eq!((table.len(), table.made()), (1000, 0));
        assert_eq!(*table.get(300), 90_000);
        assert_eq!(table.made(), BLOCK);
        assert_eq!(*table.get(999), 998_001);
        assert_eq!(table.made(), BLOCK + 1000 % BLOCK);
        assert!((0..1000).all(|place| *table.get(place) == place * place));
        for places in [[4, 3, 7], [255, 256, 0], [600, 598, 599], [999, 998, 997]] {
            assert_eq!(table.at(places), places.map(|place| place * place));
        }
    }
}

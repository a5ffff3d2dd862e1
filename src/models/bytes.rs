//! Bytes of no known meaning: file headers, fields of a record beside position and intensity, files that are
//! not scans. Each bit is mixed from counters in the contexts of the preceding bytes and of the same position
//! in the record before. FORMAT.md 8.1.

use crate::entropy::{BitCoder, MixedBits};

const VIEWS: usize = 5;
const OPINIONS: usize = 8;
/// Binary logarithm of the number of slots of each view, for few bytes and for many. Contexts share slots by
/// hashing.
const FEWEST_SLOTS: u32 = 6;
const MOST_SLOTS: u32 = 14;

/// The adaptive models of bytes.
#[derive(Clone)]
pub struct ByteModel {
    learned: Option<Learned>,
    most_slot_bits: u32,
}

impl Default for ByteModel {
    fn default() -> Self {
        ByteModel { learned: None, most_slot_bits: MOST_SLOTS }
    }
}

/// Counters for as many slots as are worthwhile for the largest number of bytes so far.
#[derive(Clone)]
struct Learned {
    slot_bits: u32,
    bits: MixedBits<VIEWS, OPINIONS>,
}

impl Learned {
    fn new(slot_bits: u32) -> Self {
        Learned { slot_bits, bits: MixedBits::new([256 << slot_bits; VIEWS], 256, 0.3, 0.0, 0.004) }
    }
}

impl ByteModel {
    /// A model that takes a quarter of the memory.
    pub fn small() -> Self {
        ByteModel { most_slot_bits: MOST_SLOTS - 2, ..ByteModel::default() }
    }

    /// Codes bytes of records of `stride` bytes (1 if there are no records); a decoder passes a buffer of the
    /// right length to fill. If there are more bytes than ever before, the model may start anew with more
    /// slots.
    pub fn code<C: BitCoder>(&mut self, coder: &mut C, stride: usize, bytes: &mut [u8]) {
        let Some(octave) = bytes.len().checked_ilog2() else { return };
        let slot_bits = (octave + 2).clamp(FEWEST_SLOTS, self.most_slot_bits);
        let outgrown = self.learned.take_if(|learned| learned.slot_bits < slot_bits);
        drop(outgrown);
        let learned = self.learned.get_or_insert_with(|| Learned::new(slot_bits));
        for index in 0..bytes.len() {
            if coder.is_exhausted() {
                return;
            }
            let back = |distance: usize| index.checked_sub(distance).map_or(0, |i| u64::from(bytes[i]));
            // One context for each byte position in a short record; those of long records share, and so do
            // bytes outside records.
            let place = if stride > 1 { (index % stride + 1) as u64 } else { 0 };
            let views = [
                place,
                place << 8 | back(stride),
                (place << 8 | back(stride)) << 8 | back(2 * stride),
                (place << 8 | back(1)) << 8 | if stride > 1 { back(stride) } else { back(2) },
                (back(1) << 16 | back(2) << 8 | back(3)) ^ place << 24,
            ];
            bytes[index] = learned.code_byte(coder, views, bytes[index]);
        }
    }
}

impl Learned {
    /// Codes one byte from the top bit down.
    fn code_byte<C: BitCoder>(&mut self, coder: &mut C, views: [u64; VIEWS], byte: u8) -> u8 {
        let slots = views.map(|view| self.slot(view) << 8);
        let mut node = 1usize;
        for i in (0..8).rev() {
            let places = slots.map(|slot| slot + node);
            let bit = self.bits.code(coder, node, &places, 0.0, byte >> i & 1 == 1);
            node = node << 1 | usize::from(bit);
        }
        node as u8
    }

    /// The slot of a context.
    fn slot(&self, view: u64) -> usize {
        (view.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> (u64::BITS - self.slot_bits)) as usize
    }
}

//! The section of a frame that describes how its points were moved. FORMAT.md 8.15.

use super::{Miss, Motion, Turn};
use crate::ground::error::{Error, Result};
use crate::ground::varint::{read_signed, read_unsigned, write_signed, write_unsigned};

/// The section's name in errors.
const WHAT: &str = "motion compensation";

impl Turn {
    /// Appends the payload of the section.
    pub fn write_to(&self, out: &mut Vec<u8>) {
        self.motion.write_to(out);
        let mut next = 0;
        for miss in &self.misses {
            write_unsigned(out, u64::from(miss.point - next));
            miss.units.iter().for_each(|&units| write_signed(out, units));
            next = miss.point + 1;
        }
    }

    /// Reads the payload of the section, for a frame with `points` points.
    ///
    /// # Errors
    /// If it is cut short, or contains a motion that no scanner makes or points that the frame does not have.
    pub fn from_payload(mut bytes: &[u8], points: usize) -> Result<Self> {
        let input = &mut bytes;
        let mut turn = Turn { motion: Motion::read_from(input, WHAT)?, misses: Vec::new() };
        let mut next = 0u64;
        while !input.is_empty() {
            let point = next.saturating_add(read_unsigned(input, WHAT)?);
            if point >= points as u64 || point > u64::from(u32::MAX) {
                return Err(Error::corrupt(format!("{WHAT}: the frame has no point {point}")));
            }
            let mut units = [0; 3];
            for unit in &mut units {
                *unit = read_signed(input, WHAT)?;
            }
            turn.misses.push(Miss { point: point as u32, units });
            next = point + 1;
        }
        Ok(turn)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> Turn {
        let motion = Motion { rotation: [0.25, -1e-9, 0.0], translation: [0.8, 0.1, -0.25] };
        let miss = |point, units| Miss { point, units };
        Turn { motion, misses: vec![miss(0, [1, 0, 0]), miss(1, [0, -70_000, 1 << 33]), miss(9, [0; 3])] }
    }

    #[test]
    fn comes_back() {
        let mut bytes = Vec::new();
        example().write_to(&mut bytes);
        assert_eq!(Turn::from_payload(&bytes, 10).unwrap(), example());
        assert!(Turn::from_payload(&bytes, 9).is_err(), "a point too many");
        assert!(Turn::from_payload(&bytes[..bytes.len() - 1], 10).is_err(), "cut short");
        assert!(Turn::from_payload(&bytes[..47], 10).is_err(), "cut short");
    }

    #[test]
    fn impossible_motions_are_refused() {
        for value in [f64::NAN, f64::INFINITY, -9.0] {
            let mut bytes = Vec::new();
            example().write_to(&mut bytes);
            bytes[..8].copy_from_slice(&value.to_le_bytes());
            assert!(Turn::from_payload(&bytes, 10).is_err(), "{value}");
        }
    }
}

//! The section of a frame that describes how its points were moved by their time stamps. FORMAT.md 8.15.

use super::{Moment, Stamped};
use crate::entropy::{AdaptiveBit, ArithmeticDecoder, ArithmeticEncoder, BitCoder};
use crate::ground::error::{Error, Result};
use crate::ground::varint::{read_unsigned, saturated, write_unsigned};
use crate::scan::Channel;
use crate::scanner::motion::units::{UnitModel, exponent_of};
use crate::scanner::motion::{Miss, Motion};

/// The section's name in errors.
const WHAT: &str = "stamped";

impl Stamped {
    /// The payload of the section, for a frame whose points were measured at `measured`.
    pub fn to_payload(&self, measured: &[[f32; 3]], channels: &[Channel]) -> Vec<u8> {
        let mut bytes = Vec::new();
        write_unsigned(&mut bytes, self.channel as u64);
        write_unsigned(&mut bytes, self.moment as u64);
        self.motion.write_to(&mut bytes);
        let mut coder = ArithmeticEncoder::default();
        code_misses(&mut coder, &self.formula(measured, channels), &self.misses);
        bytes.extend(coder.finish());
        bytes
    }

    /// Reads the payload of the section.
    ///
    /// # Errors
    /// If it is cut short, or holds a channel that the frame does not have or a motion that no scanner makes.
    pub fn from_payload(mut bytes: &[u8], measured: &[[f32; 3]], channels: &[Channel]) -> Result<Self> {
        let input = &mut bytes;
        let channel = saturated(read_unsigned(input, WHAT)?);
        if channels.get(channel).is_none_or(|channel| channel.field.count != 1) {
            return Err(Error::corrupt(format!("{WHAT}: no channel of time stamps")));
        }
        let moment = read_unsigned(input, WHAT)?;
        let moment = usize::try_from(moment).ok().and_then(|number| Moment::ALL.get(number));
        let moment = *moment.ok_or_else(|| Error::unsupported(format!("{WHAT}: unknown moment")))?;
        let motion = Motion::read_from(input, WHAT)?;
        let mut stamped = Stamped { channel, moment, motion, misses: Vec::new() };
        let mut coder = ArithmeticDecoder::new(bytes);
        stamped.misses = code_misses(&mut coder, &stamped.formula(measured, channels), &[]);
        if coder.is_exhausted() {
            return Err(Error::corrupt(format!("{WHAT} ends too early")));
        }
        Ok(stamped)
    }
}

/// Codes the misses among all points, and returns them.
fn code_misses<C: BitCoder>(coder: &mut C, formula: &[[f32; 3]], misses: &[Miss]) -> Vec<Miss> {
    // Contexts: whether a coordinate is close to 0, where float32 values are dense, and how many of the last
    // two points were missed.
    let mut is_missed = [[AdaptiveBit::default(); 3]; 2];
    let mut of_units = UnitModel::default();
    let mut given = misses.iter().peekable();
    let mut found = Vec::new();
    let mut missed = 0u32;
    for (point, start) in (0u32..).zip(formula) {
        if coder.is_exhausted() {
            break;
        }
        let known = given.next_if(|miss| miss.point == point);
        let is_small = start.iter().any(|&metres| exponent_of(metres) == 0);
        let bit = &mut is_missed[usize::from(is_small)][missed.count_ones() as usize];
        let is_miss = bit.code(coder, known.is_some());
        missed = (missed << 1 | u32::from(is_miss)) & 3;
        if is_miss {
            let mut units = known.map_or([0; 3], |miss| miss.units);
            of_units.code(coder, start, &mut units);
            found.push(Miss { point, units });
        }
    }
    found
}

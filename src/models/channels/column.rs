//! One column: a value of one type for each record.

use std::collections::HashMap;

use super::integers::{IntegersModel, Site};
use super::numbers::{Scale, number, write_number};
use super::plan::{Geometry, Integers, Plan};
use super::{Sources, may_be_key};
use crate::entropy::{AdaptiveBit, ArithmeticEncoder, BitCoder, IntegerModel};
use crate::ground::error::{Error, Result};
use crate::ground::varint::{unzigzag, zigzag};
use crate::scan::Scalar;

/// What the coder has learned about a column.
#[derive(Clone, Default)]
pub struct ColumnModel {
    /// Made when it is first wanted: it is large.
    integers: Option<IntegersModel>,
    is_off: AdaptiveBit,
    off: IntegerModel,
    last_off: i64,
}

impl ColumnModel {
    /// Codes the values of a column; a decoder gets as many zeros.
    ///
    /// # Errors
    /// If a decoder's bytes make no column.
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        plan: &Plan,
        sources: &Sources,
        scalar: Scalar,
        values: &mut [u8],
    ) -> Result<()> {
        let size = scalar.size() as usize;
        match plan.code(coder)? {
            Plan::Constant => {
                let mut value = [0; 8];
                let first = values.get(..size).unwrap_or(&[]);
                value[..first.len()].copy_from_slice(first);
                let value = coder.code_plain(u64::from_le_bytes(value), 8 * size as u32).to_le_bytes();
                values.chunks_exact_mut(size).for_each(|to| to.copy_from_slice(&value[..size]));
                Ok(())
            }
            Plan::Same(source) => {
                let (type_of, from) = sources.values(source.into()).ok_or_else(no_source)?;
                let step = type_of.size() as usize;
                for (to, from) in values.chunks_exact_mut(size).zip(from.chunks_exact(step)) {
                    convert(type_of, from, scalar, to);
                }
                Ok(())
            }
            Plan::Integers(plan) => self.code_integers(coder, plan, sources, scalar, values),
        }
    }

    fn code_integers<C: BitCoder>(
        &mut self,
        coder: &mut C,
        plan: Integers,
        sources: &Sources,
        scalar: Scalar,
        values: &mut [u8],
    ) -> Result<()> {
        if plan.scale != Scale::PLACE && !scalar.is_float() {
            return Err(Error::corrupt("channels: a scale of integers"));
        }
        let size = scalar.size() as usize;
        let keys = keys(plan.key, sources)?;
        let columns = &sources.beside.columns;
        let positions = if plan.geometry == Geometry::NONE { &[][..] } else { &sources.beside.positions[..] };
        let lag = plan.lag as usize;
        let mut past = Vec::new();
        let model = self.integers.get_or_insert_default();
        for (record, value) in values.chunks_exact_mut(size).enumerate() {
            if coder.is_exhausted() {
                return Ok(());
            }
            let mut integer = if C::ENCODES { plan.scale.integer(scalar, value) } else { Some(0) };
            if plan.has_exceptions && self.is_off.code(coder, integer.is_none()) {
                let place = if C::ENCODES { Scale::PLACE.integer(scalar, value).unwrap_or(0) } else { 0 };
                let place = code_off(coder, &mut self.off, self.last_off, place);
                self.last_off = place;
                Scale::PLACE.write(scalar, place, value);
                integer = None;
            } else {
                let site = Site {
                    key: keys.get(record).copied().unwrap_or(0),
                    column: columns.get(record).copied().unwrap_or(0),
                    geometry: positions
                        .get(record)
                        .map(|position| plan.scale.nearest(scalar, plan.geometry.of(position))),
                    lagged: (lag > 0 && record > lag).then(|| [past[record - lag], past[record - lag - 1]]),
                };
                let coded = model.code(coder, &site, integer.unwrap_or(0));
                plan.scale.write(scalar, coded, value);
                integer = Some(coded);
            }
            if lag > 0 {
                past.push(integer.or(past.last().copied()).unwrap_or(0));
            }
        }
        Ok(())
    }

    /// How to code a column, and in how many bytes.
    pub fn choose(&self, sources: &Sources, scalar: Scalar, values: &[u8]) -> (Plan, usize) {
        /// Records that are coded to choose what predicts them.
        const SAMPLE: usize = 6000;
        /// Bytes of such a sample; less is good enough.
        const SMALL: usize = 40;
        let size = scalar.size() as usize;
        if values.chunks_exact(size).all(|value| *value == values[..size]) {
            return (Plan::Constant, size + 1);
        }
        let same = (0..4 + sources.channels.len()).find(|&source| is_same(sources, source, scalar, values));
        if let Some(source) = same.and_then(|source| u16::try_from(source).ok()) {
            return (Plan::Same(source), 3);
        }
        let scale = Scale::of(scalar, values);
        let has_exceptions = values.chunks_exact(size).any(|value| scale.integer(scalar, value).is_none());
        let mut best =
            Integers { scale, has_exceptions, lag: likely_lag(size, values), ..Integers::default() };
        // The middle is more like the rest than the start.
        let records = values.len() / size;
        let sample = records.saturating_sub(SAMPLE) / 2..records;
        let sample = sample.start..records.min(sample.start + SAMPLE);
        let part = sources.part(sample.clone());
        let sampled = &values[sample.start * size..sample.end * size];
        let trial = |plan: Integers| self.size_of(plan, &part.sources(), scalar, sampled);
        let mut least = trial(best);
        let mut improve = |best: &mut Integers, plan: Integers| {
            if least > SMALL {
                let bytes = trial(plan);
                if bytes < least {
                    (least, *best) = (bytes, plan);
                }
            }
        };
        let keys = sources.known.iter().filter(|&&channel| may_be_key(&sources.channels[channel].field));
        for key in keys.filter_map(|&channel| u16::try_from(channel + 1).ok()) {
            let plan = Integers { key, ..best };
            improve(&mut best, plan);
        }
        if !sources.beside.positions.is_empty() && size >= 2 {
            for geometry in Geometry::all() {
                let plan = Integers { geometry, ..best };
                improve(&mut best, plan);
            }
        }
        let bytes = self.size_of(best, sources, scalar, values);
        (Plan::Integers(best), bytes)
    }

    fn size_of(&self, plan: Integers, sources: &Sources, scalar: Scalar, values: &[u8]) -> usize {
        let mut encoder = ArithmeticEncoder::default();
        let coded =
            self.clone().code(&mut encoder, &Plan::Integers(plan), sources, scalar, &mut values.to_vec());
        if coded.is_ok() { encoder.finish().len() } else { usize::MAX }
    }
}

/// A value off the grid, by its place among all numbers.
fn code_off<C: BitCoder>(coder: &mut C, model: &mut IntegerModel, last: i64, place: i64) -> i64 {
    // Those below 2^62 either way differ by less than 2^63.
    let difference = zigzag(place.wrapping_sub(last));
    let is_long = coder.code_plain((difference >> 62 > 0).into(), 1) == 1;
    if is_long {
        return coder.code_plain(place as u64, 64) as i64;
    }
    last.wrapping_add(unzigzag(model.code(coder, difference)))
}

fn no_source() -> Error {
    Error::corrupt("channels: a column is told by one that is not there")
}

/// The key of every record.
fn keys(key: u16, sources: &Sources) -> Result<Vec<u32>> {
    let Some(channel) = key.checked_sub(1) else { return Ok(sources.beside.rows.clone()) };
    let channel = sources.channel(channel.into()).filter(|channel| may_be_key(&channel.field));
    let channel = channel.ok_or_else(no_source)?;
    let size = channel.field.width();
    Ok(channel
        .bytes
        .chunks_exact(size)
        .map(|value| value.iter().rev().fold(0, |key, &byte| key << 8 | u32::from(byte)))
        .collect())
}

/// How many records after it a run of values most often comes again; 0 if it seldom does.
fn likely_lag(size: usize, values: &[u8]) -> u32 {
    /// Values of a run.
    const RUN: usize = 4;
    /// How many runs are looked at.
    const RUNS: usize = 500;
    /// One in so many must come again at the same distance.
    const PART: usize = 4;
    let records = values.len() / size;
    if records < 16 * RUN {
        return 0;
    }
    let run = |record: usize| &values[record * size..(record + RUN) * size];
    let mut seen: HashMap<&[u8], usize> = HashMap::new();
    let mut distances: HashMap<usize, usize> = HashMap::new();
    let mut tried = 0;
    for record in 0..records - RUN {
        let last = seen.insert(run(record), record);
        if record % (records / RUNS).max(1) == 0 {
            tried += 1;
            if let Some(distance) = last.map(|last| record - last).filter(|&distance| distance > RUN) {
                *distances.entry(distance).or_default() += 1;
            }
        }
    }
    let most = distances.into_iter().max_by_key(|&(distance, count)| (count, std::cmp::Reverse(distance)));
    match most {
        Some((distance, count)) if count * PART > tried && distance < 1 << 24 => distance as u32,
        _ => 0,
    }
}

/// Whether all values are those of a source.
fn is_same(sources: &Sources, source: usize, scalar: Scalar, values: &[u8]) -> bool {
    let Some((type_of, from)) = sources.values(source) else { return false };
    let size = scalar.size() as usize;
    let mut again = [0; 8];
    from.len() / type_of.size() as usize == values.len() / size
        && values.chunks_exact(size).zip(from.chunks_exact(type_of.size() as usize)).all(|(value, from)| {
            convert(type_of, from, scalar, &mut again[..size]);
            again[..size] == *value
        })
}

/// A number in another type: the nearest there is.
fn convert(type_of: Scalar, from: &[u8], scalar: Scalar, to: &mut [u8]) {
    match type_of == scalar {
        true => to.copy_from_slice(from),
        false => write_number(scalar, number(type_of, from), to),
    }
}

//! One column: a value of one type for each record.

use super::choice::Tried;
use super::integers::{IntegersModel, Site};
use super::numbers::{Grid, Scale, number, write_number};
use super::plan::{Integers, Plan};
use super::rules::RuleModel;
use super::{Beside, Sources, may_be_key};
use crate::entropy::{AdaptiveBit, BitCoder, IntegerModel};
use crate::ground::error::{Error, Result};
use crate::ground::varint::{unzigzag, zigzag};
use crate::scan::Scalar;

/// What the coder has learned about a column.
#[derive(Clone, Default)]
pub struct ColumnModel {
    /// Made when it is first wanted: it is large.
    integers: Option<IntegersModel>,
    rules: RuleModel,
    /// How it was last coded, if as integers.
    last_plan: Option<Integers>,
    /// What an encoder found the best, if it was coded so.
    pub tried: Option<Tried>,
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
        self.last_plan = Some(plan);
        let size = scalar.size() as usize;
        let places = Places::new(&plan, sources, scalar)?;
        let (grid, by_place) = (&places.grid, Scale::PLACE.grid(scalar));
        let lag = plan.lag as usize;
        let mut past = Vec::new();
        for (record, value) in values.chunks_exact_mut(size).enumerate() {
            if coder.is_exhausted() {
                return Ok(());
            }
            let mut integer = if C::ENCODES { grid.integer(value) } else { Some(0) };
            if plan.has_exceptions && self.is_off.code(coder, integer.is_none()) {
                let place = if C::ENCODES { by_place.integer(value).unwrap_or(0) } else { 0 };
                let place = code_off(coder, &mut self.off, self.last_off, place);
                self.last_off = place;
                by_place.write(place, value);
                integer = None;
            } else {
                let mut site = places.site(record);
                let known = integer.unwrap_or(0);
                let coded = match plan.rule {
                    Some(rule) => self.rules.code(coder, rule, &site, known),
                    None => {
                        site.lagged =
                            (lag > 0 && record > lag).then(|| [past[record - lag], past[record - lag - 1]]);
                        self.integers.get_or_insert_default().code(coder, &site, known)
                    }
                };
                grid.write(coded, value);
                integer = Some(coded);
            }
            if lag > 0 {
                past.push(integer.or(past.last().copied()).unwrap_or(0));
            }
        }
        Ok(())
    }

    /// How the column was last coded, if as integers.
    pub fn last_plan(&self) -> Option<Integers> {
        self.last_plan
    }
}

/// What a plan knows of each record.
pub struct Places<'a> {
    keys: Vec<u32>,
    plan: Integers,
    beside: &'a Beside,
    pub grid: Grid,
}

impl<'a> Places<'a> {
    /// # Errors
    /// If there is no channel of the plan's keys.
    pub fn new(plan: &Integers, sources: &Sources<'a>, scalar: Scalar) -> Result<Self> {
        let (keys, grid) = (keys(plan.key, sources)?, plan.scale.grid(scalar));
        Ok(Places { keys, plan: *plan, beside: sources.beside, grid })
    }

    /// What is known of a record, but for the integers before it.
    pub fn site(&self, record: usize) -> Site {
        Site {
            key: self.keys.get(record).copied().unwrap_or(0),
            column: self.beside.columns.get(record).copied().unwrap_or(0),
            geometry: self.plan.geometry.of(record, self.beside).map(|number| self.grid.nearest(number)),
            lagged: None,
        }
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

/// A number in another type: the nearest there is.
pub fn convert(type_of: Scalar, from: &[u8], scalar: Scalar, to: &mut [u8]) {
    match type_of == scalar {
        true => to.copy_from_slice(from),
        false => write_number(scalar, number(type_of, from), to),
    }
}

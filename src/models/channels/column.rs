//! One column: a value of one type for each record. FORMAT.md 8.9, "Columns of channels".

use std::borrow::Cow;

use super::choice::Tried;
use super::image::ImageModel;
use super::integers::{IntegersModel, Site};
use super::levels::{LevelsModel, MOST_LEVELS, Palette};
use super::plan::{Geometry, Image, Integers, Levels, Plan};
use super::rules::{AFTER, BEAM, COLUMN, Rule, RuleModel, TICK, TURN};
use super::{RecordContext, Sources, may_be_key};
use crate::entropy::{AdaptiveBit, BitCoder, IntegerModel};
use crate::ground::error::{Error, Result};
use crate::ground::varint::{unzigzag, zigzag};
use crate::models::numbers::{NumberGrid, Scale, number, write_number};
use crate::scan::ScalarType;

/// Adaptive models of a column.
#[derive(Clone)]
pub struct ColumnModel {
    /// Allocated when it is first needed, because it is large.
    integers: Option<IntegersModel>,
    rules: RuleModel,
    /// Whether it may be coded as levels.
    pub may_have_levels: bool,
    pub(super) levels: Option<LevelsModel>,
    image: Option<ImageModel>,
    /// The type of the values and the plan by which it was last coded.
    last: Option<(ScalarType, Plan)>,
    /// The best plan that an encoder found, if the column was coded by it.
    pub tried: Option<Tried>,
    off: OffModel,
}

/// Adaptive models of values off the grid.
#[derive(Clone, Default)]
struct OffModel {
    is_off: AdaptiveBit,
    differences: IntegerModel,
    last: i64,
}

/// The grid of a column's values, and how those off it are coded, if there are any.
struct OffGrid<'m> {
    model: &'m mut OffModel,
    has_exceptions: bool,
    grid: &'m NumberGrid,
}

impl ColumnModel {
    /// The models of a column, which may be coded as levels or not.
    pub fn new(may_have_levels: bool) -> Self {
        ColumnModel {
            integers: None,
            rules: RuleModel::default(),
            may_have_levels,
            levels: None,
            image: None,
            last: None,
            tried: None,
            off: OffModel::default(),
        }
    }

    /// Codes the values of a column; a decoder passes zeros of the same length.
    ///
    /// # Errors
    /// If a decoder's input is not a valid column.
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        plan: &Plan,
        sources: &Sources,
        scalar: ScalarType,
        values: &mut [u8],
    ) -> Result<()> {
        let size = scalar.size() as usize;
        let plan = plan.code(coder)?;
        if let Plan::Integers(Integers { scale, .. })
        | Plan::Levels(Levels { scale, .. })
        | Plan::Image(Image { scale, .. }) = plan
        {
            if scale != Scale::RANK && !scalar.is_float() {
                return Err(Error::corrupt("channels: a scale of integers"));
            }
            self.last = Some((scalar, plan));
        }
        if plan.has_image() {
            sources.images.check()?;
        }
        if matches!(plan, Plan::Levels(_)) && !self.may_have_levels {
            return Err(Error::corrupt("channels: levels in a column with too high a number"));
        }
        match plan {
            Plan::Constant => {
                let mut value = [0; 8];
                let first = values.get(..size).unwrap_or(&[]);
                value[..first.len()].copy_from_slice(first);
                let value = coder.code_plain(u64::from_le_bytes(value), 8 * size as u32).to_le_bytes();
                values.chunks_exact_mut(size).for_each(|to| to.copy_from_slice(&value[..size]));
                Ok(())
            }
            Plan::Same(source) => {
                let from = sources.values(source.into()).ok_or_else(no_source)?;
                let mut values = values.chunks_exact_mut(size);
                from.all_as(scalar, |_, value| match values.next() {
                    Some(to) => {
                        to.copy_from_slice(value);
                        true
                    }
                    None => false,
                });
                Ok(())
            }
            Plan::Integers(plan) => self.code_integers(coder, plan, sources, scalar, values),
            Plan::Levels(plan) => self.code_levels(coder, plan, sources.context, scalar, values),
            Plan::Image(plan) => self.code_image(coder, plan, sources.context, scalar, values),
        }
    }

    fn code_image<C: BitCoder>(
        &mut self,
        coder: &mut C,
        plan: Image,
        context: &RecordContext,
        scalar: ScalarType,
        values: &mut [u8],
    ) -> Result<()> {
        let ColumnModel { image, off, .. } = self;
        let model = image.get_or_insert_default();
        model.start_frame(context.size());
        let (grid, divisor) = (plan.scale.grid(scalar), i64::from(plan.divisor));
        let integers = known_integers::<C>(&grid, values);
        let off = OffGrid { model: off, has_exceptions: plan.has_exceptions, grid: &grid };
        code_each(coder, off, scalar, &integers, values, |coder, record, integer| {
            let steps = context.steps.get(record).copied().unwrap_or(0);
            integer.map(|integer| model.code(coder, context.cell(record), steps, integer / divisor) * divisor)
        });
        Ok(())
    }

    fn code_levels<C: BitCoder>(
        &mut self,
        coder: &mut C,
        plan: Levels,
        context: &RecordContext,
        scalar: ScalarType,
        values: &mut [u8],
    ) -> Result<()> {
        let grid = plan.scale.grid(scalar);
        let count = values.len() / scalar.size() as usize;
        let integers = known_integers::<C>(&grid, values);
        let known = Palette::of(integers.iter().copied().flatten(), MOST_LEVELS);
        let palette = known.unwrap_or_default().code(coder, MOST_LEVELS)?;
        let model = self.levels.get_or_insert_default();
        model.start_frame(&palette, context.size(), count);
        let off = OffGrid { model: &mut self.off, has_exceptions: plan.has_exceptions, grid: &grid };
        code_each(coder, off, scalar, &integers, values, |coder, record, integer| {
            integer.map(|integer| model.code(coder, &palette, context.cell(record), integer))
        });
        Ok(())
    }

    fn code_integers<C: BitCoder>(
        &mut self,
        coder: &mut C,
        plan: Integers,
        sources: &Sources,
        scalar: ScalarType,
        values: &mut [u8],
    ) -> Result<()> {
        let places = Places::new(&plan, sources, scalar)?;
        let ColumnModel { integers: model, rules, off, .. } = self;
        if let Some(rule) = plan.rule {
            rules.prepare(rule, plan.are_singles(scalar));
            let off = OffGrid { model: off, has_exceptions: plan.has_exceptions, grid: &places.grid };
            match rule {
                Rule::Beam => code_by_rule::<C, BEAM>(coder, rule, rules, off, &places, scalar, values),
                Rule::Column => code_by_rule::<C, COLUMN>(coder, rule, rules, off, &places, scalar, values),
                Rule::After => code_by_rule::<C, AFTER>(coder, rule, rules, off, &places, scalar, values),
                Rule::Tick => code_by_rule::<C, TICK>(coder, rule, rules, off, &places, scalar, values),
                Rule::Turn(_) => code_by_rule::<C, TURN>(coder, rule, rules, off, &places, scalar, values),
            }
            return Ok(());
        }
        let lag = plan.lag as usize;
        let mut past = Vec::new();
        let integers = known_integers::<C>(&places.grid, values);
        let off = OffGrid { model: off, has_exceptions: plan.has_exceptions, grid: &places.grid };
        code_each(coder, off, scalar, &integers, values, |coder, record, integer| {
            let coded = integer.map(|integer| {
                let mut site = places.site(record);
                site.lagged = (lag > 0 && record > lag).then(|| [past[record - lag], past[record - lag - 1]]);
                model.get_or_insert_default().code(coder, &site, integer)
            });
            if lag > 0 {
                past.push(coded.or(past.last().copied()).unwrap_or(0));
            }
            coded
        });
        Ok(())
    }

    /// The plan by which values of this type were last coded, if the last ones were neither of another type,
    /// constant, nor those of another column.
    pub fn last_plan(&self, scalar: ScalarType) -> Option<Plan> {
        self.last.filter(|(of, _)| *of == scalar).map(|(_, plan)| plan)
    }

    /// Whether the last plan codes values by an image.
    pub fn has_image(&self) -> bool {
        self.last.is_some_and(|(_, plan)| plan.has_image())
    }
}

/// Codes values as integers, all or nearly all of which follow a rule of this kind: the loop over the records
/// is compiled for each.
fn code_by_rule<C: BitCoder, const KIND: u8>(
    coder: &mut C,
    rule: Rule,
    model: &mut RuleModel,
    off: OffGrid,
    places: &Places,
    scalar: ScalarType,
    values: &mut [u8],
) {
    let rule = rule.of_kind::<KIND>();
    let integers = known_integers::<C>(&places.grid, values);
    let known = integers
        .iter()
        .enumerate()
        .map(|(record, integer)| integer.map(|integer| (places.site(record), integer)));
    model.code_phase(coder, rule, known.clone());
    let (doubts, learned) = model.code_doubts(coder, rule, known);
    // If the rule is right for all integers, nothing else is coded.
    if doubts.is_empty() && !off.has_exceptions {
        if let Some(learned) = learned {
            return model.know(learned);
        }
        for (record, value) in values.chunks_exact_mut(scalar.size() as usize).enumerate() {
            places.grid.write(model.follow(rule, &places.site(record)), value);
        }
        return;
    }
    code_each(coder, off, scalar, &integers, values, |coder, record, integer| {
        integer.map(|integer| model.code(coder, rule, doubts, record, &places.site(record), integer))
    });
}

/// The integers of values, which only an encoder knows.
fn known_integers<C: BitCoder>(grid: &NumberGrid, values: &[u8]) -> Vec<Option<i64>> {
    if C::ENCODES { grid.integers(values) } else { Vec::new() }
}

/// Codes values as integers, which an encoder passes as well, by calling `code` for each, with the number of
/// its record; the integer is `None` for a value off the grid.
#[inline(always)]
fn code_each<C: BitCoder>(
    coder: &mut C,
    off: OffGrid,
    scalar: ScalarType,
    integers: &[Option<i64>],
    values: &mut [u8],
    mut code: impl FnMut(&mut C, usize, Option<i64>) -> Option<i64>,
) {
    for (record, value) in values.chunks_exact_mut(scalar.size() as usize).enumerate() {
        if coder.is_exhausted() {
            return;
        }
        let integer = if C::ENCODES { integers[record] } else { Some(0) };
        let is_off = off.has_exceptions && off.model.code(coder, scalar, integer.is_none(), value);
        // Called at one place, so that it can become a part of the loop.
        let coded = code(coder, record, if is_off { None } else { integer.or(Some(0)) });
        // An encoder already has the value.
        if !C::ENCODES && !is_off {
            off.grid.write(coded.unwrap_or(0), value);
        }
    }
}

/// What a plan uses of each record.
pub struct Places<'a> {
    keys: Cow<'a, [u32]>,
    columns: &'a [u32],
    geometry: Geometry,
    context: &'a RecordContext,
    grid: NumberGrid,
}

impl<'a> Places<'a> {
    /// # Errors
    /// If the channel of the plan's keys does not exist.
    pub fn new(plan: &Integers, sources: &'a Sources, scalar: ScalarType) -> Result<Self> {
        let (keys, grid, context) = (keys(plan.key, sources)?, plan.scale.grid(scalar), sources.context);
        let columns = if plan.rule == Some(Rule::Tick) { &context.ticks } else { &context.columns };
        Ok(Places { keys, columns, geometry: plan.geometry, context, grid })
    }

    /// What is known about a record, apart from the integers before it.
    #[inline(always)]
    pub fn site(&self, record: usize) -> Site {
        Site {
            key: self.keys.get(record).copied().unwrap_or(0),
            column: self.columns.get(record).copied().unwrap_or(0),
            geometry: self.geometry.of(record, self.context).map(|number| self.grid.nearest(number)),
            lagged: None,
        }
    }
}

impl OffModel {
    /// Codes whether a value is off the grid and, if so, its rank among all numbers.
    fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        scalar: ScalarType,
        is_off: bool,
        value: &mut [u8],
    ) -> bool {
        if !self.is_off.code(coder, is_off) {
            return false;
        }
        let by_rank = Scale::RANK.grid(scalar);
        let rank = if C::ENCODES { by_rank.integer(value).unwrap_or(0) } else { 0 };
        // Ranks between -2^62 and 2^62 differ by less than 2^63.
        let difference = zigzag(rank.wrapping_sub(self.last));
        let is_long = coder.code_plain((difference >> 62 > 0).into(), 1) == 1;
        self.last = match is_long {
            true => coder.code_plain(rank as u64, 64) as i64,
            false => self.last.wrapping_add(unzigzag(self.differences.code(coder, difference))),
        };
        by_rank.write(self.last, value);
        true
    }
}

fn no_source() -> Error {
    Error::corrupt("channels: a column that depends on one that does not exist")
}

/// The key of every record.
fn keys<'a>(key: u16, sources: &'a Sources) -> Result<Cow<'a, [u32]>> {
    let Some(channel) = key.checked_sub(1) else { return Ok(Cow::Borrowed(&sources.context.rows)) };
    let channel = sources.channel(channel.into()).filter(|channel| may_be_key(&channel.field));
    let channel = channel.ok_or_else(no_source)?;
    Ok(match channel.field.width() {
        1 => channel.bytes.iter().map(|&byte| byte.into()).collect(),
        _ => channel.bytes.as_chunks().0.iter().map(|&value| u16::from_le_bytes(value).into()).collect(),
    })
}

/// Converts a number to the nearest value of another type.
pub fn convert(type_of: ScalarType, from: &[u8], scalar: ScalarType, to: &mut [u8]) {
    match type_of == scalar {
        true => to.copy_from_slice(from),
        false => write_number(scalar, number(type_of, from), to),
    }
}

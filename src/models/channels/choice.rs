//! How the encoder chooses the way to code a column.

use std::collections::HashMap;
use std::ops::Range;

use super::column::{ColumnModel, Places};
use super::image::LIMIT;
use super::integers::{ENTRIES, Site, slot};
use super::levels::{MOST_LEVELS, Palette};
use super::plan::{Geometry, Image, Integers, Levels, Plan};
use super::rules::{Rule, RuleState};
use super::{Sources, is_constant, may_be_key};
use crate::entropy::ArithmeticEncoder;
use crate::models::numbers::{Scale, number};
use crate::scan::ScalarType;

/// Number of records that are coded to choose what predicts them.
const SAMPLE: usize = 6000;
/// Fewer records than this do not tell which way suits the next frame.
const FEWEST: usize = 1000;
/// At most one in this number of integers may break a rule, if they are wide and above a base, which changes
/// now and then.
const FEW_BASES: usize = 64;

/// A plan with a rule that seems worth a try.
enum Ruled {
    None,
    /// A part of the integers of a sample breaks the rule.
    OfSample(Integers),
    /// Those of the sample follow the rule, but too many others do not.
    OfSome(Integers),
}

/// How to code a column.
pub struct Choice {
    pub plan: Plan,
    /// Approximate number of bytes.
    pub bytes: usize,
    /// Whether no other way to code it is worth a try.
    pub is_sure: bool,
    /// What the next frame starts from, if all ways were tried.
    pub tried: Option<Tried>,
}

/// The best of all ways to code integers in a frame.
#[derive(Clone, Copy)]
pub struct Tried {
    scalar: ScalarType,
    plan: Integers,
    /// Bytes per record of a sample.
    bytes: f64,
}

impl Choice {
    fn sure(plan: Plan, bytes: usize) -> Self {
        Choice { plan, bytes, is_sure: true, tried: None }
    }
}

/// The records that are coded to compare ways of coding: some from all over the file, since its lines differ,
/// or all records if they are few.
pub fn sample(records: usize) -> Vec<Range<usize>> {
    /// Up to this multiple of [`SAMPLE`], records are few.
    const FEW: usize = 2;
    /// Number of parts of the sample.
    const PARTS: usize = 8;
    /// One record in this number is in the sample.
    const SHARE: usize = 8;
    if records <= FEW * SAMPLE {
        return std::iter::once(0..records).collect();
    }
    let (distance, count) = (records / PARTS, records / PARTS / SHARE);
    (0..PARTS)
        .map(|part| part * distance + (distance - count) / 2)
        .map(|start| start..start + count)
        .collect()
}

/// The values of some records.
pub fn gather(values: &[u8], width: usize, records: &[Range<usize>]) -> Vec<u8> {
    records.iter().map(|part| &values[part.start * width..part.end * width]).collect::<Vec<_>>().concat()
}

/// `count` records from the middle.
fn middle(records: usize, count: usize) -> Range<usize> {
    let start = records.saturating_sub(count) / 2;
    start..records.min(start + count)
}

/// A column to be coded.
#[derive(Clone, Copy)]
pub struct Column<'s> {
    pub sources: &'s Sources<'s>,
    pub scalar: ScalarType,
    /// The bytes of its values.
    pub values: &'s [u8],
}

impl Column<'_> {
    /// Bytes of a value.
    fn width(&self) -> usize {
        self.scalar.size() as usize
    }

    fn records(&self) -> usize {
        self.values.len() / self.width()
    }

    /// The values as integers of a scale; `None` for those that are not on it.
    fn integers(&self, scale: Scale) -> Vec<Option<i64>> {
        scale.grid(self.scalar).integers(self.values)
    }
}

impl ColumnModel {
    /// Chooses how to code a column.
    pub fn choose(&self, column: &Column) -> Choice {
        let &Column { sources, scalar, values } = column;
        let (size, records) = (column.width(), column.records());
        if is_constant(values, size) {
            return Choice::sure(Plan::Constant, size + 1);
        }
        let same = (0..4 + sources.channels.len()).find(|&source| is_same(column, source));
        if let Some(source) = same.and_then(|source| u16::try_from(source).ok()) {
            return Choice::sure(Plan::Same(source), 3);
        }
        let scale = Scale::of(scalar, values);
        let has_exceptions = scale.grid(scalar).misses_any(values);
        let plain = Integers { scale, has_exceptions, ..Integers::default() };
        let may_have_image = sources.images.check().is_ok();
        if let Some(plan) = self.same_kind(plain, column).filter(|_| may_have_image) {
            return Choice::sure(plan, 1);
        }
        // Times since the start of a scan in single precision are the most accurate there.
        let [first, last] =
            [&values[..size], &values[values.len() - size..]].map(|v| number(scalar, v).abs());
        let is_from_start = plain.are_singles(scalar) && first < last;
        let sampled = [if is_from_start { 0..records.min(SAMPLE) } else { middle(records, SAMPLE) }];
        let part = sources.part(&sampled);
        let sampled = gather(values, size, &sampled);
        let part = Column { sources: &part.sources(), scalar, values: &sampled };
        if let Some(plan) = self.tried_plan(plain, &part) {
            return Choice { tried: self.tried, ..Choice::sure(Plan::Integers(plan), 1) };
        }
        let ruled = match self.best_rule(plain, &part) {
            Some((plan, true)) => match self.settled(plan, column) {
                Ok(plan) => return Choice::sure(Plan::Integers(plan), 1),
                // The sample is misleading, so the plans are compared on all records.
                Err(plan) => Ruled::OfSome(plan),
            },
            Some((plan, false)) => Ruled::OfSample(plan),
            None => Ruled::None,
        };
        let lag = likely_lag(size, values);
        let of_sample = if let Ruled::OfSample(plan) = ruled { Some(plan) } else { None };
        let (mut best, tried) = self.best_way(Integers { lag, ..plain }, of_sample, &part);
        // A few records, as of a scan that was cut short, tell nothing about the next frame.
        let tells = part.records() >= FEWEST;
        let tried = Tried { scalar, plan: best, bytes: tried as f64 / part.records().max(1) as f64 };
        if let Ruled::OfSome(ruled) = ruled {
            let [of_best, of_ruled] = [best, ruled].map(|plan| self.size_of(&Plan::Integers(plan), column));
            best = if of_ruled < of_best { ruled } else { best };
            let tried = Some(tried).filter(|tried| tells && tried.plan == best);
            let bytes = of_best.min(of_ruled);
            return Choice { plan: Plan::Integers(best), bytes, is_sure: false, tried };
        }
        let sampled = sample(records);
        let sample = gather(values, size, &sampled);
        let part = sources.part(&sampled);
        let part = Column { sources: &part.sources(), scalar, values: &sample };
        let bytes = self.size_of(&Plan::Integers(best), &part);
        let bytes = bytes.saturating_mul(values.len()) / sample.len().max(1);
        let of_neighbours = match may_have_image {
            true => self.likely_by_neighbours(plain, column),
            false => Vec::new(),
        };
        let of_neighbours = of_neighbours.into_iter();
        let sized = of_neighbours.map(|plan| (self.size_of(&plan, column), plan));
        if let Some((bytes, plan)) = sized.min_by_key(|(bytes, _)| *bytes).filter(|(least, _)| *least < bytes)
        {
            return Choice { plan, bytes, is_sure: false, tried: None };
        }
        Choice { plan: Plan::Integers(best), bytes, is_sure: false, tried: tells.then_some(tried) }
    }

    /// The plans by neighbours that may take the fewest bytes: the better one for a part of the records, or
    /// both if it is a close call.
    fn likely_by_neighbours(&self, plain: Integers, column: &Column) -> Vec<Plan> {
        /// Sizes of parts are accurate to within one part in this number.
        const UNSURE: usize = 8;
        let levels = if self.may_have_levels { levels_plan(plain, column) } else { None };
        let plans = [levels, image_plan(plain, column)];
        let plans: Vec<Plan> = plans.into_iter().flatten().collect();
        if plans.len() < 2 {
            return plans;
        }
        let sampled = [middle(column.records(), SAMPLE)];
        let part = column.sources.part(&sampled);
        let values = gather(column.values, column.width(), &sampled);
        let part = Column { sources: &part.sources(), values: &values, ..*column };
        let sizes = plans.iter().map(|plan| self.size_of(plan, &part));
        let sizes: Vec<usize> = sizes.collect();
        let least = sizes.iter().min().copied().unwrap_or(0);
        let close = plans.into_iter().zip(sizes).filter(|(_, size)| *size <= least + least / UNSURE);
        close.map(|(plan, _)| plan).collect()
    }

    /// A plan by neighbours, if the column was last coded by one of that kind: they suit the same columns in
    /// all frames.
    fn same_kind(&self, plain: Integers, column: &Column) -> Option<Plan> {
        match self.last_plan(column.scalar)? {
            Plan::Levels(_) => levels_plan(plain, column),
            Plan::Image(_) => image_plan(plain, column),
            _ => None,
        }
    }

    /// The plan that was the best of all in an earlier frame, if it does as well now: trying all of them
    /// takes many times as long as coding the column.
    fn tried_plan(&self, plain: Integers, part: &Column) -> Option<Integers> {
        /// Up to this factor, more bytes count as equally good.
        const MORE: f64 = 1.02;
        let is_same = |tried: &Tried| tried.scalar == part.scalar && tried.plan.scale == plain.scale;
        let Tried { plan, bytes, .. } = self.tried.filter(is_same)?;
        let plan = Integers { has_exceptions: plain.has_exceptions, ..plan };
        let most = bytes * MORE * part.records() as f64;
        let taken = self.size_of(&Plan::Integers(plan), part);
        (taken as f64 <= most).then_some(plan)
    }

    /// Checks a plan whose rule uses the columns of an image, or its ticks, on all integers: a few rows show
    /// neither which of the two rules holds nor what holds in rows without returns. Returns the plan with the
    /// rule that more integers follow, as an error if too many follow neither.
    fn settled(&self, plan: Integers, column: &Column) -> std::result::Result<Integers, Integers> {
        let is_of_image = matches!(plan.rule, Some(Rule::Column | Rule::Tick));
        if !is_of_image
            || column.sources.context.ticks.is_empty()
            || self.last_plan(column.scalar) == Some(Plan::Integers(plan))
        {
            return Ok(plan);
        }
        let integers = column.integers(plan.scale);
        let missed = |rule: Rule| {
            let plan = Integers { rule: Some(rule), ..plan };
            (plan, misses(&plan, column, &integers, usize::MAX).unwrap_or(usize::MAX))
        };
        let (by_column, by_tick) = (missed(Rule::Column), missed(Rule::Tick));
        let (plan, missed) = if by_tick.1 < by_column.1 { by_tick } else { by_column };
        if missed <= integers.len() / 2 / FEW_BASES { Ok(plan) } else { Err(plan) }
    }

    /// The rule that most integers of a sample follow, and whether nearly all do; `None` if too few follow
    /// any rule.
    fn best_rule(&self, plain: Integers, part: &Column) -> Option<(Integers, bool)> {
        /// At most one in this number of integers breaks a rule that nearly all follow.
        const FEW: usize = 512;
        /// If one in this number of integers or more breaks a rule, it is useless.
        const MANY: usize = 3;
        let Sources { context, known, channels, .. } = part.sources;
        let integers = part.integers(plain.scale);
        let mut best = None;
        let mut least = integers.len() / 2 / MANY;
        let has_bases = part.width() > 2 && !context.columns.is_empty();
        let few = |plan: &Integers| match plan.rule {
            Some(Rule::Turn(_) | Rule::Column | Rule::Tick) if has_bases => integers.len() / 2 / FEW_BASES,
            _ => integers.len() / 2 / FEW,
        };
        let mut consider = |plan: Integers| {
            let is_better = best.as_ref().is_none_or(|best| least > few(best));
            if is_better && let Some(misses) = misses(&plan, part, &integers, least) {
                (least, best) = (misses, Some(plan));
            }
        };
        if let Some(Plan::Integers(plan)) = self.last_plan(part.scalar)
            && plan.rule.is_some()
        {
            consider(Integers { scale: plain.scale, has_exceptions: plain.has_exceptions, ..plan });
        }
        let channels = known.iter().filter(|&&channel| may_be_key(&channels[channel].field));
        let channels = channels.filter_map(|&channel| u16::try_from(channel + 1).ok());
        let keys = || std::iter::once(0).chain(channels.clone());
        for key in keys() {
            let beam = Integers { rule: Some(Rule::Beam), key, ..plain };
            consider(beam);
            if !context.steps.is_empty() {
                Geometry::of_places().for_each(|geometry| consider(Integers { geometry, ..beam }));
            }
        }
        for key in keys() {
            let turns = (1..=Rule::MOST_COLUMNS.min(64)).map(Rule::Turn);
            let rules = turns.take(if context.columns.is_empty() { 1 } else { usize::MAX });
            let by_tick = (!context.ticks.is_empty()).then_some(Rule::Tick);
            for rule in [Rule::Column, Rule::After].into_iter().chain(by_tick).chain(rules) {
                consider(Integers { rule: Some(rule), key, ..plain });
            }
        }
        if !context.positions.is_empty() && part.width() >= 2 {
            for geometry in Geometry::of_positions() {
                keys().for_each(|key| consider(Integers { rule: Some(Rule::Beam), key, geometry, ..plain }));
            }
        }
        let best = best?;
        let is_sure = least <= few(&best)
            && (least <= integers.len() / 2 / FEW
                || self.last_plan(part.scalar) == Some(Plan::Integers(best))
                || {
                    let size = |plan| self.size_of(&Plan::Integers(plan), part);
                    size(best) <= size(Integers { rule: None, ..best })
                });
        Some((best, is_sure))
    }

    /// The plan that takes the fewest bytes for a sample, with this rule or without any, and these bytes.
    fn best_way(&self, plain: Integers, ruled: Option<Integers>, part: &Column) -> (Integers, usize) {
        /// In bytes: if a sample takes no more than this, no better plan is sought.
        const SMALL: usize = 40;
        let mut best = plain;
        let mut least = self.size_of(&Plan::Integers(best), part);
        let mut improve = |best: &mut Integers, plan: Integers| {
            if least > SMALL {
                let bytes = self.size_of(&Plan::Integers(plan), part);
                if bytes < least {
                    (least, *best) = (bytes, plan);
                }
            }
        };
        let Sources { context, known, channels, .. } = part.sources;
        let keys = known.iter().filter(|&&channel| may_be_key(&channels[channel].field));
        for key in keys.filter_map(|&channel| u16::try_from(channel + 1).ok()) {
            let plan = Integers { key, ..best };
            improve(&mut best, plan);
        }
        if part.width() >= 2 {
            let places = Geometry::of_places().filter(|_| !context.steps.is_empty());
            let positions = Geometry::of_positions().filter(|_| !context.positions.is_empty());
            let integers = part.integers(plain.scale);
            for geometry in places.chain(positions) {
                let plan = Integers { geometry, ..best };
                if geometry_may_help(&plan, part, &integers) {
                    improve(&mut best, plan);
                }
            }
        }
        if let Some(ruled) = ruled {
            improve(&mut best, ruled);
        }
        (best, least)
    }

    /// Size of the coded column, in bytes.
    pub fn size_of(&self, plan: &Plan, &Column { sources, scalar, values }: &Column) -> usize {
        let mut encoder = ArithmeticEncoder::default();
        let coded = self.clone().code(&mut encoder, plan, sources, scalar, &mut values.to_vec());
        if coded.is_ok() { encoder.finish().len() } else { usize::MAX }
    }
}

/// The number of integers of the second half that break a plan's rule; `None` if there are `most` or more.
fn misses(plan: &Integers, column: &Column, integers: &[Option<i64>], most: usize) -> Option<usize> {
    let places = Places::new(plan, column.sources, column.scalar).ok()?;
    let rule = plan.rule?;
    let mut state = RuleState::default();
    state.prepare(rule, plan.are_singles(column.scalar));
    // The loop over the records is compiled for each kind of rule.
    match rule {
        Rule::Beam => count_misses(state, Rule::Beam, &places, integers, most),
        Rule::Column => count_misses(state, Rule::Column, &places, integers, most),
        Rule::After => count_misses(state, Rule::After, &places, integers, most),
        Rule::Tick => count_misses(state, Rule::Tick, &places, integers, most),
        Rule::Turn(columns) => count_misses(state, Rule::Turn(columns), &places, integers, most),
    }
}

/// As [`misses`], for a rule that the compiler knows.
#[inline(always)]
fn count_misses(
    mut state: RuleState,
    rule: Rule,
    places: &Places,
    integers: &[Option<i64>],
    most: usize,
) -> Option<usize> {
    let mut misses = 0;
    for (record, integer) in integers.iter().enumerate() {
        let Some(integer) = *integer else { continue };
        let site: Site = places.site(record);
        let is_right = state.is_right(rule, &site, integer);
        misses += usize::from(!is_right && record >= integers.len() / 2);
        if misses >= most {
            return None;
        }
    }
    Some(misses)
}

/// Whether the geometry of a plan predicts enough integers better than those before them do: coding a sample
/// to find out takes much longer.
fn geometry_may_help(plan: &Integers, column: &Column, integers: &[Option<i64>]) -> bool {
    /// Better predictions must save at least one in this number of the bits of all differences.
    const ENOUGH: u32 = 16;
    let Ok(places) = Places::new(plan, column.sources, column.scalar) else { return false };
    let bits = |value: i64, from: i64| u64::BITS - value.wrapping_sub(from).unsigned_abs().leading_zeros();
    let (mut all, mut saved, mut last) = (0, 0, 0);
    // By hash of the key: the last integer, and its difference from the geometry.
    let mut of_key = vec![[0; 2]; ENTRIES];
    for (record, integer) in integers.iter().enumerate() {
        let Some(integer) = *integer else { continue };
        let site = places.site(record);
        let geometry = site.geometry.unwrap_or(last);
        let [before, off] = std::mem::replace(
            &mut of_key[slot(site.key.into(), 0)],
            [integer, integer.wrapping_sub(geometry)],
        );
        let of_integers = bits(integer, last).min(bits(integer, before));
        let of_geometry = bits(integer, geometry).min(bits(integer, geometry.wrapping_add(off)));
        all += of_integers;
        saved += of_integers.saturating_sub(of_geometry);
        last = integer;
    }
    saved * ENOUGH > all
}

/// The distance, in records, at which a run of values most often recurs; 0 if it seldom does.
fn likely_lag(size: usize, values: &[u8]) -> u32 {
    /// Values per run.
    const RUN: usize = 4;
    /// Number of runs that are examined.
    const RUNS: usize = 500;
    /// More than one run in this number must recur at the same distance.
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

/// Whether all values equal those of a source.
fn is_same(column: &Column, source: usize) -> bool {
    let (size, values) = (column.width(), column.values);
    let from = column.sources.values(source).filter(|from| from.len() == column.records());
    from.is_some_and(|from| {
        from.all_as(column.scalar, |record, again| *again == values[record * size..][..size])
    })
}

/// The plan to code values as levels, if they are few.
fn levels_plan(Integers { scale, has_exceptions, .. }: Integers, column: &Column) -> Option<Plan> {
    Palette::of(integers_on(scale, column), MOST_LEVELS)?;
    Some(Plan::Levels(Levels { scale, has_exceptions }))
}

/// The plan to code values as integers of an image, if they are not too large.
fn image_plan(Integers { scale, has_exceptions, .. }: Integers, column: &Column) -> Option<Plan> {
    let (mut divisor, mut most) = (0, 0);
    for integer in integers_on(scale, column) {
        if !(0..LIMIT * i64::from(u16::MAX)).contains(&integer) {
            return None;
        }
        // Most integers are multiples of the divisor of those before.
        if divisor == 0 || integer % divisor > 0 {
            divisor = greatest_divisor(divisor, integer);
        }
        most = most.max(integer);
    }
    let divisor = u16::try_from(divisor.max(1)).ok()?;
    (most / i64::from(divisor) < LIMIT).then_some(Plan::Image(Image { scale, has_exceptions, divisor }))
}

/// The integers of those values that are on a scale.
fn integers_on(scale: Scale, column: &Column) -> impl Iterator<Item = i64> {
    let grid = scale.grid(column.scalar);
    column.values.chunks_exact(column.width()).filter_map(move |value| grid.integer(value))
}

/// The greatest common divisor.
fn greatest_divisor(a: i64, b: i64) -> i64 {
    if b == 0 { a } else { greatest_divisor(b, a % b) }
}

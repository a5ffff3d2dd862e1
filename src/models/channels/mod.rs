//! The fields of a record other than position and intensity, column by column: each by the method that the
//! encoder found to be the shortest for it. FORMAT.md 8.9.
//!
//! A column that is coded can predict those after it, so narrow types come first: rings, then times.

mod choice;
mod column;
mod compressed;
mod image;
mod integers;
mod levels;
mod plan;
mod rules;
#[cfg(test)]
mod tests;

pub use compressed::{Compressed, code_compressed};

use std::borrow::Cow;
use std::ops::Range;

use choice::{Choice, Column};
use column::{ColumnModel, convert};
use levels::{MOST_ENTRIES, Palette};
use plan::{Integers, Plan};

use super::ByteModel;
use crate::backend::{Compressors, Verdict};
use crate::entropy::{ArithmeticEncoder, BitCoder};
use crate::ground::error::{Error, Result};
use crate::models::numbers::Scale;
use crate::scan::{Channel, Field, ScalarType};

/// Fields with more values than this are coded as bytes.
const MOST_ELEMENTS: usize = 8;

/// Largest number of columns that have models of their own.
const MOST_COLUMNS: usize = 64;

/// Number of columns that may be coded as levels, the first ones: the models of levels take up to 34 MB a
/// column.
const COLUMNS_WITH_LEVELS: usize = 16;

/// What is known about the records before their channels are coded: all in file order.
#[derive(Clone, Debug, Default)]
pub struct RecordContext {
    /// The row of each record in the range image, counted from 1; 0 for a stray. Empty without an image.
    pub rows: Vec<u32>,
    /// The column of each record, likewise.
    pub columns: Vec<u32>,
    /// The range of each in steps, 0 for a stray. Empty without an image of a scanner of firings.
    pub steps: Vec<u32>,
    /// The azimuth tick of each record, likewise.
    pub ticks: Vec<u32>,
    /// One range step, in metres.
    pub range_step_m: f64,
    /// One azimuth tick, in degrees.
    pub tick_degrees: f64,
    /// The positions; empty if there are none.
    pub positions: Vec<[f32; 3]>,
    /// The intensities; empty if there are none.
    pub intensity: Vec<f32>,
}

impl RecordContext {
    /// The highest row and column of a record.
    fn size(&self) -> (usize, usize) {
        let highest = |numbers: &[u32]| numbers.iter().max().map_or(0, |&number| number as usize);
        (highest(&self.rows), highest(&self.columns))
    }

    /// The cells of the image of a column, with a row and a column for records without a cell.
    fn cells(&self) -> u64 {
        let (rows, columns) = self.size();
        (rows as u64 + 1).saturating_mul(columns as u64 + 1)
    }

    /// The row and column of a record, counted from 1; 0 if it has none.
    fn cell(&self, record: usize) -> (usize, usize) {
        let number = |numbers: &[u32]| numbers.get(record).map_or(0, |&number| number as usize);
        (number(&self.rows), number(&self.columns))
    }
}

/// Adaptive models of channels.
#[derive(Clone, Default)]
pub struct ChannelsModel {
    columns: Vec<ColumnModel>,
    /// For each channel, the result of compressing it in place of the models.
    verdicts: Vec<Verdict>,
    /// Shared by all channels, because it is large.
    bytes: Option<ByteModel>,
}

/// How a channel is coded.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Shape {
    /// All records hold the same bytes.
    Constant,
    /// The values at the same position of all records are a column.
    Columns,
    /// As bytes of no known meaning.
    Bytes,
    /// By a general-purpose coder.
    Compressed,
    /// The values that occur, and a column of their numbers.
    Palette,
}

impl Shape {
    const ALL: [Shape; 5] =
        [Shape::Constant, Shape::Columns, Shape::Bytes, Shape::Compressed, Shape::Palette];

    /// Codes the number of the shape.
    fn code<C: BitCoder>(self, coder: &mut C) -> Result<Self> {
        let number = coder.code_plain(self as u64, 8) as usize;
        Self::ALL
            .get(number)
            .copied()
            .ok_or_else(|| Error::unsupported(format!("channels: unknown shape {number}")))
    }
}

impl ChannelsModel {
    /// Codes the values of channels; a decoder passes zeros of the same length. An encoder may try these
    /// `compressors`. The images of all columns have at most `most_cells` cells. Returns their number, 0 if no
    /// column is coded by one.
    ///
    /// # Errors
    /// If a decoder's input does not contain valid channels, or if images are too large.
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        channels: &mut [Channel],
        context: &RecordContext,
        compressors: Compressors,
        most_cells: u64,
    ) -> Result<u64> {
        let mut order: Vec<usize> = (0..channels.len()).collect();
        order.sort_by_key(|&channel| channels[channel].field.scalar.size());
        let models = models_of_columns(order.iter().map(|&channel| channels[channel].field.count as usize));
        let columns = models.last().map_or(0, |models| models.end);
        for number in self.columns.len()..columns {
            self.columns.push(ColumnModel::new(number < COLUMNS_WITH_LEVELS));
        }
        let images = ImageSize { cells: context.cells().saturating_mul(columns as u64), most: most_cells };
        let bytes_model = self.bytes.get_or_insert_with(ByteModel::small);
        self.verdicts.resize(channels.len(), Verdict::Open);
        let mut known = Vec::new();
        for (channel, models) in order.into_iter().zip(models) {
            let scalar = channels[channel].field.scalar;
            let mut bytes = std::mem::take(&mut channels[channel].bytes);
            let sources = Sources { channels: &*channels, known: &known, context, images };
            let mut coding = ChannelCoder {
                columns: &mut self.columns[models],
                verdict: &mut self.verdicts[channel],
                bytes: bytes_model,
                width: scalar.size() as usize * (channels[channel].field.count as usize),
                scalar,
                compressors,
            };
            coding.code(coder, &sources, &mut bytes)?;
            channels[channel].bytes = bytes;
            known.push(channel);
        }
        let has_images = self.columns.iter().any(ColumnModel::has_image);
        Ok(if has_images { images.cells } else { 0 })
    }
}

/// The models of the columns of each field, given the number of its elements: none if there are too many.
fn models_of_columns(counts: impl Iterator<Item = usize>) -> Vec<Range<usize>> {
    let models = counts.scan(0, |columns, count| {
        let has_columns = count <= MOST_ELEMENTS && *columns + count <= MOST_COLUMNS;
        let models = *columns..*columns + if has_columns { count } else { 0 };
        *columns = models.end;
        Some(models)
    });
    models.collect()
}

/// The size of the images of all columns of a frame, in cells.
#[derive(Clone, Copy)]
struct ImageSize {
    /// What they have if all columns are coded by one.
    cells: u64,
    /// What they may have.
    most: u64,
}

impl ImageSize {
    /// # Errors
    /// If columns may not be coded by images.
    fn check(self) -> Result<()> {
        Error::check_limit("cells of the images of channels", self.cells, self.most).map(drop)
    }
}

/// What can predict a column.
struct Sources<'a> {
    channels: &'a [Channel],
    /// The channels that are already coded.
    known: &'a [usize],
    context: &'a RecordContext,
    images: ImageSize,
}

impl Sources<'_> {
    /// A source by its number; `None` if there is no such source.
    fn values(&self, source: usize) -> Option<Values<'_>> {
        let context = self.context;
        match source {
            0..3 if !context.positions.is_empty() => Some(Values::Coordinates(&context.positions, source)),
            3 if !context.intensity.is_empty() => Some(Values::Intensities(&context.intensity)),
            0..4 => None,
            _ => self.channel(source - 4).map(Values::Of),
        }
    }

    /// The sources of these records only.
    fn part(&self, records: &[Range<usize>]) -> OwnedSources {
        fn part<T: Copy>(values: &[T], records: &[Range<usize>]) -> Vec<T> {
            let parts = records.iter().map(|part| values.get(part.clone()).unwrap_or_default());
            parts.collect::<Vec<_>>().concat()
        }
        let context = self.context;
        let channels = self.channels.iter().enumerate().map(|(number, channel)| {
            let width = channel.field.width();
            let is_known = self.known.contains(&number);
            let bytes = if is_known { choice::gather(&channel.bytes, width, records) } else { Vec::new() };
            Channel { field: channel.field.clone(), bytes }
        });
        OwnedSources {
            channels: channels.collect(),
            known: self.known.to_vec(),
            images: self.images,
            context: RecordContext {
                rows: part(&context.rows, records),
                columns: part(&context.columns, records),
                steps: part(&context.steps, records),
                ticks: part(&context.ticks, records),
                positions: part(&context.positions, records),
                intensity: part(&context.intensity, records),
                ..*context
            },
        }
    }

    /// The channel with this number, if it is already coded and holds single values.
    fn channel(&self, number: usize) -> Option<&Channel> {
        let channel = self.known.contains(&number).then(|| &self.channels[number])?;
        (channel.field.count == 1).then_some(channel)
    }
}

/// The values of a source, one per record.
enum Values<'a> {
    /// The coordinates along an axis.
    Coordinates(&'a [[f32; 3]], usize),
    Intensities(&'a [f32]),
    Of(&'a Channel),
}

impl Values<'_> {
    /// Their type.
    fn scalar(&self) -> ScalarType {
        match self {
            Values::Coordinates(..) | Values::Intensities(_) => ScalarType::F32,
            Values::Of(channel) => channel.field.scalar,
        }
    }

    /// Their number.
    fn len(&self) -> usize {
        match self {
            Values::Coordinates(positions, _) => positions.len(),
            Values::Intensities(values) => values.len(),
            Values::Of(channel) => channel.bytes.len() / channel.field.width().max(1),
        }
    }

    /// The bytes of one value, at the start of the array.
    fn get(&self, record: usize) -> [u8; 8] {
        let mut bytes = [0; 8];
        match self {
            Values::Coordinates(positions, axis) => {
                bytes[..4].copy_from_slice(&positions[record][*axis].to_le_bytes());
            }
            Values::Intensities(values) => bytes[..4].copy_from_slice(&values[record].to_le_bytes()),
            Values::Of(channel) => {
                let width = channel.field.width();
                bytes[..width].copy_from_slice(&channel.bytes[record * width..][..width]);
            }
        }
        bytes
    }

    /// Passes each value, converted to another type, to `take` until that refuses one. Returns whether it
    /// took all.
    fn all_as(&self, scalar: ScalarType, mut take: impl FnMut(usize, &[u8]) -> bool) -> bool {
        let (from, size) = (self.scalar(), scalar.size() as usize);
        let mut value = [0; 8];
        (0..self.len()).all(|record| {
            convert(from, &self.get(record)[..from.size() as usize], scalar, &mut value[..size]);
            take(record, &value[..size])
        })
    }
}

/// [`Sources`] of some of the records.
struct OwnedSources {
    channels: Vec<Channel>,
    known: Vec<usize>,
    context: RecordContext,
    images: ImageSize,
}

impl OwnedSources {
    fn sources(&self) -> Sources<'_> {
        let OwnedSources { channels, known, context, images } = self;
        Sources { channels, known, context, images: *images }
    }
}

/// Codes one channel.
struct ChannelCoder<'m> {
    columns: &'m mut [ColumnModel],
    verdict: &'m mut Verdict,
    bytes: &'m mut ByteModel,
    width: usize,
    scalar: ScalarType,
    compressors: Compressors,
}

impl ChannelCoder<'_> {
    fn code<C: BitCoder>(&mut self, coder: &mut C, sources: &Sources, bytes: &mut [u8]) -> Result<()> {
        let (mut shape, mut plans, mut compressed) = (Shape::Bytes, Vec::new(), None);
        if C::ENCODES {
            (shape, plans, compressed) = self.choose(sources, bytes);
        }
        match shape.code(coder)? {
            Shape::Constant => {
                bytes
                    .iter_mut()
                    .take(self.width)
                    .for_each(|byte| *byte = coder.code_plain((*byte).into(), 8) as u8);
                repeat(bytes, self.width);
                Ok(())
            }
            Shape::Bytes => {
                self.bytes.code(coder, self.width, bytes);
                Ok(())
            }
            Shape::Compressed => code_compressed(coder, compressed, self.scalar, self.width, bytes),
            Shape::Palette => {
                let [model] = &mut *self.columns else {
                    return Err(Error::corrupt("channels: a palette of several columns"));
                };
                let known = if C::ENCODES { Numbered::of(self.scalar, bytes) } else { None };
                let mut numbered = known.unwrap_or_default();
                numbered.palette = numbered.palette.code(coder, MOST_ENTRIES)?;
                numbered.numbers.resize(bytes.len() / self.width * 2, 0);
                let plan = plans.first().copied().unwrap_or_default();
                model.code(coder, &plan, sources, NUMBER, &mut numbered.numbers)?;
                if !C::ENCODES {
                    numbered.write(self.scalar, bytes);
                }
                Ok(())
            }
            Shape::Columns => {
                plans.resize_with(self.columns.len(), Plan::default);
                match &mut *self.columns {
                    [] => Err(Error::corrupt("channels: too many columns")),
                    [model] => model.code(coder, &plans[0], sources, self.scalar, bytes),
                    models => {
                        let mut columns: Vec<_> =
                            split(bytes, self.scalar, models.len()).map(Cow::into_owned).collect();
                        for ((model, plan), values) in models.iter_mut().zip(&plans).zip(&mut columns) {
                            model.code(coder, plan, sources, self.scalar, values)?;
                        }
                        join(&columns, self.scalar, bytes);
                        Ok(())
                    }
                }
            }
        }
    }

    /// Chooses the shortest way to code a channel.
    fn choose(&mut self, sources: &Sources, bytes: &[u8]) -> (Shape, Vec<Plan>, Option<Compressed>) {
        /// In bytes: nothing else is tried if the columns take no more than this.
        const SMALL: usize = 64;
        /// Nor if they take no more than a byte for this number of records.
        const MANY: usize = 256;
        if is_constant(bytes, self.width) {
            return (Shape::Constant, Vec::new(), None);
        }
        if self.verdict.has_won(|| Verdict::likeness(bytes, bytes.len() / self.width))
            && let Some(compressed) = self.compressed(bytes, usize::MAX)
        {
            return (Shape::Compressed, Vec::new(), Some(compressed));
        }
        if let [model] = &*self.columns
            && model.last_plan(NUMBER).is_some()
            && let Some((choice, _)) = self.by_palette(sources, bytes).filter(|(choice, _)| choice.is_sure)
        {
            self.columns[0].tried = choice.tried;
            return (Shape::Palette, vec![choice.plan], None);
        }
        let mut plans = Vec::new();
        let (mut size, mut is_sure) = (0usize, !self.columns.is_empty());
        let columns = split(bytes, self.scalar, self.columns.len());
        for (model, values) in self.columns.iter_mut().zip(columns) {
            let choice = model.choose(&Column { sources, scalar: self.scalar, values: &values });
            size = choice.bytes.saturating_add(size);
            is_sure &= choice.is_sure;
            plans.push(choice.plan);
            model.tried = choice.tried;
        }
        if is_sure || !plans.is_empty() && size <= SMALL.max(bytes.len() / self.width / MANY) {
            return (Shape::Columns, plans, None);
        }
        let mut own = (Shape::Columns, size);
        // A palette is worth a try if values lie on no scale.
        let has_no_scale = matches!(plans[..], [Plan::Integers(Integers { scale: Scale::RANK, .. })]);
        let by_palette = if has_no_scale { self.by_palette(sources, bytes) } else { None };
        if let Some((choice, size)) = by_palette.filter(|(_, least)| *least < size) {
            own = (Shape::Palette, size);
            plans = vec![choice.plan];
            self.columns[0].tried = choice.tried;
        }
        let (shape, compressed) = self.choose_shape(sources, bytes, &plans, own);
        if shape != own.0 {
            self.columns.iter_mut().for_each(|model| model.tried = None);
        }
        (shape, plans, compressed)
    }

    /// The best way to code a channel of single values by a palette, and about the number of bytes; `None` if
    /// it has too many values.
    fn by_palette(&self, sources: &Sources, bytes: &[u8]) -> Option<(Choice, usize)> {
        let [model] = &*self.columns else { return None };
        let Numbered { palette, numbers } = Numbered::of(self.scalar, bytes)?;
        let choice = model.choose(&Column { sources, scalar: NUMBER, values: &numbers });
        let mut encoder = ArithmeticEncoder::default();
        palette.code(&mut encoder, MOST_ENTRIES).ok()?;
        let size = choice.bytes.saturating_add(encoder.finish().len());
        Some((choice, size))
    }

    /// The shape that takes the fewest bytes; `own` is that by columns or by a palette, and its size.
    fn choose_shape(
        &mut self,
        sources: &Sources,
        bytes: &[u8],
        plans: &[Plan],
        own: (Shape, usize),
    ) -> (Shape, Option<Compressed>) {
        /// Sizes estimated from a sample are accurate to within one part in this number.
        const UNSURE: usize = 8;
        let sampled = choice::gather(bytes, self.width, &choice::sample(bytes.len() / self.width));
        let as_bytes = self.size_as_bytes(&sampled).saturating_mul(bytes.len()) / sampled.len().max(1);
        let as_bytes = self.handicapped(as_bytes);
        let (own, size) = own;
        let (mut best, shape) = match plans.is_empty() || as_bytes < size {
            true => (as_bytes, Shape::Bytes),
            false => (size, own),
        };
        let likeness = || Verdict::likeness(bytes, bytes.len() / self.width);
        if self.verdict.has_lost(likeness) {
            return (shape, None);
        }
        let Some(compressed) = self.compressed(bytes, best.saturating_add(best / UNSURE)) else {
            return (shape, None);
        };
        // Models learn more from all records than from a sample.
        if sampled.len() < bytes.len() {
            best = match shape {
                Shape::Columns => self.size_as_columns(plans, sources, bytes),
                Shape::Palette => best,
                _ => self.handicapped(self.size_as_bytes(bytes)),
            };
        }
        let likeness = likeness();
        *self.verdict = match Verdict::of(compressed.size(), best, likeness) {
            // In the next frames, the models have learned more.
            Verdict::Open => Verdict::Lost(likeness),
            decided => decided,
        };
        match compressed.size() < best {
            true => (Shape::Compressed, Some(compressed)),
            false => (shape, None),
        }
    }

    /// The channel by a general-purpose coder; `None` if the `most` bytes that it may take are few.
    fn compressed(&self, bytes: &[u8], most: usize) -> Option<Compressed> {
        Compressed::shortest(bytes, self.scalar, self.width, self.compressors, most)
    }

    /// The size by the model of bytes, for comparison with other ways: they are preferred up to this size, as
    /// the model takes many times as long as any of them to encode and decode.
    fn handicapped(&self, as_bytes: usize) -> usize {
        match self.compressors {
            Compressors::Fast => as_bytes.saturating_add(as_bytes / 4),
            Compressors::Slow => as_bytes.saturating_add(as_bytes / 32),
            Compressors::All => as_bytes,
        }
    }

    fn size_as_bytes(&self, bytes: &[u8]) -> usize {
        let mut encoder = ArithmeticEncoder::default();
        self.bytes.clone().code(&mut encoder, self.width, &mut bytes.to_vec());
        encoder.finish().len()
    }

    fn size_as_columns(&self, plans: &[Plan], sources: &Sources, bytes: &[u8]) -> usize {
        let columns = split(bytes, self.scalar, plans.len());
        let sizes = self.columns.iter().zip(plans).zip(columns);
        sizes
            .map(|((model, plan), values)| {
                model.size_of(plan, &Column { sources, scalar: self.scalar, values: &values })
            })
            .sum()
    }
}

/// The type of the numbers of a palette's entries.
const NUMBER: ScalarType = ScalarType::U16;

/// Values as the numbers of the entries of a palette.
#[derive(Default)]
struct Numbered {
    palette: Palette,
    /// Two bytes each, the lower one first.
    numbers: Vec<u8>,
}

impl Numbered {
    /// `None` if there are too many values for a palette, or too few records of each.
    fn of(scalar: ScalarType, bytes: &[u8]) -> Option<Self> {
        /// Records to each entry of a palette, at least.
        const FEWEST: usize = 16;
        if scalar.size() <= NUMBER.size() {
            return None;
        }
        let ranks: Vec<i64> = Scale::RANK.grid(scalar).integers(bytes).into_iter().collect::<Option<_>>()?;
        let palette = Palette::of(ranks.iter().copied(), MOST_ENTRIES.min(ranks.len() / FEWEST))?;
        let numbers = ranks.iter().flat_map(|&rank| (palette.index_of(rank) as u16).to_le_bytes());
        Some(Numbered { numbers: numbers.collect(), palette })
    }

    /// Writes the values.
    fn write(&self, scalar: ScalarType, bytes: &mut [u8]) {
        let grid = Scale::RANK.grid(scalar);
        let values = bytes.chunks_exact_mut(scalar.size() as usize);
        for (value, number) in values.zip(self.numbers.as_chunks().0) {
            grid.write(self.palette.value_of(u16::from_le_bytes(*number).into()), value);
        }
    }
}

/// Splits records into the values of each element.
fn split(bytes: &[u8], scalar: ScalarType, count: usize) -> impl Iterator<Item = Cow<'_, [u8]>> {
    let size = scalar.size() as usize;
    (0..count).map(move |at| match count {
        1 => Cow::Borrowed(bytes),
        _ => bytes.chunks_exact(size).skip(at).step_by(count).collect::<Vec<_>>().concat().into(),
    })
}

/// Whether all values of `width` bytes equal the first one.
fn is_constant(bytes: &[u8], width: usize) -> bool {
    bytes.get(width..).is_none_or(|rest| *rest == bytes[..rest.len()])
}

/// Fills a buffer with repetitions of its first `width` bytes.
fn repeat(bytes: &mut [u8], width: usize) {
    let mut filled = width;
    while filled < bytes.len() {
        let more = filled.min(bytes.len() - filled);
        bytes.copy_within(..more, filled);
        filled += more;
    }
}

/// The inverse of [`split`].
fn join(columns: &[Vec<u8>], scalar: ScalarType, bytes: &mut [u8]) {
    let size = scalar.size() as usize;
    for (at, column) in columns.iter().enumerate() {
        let values = bytes.chunks_exact_mut(size).skip(at).step_by(columns.len());
        values.zip(column.chunks_exact(size)).for_each(|(to, from)| to.copy_from_slice(from));
    }
}

/// Whether values of this field may be keys: one small integer each.
fn may_be_key(field: &Field) -> bool {
    field.count == 1
        && matches!(field.scalar, ScalarType::U8 | ScalarType::I8 | ScalarType::U16 | ScalarType::I16)
}

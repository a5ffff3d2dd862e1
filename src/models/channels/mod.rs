//! The fields of a record beside position and intensity, column by column: each by the method that the
//! encoder found to be the shortest for it.
//!
//! A column that is coded can tell of those after it, so narrow types come first: rings, then times.

mod column;
mod integers;
mod numbers;
mod packed;
mod plan;
#[cfg(test)]
mod tests;

pub use packed::{FLOOR_LEVEL, LZMA_GAIN, Packed, code_packed};

use column::ColumnModel;
use plan::Plan;

use super::ByteModel;
use crate::backend::Level;
use crate::entropy::BitCoder;
use crate::ground::error::{Error, Result};
use crate::scan::{Channel, Field, Scalar};

/// Fields of more values than this are bytes.
const MOST_ELEMENTS: u32 = 8;

/// No more columns than this have a model of their own.
const MOST_COLUMNS: usize = 64;

/// What is known of the records before their channels are: all in the order of the file.
#[derive(Clone, Debug, Default)]
pub struct Beside {
    /// The row of each record in the range image, the first being 1; 0 for a stray. Empty without an image.
    pub rows: Vec<u32>,
    /// The column of each, likewise.
    pub columns: Vec<u32>,
    /// Empty if there are none.
    pub positions: Vec<[f32; 3]>,
    /// Empty if there are none.
    pub intensity: Vec<f32>,
}

/// What the coder has learned about channels.
#[derive(Clone, Default)]
pub struct ChannelsModel {
    columns: Vec<ColumnModel>,
    /// One for all channels: it is large.
    bytes: Option<ByteModel>,
}

/// How a channel is coded.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Shape {
    /// All records hold the same bytes.
    Constant,
    /// Every value of a record is a column.
    Columns,
    /// As bytes of no known meaning.
    Bytes,
    /// By a general-purpose coder.
    Packed,
}

impl Shape {
    const ALL: [Shape; 4] = [Shape::Constant, Shape::Columns, Shape::Bytes, Shape::Packed];

    /// Codes which one it is.
    fn code<C: BitCoder>(self, coder: &mut C) -> Result<Self> {
        let number = coder.code_plain(self as u64, 8) as usize;
        Self::ALL
            .get(number)
            .copied()
            .ok_or_else(|| Error::unsupported(format!("channels: unknown shape {number}")))
    }
}

impl ChannelsModel {
    /// Codes the values of channels; a decoder gets them with as many zeros. `level` says how hard an encoder
    /// tries.
    ///
    /// # Errors
    /// If a decoder's bytes make no channels.
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        channels: &mut [Channel],
        beside: &Beside,
        level: Level,
    ) -> Result<()> {
        let mut order: Vec<usize> = (0..channels.len()).collect();
        order.sort_by_key(|&channel| channels[channel].field.scalar.size());
        let bytes_model = self.bytes.get_or_insert_with(ByteModel::small);
        let mut columns = 0;
        let mut known = Vec::new();
        for channel in order {
            let Channel { field, .. } = &channels[channel];
            let scalar = field.scalar;
            let has_columns = field.count <= MOST_ELEMENTS && columns + field.count as usize <= MOST_COLUMNS;
            let count = if has_columns { field.count as usize } else { 0 };
            let models = columns..columns + count;
            columns += count;
            if self.columns.len() < columns {
                self.columns.resize_with(columns, ColumnModel::default);
            }
            let mut bytes = std::mem::take(&mut channels[channel].bytes);
            let sources = Sources { channels: &*channels, known: &known, beside };
            let mut coding = ChannelCoder {
                columns: &mut self.columns[models],
                bytes: bytes_model,
                width: scalar.size() as usize * (channels[channel].field.count as usize),
                scalar,
                level,
            };
            coding.code(coder, &sources, &mut bytes)?;
            channels[channel].bytes = bytes;
            known.push(channel);
        }
        Ok(())
    }
}

/// What a column can be told by.
struct Sources<'a> {
    channels: &'a [Channel],
    /// The channels that are coded.
    known: &'a [usize],
    beside: &'a Beside,
}

impl Sources<'_> {
    /// The values of a source by its number, and their type; `None` if there is no such source.
    fn values(&self, source: usize) -> Option<(Scalar, Vec<u8>)> {
        let coordinate =
            |axis: usize| self.beside.positions.iter().flat_map(|point| point[axis].to_le_bytes()).collect();
        let values = match source {
            0..3 if !self.beside.positions.is_empty() => (Scalar::F32, coordinate(source)),
            3 if !self.beside.intensity.is_empty() => {
                (Scalar::F32, self.beside.intensity.iter().flat_map(|value| value.to_le_bytes()).collect())
            }
            0..4 => return None,
            _ => {
                let channel = self.channel(source - 4)?;
                (channel.field.scalar, channel.bytes.clone())
            }
        };
        Some(values)
    }

    /// The same for some of the records alone.
    fn part(&self, records: std::ops::Range<usize>) -> OwnedSources {
        let part = |values: &[u32]| values.get(records.clone()).map_or_else(Vec::new, <[u32]>::to_vec);
        let beside = self.beside;
        let channels = self.channels.iter().enumerate().map(|(number, channel)| {
            let width = channel.field.width();
            let is_known = self.known.contains(&number);
            let bytes = if is_known {
                channel.bytes[records.start * width..records.end * width].to_vec()
            } else {
                Vec::new()
            };
            Channel { field: channel.field.clone(), bytes }
        });
        OwnedSources {
            channels: channels.collect(),
            known: self.known.to_vec(),
            beside: Beside {
                rows: part(&beside.rows),
                columns: part(&beside.columns),
                positions: beside.positions.get(records.clone()).unwrap_or_default().to_vec(),
                intensity: beside.intensity.get(records.clone()).unwrap_or_default().to_vec(),
            },
        }
    }

    /// The channel of this number, if it is coded and holds single values.
    fn channel(&self, number: usize) -> Option<&Channel> {
        let channel = self.known.contains(&number).then(|| &self.channels[number])?;
        (channel.field.count == 1).then_some(channel)
    }
}

/// [`Sources`] of some of the records.
struct OwnedSources {
    channels: Vec<Channel>,
    known: Vec<usize>,
    beside: Beside,
}

impl OwnedSources {
    fn sources(&self) -> Sources<'_> {
        Sources { channels: &self.channels, known: &self.known, beside: &self.beside }
    }
}

/// Codes one channel.
struct ChannelCoder<'m> {
    columns: &'m mut [ColumnModel],
    bytes: &'m mut ByteModel,
    width: usize,
    scalar: Scalar,
    level: Level,
}

impl ChannelCoder<'_> {
    fn code<C: BitCoder>(&mut self, coder: &mut C, sources: &Sources, bytes: &mut [u8]) -> Result<()> {
        let (mut shape, mut plans, mut packed) = (Shape::Bytes, Vec::new(), None);
        if C::ENCODES {
            (shape, plans, packed) = self.choose(sources, bytes);
        }
        match shape.code(coder)? {
            Shape::Constant => {
                bytes
                    .iter_mut()
                    .take(self.width)
                    .for_each(|byte| *byte = coder.code_plain((*byte).into(), 8) as u8);
                for at in self.width..bytes.len() {
                    bytes[at] = bytes[at - self.width];
                }
                Ok(())
            }
            Shape::Bytes => {
                self.bytes.code(coder, self.width, bytes);
                Ok(())
            }
            Shape::Packed => code_packed(coder, packed, self.scalar, self.width, bytes),
            Shape::Columns => {
                if self.columns.is_empty() {
                    return Err(Error::corrupt("channels: too many columns"));
                }
                let mut columns = split(bytes, self.scalar, self.columns.len());
                plans.resize_with(columns.len(), Plan::default);
                for ((model, plan), values) in self.columns.iter_mut().zip(&plans).zip(&mut columns) {
                    model.code(coder, plan, sources, self.scalar, values)?;
                }
                join(&columns, self.scalar, bytes);
                Ok(())
            }
        }
    }

    /// The shortest way to code a channel.
    fn choose(&self, sources: &Sources, bytes: &[u8]) -> (Shape, Vec<Plan>, Option<packed::Packed>) {
        /// Bytes; what takes less is not worth a further try.
        const SMALL: usize = 64;
        if bytes.chunks_exact(self.width).all(|value| value == &bytes[..self.width]) {
            return (Shape::Constant, Vec::new(), None);
        }
        let mut best = (usize::MAX, Shape::Bytes);
        let mut plans = Vec::new();
        if !self.columns.is_empty() {
            let mut size = 0;
            for (model, values) in self.columns.iter().zip(split(bytes, self.scalar, self.columns.len())) {
                let (plan, column_size) = model.choose(sources, self.scalar, &values);
                size += column_size;
                plans.push(plan);
            }
            best = (size, Shape::Columns);
        }
        if best.0 > SMALL {
            let mut encoder = crate::entropy::ArithmeticEncoder::default();
            self.bytes.clone().code(&mut encoder, self.width, &mut bytes.to_vec());
            let size = encoder.finish().len();
            if size < best.0 {
                best = (size, Shape::Bytes);
            }
        }
        let packed = packed::Packed::shortest(bytes, self.scalar, self.width, self.level, best.0);
        match packed {
            Some(packed) => (Shape::Packed, plans, Some(packed)),
            None => (best.1, plans, None),
        }
    }
}

/// The values of each element.
fn split(bytes: &[u8], scalar: Scalar, count: usize) -> Vec<Vec<u8>> {
    let size = scalar.size() as usize;
    let element = |at: usize| bytes.chunks_exact(size).skip(at).step_by(count).flatten().copied().collect();
    (0..count).map(element).collect()
}

/// The inverse of [`split`].
fn join(columns: &[Vec<u8>], scalar: Scalar, bytes: &mut [u8]) {
    let size = scalar.size() as usize;
    for (at, column) in columns.iter().enumerate() {
        let values = bytes.chunks_exact_mut(size).skip(at).step_by(columns.len());
        values.zip(column.chunks_exact(size)).for_each(|(to, from)| to.copy_from_slice(from));
    }
}

/// Whether values of this field may be keys: one small integer each.
fn may_be_key(field: &Field) -> bool {
    field.count == 1 && matches!(field.scalar, Scalar::U8 | Scalar::I8 | Scalar::U16 | Scalar::I16)
}

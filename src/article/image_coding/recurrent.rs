//! Recurrent coding (article, VI-C, Fig. 14): each pass codes the remaining error of those before.
//! FORMAT.md 8.14.

use super::plane::Plane;
use super::{ImageCodec, MOST_PASSES, jpeg, jpeg2000};
use crate::ground::error::{Error, Result};
use crate::ground::grid::Grid;
use crate::ground::varint::{read_signed, read_unsigned, write_signed, write_unsigned};

/// The share of the remaining bits that a pass gets if another one follows. According to measurements, less
/// is better at high rates, and more at low rates.
const SHARE: f64 = 0.4;
/// The largest number of bytes that a pass takes in addition to its image.
const OVERHEAD: usize = 16;

/// One pass: an image in which a sample s represents the value `centre + step * s`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pass {
    pub centre: i32,
    pub step: u32,
    /// The image in the codec's format; if empty, all samples are 0.
    pub image: Vec<u8>,
}

/// Whether another pass follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PassKind {
    /// Another pass follows; this one may leave to it what suits it less.
    Early,
    /// No pass follows.
    Last,
}

/// Codes the residuals of the returns (rows x columns, in steps), within `most_bytes` or losslessly.
///
/// # Errors
/// If the image has more columns than the format allows, or if it is to be coded losslessly and the format
/// does not support that.
pub fn encode(
    codec: ImageCodec,
    residuals: Grid<i32>,
    returns: &Grid<bool>,
    passes: u8,
    most_bytes: Option<usize>,
) -> Result<Vec<u8>> {
    let plane = Plane { values: residuals, returns };
    let passes = match most_bytes {
        Some(bytes) => within(codec, plane, passes, bytes)?,
        None => lossless(codec, plane)?,
    };
    let mut payload = Vec::new();
    write_unsigned(&mut payload, passes.len() as u64);
    passes.iter().for_each(|pass| pass.write_to(&mut payload));
    Ok(payload)
}

/// The passes that leave the least error within `bytes` bytes: a single one, or several, each of which except
/// the last gets a share of the remaining bytes.
fn within(codec: ImageCodec, plane: Plane<'_>, passes: u8, mut bytes: usize) -> Result<Vec<Pass>> {
    let mut early = Vec::new();
    let mut left = plane;
    let (mut least, mut best) = (left.energy(), Vec::new());
    let constant = Pass { centre: left.median(), step: 1, image: Vec::new() };
    let error = left.without(&constant.decode(codec, left.size())?).energy();
    if bytes > OVERHEAD && error < least {
        (least, best) = (error, vec![constant]);
    }
    for number in 1..=passes {
        let room = bytes.saturating_sub(OVERHEAD);
        if let Some(last) = codec.encode(&left, PassKind::Last, Some(room))? {
            let error = left.without(&last.decode(codec, left.size())?).energy();
            if error < least {
                (least, best) = (error, [&early[..], &[last]].concat());
            }
        }
        if number == passes {
            break;
        }
        let share = (room as f64 * SHARE) as usize;
        let Some(pass) = codec.encode(&left, PassKind::Early, Some(share))? else { break };
        bytes = room.saturating_sub(pass.image.len());
        left = left.without(&pass.decode(codec, left.size())?);
        early.push(pass);
    }
    Ok(best)
}

/// As many passes as a lossless result needs.
fn lossless(codec: ImageCodec, mut left: Plane<'_>) -> Result<Vec<Pass>> {
    let mut passes = Vec::new();
    while left.energy() > 0.0 {
        let pass =
            codec.encode(&left, PassKind::Last, None)?.filter(|_| passes.len() < usize::from(MOST_PASSES));
        let cannot =
            || Error::InvalidSettings(format!("{} cannot code these ranges without loss", codec.name()));
        let pass = pass.ok_or_else(cannot)?;
        left = left.without(&pass.decode(codec, left.size())?);
        passes.push(pass);
    }
    Ok(passes)
}

/// The inverse of [`encode`], except for losses: the residual of each return of an image with these numbers
/// of rows and columns. The values of other cells are meaningless.
///
/// # Errors
/// If the payload does not hold such an image.
pub fn decode(codec: ImageCodec, mut payload: &[u8], rows: usize, columns: usize) -> Result<Grid<i32>> {
    let input = &mut payload;
    let passes = read_unsigned(input, "number of passes")?;
    if passes > u64::from(MOST_PASSES) {
        return Err(Error::corrupt(format!("an image in {passes} passes")));
    }
    let mut sum: Grid<i32> = Grid::new(rows, columns);
    for _ in 0..passes {
        let values = Pass::read_from(input)?.decode(codec, (rows, columns))?;
        for row in 0..rows {
            let cells = sum.row_mut(row).iter_mut().zip(values.row(row));
            cells.for_each(|(sum, value)| *sum = sum.saturating_add(*value));
        }
    }
    if !input.is_empty() {
        return Err(Error::corrupt("bytes left over behind the image"));
    }
    Ok(sum)
}

impl Pass {
    fn write_to(&self, out: &mut Vec<u8>) {
        write_signed(out, i64::from(self.centre));
        write_unsigned(out, u64::from(self.step));
        write_unsigned(out, self.image.len() as u64);
        out.extend_from_slice(&self.image);
    }

    fn read_from(input: &mut &[u8]) -> Result<Self> {
        let damaged = || Error::corrupt("damaged pass of an image");
        let centre = i32::try_from(read_signed(input, "pass")?).map_err(|_| damaged())?;
        let step = u32::try_from(read_unsigned(input, "pass")?).map_err(|_| damaged())?;
        let length = usize::try_from(read_unsigned(input, "pass")?).map_err(|_| damaged())?;
        let (image, rest) = input.split_at_checked(length).ok_or_else(damaged)?;
        *input = rest;
        Ok(Pass { centre, step, image: image.to_vec() })
    }

    /// The values of all cells.
    pub fn decode(&self, codec: ImageCodec, (rows, columns): (usize, usize)) -> Result<Grid<i32>> {
        let samples = match self.image.is_empty() {
            true => Grid::new(rows, columns),
            false => codec.decode(&self.image, rows, columns)?,
        };
        Ok(samples.map(|sample| {
            let value = i64::from(self.centre) + i64::from(self.step) * i64::from(*sample);
            value.clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32
        }))
    }
}

impl ImageCodec {
    /// Codes a plane in one pass; `None` if `most_bytes` cannot hold an image.
    fn encode(self, plane: &Plane<'_>, kind: PassKind, most_bytes: Option<usize>) -> Result<Option<Pass>> {
        match self {
            ImageCodec::Jpeg => jpeg::encode(plane, most_bytes),
            ImageCodec::Jpeg2000 => jpeg2000::encode(plane, kind, most_bytes),
        }
    }

    /// The samples of an image, rows x columns.
    fn decode(self, image: &[u8], rows: usize, columns: usize) -> Result<Grid<i32>> {
        match self {
            ImageCodec::Jpeg => jpeg::decode(image, rows, columns),
            ImageCodec::Jpeg2000 => jpeg2000::decode(image, rows, columns),
        }
    }
}

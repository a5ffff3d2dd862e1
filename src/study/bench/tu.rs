//! Two coders of sequences of range images, for comparison, after C. Tu et al.: the article's references 10
//! (range images through a video codec, "Tu-MPEG" in Table VI) and 12 (frames between key frames, predicted
//! by the motion estimated by SLAM, "Tu-SLAM").
//!
//! Both get the range image without the outlier filter, and code the prediction residuals by JPEG 2000. The
//! papers themselves were not available: only the abstract of the first, and what the article says about
//! both. Simplifications, or differences in their favour:
//!
//! - Range images are those of the article's ideal scanner, not tables of the scanner's packets, which files
//!   of points do not have. So all image coders code the same image.
//! - JPEG 2000 takes the place of MPEG and JPEG, whose samples have 8 bits: it is the better of the article's
//!   two image coders (VI-C.2), its samples hold whole ranges, and it gets the two passes of the article's
//!   own coders.
//! - Occupancy is coded separately, without loss; a table of packets has zeros in empty cells, around which a
//!   transform rings.
//! - The video codec has I and P frames and blocks of one size, and no B frames; its vectors are whole cells.
//! - Poses come from registration of each frame with its key frames, not from SLAM. Each return is predicted
//!   from the key frame nearer in time, or else from the other one.

use crate::article::image_coding::{self, ImageCodec};
use crate::entropy::{AdaptiveBit, ArithmeticDecoder, ArithmeticEncoder, BitCoder, IntegerModel};
use crate::ground::error::{Error, Result};
use crate::ground::grid::Grid;
use crate::ground::varint::{read_unsigned, unzigzag, write_unsigned, zigzag};
use crate::inter::registration::{Pose, QuantisedPose, RegistrationConfig, register};
use crate::inter::{self, Layer, Past, Reference};
use crate::scanner::RangeImage;
use crate::scanner::hdl64::Hdl64;

/// Rows and columns of a block, like those of a macroblock of MPEG.
const BLOCK: usize = 16;
/// The largest vector of a block: rows, and columns to either side. At 0.18 degrees, 32 columns correspond to
/// a rotation of 6 degrees between frames, or to passing an object at 10 m by 1 m.
const REACH: [i32; 2] = [2, 32];
/// Distance between key frames; the last frame of a run is a key frame too.
const KEY_DISTANCE: usize = 3;
/// The image coder, and its largest number of passes.
const CODEC: ImageCodec = ImageCodec::Jpeg2000;
const PASSES: u8 = 2;
/// The lowest and the highest rate, in bits per return, that are tried to reach an error, and the number of
/// trials.
const BITS: [f64; 2] = [0.02, 24.0];
const MOST_TRIES: usize = 8;
/// An error is near enough to the target if the binary logarithm of their ratio is between this and 0.
const NEAR: f64 = -0.05;

/// How frames are predicted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Each frame except the first from the frame before, block by block.
    Video,
    /// Frames between key frames from both of these, by the scanner's motion.
    Slam,
}

/// The target of a frame: its rate or its error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Aim {
    /// Bits per return.
    Bits(f64),
    /// Root mean square of the ranges' errors, in metres.
    Error(f64),
}

/// A coder of one run of frames.
pub struct Coder<'a> {
    /// How frames are predicted.
    pub method: Method,
    /// The scanner of the images, which defines the steps of ranges.
    pub scanner: &'a Hdl64,
    /// How motions are estimated; only for encoding.
    pub registration: RegistrationConfig,
}

/// A frame of a run, in the order of coding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Turn {
    frame: usize,
    /// The frames from which it is predicted: before and after it, if there are any.
    sources: [Option<usize>; 2],
    /// The nearer of these.
    nearer: usize,
}

/// The data coded before the image of a frame.
struct Side {
    /// Vectors of the blocks, row by row: rows and columns. Empty if there is no frame to predict from.
    vectors: Vec<[i32; 2]>,
    /// The motion of the scanner from each source.
    motions: [QuantisedPose; 2],
    /// Which cells hold a return.
    returns: Grid<bool>,
}

impl Coder<'_> {
    /// Codes a run of images, each with all columns of the scanner.
    ///
    /// # Errors
    /// If the image coder's library fails.
    pub fn encode(&self, images: &[RangeImage], aim: Aim) -> Result<Vec<Vec<u8>>> {
        let mut payloads = vec![Vec::new(); images.len()];
        let mut decoded: Vec<Option<RangeImage>> = vec![None; images.len()];
        let mut last = [Pose::default(); 2];
        for turn in self.order(images.len()) {
            let (frame, pasts) = (turn.frame, pasts(&decoded, turn));
            let image = &images[frame];
            let motions = self.motions(&pasts, image, &mut last);
            let vectors = match (self.method, &pasts) {
                (Method::Video, [Some(before), _]) => vectors(&before.0, image),
                _ => Vec::new(),
            };
            let mut side = Side { vectors, motions, returns: image.occupancy() };
            let mut coder = ArithmeticEncoder::default();
            let predicted = self.code_side(&mut coder, &mut side, &pasts, turn.nearer);
            let mut residuals: Grid<i32> = Grid::new(predicted.rows(), predicted.columns());
            let cells = image.steps.cells().iter().zip(predicted.cells());
            for (residual, (&steps, &predicted)) in residuals.cells_mut().iter_mut().zip(cells) {
                *residual = if steps > 0 { (i64::from(steps) - i64::from(predicted)) as i32 } else { 0 };
            }
            let (image, left) = self.code_image(&residuals, &side.returns, aim)?;
            let side_bytes = coder.finish();
            let payload = &mut payloads[frame];
            write_unsigned(payload, side_bytes.len() as u64);
            payload.extend(side_bytes);
            payload.extend(image);
            decoded[frame] = Some(self.image_of(&predicted, &left, &side.returns));
        }
        Ok(payloads)
    }

    /// The inverse of [`encode`](Self::encode), except for losses.
    ///
    /// # Errors
    /// If the payloads do not hold such images.
    pub fn decode(&self, payloads: &[Vec<u8>]) -> Result<Vec<RangeImage>> {
        let mut decoded: Vec<Option<RangeImage>> = vec![None; payloads.len()];
        let (rows, columns) = (self.scanner.rows(), self.scanner.ticks as usize);
        for turn in self.order(payloads.len()) {
            let mut payload = &payloads[turn.frame][..];
            let length = read_unsigned(&mut payload, "length of what comes before the image")?;
            let short = || Error::corrupt("a frame that is cut short");
            let length = usize::try_from(length).map_err(|_| short())?;
            let (side_bytes, image) = payload.split_at_checked(length).ok_or_else(short)?;
            let pasts = pasts(&decoded, turn);
            let mut side = Side {
                vectors: Vec::new(),
                motions: [QuantisedPose::default(); 2],
                returns: Grid::new(rows, columns),
            };
            let predicted =
                self.code_side(&mut ArithmeticDecoder::new(side_bytes), &mut side, &pasts, turn.nearer);
            let left = image_coding::decode(CODEC, image, rows, columns)?;
            decoded[turn.frame] = Some(self.image_of(&predicted, &left, &side.returns));
        }
        Ok(decoded.into_iter().flatten().collect())
    }

    /// The frames of a run in the order in which they are coded.
    fn order(&self, frames: usize) -> Vec<Turn> {
        let is_key = |frame: usize| match self.method {
            Method::Video => true,
            Method::Slam => frame.is_multiple_of(KEY_DISTANCE) || frame + 1 == frames,
        };
        let turn = |frame: usize| {
            let key = frame - frame % KEY_DISTANCE;
            let next_key = (key + KEY_DISTANCE).min(frames - 1);
            let sources = match self.method {
                Method::Video => [frame.checked_sub(1), None],
                Method::Slam if is_key(frame) => [None, None],
                Method::Slam => [Some(key), Some(next_key)],
            };
            Turn { frame, sources, nearer: usize::from(frame - key > next_key - frame) }
        };
        let (keys, between): (Vec<usize>, Vec<usize>) = (0..frames).partition(|&frame| is_key(frame));
        keys.into_iter().chain(between).map(turn).collect()
    }

    /// The motions from the sources to a frame, starting from those of the frame before; none if the estimate
    /// fails.
    fn motions(&self, pasts: &Pasts, image: &RangeImage, last: &mut [Pose; 2]) -> [QuantisedPose; 2] {
        let mut motions = [QuantisedPose::default(); 2];
        if self.method == Method::Slam {
            let sources = motions.iter_mut().zip(last).zip(pasts);
            for ((motion, last), (_, past)) in
                sources.filter_map(|(motion, past)| Some((motion, past.as_ref()?)))
            {
                let surface = past.surface(self.scanner);
                let found = register(surface, image, self.scanner, last, &self.registration);
                *motion = found.and_then(|found| found.pose.quantise()).unwrap_or_default();
                *last = motion.pose();
            }
        }
        motions
    }

    /// Codes the data before the image, and predicts the ranges of its returns, in steps.
    fn code_side<C: BitCoder>(
        &self,
        coder: &mut C,
        side: &mut Side,
        pasts: &Pasts,
        nearer: usize,
    ) -> Grid<u32> {
        let mut integers = IntegerModel::default();
        let mut integer =
            |coder: &mut C, value: i32| unzigzag(integers.code(coder, zigzag(i64::from(value)))) as i32;
        let (rows, columns) = (side.returns.rows(), side.returns.columns());
        let mut reference = Reference::new(rows, columns);
        match (self.method, pasts) {
            (Method::Video, [Some((before, _)), _]) => {
                let blocks = rows.div_ceil(BLOCK) * columns.div_ceil(BLOCK);
                side.vectors.resize(blocks, [0; 2]);
                let reach = |vector: [i32; 2]| [0, 1].map(|i| vector[i].clamp(-REACH[i], REACH[i]));
                for vector in &mut side.vectors {
                    *vector = reach(vector.map(|value| integer(coder, value)));
                }
                reference.moved = shifted(before, &side.vectors);
                reference.same.steps = before.steps.clone();
            }
            (Method::Slam, _) => {
                let ticks: Vec<u32> = (0..columns as u32).collect();
                for source in [nearer, 1 - nearer] {
                    let Some((_, past)) = &pasts[source] else { continue };
                    let motion = &mut side.motions[source];
                    motion.values = motion.values.map(|value| integer(coder, value));
                    let seen = past.reference(self.scanner, &ticks, &motion.pose().motion());
                    fill(&mut reference.moved.steps, &seen.moved.steps);
                    fill(&mut reference.same.steps, &seen.same.steps);
                }
            }
            (Method::Video, _) => {}
        }
        code_returns(coder, &mut side.returns, &reference.moved.steps);
        match pasts {
            [None, None] => Grid::new(rows, columns),
            _ => inter::ranges(&reference, &side.returns),
        }
    }

    /// Codes the prediction residuals; also returns the decoded ones.
    fn code_image(
        &self,
        residuals: &Grid<i32>,
        returns: &Grid<bool>,
        aim: Aim,
    ) -> Result<(Vec<u8>, Grid<i32>)> {
        let count = returns.cells().iter().filter(|is| **is).count();
        let at = |bits: f64| -> Result<(Vec<u8>, Grid<i32>)> {
            let most = (bits * count as f64 / 8.0) as usize;
            let image = image_coding::encode(CODEC, residuals.clone(), returns, PASSES, Some(most))?;
            let decoded = image_coding::decode(CODEC, &image, returns.rows(), returns.columns())?;
            Ok((image, decoded))
        };
        let metres = match aim {
            Aim::Bits(bits) => return at(bits),
            Aim::Error(metres) => metres,
        };
        // The nearest trials on either side of the target: bits, and the logarithm of the ratio of the error
        // to the target.
        let (mut too_few, mut enough): (Option<[f64; 2]>, Option<[f64; 2]>) = (None, None);
        let mut best = None;
        let mut bits: f64 = 3.0;
        for _ in 0..MOST_TRIES {
            let coded = at(bits)?;
            let times = (self.rmse(residuals, &coded.1, returns, count).max(1e-9) / metres).log2();
            if times <= 0.0 {
                enough = Some([bits, times]);
                best = Some(coded);
                if times >= NEAR {
                    break;
                }
            } else {
                too_few = Some([bits, times]);
            }
            bits = match (too_few, enough) {
                (Some([few, above]), Some([many, below])) => {
                    // Not too near to either side, so that both sides move.
                    let share = (above / (above - below)).clamp(0.2, 0.8);
                    few + share * (many - few)
                }
                // At best, one more bit per return halves the error.
                _ => (bits + 1.3 * times).clamp(BITS[0], BITS[1]),
            };
        }
        best.map_or_else(|| at(BITS[1]), Ok)
    }

    /// The root mean square of the loss in the returns' ranges, in metres.
    fn rmse(&self, values: &Grid<i32>, decoded: &Grid<i32>, returns: &Grid<bool>, count: usize) -> f64 {
        let cells = values.cells().iter().zip(decoded.cells()).zip(returns.cells());
        let squares = cells.filter(|(_, is)| **is).map(|((a, b), _)| (f64::from(*a) - f64::from(*b)).powi(2));
        (squares.sum::<f64>() / count.max(1) as f64).sqrt() * self.scanner.range_step_m()
    }

    /// The decoded image.
    fn image_of(&self, predicted: &Grid<u32>, left: &Grid<i32>, returns: &Grid<bool>) -> RangeImage {
        let mut image = RangeImage::new(returns.rows(), (0..self.scanner.ticks).collect());
        let cells = predicted.cells().iter().zip(left.cells()).zip(returns.cells());
        for (steps, ((&predicted, &left), _)) in
            image.steps.cells_mut().iter_mut().zip(cells).filter(|(_, (_, is))| **is)
        {
            let sum = i64::from(predicted) + i64::from(left);
            *steps = sum.clamp(1, i64::from(self.scanner.most_steps())) as u32;
        }
        image
    }
}

/// The decoded images of a frame's sources, prepared for prediction.
type Pasts = [Option<(RangeImage, Past)>; 2];

fn pasts(decoded: &[Option<RangeImage>], turn: Turn) -> Pasts {
    turn.sources.map(|source| {
        let image = decoded.get(source?)?.clone()?;
        let levels = Grid::new(image.steps.rows(), image.steps.columns());
        Some((image.clone(), Past::new(image, levels)))
    })
}

/// Fills the cells without a range from another image.
fn fill(steps: &mut Grid<u32>, from: &Grid<u32>) {
    let cells = steps.cells_mut().iter_mut().zip(from.cells());
    cells.filter(|(steps, _)| **steps == 0).for_each(|(steps, from)| *steps = *from);
}

/// Codes which cells hold a return, in the context of those around them and of the prediction.
fn code_returns<C: BitCoder>(coder: &mut C, returns: &mut Grid<bool>, predicted: &Grid<u32>) {
    let mut contexts = [AdaptiveBit::default(); 256];
    for row in 0..returns.rows() {
        for column in 0..returns.columns() {
            let known = [(0, -1), (0, -2), (-1, -1), (-1, 0), (-1, 1)];
            let known = known.map(|(down, right)| returns.beside((row, column), down, right));
            let seen = [-1, 0, 1].map(|right| predicted.beside((row, column), 0, right) > 0);
            let context = known.into_iter().chain(seen).fold(0, |bits, bit| bits << 1 | usize::from(bit));
            returns[(row, column)] = contexts[context].code(coder, returns[(row, column)]);
        }
    }
}

/// The image before, with each block taken from where its vector points; columns wrap around.
fn shifted(before: &RangeImage, vectors: &[[i32; 2]]) -> Layer {
    let (rows, columns) = (before.steps.rows(), before.steps.columns());
    let mut layer = Layer { steps: Grid::new(rows, columns), levels: Grid::new(rows, columns) };
    let across = columns.div_ceil(BLOCK);
    for row in 0..rows {
        for column in 0..columns {
            let vector = vectors[row / BLOCK * across + column / BLOCK];
            layer.steps[(row, column)] = before.steps[source((row, column), vector, (rows, columns))];
        }
    }
    layer
}

/// The cell to which a vector points.
fn source(
    (row, column): (usize, usize),
    [down, right]: [i32; 2],
    (rows, columns): (usize, usize),
) -> (usize, usize) {
    let row = (row as i64 + i64::from(down)).clamp(0, rows as i64 - 1);
    let column = (column as i64 + i64::from(right)).rem_euclid(columns as i64);
    (row as usize, column as usize)
}

/// The vector of each block with the least sum of absolute differences of the ranges; of equal ones, the
/// shortest.
fn vectors(before: &RangeImage, image: &RangeImage) -> Vec<[i32; 2]> {
    let (rows, columns) = (image.steps.rows(), image.steps.columns());
    let [down, right] = REACH;
    let mut candidates: Vec<[i32; 2]> =
        (-down..=down).flat_map(|down| (-right..=right).map(move |right| [down, right])).collect();
    candidates.sort_by_key(|[down, right]| down * down + right * right);
    // Columns wrap around; repeating the ends of the turn avoids this in the search.
    let aside = right as usize;
    let mut around: Grid<u32> = Grid::new(rows, columns + 2 * aside);
    for row in 0..rows {
        for (column, steps) in around.row_mut(row).iter_mut().enumerate() {
            *steps = before.steps[source((row, column), [0, -right], (rows, columns))];
        }
    }
    let mut vectors = Vec::new();
    for (top, left) in
        (0..rows).step_by(BLOCK).flat_map(|row| (0..columns).step_by(BLOCK).map(move |i| (row, i)))
    {
        let (bottom, width) = ((top + BLOCK).min(rows), BLOCK.min(columns - left));
        let mut ranges: Vec<u32> = (top..bottom)
            .flat_map(|row| &image.steps.row(row)[left..left + width])
            .copied()
            .filter(|steps| *steps > 0)
            .collect();
        // For a return without a counterpart, the difference is the median range of the block's returns.
        let middle = ranges.len() / 2;
        let alone = if ranges.is_empty() { 0 } else { *ranges.select_nth_unstable(middle).1 };
        let cost = |[down, right]: [i32; 2]| -> u64 {
            let of_row = |row: usize| -> u64 {
                let (other, _) = source((row, 0), [down, 0], (rows, columns));
                let start = (left + aside).saturating_add_signed(right as isize);
                let cells = image.steps.row(row)[left..].iter().zip(&around.row(other)[start..][..width]);
                let differences = cells.filter(|(steps, _)| **steps > 0).map(|(&steps, &before)| {
                    u64::from(if before == 0 { alone } else { steps.abs_diff(before) })
                });
                differences.sum()
            };
            (top..bottom).map(of_row).sum()
        };
        vectors.push(candidates.iter().copied().min_by_key(|vector| cost(*vector)).unwrap_or_default());
    }
    vectors
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::parse;
    use crate::scanner::hdl64::project_nearest;
    use crate::scanner::ideal;
    use crate::study::synth::{SynthConfig, drive};

    fn coder(method: Method, scanner: &Hdl64) -> Coder<'_> {
        Coder { method, scanner, registration: RegistrationConfig::default() }
    }

    fn images(scanner: &Hdl64, frames: usize) -> Vec<RangeImage> {
        let config = SynthConfig { frames, thinning: 4, ..SynthConfig::default() };
        let image = |cloud| project_nearest(scanner, &cloud).image;
        drive(&config).map(|frame| image(parse(&frame.name, frame.to_bin()).cloud)).collect()
    }

    #[test]
    fn key_frames_come_before_those_between_them() {
        let scanner = ideal(64, 1000);
        let turn = |frame, sources, nearer| Turn { frame, sources, nearer };
        let key = |frame| turn(frame, [None, None], 0);
        let turns = coder(Method::Slam, &scanner).order(6);
        let keys = [key(0), key(3)];
        assert_eq!(turns[..2], keys);
        assert_eq!((turns[2].frame, turns[2].sources), (5, [None, None]), "the last of the run");
        let both = |first, second| [Some(first), Some(second)];
        assert_eq!(turns[3..], [turn(1, both(0, 3), 0), turn(2, both(0, 3), 1), turn(4, both(3, 5), 0)]);
        let video: Vec<_> =
            coder(Method::Video, &scanner).order(3).into_iter().map(|turn| turn.sources).collect();
        assert_eq!(video, [[None, None], [Some(0), None], [Some(1), None]]);
    }

    #[test]
    fn ranges_come_back_within_the_error_that_was_aimed_at() {
        let scanner = ideal(500, 1000);
        let images = images(&scanner, 4);
        for method in [Method::Video, Method::Slam] {
            let coder = coder(method, &scanner);
            let mut before = usize::MAX;
            for metres in [0.01, 0.1] {
                let payloads = coder.encode(&images, Aim::Error(metres)).unwrap();
                let decoded = coder.decode(&payloads).unwrap();
                for (image, decoded) in images.iter().zip(&decoded) {
                    assert!(image.occupancy() == decoded.occupancy());
                    let signed = |image: &RangeImage| image.steps.map(|&steps| steps as i32);
                    let returns = image.occupancy();
                    let error = coder.rmse(&signed(image), &signed(decoded), &returns, image.returns());
                    assert!(error <= metres && error > 0.8 * metres, "{method:?}: {error} of {metres}");
                }
                let bytes = payloads.iter().map(Vec::len).sum();
                assert!(bytes < before, "{method:?}: a larger error costs less");
                before = bytes;
            }
        }
    }

    #[test]
    fn motion_makes_frames_between_key_frames_smaller() {
        let scanner = ideal(500, 1000);
        let payloads = coder(Method::Slam, &scanner).encode(&images(&scanner, 4), Aim::Error(0.05)).unwrap();
        let lengths: Vec<_> = payloads.iter().map(Vec::len).collect();
        assert!(
            lengths[1..3].iter().all(|length| length < lengths.first().min(lengths.last()).unwrap()),
            "{lengths:?}"
        );
    }

    #[test]
    fn bits_are_those_of_the_image() {
        let scanner = ideal(500, 1000);
        let images = images(&scanner, 1);
        let coder = coder(Method::Video, &scanner);
        let [few, many] =
            [1.0, 5.0].map(|bits| coder.encode(&images, Aim::Bits(bits)).unwrap()[0].len() as f64);
        let difference = 4.0 * images[0].returns() as f64 / 8.0;
        assert!((many - few - difference).abs() < 0.1 * difference, "{few} {many} {difference}");
    }

    #[test]
    fn blocks_are_found_where_they_have_moved_to() {
        let (rows, columns) = (32, 320);
        let image = |turn: usize| {
            let mut image = RangeImage::new(rows, (0..columns as u32).collect());
            for row in 0..rows {
                for (column, steps) in image.steps.row_mut(row).iter_mut().enumerate() {
                    let place = (column + turn) % columns;
                    *steps = 1000 + ((place * place * 7 + row * 31) % 997) as u32;
                }
            }
            image
        };
        let found = vectors(&image(0), &image(9));
        assert_eq!(found, vec![[0, 9]; 2 * columns / BLOCK]);
        assert_eq!(shifted(&image(0), &found).steps, image(9).steps);
    }

    #[test]
    fn damaged_frames_are_errors() {
        let scanner = ideal(100, 10_000);
        let coder = coder(Method::Video, &scanner);
        let payloads = coder.encode(&images(&scanner, 1), Aim::Bits(2.0)).unwrap();
        let half = payloads[0][..payloads[0].len() / 2].to_vec();
        assert!(coder.decode(&[half]).is_err());
        assert!(coder.decode(&[Vec::new()]).is_err());
    }
}

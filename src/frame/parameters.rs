//! How a frame is coded: what a decoder must know before the frame's other sections, and the properties of
//! the original file for reports. FORMAT.md 8.10.

use std::fmt;
use std::ops::RangeInclusive;

use super::fidelity::{IntensityFidelity, PositionFidelity};
use super::modelling::Modelling;
use crate::article::image_coding::ImageCodec;
use crate::backend::{self, Packing};
use crate::container::{CodedFrame, FrameHeader, SectionKind};
use crate::ground::error::{Error, Result};
use crate::ground::grid::Grid;
use crate::ground::varint::{read_signed, read_unsigned, read_within, write_signed, write_unsigned};
use crate::inter::registration::QuantisedPose;
use crate::scanner::{LEAST_RANGE_BITS, Scanner};

/// The section's name in errors.
pub(super) const PART: &str = "frame parameters";

/// The parameters of a frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameParameters {
    /// How positions are restored.
    pub positions: PositionFidelity,
    /// How intensities are restored.
    pub intensity: IntensityFidelity,
    /// How the ranges are predicted.
    pub prediction: Prediction,
    /// The motion of the scanner since the frame before; only if it is used to predict the ranges.
    pub motion: QuantisedPose,
    /// Whether a back-end gets the differences along the snake's path (article, V-C).
    pub snake: bool,
    /// The coder of the ranges.
    pub range_coder: RangeCoder,
    /// Whether the halves of the range image are coded separately; only with the context coder.
    pub halved: bool,
    /// Properties of the original file, if the decoded one differs from it.
    pub source: Option<OriginalFile>,
}

/// The prediction of the ranges of a range image before they are coded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Prediction {
    /// No prediction: the coder gets the ranges themselves.
    #[default]
    None,
    /// Regions of ground and objects, and their models (article, IV-C).
    Intra,
    /// An earlier frame of the group, moved like the scanner (article, V).
    Inter,
}

/// The coder of the ranges or their residuals.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RangeCoder {
    /// The context coder, for ranges below 2 to the power of `range_bits`.
    Context {
        /// The modelling of the ranges, and of the parts of the frame that are coded along with them.
        modelling: Modelling,
        /// From 16 to 24.
        range_bits: u32,
        /// Bin width in steps: ranges decode to the middle of their bin; with 1, every range decodes to
        /// itself.
        bin: u32,
        /// Whether decoded ranges are half a step too long, because the middle of an even number of steps is
        /// between two steps.
        between: bool,
    },
    /// A back-end.
    Backend {
        /// Its number in the registry.
        id: u8,
        /// How the residuals are packed for it.
        packing: Packing,
    },
    /// An image coder; the ranges may differ from the scan's.
    Image(ImageCodec),
}

/// The file from which a frame was encoded, and what happened to its points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OriginalFile {
    /// Bytes of the file.
    pub file_size: u64,
    /// Points in the file.
    pub points: u64,
    /// Points removed by the outlier filter (equation 1).
    pub outliers: u64,
    /// Points lost because a nearer one took their cell, or because the image has no cell for them.
    pub lost: u64,
}

impl Default for FrameParameters {
    fn default() -> Self {
        FrameParameters {
            positions: PositionFidelity::Exact,
            intensity: IntensityFidelity::Exact,
            prediction: Prediction::None,
            motion: QuantisedPose::default(),
            snake: false,
            range_coder: RangeCoder::EXACT,
            halved: false,
            source: None,
        }
    }
}

/// Coder numbers below this are the context coder with the modelling of that number.
const BACKENDS: u64 = 32;
/// Coder numbers from [`BACKENDS`] on are back-ends, offset by that; from here on, image coders.
const JPEG: u64 = 64;
const JPEG_2000: u64 = 65;
/// The widest bin, in steps.
const WIDEST_BIN: u32 = 1 << 20;
/// The range bits that the context coder accepts.
const RANGE_BITS: RangeInclusive<u64> = 16..=24;

impl FrameParameters {
    /// The payload of the section.
    pub fn to_payload(&self) -> Vec<u8> {
        let mut payload = Vec::new();
        self.write_to(&mut payload);
        payload
    }

    fn write_to(&self, out: &mut Vec<u8>) {
        self.positions.write_to(out);
        self.intensity.write_to(out);
        write_unsigned(out, self.prediction.to_code());
        if self.prediction == Prediction::Inter {
            self.motion.values.iter().for_each(|&value| write_signed(out, i64::from(value)));
        }
        write_unsigned(out, u64::from(self.snake));
        match self.range_coder {
            RangeCoder::Context { modelling, range_bits, bin, between } => {
                write_unsigned(out, modelling.to_code());
                write_unsigned(out, u64::from(range_bits));
                write_unsigned(out, u64::from(bin));
                write_unsigned(out, u64::from(between));
                write_unsigned(out, u64::from(self.halved));
            }
            RangeCoder::Backend { id, packing } => {
                write_unsigned(out, BACKENDS + u64::from(id));
                write_unsigned(out, u64::from(packing.to_code()));
            }
            RangeCoder::Image(codec) => write_unsigned(out, image_code(codec)),
        }
        write_unsigned(out, u64::from(self.source.is_some()));
        if let Some(OriginalFile { file_size, points, outliers, lost }) = self.source {
            [file_size, points, outliers, lost].into_iter().for_each(|count| write_unsigned(out, count));
        }
    }

    /// Reads the payload of the section.
    ///
    /// # Errors
    /// If it is cut short, too long, or holds a value that this program does not know.
    pub fn from_payload(mut bytes: &[u8]) -> Result<Self> {
        if bytes.is_empty() {
            return Err(Error::corrupt("frame parameters: the section is missing"));
        }
        let input = &mut bytes;
        let positions = PositionFidelity::read_from(input)?;
        let intensity = IntensityFidelity::read_from(input)?;
        let prediction = Prediction::from_code(read(input)?)?;
        let mut motion = QuantisedPose::default();
        if prediction == Prediction::Inter {
            motion = read_pose(input)?;
        }
        let snake = flag(input)?;
        let range_coder = RangeCoder::read_from(input)?;
        let halved = matches!(range_coder, RangeCoder::Context { .. }) && flag(input)?;
        let source = if flag(input)? { Some(OriginalFile::read_from(input)?) } else { None };
        if !input.is_empty() {
            return Err(Error::corrupt("frame parameters: bytes left over"));
        }
        Ok(FrameParameters { positions, intensity, prediction, motion, snake, range_coder, halved, source })
    }

    /// The modelling of the ranges, and of the parts that are coded along with them.
    pub(crate) fn modelling(&self) -> Modelling {
        match self.range_coder {
            RangeCoder::Context { modelling, .. } => modelling,
            RangeCoder::Backend { .. } | RangeCoder::Image(_) => Modelling::Light,
        }
    }

    /// Whether a P frame uses only the same cells of the frame before if the scanner has not moved, because
    /// computing surfaces takes time.
    pub(crate) fn can_do_without_surfaces(&self) -> bool {
        matches!(self.range_coder, RangeCoder::Context { modelling: Modelling::Light, .. })
    }

    /// The parameters of a coded frame.
    ///
    /// # Errors
    /// If they are damaged, unknown to this program, or not before all other sections.
    pub fn of(frame: &CodedFrame) -> Result<Self> {
        let first = frame.sections.iter().find(|section| !section.kind.is_skippable());
        let first = first.filter(|section| section.kind == SectionKind::Parameters);
        Self::from_payload(first.map_or(&[], |section| &section.payload))
    }
}

impl FrameParameters {
    /// The original file of the frame with this header.
    pub fn original_of(&self, header: &FrameHeader) -> OriginalFile {
        self.source.unwrap_or(OriginalFile::all_points(header.file_size, header.point_count))
    }

    /// How accurately points are restored, in words.
    pub fn fidelity(&self) -> String {
        let FrameParameters { positions, intensity, .. } = self;
        match intensity {
            IntensityFidelity::Rounded { .. } => format!("{positions}, {intensity}"),
            IntensityFidelity::Exact | IntensityFidelity::None => positions.to_string(),
        }
    }
}

/// A short form, such as `exact, context` or `range image, intra, snake, lzma, planes`.
impl fmt::Display for FrameParameters {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.fidelity())?;
        f.write_str(match self.prediction {
            Prediction::None => "",
            Prediction::Intra => ", intra",
            Prediction::Inter => ", inter",
        })?;
        if self.snake {
            f.write_str(", snake")?;
        }
        match self.range_coder {
            RangeCoder::Context { modelling, .. } => write!(f, ", context{}", modelling.suffix()),
            RangeCoder::Backend { id, packing } => match backend::by_id(id) {
                Ok(backend) => write!(f, ", {}, {}", backend.name(), packing.name()),
                Err(_) => write!(f, ", back-end {id}, {}", packing.name()),
            },
            RangeCoder::Image(codec) => write!(f, ", {}", codec.name()),
        }
    }
}

fn image_code(codec: ImageCodec) -> u64 {
    match codec {
        ImageCodec::Jpeg => JPEG,
        ImageCodec::Jpeg2000 => JPEG_2000,
    }
}

impl Prediction {
    fn to_code(self) -> u64 {
        match self {
            Prediction::None => 0,
            Prediction::Intra => 1,
            Prediction::Inter => 2,
        }
    }

    fn from_code(code: u64) -> Result<Self> {
        match code {
            0 => Ok(Prediction::None),
            1 => Ok(Prediction::Intra),
            2 => Ok(Prediction::Inter),
            _ => Err(Error::unsupported(format!("frame parameters: unknown prediction {code}"))),
        }
    }
}

impl RangeCoder {
    /// The context coder with exact ranges; other parts are coded as in the frames of back-ends.
    pub const EXACT: Self = RangeCoder::of_modelling(Modelling::Light);

    /// The context coder with exact ranges and this modelling.
    pub(crate) const fn of_modelling(modelling: Modelling) -> Self {
        RangeCoder::Context { modelling, range_bits: LEAST_RANGE_BITS, bin: 1, between: false }
    }

    /// This coder with ranges to within half a bin of `bin` steps, if it is the context coder.
    pub(crate) fn in_bins(self, bin: u32) -> Self {
        match self {
            RangeCoder::Context { modelling, range_bits, .. } => {
                RangeCoder::Context { modelling, range_bits, bin, between: bin.is_multiple_of(2) }
            }
            RangeCoder::Backend { .. } | RangeCoder::Image(_) => self,
        }
    }

    /// The coder for ranges that were decoded with this one: they are coded exactly.
    pub(crate) fn of_decoded(self) -> Self {
        match self {
            RangeCoder::Context { modelling, range_bits, between, .. } => {
                RangeCoder::Context { modelling, range_bits, bin: 1, between }
            }
            RangeCoder::Backend { .. } | RangeCoder::Image(_) => self,
        }
    }

    /// Increases the number of range bits for these ranges, in steps, if necessary.
    pub(crate) fn fit(&mut self, steps: &Grid<u32>) {
        if let RangeCoder::Context { range_bits, .. } = self {
            let most = steps.cells().iter().copied().max().unwrap_or(0);
            *range_bits = (*range_bits).max(32 - most.leading_zeros());
        }
    }

    /// The difference between the range represented by decoded steps and the steps themselves, in metres.
    pub(crate) fn offset_m(self, scanner: &Scanner) -> f64 {
        match self {
            RangeCoder::Context { between: true, .. } => -0.5 * scanner.range_step_m(),
            RangeCoder::Context { .. } | RangeCoder::Backend { .. } | RangeCoder::Image(_) => 0.0,
        }
    }

    fn read_from(input: &mut &[u8]) -> Result<Self> {
        match read(input)? {
            coder @ ..BACKENDS => Ok(RangeCoder::Context {
                modelling: Modelling::from_code(coder)?,
                range_bits: read_within(input, "frame parameters: bits of a range", RANGE_BITS)? as u32,
                bin: read_within(input, "frame parameters: steps a bin", 1..=WIDEST_BIN.into())? as u32,
                between: flag(input)?,
            }),
            coder @ BACKENDS..JPEG => {
                let code = read(input)?;
                let packing = u8::try_from(code).ok().and_then(Packing::from_code);
                let unknown = || Error::unsupported(format!("frame parameters: unknown packing {code}"));
                let id = (coder - BACKENDS) as u8;
                Ok(RangeCoder::Backend { id, packing: packing.ok_or_else(unknown)? })
            }
            JPEG => Ok(RangeCoder::Image(ImageCodec::Jpeg)),
            JPEG_2000 => Ok(RangeCoder::Image(ImageCodec::Jpeg2000)),
            other => Err(Error::unsupported(format!("frame parameters: unknown coder {other}"))),
        }
    }
}

impl OriginalFile {
    /// A file with this size and number of points, none of which is lost.
    pub(crate) fn all_points(file_size: u64, points: u64) -> Self {
        OriginalFile { file_size, points, ..OriginalFile::default() }
    }

    /// Adds the counts of another file.
    pub fn add(&mut self, other: &OriginalFile) {
        self.file_size = self.file_size.saturating_add(other.file_size);
        self.points = self.points.saturating_add(other.points);
        self.outliers = self.outliers.saturating_add(other.outliers);
        self.lost = self.lost.saturating_add(other.lost);
    }

    fn read_from(input: &mut &[u8]) -> Result<Self> {
        Ok(OriginalFile {
            file_size: read(input)?,
            points: read(input)?,
            outliers: read(input)?,
            lost: read(input)?,
        })
    }
}

fn read_pose(input: &mut &[u8]) -> Result<QuantisedPose> {
    let mut pose = QuantisedPose::default();
    for value in &mut pose.values {
        let read = read_signed(input, PART)?;
        *value = i32::try_from(read).map_err(|_| Error::corrupt("frame parameters: no such motion"))?;
    }
    Ok(pose)
}

fn read(input: &mut &[u8]) -> Result<u64> {
    read_unsigned(input, PART)
}

fn flag(input: &mut &[u8]) -> Result<bool> {
    match read(input)? {
        value @ 0..2 => Ok(value == 1),
        other => Err(Error::unsupported(format!("frame parameters: unknown choice {other}"))),
    }
}

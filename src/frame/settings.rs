//! The coder controller (article, III-H): all settings of the encoder in one place.

use super::fidelity::{
    IntensityFidelity, MOST_INTENSITY_STEP_MILLIONTHS, MOST_MAX_ERROR_UM, PositionFidelity,
};
use super::levels::{self, InterChoice, LevelSettings};
use super::modelling::Modelling;
use super::parameters::{FrameParameters, Prediction, RangeCoder};
use super::sections::Effort;
use crate::article::image_coding::{ImageCodec, ImageConfig, Rate};
use crate::article::outlier::RadiusOutlier;
use crate::article::prediction::intra::{IntraConfig, RegionModels};
use crate::article::segmentation::SegmentationConfig;
use crate::backend::{self, Compressors, Level, Packing};
use crate::files::HeaderlessLayout;
use crate::ground::error::{Error, Result};
use crate::inter::registration::{QuantisedPose, RegistrationConfig};
use crate::scanner::{FLOAT_RANGES, MOST_RANGE_STEP_UM, MOST_TICKS};

/// Presets of the coder controller.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// Every file is restored byte for byte, whatever it contains.
    #[default]
    Exact,
    /// Every point is restored, at its index in the file, within a bound of its original position.
    Bounded {
        /// The bound on the 3-D distance, in micrometres: 1 to [`MOST_MAX_ERROR_UM`].
        max_error_um: u32,
    },
    /// The article's codec: outliers are removed, and the ideal scanner's range image is coded.
    Paper,
}

/// The range image to be coded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProjectionKind {
    /// That of the scanner fitted to the sequence: no point is lost.
    Calibrated {
        /// Range step in micrometres; `None`: the scanner's own step, which is lossless.
        range_step_um: Option<u32>,
    },
    /// The article's (IV-A): 64 rows at the published elevations, or those of the fitted scanner if it is of
    /// the `firings` family; equally spaced columns.
    Ideal {
        /// Columns in a turn.
        columns: u32,
        /// Range step in micrometres; [`FLOAT_RANGES`] for float32.
        range_step_um: u32,
    },
}

impl ProjectionKind {
    /// The calibrated image, with the scanner's own steps.
    pub const CALIBRATED: Self = ProjectionKind::Calibrated { range_step_um: None };

    fn has_float_ranges(self) -> bool {
        matches!(self, ProjectionKind::Ideal { range_step_um: FLOAT_RANGES, .. })
    }
}

/// Which frames of a group may be predicted from the one before (article, Fig. 2).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FrameOrder {
    /// Compression rate first: I P P P and so on.
    #[default]
    Ratio,
    /// Time first: I P I P and so on.
    Time,
}

/// How the prediction of ranges is chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PredictionChoice {
    /// The same prediction for every frame, as chosen by the user. [`Prediction::Inter`]: each P frame from
    /// the frame before or, if that is smaller, as an I frame; that is, from regions or by context.
    Always(Prediction),
    /// For each frame, the prediction that makes it smallest.
    Smallest,
    /// Each P frame from the frame before, if the motion of the scanner can be estimated, even if an I frame
    /// would be smaller, as in the article's experiments; I frames as with `Always(Inter)`.
    EveryReference,
}

/// The coder of the ranges.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Coder {
    /// The context coder.
    #[default]
    Context,
    /// A back-end, by its number in the registry.
    Backend(u8),
    /// An image coder, which is lossy.
    Image(ImageCodec),
}

/// Settings of the encoder.
#[derive(Clone, Debug, PartialEq)]
pub struct EncoderConfig {
    /// Frames in a group: more compress better, fewer make seeking and recovery finer. Default 10; 30 at
    /// level 9.
    pub gop: usize,
    /// Number of groups coded at the same time; 0, the default, means one for each processor. The stream does
    /// not depend on it.
    pub threads: usize,
    /// The filter of points with few neighbours (equation 1). Default: none; in paper mode, points with fewer
    /// than 2 neighbours within 0.38 m are removed.
    pub outliers: Option<RadiusOutlier>,
    /// The fields of files without a header. Default: KITTI's and nuScenes', depending on the extension.
    pub headerless: Option<HeaderlessLayout>,
    /// The range image to be coded (equation 2). Default: calibrated; in paper mode ideal, with 2000 columns
    /// and steps of 1 mm.
    pub projection: ProjectionKind,
    /// How positions are restored. Default: exactly; in paper mode they are those of the formula, in bounded
    /// mode within the bound.
    pub positions: PositionFidelity,
    /// How intensities are restored. Default: exactly; in paper mode they are left out, as in the article.
    pub intensity: IntensityFidelity,
    /// How the ranges are predicted. Default: whichever makes each frame smallest; in paper mode, as in the
    /// article, from regions (IV-C) in I frames and from the frame before (V) in P frames.
    pub prediction: PredictionChoice,
    /// Which frames are P frames. Default: all except the first of a group.
    pub order: FrameOrder,
    /// How the motion of the scanner is estimated (V-B).
    pub registration: RegistrationConfig,
    /// Whether a back-end gets the differences along the snake's path (V-C). Default: yes, since this makes
    /// residuals smaller whatever the prediction. Image coders never get them, as their errors would add up
    /// along the path.
    pub snake: bool,
    /// Images with at least this many returns are coded in two halves, which two threads can do in parallel.
    /// Default 90,000: for smaller images the gain is not worth the cost of separate models that learn from
    /// half the returns each.
    pub halved_from: usize,
    /// How ground and objects are distinguished (equations 3 and 4).
    pub segmentation: SegmentationConfig,
    /// How regions are modelled (equations 5 to 7).
    pub intra: IntraConfig,
    /// The coder of the ranges. Default: the context coder; in paper mode LZMA.
    pub coder: Coder,
    /// Effort of the context coder, which does not have every level, or of a back-end. Default 6.
    pub level: Level,
    /// How residuals are packed for a back-end. `None`, the default: the packing that suits it best.
    pub packing: Option<Packing>,
    /// The bit rate of an image coder, and the number of its passes.
    pub image: ImageConfig,
}

impl Default for EncoderConfig {
    fn default() -> Self {
        EncoderConfig::preset(Mode::Exact)
    }
}

/// Largest number of frames in a group, all of which are in memory before the group is encoded.
pub const MOST_FRAMES_OF_GROUP: u32 = 100_000;

/// Columns and range step of the article's range image.
const PAPER_PROJECTION: ProjectionKind = ProjectionKind::Ideal { columns: 2000, range_step_um: 1000 };

impl EncoderConfig {
    /// The settings of a mode.
    pub fn preset(mode: Mode) -> Self {
        let exact = EncoderConfig {
            gop: levels::GOP,
            threads: 0,
            headerless: None,
            outliers: None,
            projection: ProjectionKind::CALIBRATED,
            positions: PositionFidelity::Exact,
            intensity: IntensityFidelity::Exact,
            prediction: PredictionChoice::Smallest,
            order: FrameOrder::default(),
            registration: RegistrationConfig::default(),
            snake: true,
            halved_from: 90_000,
            segmentation: SegmentationConfig::default(),
            intra: IntraConfig::default(),
            coder: Coder::Context,
            level: Level::default(),
            packing: None,
            image: ImageConfig::default(),
        };
        match mode {
            Mode::Exact => exact,
            Mode::Bounded { max_error_um } => {
                let positions = PositionFidelity::Bounded { max_error_um, on_grid: false };
                EncoderConfig { positions, ..exact }
            }
            Mode::Paper => EncoderConfig {
                outliers: Some(RadiusOutlier::default()),
                projection: PAPER_PROJECTION,
                positions: PositionFidelity::Formula,
                intensity: IntensityFidelity::None,
                prediction: PredictionChoice::Always(Prediction::Inter),
                coder: Coder::Backend(backend::LZMA),
                ..exact
            },
        }
    }

    /// The default prediction with this coder: whichever makes a frame smallest, or, with a back-end or an
    /// image coder in paper mode, as in the article.
    pub fn default_prediction(&self) -> PredictionChoice {
        match (self.coder, self.positions) {
            (Coder::Backend(_) | Coder::Image(_), PositionFidelity::Formula) => {
                PredictionChoice::Always(Prediction::Inter)
            }
            _ => PredictionChoice::Smallest,
        }
    }

    /// The meaning of the level for the coder. [`check`](Self::check) rejects levels without one.
    fn level_settings(&self) -> LevelSettings {
        match self.coder {
            Coder::Context => levels::settings_of(self.level).unwrap_or(levels::OTHER_CODERS),
            Coder::Backend(_) | Coder::Image(_) => levels::OTHER_CODERS,
        }
    }

    /// The default number of frames in a group, for the coder at its level.
    pub fn default_gop(&self) -> usize {
        self.level_settings().gop
    }

    /// The context coder's modelling at this level.
    pub(crate) fn modelling(&self) -> Modelling {
        self.level_settings().modelling
    }

    /// Which general-purpose compressors are tried where models may do worse.
    pub(crate) fn compressors(&self) -> Compressors {
        self.level_settings().compressors
    }

    /// The effort of the coders of a frame.
    pub(crate) fn effort(&self) -> Effort {
        Effort { level: self.level, compressors: self.compressors(), image: self.image }
    }

    /// The number of frames to which the scanner is fitted.
    pub(crate) fn sample_frames(&self) -> usize {
        self.level_settings().sample_frames
    }

    /// When a frame is predicted from the one before it; frames of a group are counted from 0.
    pub(crate) fn inter_choice(&self, frame_of_group: usize) -> InterChoice {
        let is_turn = match self.order {
            FrameOrder::Ratio => frame_of_group > 0,
            FrameOrder::Time => frame_of_group % 2 == 1,
        };
        match self.prediction {
            _ if !is_turn => InterChoice::Never,
            PredictionChoice::Always(Prediction::None | Prediction::Intra) => InterChoice::Never,
            PredictionChoice::Smallest => self.level_settings().inter,
            PredictionChoice::Always(Prediction::Inter) | PredictionChoice::EveryReference => {
                InterChoice::IfItFits
            }
        }
    }

    /// The predictions that are tried for a frame, of which the smallest result is used. `fit` is how much of
    /// the frame before fits it, from 0 to 1, if it may be predicted from that. Intra is tried only if
    /// `has_regions`.
    pub(crate) fn predictions(&self, fit: Option<f64>, has_regions: bool) -> Vec<Prediction> {
        /// From this fit on, a trial without the reference is not worth the time, as the models ignore a
        /// useless reference.
        const SURE: f64 = 0.5;
        let mut tried = match (self.prediction, self.coder) {
            (PredictionChoice::EveryReference, _) if fit.is_some() => vec![],
            (PredictionChoice::Always(Prediction::Intra), _) => vec![Prediction::Intra],
            (_, Coder::Context) if fit.is_some_and(|fit| fit > SURE) => vec![],
            (PredictionChoice::Always(Prediction::None), _) | (_, Coder::Context) => vec![Prediction::None],
            (PredictionChoice::Always(Prediction::Inter) | PredictionChoice::EveryReference, _) => {
                vec![Prediction::Intra]
            }
            (PredictionChoice::Smallest, _) => vec![Prediction::None, Prediction::Intra],
        };
        if fit.is_some() {
            tried.push(Prediction::Inter);
        }
        if !has_regions {
            tried.retain(|prediction| *prediction != Prediction::Intra);
        }
        if tried.is_empty() {
            tried.push(Prediction::None);
        }
        tried
    }

    /// Whether motion compensation is undone. Paper mode codes scans as they are, like the article.
    pub(crate) fn undoes_compensation(&self) -> bool {
        self.positions != PositionFidelity::Formula
    }

    /// The parameters of a frame, as far as they do not depend on it.
    pub(crate) fn frame_parameters(&self) -> Result<FrameParameters> {
        Ok(FrameParameters {
            positions: self.positions,
            intensity: self.intensity,
            prediction: Prediction::None,
            motion: QuantisedPose::default(),
            snake: self.snake && matches!(self.coder, Coder::Backend(_)),
            halved: false,
            range_coder: match self.coder {
                Coder::Context => RangeCoder::of_modelling(self.modelling()),
                Coder::Backend(id) => {
                    RangeCoder::Backend { id, packing: self.packing.unwrap_or(backend::by_id(id)?.packing()) }
                }
                Coder::Image(codec) => RangeCoder::Image(codec),
            },
            source: None,
        })
    }

    /// Whether every file is restored byte for byte.
    pub fn is_exact(&self) -> bool {
        (self.positions, self.intensity) == (PositionFidelity::Exact, IntensityFidelity::Exact)
    }

    /// Checks that all settings are in range and fit together.
    ///
    /// # Errors
    /// [`Error::InvalidSettings`] names the setting that does not.
    pub fn check(&self) -> Result<()> {
        let gop = 1..=MOST_FRAMES_OF_GROUP as usize;
        require(gop.contains(&self.gop), "a group holds 1 to 100,000 frames")?;
        let needs_article = self.outliers.is_some() || matches!(self.coder, Coder::Image(_));
        require(
            cfg!(feature = "article") || !needs_article,
            "outliers and image coders need the feature `article`, which was not built",
        )?;
        self.check_fidelity()?;
        self.check_level()?;
        self.check_projection()?;
        self.check_prediction()?;
        if let Coder::Image(codec) = self.coder {
            self.check_image_coder(codec)?;
        }
        self.segmentation.check()?;
        self.intra.check()?;
        self.registration.check()?;
        self.frame_parameters().map(|_| ())
    }

    /// Checks the required fidelity, and that no other setting contradicts it.
    fn check_fidelity(&self) -> Result<()> {
        let drops = self.outliers.is_some()
            || self.projection != ProjectionKind::CALIBRATED
            || self.intensity == IntensityFidelity::None;
        match (self.positions, self.intensity) {
            (PositionFidelity::Formula | PositionFidelity::Exact, IntensityFidelity::Rounded { .. }) => {
                wrong("intensities are rounded in bounded mode only")
            }
            (_, IntensityFidelity::Rounded { step_millionths })
                if !(1..=MOST_INTENSITY_STEP_MILLIONTHS).contains(&step_millionths) =>
            {
                wrong("the step of intensities is from 0.000001 to 1000")
            }
            (PositionFidelity::Exact, _) if drops => {
                wrong("exact mode keeps every point and intensity; use paper mode to drop any")
            }
            (PositionFidelity::Bounded { .. }, _) if drops => {
                wrong("bounded mode keeps every point; use paper mode to drop any")
            }
            (PositionFidelity::Bounded { max_error_um, .. }, _)
                if !(1..=MOST_MAX_ERROR_UM).contains(&max_error_um) =>
            {
                wrong("the largest error is from 1 micrometre to 10 metres")
            }
            (PositionFidelity::Bounded { .. }, _) if self.coder != Coder::Context => {
                wrong("bounded mode needs the context coder; general-purpose back-ends know no bound")
            }
            _ => Ok(()),
        }
    }

    fn check_level(&self) -> Result<()> {
        if self.coder != Coder::Context || levels::settings_of(self.level).is_some() {
            return Ok(());
        }
        let (level, numbers) = (self.level.number(), levels::numbers());
        wrong(&format!("the context coder has no level {level}; choose one of {numbers}"))
    }

    fn check_projection(&self) -> Result<()> {
        let (columns, step) = match self.projection {
            ProjectionKind::Ideal { columns, range_step_um } => (columns, range_step_um),
            ProjectionKind::Calibrated { range_step_um: Some(FLOAT_RANGES) } => {
                return wrong("the calibrated image has ranges in steps");
            }
            ProjectionKind::Calibrated { range_step_um } => (1, range_step_um.unwrap_or(1)),
        };
        require((1..=MOST_TICKS).contains(&u64::from(columns)), "an image has 1 to 360000 columns")?;
        require(u64::from(step) <= MOST_RANGE_STEP_UM, "a range step is at most 1 m")?;
        require(
            self.coder != Coder::Context || !self.projection.has_float_ranges(),
            "the context coder takes ranges in steps; choose a step or another back-end",
        )
    }

    fn check_prediction(&self) -> Result<()> {
        let (is_intra, is_inter) = match self.prediction {
            PredictionChoice::Always(prediction) => {
                (prediction == Prediction::Intra, prediction == Prediction::Inter)
            }
            PredictionChoice::EveryReference => (false, true),
            PredictionChoice::Smallest => (false, false),
        };
        require(
            self.coder != Coder::Context || !is_intra,
            "the context coder predicts by itself, and better than regions do",
        )?;
        require(
            !is_inter || self.modelling().has_p_frames(),
            "levels 1 to 3 take every frame by itself; inter prediction needs level 6 or more",
        )?;
        let fits_regions = self.predictions(None, true).contains(&Prediction::Intra)
            && self.intra.models == RegionModels::Fitted;
        require(
            !fits_regions || !self.projection.has_float_ranges(),
            "regions are fitted to ranges in steps; choose a step, or the article's regions",
        )
    }

    fn check_image_coder(&self, codec: ImageCodec) -> Result<()> {
        let float_ranges = "image coders take ranges in steps; choose a step or another back-end";
        require(!self.projection.has_float_ranges(), float_ranges)?;
        match (codec, self.image.rate, self.positions) {
            (ImageCodec::Jpeg, Rate::Lossless, _) => {
                wrong("jpeg always loses something; choose a rate, or jpeg2000")
            }
            (_, Rate::Bits(_), PositionFidelity::Exact) => {
                wrong("exact mode loses nothing; choose the mode paper, or jpeg2000 at the rate lossless")
            }
            _ => self.image.check(),
        }
    }
}

/// An error about a setting.
fn wrong(what: &str) -> Result<()> {
    Err(Error::InvalidSettings(what.to_owned()))
}

fn require(holds: bool, what: &str) -> Result<()> {
    if holds { Ok(()) } else { wrong(what) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_in_range() {
        assert!(EncoderConfig::preset(Mode::Exact).check().is_ok());
        assert!(EncoderConfig::preset(Mode::Bounded { max_error_um: 10_000 }).check().is_ok());
        assert!(EncoderConfig::preset(Mode::Paper).check().is_ok());
    }

    #[test]
    fn p_frames_can_be_forced() {
        let forced = |coder| EncoderConfig {
            coder,
            prediction: PredictionChoice::EveryReference,
            ..EncoderConfig::preset(Mode::Paper)
        };
        let lzma = forced(Coder::Backend(backend::LZMA));
        assert_eq!(lzma.predictions(Some(0.1), true), [Prediction::Inter]);
        assert_eq!(lzma.predictions(None, true), [Prediction::Intra]);
        assert_eq!(forced(Coder::Context).predictions(Some(0.1), true), [Prediction::Inter]);
        assert_eq!(forced(Coder::Context).predictions(None, true), [Prediction::None]);
        assert_eq!(lzma.inter_choice(1), InterChoice::IfItFits);
        assert_eq!(lzma.inter_choice(0), InterChoice::Never);
        assert!(forced(Coder::Context).check().is_ok() && lzma.check().is_ok());
    }

    #[test]
    fn settings_out_of_range_are_refused() {
        let exact = EncoderConfig::default;
        let paper = || EncoderConfig::preset(Mode::Paper);
        let bounded = || EncoderConfig::preset(Mode::Bounded { max_error_um: 10_000 });
        let ideal = |columns, range_step_um| ProjectionKind::Ideal { columns, range_step_um };
        for wrong in [
            EncoderConfig { gop: 0, ..exact() },
            EncoderConfig { intensity: IntensityFidelity::None, ..exact() },
            EncoderConfig { outliers: Some(RadiusOutlier::default()), ..exact() },
            EncoderConfig { projection: PAPER_PROJECTION, ..exact() },
            EncoderConfig { projection: ideal(0, 1000), ..paper() },
            EncoderConfig { projection: ideal(2000, 1_000_001), ..paper() },
            EncoderConfig { coder: Coder::Backend(200), ..paper() },
            EncoderConfig { level: Level::new(4).unwrap(), ..exact() },
            EncoderConfig::preset(Mode::Bounded { max_error_um: 0 }),
            EncoderConfig { coder: Coder::Backend(backend::LZMA), ..bounded() },
            EncoderConfig { intensity: IntensityFidelity::None, ..bounded() },
            EncoderConfig { intensity: IntensityFidelity::Rounded { step_millionths: 1 }, ..exact() },
        ] {
            assert!(wrong.check().is_err(), "{wrong:?}");
        }
    }
}

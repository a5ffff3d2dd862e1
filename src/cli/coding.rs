//! The options of the coder controller: a mode, and each choice by itself.

use crate::article::image_coding::{ImageCodec, Rate};
use crate::article::residual::Packing;
use crate::backend::{self, Level};
use crate::files::HeaderlessLayout;
use crate::frame::settings::{Coder, EncoderConfig, FrameOrder, Mode, PredictionChoice, ProjectionKind};
use crate::frame::{Intensity, Prediction};
use crate::ground::error::{Error, Result};
use crate::inter::registration::RegistrationMethod;
use crate::scanner::FLOAT_RANGES;
use clap::error::ErrorKind;
use clap::{Args, CommandFactory, ValueEnum};

use super::args::Threads;
use super::length::Length;
use super::regions::RegionArgs;

/// How to code. What is not given is as the mode has it.
#[derive(Clone, Debug, Args)]
pub struct CodingArgs {
    /// What decoding promises. Default: exact, or bounded if --max-error is given.
    #[arg(long, value_enum)]
    pub mode: Option<ModeArg>,
    /// Bounded mode: how far a decoded point may be from its original, such as 10mm or 2cm.
    #[arg(long, value_name = "LENGTH")]
    pub max_error: Option<Length>,
    /// Bounded mode: round intensities to multiples of this, in the file's unit, such as 0.05.
    #[arg(long, value_name = "STEP")]
    pub intensity_step: Option<IntensityStep>,
    /// What codes the ranges.
    #[arg(long, value_name = "NAME", value_parser = backend_names())]
    pub backend: Option<String>,
    /// Effort, 1 (fast) to 9 (small). Default 6. The context coder has 1, 2, 3, 6, 7, 8 and 9: from 8 on frames are
    /// predicted from those before, from 6 on where the scanner stands still.
    #[arg(long, value_name = "1..9")]
    pub level: Option<u8>,
    /// What ranges are predicted from.
    #[arg(long, value_enum, value_name = "FROM")]
    pub predict: Option<PredictArg>,
    /// Give a general-purpose back-end what prediction leaves as it is, not as the differences along the
    /// snake's path.
    #[arg(long)]
    pub no_snake: bool,
    /// How residuals are laid out for a general-purpose back-end.
    #[arg(long, value_name = "NAME", value_parser = packing_names())]
    pub packing: Option<String>,
    /// What jpeg or jpeg2000 may spend on ranges: bits for each return, on average, or `lossless`. Default 2.
    #[arg(long, value_name = "BITS")]
    pub rate: Option<RateArg>,
    /// Passes of jpeg or jpeg2000 at most, each of what those before leave: 1 to 8. Default 2.
    #[arg(long, value_name = "N")]
    pub passes: Option<u8>,
    /// Which frames may be predicted from the one before.
    #[arg(long, value_enum, value_name = "ORDER", default_value = "ratio")]
    pub order: OrderArg,
    /// How the scanner's motion from the frame before is found.
    #[arg(long, value_enum, value_name = "METHOD")]
    pub registration: Option<RegistrationArg>,
    /// Frames a group. Groups are decoded apart: more frames compress better, fewer seek faster. Default 10,
    /// and 30 at level 9.
    #[arg(long, value_name = "FRAMES", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub gop: Option<u32>,
    /// What a record of a file without a header (.bin) holds: a letter for each float32, x, y, z,
    /// i(ntensity), r(ing), t(ime), _ for another; or a list of fields with their types, such as
    /// x,y,z,intensity:u8,ring:u16,time:f64,_:u8*4. Default: xyzi, and xyzir for .pcd.bin.
    #[arg(long, value_name = "FIELDS")]
    pub layout: Option<HeaderlessLayout>,
    /// Paper mode: the range image to keep; the calibrated one loses no point.
    #[arg(long, value_enum, value_name = "KIND", help_heading = "Paper mode")]
    pub projection: Option<ProjectionArg>,
    /// Columns of the ideal range image; 2000 are 0.18 degrees each.
    #[arg(long, value_name = "N", help_heading = "Paper mode")]
    pub columns: Option<u32>,
    /// Range step of the range image, such as 1mm or 1cm, or, of the ideal one, `float` for float32 ranges.
    #[arg(long, value_name = "LENGTH", help_heading = "Paper mode")]
    pub step: Option<StepArg>,
    /// Whether intensities are kept.
    #[arg(long, value_enum, help_heading = "Paper mode")]
    pub intensity: Option<IntensityArg>,
    /// Keep outliers.
    #[arg(long, help_heading = "Paper mode")]
    pub keep_outliers: bool,
    /// Points with fewer neighbours are outliers.
    #[arg(long, value_name = "N", help_heading = "Paper mode")]
    pub outlier_neighbours: Option<usize>,
    /// How far neighbours are at most.
    #[arg(long, value_name = "LENGTH", help_heading = "Paper mode")]
    pub outlier_radius: Option<Length>,
    #[command(flatten)]
    pub regions: RegionArgs,
}

/// What decoding promises.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum ModeArg {
    /// Every file comes back byte for byte, whatever it holds.
    Exact,
    /// Every point comes back in its place, no farther than --max-error from where it was.
    Bounded,
    /// The article's codec: drops outliers, keeps the range image of an ideal sensor.
    Paper,
}

/// How a motion is found.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum RegistrationArg {
    /// Surfaces are compared with what is seen in their place.
    Projective,
    /// Points are compared with the nearest points: the article's ICP.
    Icp,
}

/// Which frames of a group are P frames.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum OrderArg {
    /// All but the first: smallest.
    Ratio,
    /// Every other one: less to compute.
    Time,
}

/// What ranges are predicted from.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum PredictArg {
    /// Nothing.
    None,
    /// Ground and objects.
    Intra,
    /// The frame before, moved as the scanner has.
    Inter,
    /// Of these, what makes each frame smallest.
    Auto,
    /// The frame before in every P frame, also where ground and objects make it smaller.
    Forced,
}

/// Which range image.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum ProjectionArg {
    /// 64 rows at published elevations, or the lasers that are found, by --columns.
    Ideal,
    /// The one that exact mode codes.
    Calibrated,
}

/// What becomes of intensities.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum IntensityArg {
    /// They are kept exactly.
    Exact,
    /// They decode to 0.
    None,
}

/// A range step, in micrometres.
#[derive(Clone, Copy, Debug)]
pub struct StepArg(u32);

impl std::str::FromStr for StepArg {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        match text {
            "float" => Ok(StepArg(FLOAT_RANGES)),
            _ => text.parse().map(|Length(micrometres)| StepArg(micrometres)),
        }
    }
}

/// A step of intensities, in millionths of the file's unit.
#[derive(Clone, Copy, Debug)]
pub struct IntensityStep(u32);

impl std::str::FromStr for IntensityStep {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let wrong = |_| format!("'{text}' is no number");
        let millionths = (text.parse::<f64>().map_err(wrong)? * 1e6).round();
        if !(1.0..=1e9).contains(&millionths) {
            return Err(format!("'{text}' is not from 0.000001 to 1000"));
        }
        Ok(IntensityStep(millionths as u32))
    }
}

/// What image coders may spend.
#[derive(Clone, Copy, Debug)]
pub struct RateArg(Rate);

impl std::str::FromStr for RateArg {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        match text {
            "lossless" => Ok(RateArg(Rate::Lossless)),
            _ => text
                .parse()
                .map(|bits| RateArg(Rate::Bits(bits)))
                .map_err(|_| "no number, nor `lossless`".to_owned()),
        }
    }
}

/// The name of the context coder among the back-ends.
const CONTEXT: &str = "context";

fn backend_names() -> Vec<&'static str> {
    let backends = backend::BACKENDS.iter().map(|backend| backend.name());
    std::iter::once(CONTEXT).chain(backends).chain(ImageCodec::ALL.map(ImageCodec::name)).collect()
}

fn packing_names() -> Vec<&'static str> {
    Packing::ALL.iter().map(|packing| packing.name()).collect()
}

/// The encoder's settings; ends the program, as for all wrong usage, if they do not fit together.
pub fn config(coding: &CodingArgs, threads: &Threads) -> EncoderConfig {
    coding
        .config(threads.threads)
        .unwrap_or_else(|error| super::args::Args::command().error(ErrorKind::ArgumentConflict, error).exit())
}

/// As [`config`], in paper mode whatever the mode.
pub fn paper_config(coding: &CodingArgs, threads: &Threads) -> EncoderConfig {
    config(&CodingArgs { mode: Some(ModeArg::Paper), ..coding.clone() }, threads)
}

impl CodingArgs {
    /// The encoder's settings.
    ///
    /// # Errors
    /// If the choices do not fit together.
    fn config(&self, threads: usize) -> Result<EncoderConfig> {
        let mut config = EncoderConfig::preset(self.preset()?);
        if let Some(IntensityStep(step_millionths)) = self.intensity_step {
            config.intensity = Intensity::Rounded { step_millionths };
        }
        config.threads = threads;
        config.headerless = self.layout.clone();
        self.choose_coder(&mut config)?;
        self.choose_image(&mut config)?;
        self.choose_outliers(&mut config);
        self.regions.choose(&mut config);
        config.check()?;
        Ok(config)
    }

    /// The mode, by its name or by the options that belong to it.
    fn preset(&self) -> Result<Mode> {
        let wrong = |what: &str| Err(Error::InvalidSettings(what.to_owned()));
        match (self.mode, self.max_error) {
            (Some(ModeArg::Bounded) | None, Some(Length(max_error_um))) => Ok(Mode::Bounded { max_error_um }),
            (Some(ModeArg::Bounded), None) => wrong("--mode bounded needs a bound, as by --max-error 10mm"),
            (_, Some(_)) => wrong("--max-error is for --mode bounded"),
            (Some(ModeArg::Exact) | None, None) => Ok(Mode::Exact),
            (Some(ModeArg::Paper), None) => Ok(Mode::Paper),
        }
    }

    fn choose_coder(&self, config: &mut EncoderConfig) -> Result<()> {
        if let Some(name) = &self.backend {
            config.coder = match (backend::by_name(name), ImageCodec::by_name(name)) {
                (Some(backend), _) => Coder::Backend(backend.id()),
                (None, Some(codec)) => Coder::Image(codec),
                (None, None) => Coder::Context,
            };
            config.prediction = config.default_prediction();
        }
        if let Some(predict) = self.predict {
            config.prediction = match predict {
                PredictArg::None => PredictionChoice::Always(Prediction::None),
                PredictArg::Intra => PredictionChoice::Always(Prediction::Intra),
                PredictArg::Inter => PredictionChoice::Always(Prediction::Inter),
                PredictArg::Auto => PredictionChoice::Smallest,
                PredictArg::Forced => PredictionChoice::EveryReference,
            };
        }
        config.order = match self.order {
            OrderArg::Ratio => FrameOrder::Ratio,
            OrderArg::Time => FrameOrder::Time,
        };
        config.registration.method = match self.registration {
            Some(RegistrationArg::Icp) => RegistrationMethod::Icp,
            Some(RegistrationArg::Projective) | None => RegistrationMethod::Projective,
        };
        config.snake = !self.no_snake;
        self.check_options_of(config.coder)?;
        if let Some(RateArg(rate)) = self.rate {
            config.image.rate = rate;
        }
        config.image.passes = self.passes.unwrap_or(config.image.passes);
        if let Some(level) = self.level {
            config.level = Level::new(level)
                .ok_or_else(|| Error::InvalidSettings(format!("level {level} is not from 1 to 9")))?;
        }
        config.gop = self.gop.map_or(config.default_gop(), |gop| gop as usize);
        if let Some(name) = &self.packing {
            config.packing = Packing::ALL.iter().copied().find(|packing| packing.name() == name);
        }
        Ok(())
    }

    /// Refuses options that are for other coders.
    fn check_options_of(&self, coder: Coder) -> Result<()> {
        let for_backends = [("--packing", self.packing.is_some())];
        let for_images = [("--rate", self.rate.is_some()), ("--passes", self.passes.is_some())];
        let refuse = |options: &[(&str, bool)], whose: &str| match options.iter().find(|(_, is)| *is) {
            Some((name, _)) => {
                Err(Error::InvalidSettings(format!("{name} is for {whose}; choose one by --backend")))
            }
            None => Ok(()),
        };
        if !matches!(coder, Coder::Backend(_)) {
            refuse(&for_backends, "general-purpose back-ends")?;
        }
        if matches!(coder, Coder::Image(_)) {
            refuse(&[("--level", self.level.is_some())], "coders without --rate")?;
        } else {
            refuse(&for_images, "jpeg and jpeg2000")?;
        }
        Ok(())
    }

    fn choose_image(&self, config: &mut EncoderConfig) -> Result<()> {
        match self.projection {
            Some(ProjectionArg::Calibrated) => config.projection = ProjectionKind::CALIBRATED,
            Some(ProjectionArg::Ideal) => {
                config.projection = EncoderConfig::preset(Mode::Paper).projection;
            }
            None => {}
        }
        match &mut config.projection {
            ProjectionKind::Ideal { columns, range_step_um } => {
                *columns = self.columns.unwrap_or(*columns);
                *range_step_um = self.step.map_or(*range_step_um, |step| step.0);
            }
            ProjectionKind::Calibrated { .. } if self.columns.is_some() => {
                let what = "the calibrated range image has the sensor's own columns; \
                            --columns needs --mode paper";
                return Err(Error::InvalidSettings(what.to_owned()));
            }
            ProjectionKind::Calibrated { range_step_um } => *range_step_um = self.step.map(|step| step.0),
        }
        if let Some(intensity) = self.intensity {
            config.intensity = match intensity {
                IntensityArg::Exact => Intensity::Exact,
                IntensityArg::None => Intensity::None,
            };
        }
        Ok(())
    }

    fn choose_outliers(&self, config: &mut EncoderConfig) {
        if self.keep_outliers {
            config.outliers = None;
            return;
        }
        if self.outlier_neighbours.is_some() || self.outlier_radius.is_some() {
            let mut filter = config.outliers.unwrap_or_default();
            filter.neighbours = self.outlier_neighbours.unwrap_or(filter.neighbours);
            filter.radius_m = self.outlier_radius.map_or(filter.radius_m, Length::metres);
            config.outliers = Some(filter);
        }
    }
}

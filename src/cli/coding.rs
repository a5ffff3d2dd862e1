//! The options of the coder controller: a mode, and individual settings.

use std::str::FromStr;

use crate::article::image_coding::{ImageCodec, Rate};
use crate::article::prediction::intra::RegionModels;
use crate::backend::{self, Level, Packing};
use crate::files::HeaderlessLayout;
use crate::frame::settings::{
    Coder, EncoderConfig, FrameOrder, MOST_FRAMES_OF_GROUP, Mode, PredictionChoice, ProjectionKind,
};
use crate::frame::{IntensityFidelity, MOST_INTENSITY_STEP_MILLIONTHS, Prediction};
use crate::ground::error::{Error, Result};
use crate::inter::registration::RegistrationMethod;
use crate::scanner::FLOAT_RANGES;
use clap::{Args, ValueEnum};

/// How to code. Options that are not given take the mode's defaults.
#[derive(Clone, Debug, Args)]
pub struct CodingArgs {
    /// Largest error of a point, such as 10mm or 2cm. Default: exact.
    ///
    /// The error is the 3-D distance of a decoded point from its original.
    #[arg(long, value_name = "LENGTH")]
    pub max_error: Option<Length>,
    /// Effort, also as -1 (fast) to -9 (small). Default: 6.
    ///
    /// The context coder has the levels 1, 2, 3, 6, 7, 8 and 9. From level 8 on, frames are predicted from
    /// the frame before; where the scanner stands still, from level 6 on.
    #[arg(long, value_name = "1..9", value_parser = level)]
    pub level: Option<Level>,
    /// Fields of .bin records, such as xyzirt. Default: xyzi.
    ///
    /// Default for .pcd.bin: xyzir. A letter for each float32: x, y, z, i(ntensity), r(ing), t(ime), _ for
    /// another; or a list of fields with their types, such as x,y,z,intensity:u8,ring:u16,time:f64,_:u8*4.
    /// Without --layout, `encode` examines the files and reports if their records have another length.
    #[arg(long, value_name = "FIELDS")]
    pub layout: Option<HeaderlessLayout>,
    /// What decoding guarantees. Default: bounded with --max-error, else exact.
    #[arg(long, value_enum, hide_short_help = true, help_heading = "Coding")]
    pub mode: Option<ModeArg>,
    /// Bounded mode: round intensities to multiples of this step, in the file's unit, such as 0.05. Default:
    /// exact.
    #[arg(long, value_name = "STEP", hide_short_help = true, help_heading = "Coding")]
    pub intensity_step: Option<IntensityStep>,
    /// Frames in a group. Default: 10, or 30 at level 9.
    ///
    /// Groups are decoded independently: longer groups compress better, shorter ones allow faster random
    /// access.
    #[arg(long, value_name = "FRAMES", value_parser = clap::value_parser!(u32).range(1..=MOST_FRAMES_OF_GROUP.into()),
          hide_short_help = true, help_heading = "Coding")]
    pub gop: Option<u32>,
    /// Coder of the ranges. Default: context; in paper mode lzma.
    #[arg(long, value_name = "NAME", value_parser = backend_names(), hide_short_help = true, help_heading = "Coding")]
    pub backend: Option<String>,
    /// Prediction of ranges. Default: auto; in paper mode, with a coder other than context, inter.
    #[arg(long, value_enum, value_name = "FROM", hide_short_help = true, help_heading = "Coding")]
    pub predict: Option<PredictArg>,
    /// Which frames of a group may be P frames, predicted from the frame before.
    #[arg(
        long,
        value_enum,
        value_name = "ORDER",
        default_value = "ratio",
        hide_short_help = true,
        help_heading = "Coding"
    )]
    pub order: OrderArg,
    /// Registration method, which estimates the motion of the scanner since the frame before. Default:
    /// projective.
    #[arg(long, value_enum, value_name = "METHOD", hide_short_help = true, help_heading = "Coding")]
    pub registration: Option<RegistrationArg>,
    /// Pass prediction residuals to a general-purpose back-end as they are, not as differences along the
    /// snake's path.
    #[arg(long, hide_short_help = true, help_heading = "Coding")]
    pub no_snake: bool,
    /// Byte layout of residuals for a general-purpose back-end. Default: the best one for the back-end.
    #[arg(long, value_name = "NAME", value_parser = packing_names(), hide_short_help = true, help_heading = "Coding")]
    pub packing: Option<String>,
    /// Rate of jpeg or jpeg2000: average bits for the range of a return, or `lossless`. Default: 2.
    #[arg(long, value_name = "BITS", hide_short_help = true, help_heading = "Coding")]
    pub rate: Option<RateArg>,
    /// Maximum number of jpeg or jpeg2000 passes, 1 to 8; each codes the residual of the passes before.
    /// Default: 2.
    #[arg(long, value_name = "N", hide_short_help = true, help_heading = "Coding")]
    pub passes: Option<u8>,
    /// Range image of paper mode; the calibrated one loses no point. Default: ideal.
    #[arg(long, value_enum, value_name = "KIND", hide_short_help = true, help_heading = "Paper mode")]
    pub projection: Option<ProjectionArg>,
    /// Columns of the ideal range image. Default: 2000, of 0.18 degrees each.
    #[arg(long, value_name = "N", hide_short_help = true, help_heading = "Paper mode")]
    pub columns: Option<u32>,
    /// Range step of the range image, such as 1mm or 1cm; the ideal image also allows `float` for float32
    /// ranges. Default: 1mm for the ideal image, the step of the scanner for the calibrated one.
    #[arg(long, value_name = "LENGTH", hide_short_help = true, help_heading = "Paper mode")]
    pub step: Option<StepArg>,
    /// Whether intensities are kept. Default: none; in the other modes exact.
    #[arg(long, value_enum, hide_short_help = true, help_heading = "Paper mode")]
    pub intensity: Option<IntensityArg>,
    /// Keep outliers.
    #[arg(long, hide_short_help = true, help_heading = "Paper mode")]
    pub keep_outliers: bool,
    /// Points with fewer neighbours than this are outliers. Default: 2.
    #[arg(long, value_name = "N", hide_short_help = true, help_heading = "Paper mode")]
    pub outlier_neighbours: Option<usize>,
    /// Radius within which points count as neighbours. Default: 0.38m.
    #[arg(long, value_name = "LENGTH", hide_short_help = true, help_heading = "Paper mode")]
    pub outlier_radius: Option<Length>,
    #[command(flatten)]
    pub regions: RegionArgs,
}

/// How ground and objects are found and modelled. Options that are not given take the mode's defaults.
#[derive(Clone, Debug, Args)]
pub struct RegionArgs {
    /// Largest angle at which ground rises, in degrees (equation 3). Default: 10.
    #[arg(long, value_name = "DEGREES", hide_short_help = true, help_heading = REGIONS)]
    pub ground_angle: Option<f64>,
    /// Largest rise of the ground from one return to the next above it. Default: 0.4m.
    #[arg(long, value_name = "LENGTH", hide_short_help = true, help_heading = REGIONS)]
    pub ground_rise: Option<Length>,
    /// Ground returns closer together than this may be up to three returns apart. Default: 2m.
    #[arg(long, value_name = "LENGTH", hide_short_help = true, help_heading = REGIONS)]
    pub ground_reach: Option<Length>,
    /// Angle above which neighbours belong to the same object, in degrees (equation 4). Default: 10.
    #[arg(long, value_name = "DEGREES", hide_short_help = true, help_heading = REGIONS)]
    pub cluster_angle: Option<f64>,
    /// Minimum number of returns of an object. Default: 20.
    #[arg(long, value_name = "N", hide_short_help = true, help_heading = REGIONS)]
    pub smallest_cluster: Option<usize>,
    /// How regions are formed. Default: article.
    #[arg(long, value_enum, value_name = "KIND", hide_short_help = true, help_heading = REGIONS)]
    pub regions: Option<RegionsArg>,
    /// Lambda of equation 5, for fitted regions: the squared error, in steps, that one bit is worth.
    /// Default: 1000.
    #[arg(long, value_name = "LAMBDA", hide_short_help = true, help_heading = REGIONS)]
    pub lambda: Option<f64>,
    /// Largest distance from the ground plane at which points support it. Default: 0.15m.
    #[arg(long, value_name = "LENGTH", hide_short_help = true, help_heading = REGIONS)]
    pub plane_tolerance: Option<Length>,
    /// Expected share of ground points that support the ground plane. Default: 0.5.
    #[arg(long, value_name = "SHARE", hide_short_help = true, help_heading = REGIONS)]
    pub plane_support: Option<f64>,
    /// Required probability of finding a plane through three supporting points. Default: 0.99.
    #[arg(long, value_name = "SHARE", hide_short_help = true, help_heading = REGIONS)]
    pub plane_confidence: Option<f64>,
    /// Seed of the random choices in the plane search. Default: 1.
    #[arg(long, value_name = "S", hide_short_help = true, help_heading = REGIONS)]
    pub plane_seed: Option<u64>,
}

/// The heading of the options of regions in the help.
const REGIONS: &str = "Regions of intra prediction";

/// A level on the command line.
fn level(text: &str) -> std::result::Result<Level, &'static str> {
    text.parse().ok().and_then(Level::new).ok_or("a level is a number from 1 (fast) to 9 (small)")
}

/// What decoding guarantees.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum ModeArg {
    /// Every file is restored byte for byte, whatever it holds.
    Exact,
    /// Every point is restored, in the same order and no farther than --max-error from its original position.
    Bounded,
    /// The article's codec: drops outliers, keeps the range image of an ideal scanner.
    Paper,
}

/// Registration methods.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum RegistrationArg {
    /// Projects the surfaces of the frame before into the range image and compares them with it.
    Projective,
    /// Matches points to their nearest neighbours: the article's ICP.
    Icp,
}

/// Which frames of a group are P frames.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum OrderArg {
    /// All but the first: smallest output.
    Ratio,
    /// Every other one: faster.
    Time,
}

/// Predictions of ranges.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum PredictArg {
    /// No prediction.
    None,
    /// From ground and objects.
    Intra,
    /// From the frame before, moved as the scanner moved.
    Inter,
    /// Whichever of these makes the frame smallest, frame by frame.
    Auto,
    /// From the frame before in every P frame, even where ground and objects would make it smaller.
    Forced,
}

/// Kinds of range images.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum ProjectionArg {
    /// 64 rows at published elevations, or a row for each fitted laser; --columns columns.
    Ideal,
    /// The range image that exact mode codes.
    Calibrated,
}

/// Whether intensities are kept.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum IntensityArg {
    /// Intensities are kept exactly.
    Exact,
    /// Intensities decode to 0.
    None,
}

/// Kinds of regions.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum RegionsArg {
    /// The article's: the mean of each object, a plane for the ground.
    Article,
    /// Split and merged at the lowest cost, each with its mean or a plane.
    Fitted,
}

/// A length, in micrometres.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Length(pub u32);

impl Length {
    /// The length in metres.
    pub fn metres(self) -> f64 {
        f64::from(self.0) * 1e-6
    }
}

impl FromStr for Length {
    type Err = String;

    /// Reads `2mm`, `1.5 cm` or `0.38m`.
    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let wrong = || format!("'{text}' is not a length; give one as 2mm, 1.5cm or 0.38m");
        let (number, unit_um) = [("um", 1.0), ("mm", 1e3), ("cm", 1e4), ("m", 1e6)]
            .into_iter()
            .find_map(|(unit, um)| Some((text.strip_suffix(unit)?, um)))
            .ok_or_else(wrong)?;
        let micrometres = number.trim().parse::<f64>().map_err(|_| wrong())? * unit_um;
        let whole = micrometres.round();
        if !(1.0..=1e9).contains(&whole) {
            return Err(format!("'{text}' is not from 1um to 1000m"));
        }
        if (micrometres - whole).abs() > 1e-6 * whole {
            return Err(format!("'{text}' is not a whole number of micrometres"));
        }
        Ok(Length(whole as u32))
    }
}

/// A range step, in micrometres.
#[derive(Clone, Copy, Debug)]
pub struct StepArg(u32);

impl FromStr for StepArg {
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

impl FromStr for IntensityStep {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let wrong = |_| format!("'{text}' is not a number");
        let millionths = (text.parse::<f64>().map_err(wrong)? * 1e6).round();
        if !(1.0..=f64::from(MOST_INTENSITY_STEP_MILLIONTHS)).contains(&millionths) {
            return Err(format!("'{text}' is not from 0.000001 to 1000"));
        }
        Ok(IntensityStep(millionths as u32))
    }
}

/// Rate of the image coders.
#[derive(Clone, Copy, Debug)]
pub struct RateArg(Rate);

impl FromStr for RateArg {
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

impl CodingArgs {
    /// The same options, but in paper mode.
    pub fn in_paper_mode(&self) -> Self {
        CodingArgs { mode: Some(ModeArg::Paper), ..self.clone() }
    }

    /// The encoder's settings.
    ///
    /// # Errors
    /// If the options do not fit together.
    pub fn config(&self, threads: usize) -> Result<EncoderConfig> {
        let mut config = EncoderConfig::preset(self.preset()?);
        if let Some(IntensityStep(step_millionths)) = self.intensity_step {
            config.intensity = IntensityFidelity::Rounded { step_millionths };
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

    /// The mode, from its name or from the options that imply it.
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
        config.level = self.level.unwrap_or(config.level);
        config.gop = self.gop.map_or(config.default_gop(), |gop| gop as usize);
        if let Some(name) = &self.packing {
            config.packing = Packing::ALL.iter().copied().find(|packing| packing.name() == name);
        }
        Ok(())
    }

    /// Rejects options that belong to other coders.
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
                let what = "the calibrated range image has the scanner's own columns; \
                            --columns needs --mode paper";
                return Err(Error::InvalidSettings(what.to_owned()));
            }
            ProjectionKind::Calibrated { range_step_um } => *range_step_um = self.step.map(|step| step.0),
        }
        if let Some(intensity) = self.intensity {
            config.intensity = match intensity {
                IntensityArg::Exact => IntensityFidelity::Exact,
                IntensityArg::None => IntensityFidelity::None,
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

impl RegionArgs {
    /// Applies the given options to the settings.
    pub fn choose(&self, config: &mut EncoderConfig) {
        let segmentation = &mut config.segmentation;
        set(&mut segmentation.ground_angle, self.ground_angle);
        set(&mut segmentation.ground_rise_m, self.ground_rise.map(Length::metres));
        set(&mut segmentation.ground_reach_m, self.ground_reach.map(Length::metres));
        set(&mut segmentation.cluster_angle, self.cluster_angle);
        set(&mut segmentation.smallest_cluster, self.smallest_cluster);
        let intra = &mut config.intra;
        let models = self.regions.map(|regions| match regions {
            RegionsArg::Article => RegionModels::Article,
            RegionsArg::Fitted => RegionModels::Fitted,
        });
        set(&mut intra.models, models);
        set(&mut intra.lambda, self.lambda);
        set(&mut intra.ransac.tolerance_m, self.plane_tolerance.map(Length::metres));
        set(&mut intra.ransac.foreseeable_support, self.plane_support);
        set(&mut intra.ransac.confidence, self.plane_confidence);
        set(&mut intra.ransac.seed, self.plane_seed);
    }
}

fn set<T>(setting: &mut T, value: Option<T>) {
    if let Some(value) = value {
        *setting = value;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_read() {
        let read = |text: &str| text.parse::<Length>().ok().map(|length| length.0);
        assert_eq!(read("2mm"), Some(2000));
        assert_eq!(read("1.5 cm"), Some(15_000));
        assert_eq!(read("0.38m"), Some(380_000));
        assert_eq!(read("7um"), Some(7));
        for wrong in ["", "2", "mm", "-1mm", "0mm", "1.5um", "nanm", "infm", "2000m", "1e3", "1 km"] {
            assert_eq!(read(wrong), None, "{wrong:?}");
        }
    }
}

//! The options of segmentation and intra prediction.

use crate::article::prediction::intra::RegionModels;
use crate::frame::settings::EncoderConfig;
use clap::{Args, ValueEnum};

use super::length::Length;

/// How ground and objects are found and modelled. Options that are not given take the mode's defaults.
#[derive(Clone, Debug, Args)]
pub struct RegionArgs {
    /// Largest angle at which ground rises, in degrees (equation 3). Default: 10.
    #[arg(long, value_name = "DEGREES", hide_short_help = true, help_heading = HEADING)]
    pub ground_angle: Option<f64>,
    /// Largest rise of the ground from one return to the next above it. Default: 0.4m.
    #[arg(long, value_name = "LENGTH", hide_short_help = true, help_heading = HEADING)]
    pub ground_rise: Option<Length>,
    /// Ground returns closer together than this may be up to three returns apart. Default: 2m.
    #[arg(long, value_name = "LENGTH", hide_short_help = true, help_heading = HEADING)]
    pub ground_reach: Option<Length>,
    /// Angle above which neighbours belong to the same object, in degrees (equation 4). Default: 10.
    #[arg(long, value_name = "DEGREES", hide_short_help = true, help_heading = HEADING)]
    pub cluster_angle: Option<f64>,
    /// Minimum number of returns of an object. Default: 20.
    #[arg(long, value_name = "N", hide_short_help = true, help_heading = HEADING)]
    pub smallest_cluster: Option<usize>,
    /// How regions are formed. Default: article.
    #[arg(long, value_enum, value_name = "KIND", hide_short_help = true, help_heading = HEADING)]
    pub regions: Option<RegionsArg>,
    /// Lambda of equation 5, for fitted regions: the squared error, in steps, that one bit is worth. Default: 1000.
    #[arg(long, value_name = "LAMBDA", hide_short_help = true, help_heading = HEADING)]
    pub lambda: Option<f64>,
    /// Largest distance from the ground plane at which points support it. Default: 0.15m.
    #[arg(long, value_name = "LENGTH", hide_short_help = true, help_heading = HEADING)]
    pub plane_tolerance: Option<Length>,
    /// Expected share of ground points that support the ground plane. Default: 0.5.
    #[arg(long, value_name = "SHARE", hide_short_help = true, help_heading = HEADING)]
    pub plane_support: Option<f64>,
    /// Required probability of finding a plane through three supporting points. Default: 0.99.
    #[arg(long, value_name = "SHARE", hide_short_help = true, help_heading = HEADING)]
    pub plane_confidence: Option<f64>,
    /// Seed of the random choices in the plane search. Default: 1.
    #[arg(long, value_name = "S", hide_short_help = true, help_heading = HEADING)]
    pub plane_seed: Option<u64>,
}

/// Heading of these options in the help.
const HEADING: &str = "Regions of intra prediction";

/// Kinds of regions.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum RegionsArg {
    /// The article's: the mean of each object, a plane for the ground.
    Article,
    /// Split and merged at the lowest cost, each with its mean or a plane.
    Fitted,
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

//! The options of segmentation and intra prediction.

use crate::article::prediction::intra::RegionModels;
use crate::frame::settings::EncoderConfig;
use clap::{Args, ValueEnum};

use super::length::Length;

/// How ground and objects are found and modelled. What is not given is as the mode has it.
#[derive(Clone, Debug, Args)]
pub struct RegionArgs {
    /// Ground rises at a smaller angle, in degrees (equation 3). Default: 10.
    #[arg(long, value_name = "DEGREES", hide_short_help = true, help_heading = HEADING)]
    pub ground_angle: Option<f64>,
    /// Ground rises by less from one return to the next above it. Default: 0.4m.
    #[arg(long, value_name = "LENGTH", hide_short_help = true, help_heading = HEADING)]
    pub ground_rise: Option<Length>,
    /// Returns of the ground nearer to each other may be up to three returns apart. Default: 2m.
    #[arg(long, value_name = "LENGTH", hide_short_help = true, help_heading = HEADING)]
    pub ground_reach: Option<Length>,
    /// Neighbours at a larger angle belong to one object, in degrees (equation 4). Default: 10.
    #[arg(long, value_name = "DEGREES", hide_short_help = true, help_heading = HEADING)]
    pub cluster_angle: Option<f64>,
    /// The fewest returns of an object. Default: 20.
    #[arg(long, value_name = "N", hide_short_help = true, help_heading = HEADING)]
    pub smallest_cluster: Option<usize>,
    /// Which regions there are. Default: article.
    #[arg(long, value_enum, value_name = "KIND", hide_short_help = true, help_heading = HEADING)]
    pub regions: Option<RegionsArg>,
    /// Lambda of equation 5, for fitted regions: the squared error, in steps, that is worth one bit. Default: 1000.
    #[arg(long, value_name = "LAMBDA", hide_short_help = true, help_heading = HEADING)]
    pub lambda: Option<f64>,
    /// The largest distance from the ground's plane of points that support it. Default: 0.15m.
    #[arg(long, value_name = "LENGTH", hide_short_help = true, help_heading = HEADING)]
    pub plane_tolerance: Option<Length>,
    /// The share of the ground that is expected to support its plane. Default: 0.5.
    #[arg(long, value_name = "SHARE", hide_short_help = true, help_heading = HEADING)]
    pub plane_support: Option<f64>,
    /// The probability with which a plane of three supporting points is to be found. Default: 0.99.
    #[arg(long, value_name = "SHARE", hide_short_help = true, help_heading = HEADING)]
    pub plane_confidence: Option<f64>,
    /// Seed of the random choices of the plane's search. Default: 1.
    #[arg(long, value_name = "S", hide_short_help = true, help_heading = HEADING)]
    pub plane_seed: Option<u64>,
}

/// What help calls these options together.
const HEADING: &str = "Regions of intra prediction";

/// Which regions.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum RegionsArg {
    /// The article's: the mean of each object, a plane for the ground.
    Article,
    /// Split and merged, each with its mean or a plane, as costs least.
    Fitted,
}

impl RegionArgs {
    /// Puts what is given into the settings.
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

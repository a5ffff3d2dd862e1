//! The options of segmentation and intra prediction.

use crate::article::prediction::intra::RegionModels;
use crate::frame::settings::EncoderConfig;
use clap::{Args, ValueEnum};

use super::length::Length;

/// How ground and objects are found and modelled. What is not given is as the mode has it.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Regions of intra prediction")]
pub struct RegionArgs {
    /// Ground rises by less, in degrees (equation 3).
    #[arg(long, value_name = "DEGREES")]
    pub ground_angle: Option<f64>,
    /// Ground rises by less from one return to the next above it.
    #[arg(long, value_name = "LENGTH")]
    pub ground_rise: Option<Length>,
    /// Returns of the ground nearer to each other may be up to three apart.
    #[arg(long, value_name = "LENGTH")]
    pub ground_reach: Option<Length>,
    /// Neighbours at a larger angle are of one object, in degrees (equation 4).
    #[arg(long, value_name = "DEGREES")]
    pub cluster_angle: Option<f64>,
    /// Clusters of fewer returns are no objects.
    #[arg(long, value_name = "N")]
    pub smallest_cluster: Option<usize>,
    /// Which regions there are.
    #[arg(long, value_enum, value_name = "KIND")]
    pub regions: Option<RegionsArg>,
    /// Squared steps that a bit is worth to fitted regions (equation 5).
    #[arg(long, value_name = "LAMBDA")]
    pub lambda: Option<f64>,
    /// Points no further from the ground's plane support it.
    #[arg(long, value_name = "LENGTH")]
    pub plane_tolerance: Option<Length>,
    /// The share of the ground that is expected to support its plane.
    #[arg(long, value_name = "SHARE")]
    pub plane_support: Option<f64>,
    /// How sure to be that a plane of three supporting points was tried.
    #[arg(long, value_name = "SHARE")]
    pub plane_confidence: Option<f64>,
    /// Where the random choices of the plane's search start.
    #[arg(long, value_name = "S")]
    pub plane_seed: Option<u64>,
}

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

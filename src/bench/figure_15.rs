//! Figure 15 of the article: error against bit rate, of every way to code that there is.

use super::experiment;
use super::report::{Axis, Figure, Marker, Origin, Point, Scale, Section, Series};
use super::sample::Sample;
use crate::backend;
use crate::codec::{Coder, EncoderConfig, Intensity, Mode, Prediction, PredictionChoice, ProjectionKind};
use crate::error::Result;
use crate::metrics;
use crate::prediction::intra::{IntraConfig, RegionModels};
use crate::sensor::{FLOAT_RANGES, RANGE_STEP_UM};

/// Range steps of the curves, in micrometres.
const STEPS_UM: [u32; 7] = [1000, 2000, 5000, 10_000, 20_000, 50_000, 100_000];
/// Those of a quick look.
const QUICK_STEPS_UM: [u32; 3] = [2000, 10_000, 50_000];

/// A curve, or a point: ways to code that differ in one setting.
struct Curve {
    name: &'static str,
    marker: Marker,
    /// The setting in words, and all settings.
    points: Vec<(String, EncoderConfig)>,
}

/// All curves.
pub struct Curves(Vec<Curve>);

impl Curves {
    /// The curves, with the image's columns, the outlier filter and the regions as `base` has them; fewer
    /// points on each for a quick look.
    pub fn new(sample: &Sample, base: &EncoderConfig, quick: bool) -> Self {
        let steps: &[u32] = if quick { &QUICK_STEPS_UM } else { &STEPS_UM };
        let at = |step: u32, coder, prediction| EncoderConfig {
            projection: with_step(base.projection, step),
            coder,
            prediction,
            ..base.clone()
        };
        let by_step = |name, marker, coder, prediction| Curve {
            name,
            marker,
            points: steps.iter().map(|&step| (length(step), at(step, coder, prediction))).collect(),
        };
        let one = |name, marker, setting: &str, config| Curve {
            name,
            marker,
            points: vec![(setting.to_owned(), config)],
        };
        let lzma = Coder::Backend(backend::LZMA);
        let (intra, inter) = (PredictionChoice::Always(Prediction::Intra), PredictionChoice::EveryReference);
        let smallest = PredictionChoice::Smallest;
        let calibrated = |step: u32| EncoderConfig {
            projection: ProjectionKind::Calibrated { range_step_um: Some(step) },
            outliers: None,
            ..at(step, Coder::Context, smallest)
        };
        // So coarse a step leaves nothing of intensities.
        let intensity = Intensity::Rounded { step_millionths: u32::MAX };
        let bounded = |max_error_um| EncoderConfig {
            threads: base.threads,
            intensity,
            ..EncoderConfig::preset(Mode::Bounded { max_error_um })
        };
        let coarser = steps.iter().filter(|&&step| step >= RANGE_STEP_UM);
        let floats = |prediction| EncoderConfig {
            intra: IntraConfig { models: RegionModels::Article, ..base.intra },
            ..at(FLOAT_RANGES, lzma, prediction)
        };
        let mut curves = vec![by_step("LZMA, intra", Marker::Square, lzma, intra)];
        if sample.has_references() {
            curves.push(by_step("LZMA, inter", Marker::Triangle, lzma, inter));
        }
        curves.push(by_step("context, ideal image", Marker::Circle, Coder::Context, smallest));
        curves.push(Curve {
            name: "context, calibrated image",
            marker: Marker::Diamond,
            points: coarser.clone().map(|&step| (length(step), calibrated(step))).collect(),
        });
        curves.push(one("LZMA, intra, floats", Marker::Cross, "float", floats(intra)));
        if sample.has_references() {
            curves.push(one("LZMA, inter, floats", Marker::Plus, "float", floats(inter)));
        }
        curves.push(Curve {
            name: "bounded mode, without intensities",
            marker: Marker::TriangleDown,
            points: coarser.map(|&error| (length(error), bounded(error))).collect(),
        });
        let exact = EncoderConfig { threads: base.threads, ..EncoderConfig::preset(Mode::Exact) };
        curves.push(one("exact mode, whole files", Marker::Star, "", exact));
        Curves(curves)
    }

    /// Frames that are coded in all.
    pub fn frames_to_code(&self, sample: &Sample) -> usize {
        self.0.iter().map(|curve| curve.points.len()).sum::<usize>() * sample.inputs.len()
    }

    /// Measures all points.
    ///
    /// # Errors
    /// If a back-end's library fails.
    pub fn measure(&self, sample: &Sample, on_frame: &(dyn Fn() + Sync)) -> Result<Section> {
        let mut series = Vec::new();
        let (mut most_alone, mut lost) = (0.0f64, 0.0f64);
        for curve in &self.0 {
            let mut points = Vec::new();
            for (setting, config) in &curve.points {
                let Measured { bits, rmse, alone, dropped } = measure(sample, config, on_frame)?;
                most_alone = most_alone.max(alone);
                lost = lost.max(dropped);
                if let (Some(x), Some(y)) = (bits, rmse) {
                    points.push(Point { x, y, label: setting.clone() });
                }
            }
            if points.is_empty() {
                continue;
            }
            series.push(Series {
                name: curve.name.into(),
                origin: Origin::Measured,
                line: curve.points.len() > 1,
                marker: curve.marker,
                points,
            });
        }
        Ok(Section::Figure(Figure {
            number: "Figure 15".into(),
            title: "error against bit rate".into(),
            note: format!(
                "On {}, of each run all frames but the first, which is there to predict from. Bits are those of \
                 the coded frames, everything included, for each point that comes back. RMSE: equation 12 \
                 over the returns of both range images, the original's made of float32 ranges, or of the \
                 scanner's own steps of 2 mm for the calibrated image; at most {:.2} % of the returns are in one \
                 of them only. It leaves out what the projection itself does to the points: {:.1} % have no cell \
                 of their own or are outliers, and the ideal sensor's beams are not the scanner's. Exact mode has \
                 all points, in order, with intensities: its RMSE is that of points. Without a calibrated image, \
                 as of scans that were moved afterwards, there is no curve of it. The article's figure is a plot \
                 without values.",
                sample.describe(),
                100.0 * most_alone,
                100.0 * lost,
            ),
            x: Axis { name: "bit rate".into(), unit: "bits a point".into(), scale: Scale::Log },
            y: Axis { name: "RMSE".into(), unit: "m".into(), scale: Scale::Log },
            series,
        }))
    }
}

/// A point of a curve.
struct Measured {
    /// Bits for each point that comes back.
    bits: Option<f64>,
    /// Metres.
    rmse: Option<f64>,
    /// The part of the returns that only one of the range images has.
    alone: f64,
    /// The part of the points that were dropped.
    dropped: f64,
}

fn measure(sample: &Sample, config: &EncoderConfig, on_frame: &(dyn Fn() + Sync)) -> Result<Measured> {
    let coded = experiment::run(sample, config, on_frame)?;
    let frames = || sample.compared();
    let points = sample.points(frames());
    let decoded = frames().map(|frame| coded.frames[frame].decoded.header.point_count).sum();
    let distortion = coded.distortion(sample, config, frames());
    let ranges = &distortion.ranges;
    let alone = ranges.only_original + ranges.only_decoded;
    let sources = frames().filter_map(|frame| coded.frames[frame].decoded.source);
    let dropped: u64 = sources.map(|source| source.outliers + source.lost).sum();
    let part = |part: u64, whole: u64| part as f64 / whole.max(1) as f64;
    Ok(Measured {
        bits: metrics::bits_per_point(coded.bytes(frames()).round() as u64, decoded),
        rmse: distortion.rmse(),
        alone: part(alone, alone + ranges.compared),
        dropped: part(dropped, points),
    })
}

/// The ideal image with another step.
fn with_step(projection: ProjectionKind, step: u32) -> ProjectionKind {
    match projection {
        ProjectionKind::Ideal { columns, .. } => ProjectionKind::Ideal { columns, range_step_um: step },
        ProjectionKind::Calibrated { .. } => ProjectionKind::Calibrated { range_step_um: Some(step) },
    }
}

/// A length in words: `2 mm`, `1 cm`.
fn length(micrometres: u32) -> String {
    let units = [(10_000, "cm"), (1000, "mm"), (1, "\u{b5}m")];
    let fitting = units.into_iter().find(|(unit, _)| micrometres.is_multiple_of(*unit));
    fitting.map_or_else(String::new, |(unit, name)| format!("{} {name}", micrometres / unit))
}

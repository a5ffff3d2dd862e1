//! Figure 15 of the article: error against bit rate, for every coder available.

use super::experiment;
use super::report::{Axis, Figure, Marker, Origin, Point, Scale, Section, Series};
use super::rivals::{self, Rival, TU};
use super::sample::{Sample, returns_of};
use super::tu::{Aim, Method};
use crate::article::image_coding::{ImageCodec, ImageConfig, Rate};
use crate::article::prediction::intra::{IntraConfig, RegionModels};
use crate::backend;
use crate::frame::settings::{Coder, EncoderConfig, Mode, PredictionChoice, ProjectionKind};
use crate::frame::{IntensityFidelity, MOST_INTENSITY_STEP_MILLIONTHS, Prediction};
use crate::ground::error::Result;
use crate::scanner::FLOAT_RANGES;
use crate::scanner::hdl64::{Hdl64, RANGE_STEP_UM};
use crate::study::metrics;

/// Range steps of the curves, in micrometres.
const STEPS_UM: [u32; 7] = [1000, 2000, 5000, 10_000, 20_000, 50_000, 100_000];
/// The steps with `--quick`.
const QUICK_STEPS_UM: [u32; 3] = [2000, 10_000, 50_000];

/// Rates of image coders, in bits a return.
const RATES: [f64; 5] = [0.5, 1.0, 2.0, 4.0, 8.0];
/// The rates with `--quick`.
const QUICK_RATES: [f64; 2] = [1.0, 4.0];

/// Target errors of the coders of Tu et al., in metres.
const ERRORS_M: [f64; 6] = [0.002, 0.005, 0.01, 0.02, 0.05, 0.1];
/// The target errors with `--quick`.
const QUICK_ERRORS_M: [f64; 2] = [0.01, 0.05];

/// Errors at which curves are compared, in metres; the first that all coders reach is used.
const COMPARED_M: [f64; 6] = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5];

const INTRA: PredictionChoice = PredictionChoice::Always(Prediction::Intra);
const INTER: PredictionChoice = PredictionChoice::EveryReference;

/// A curve, or a point: settings of a coder that differ in one parameter.
struct Curve {
    name: &'static str,
    of: Whose,
    marker: Marker,
    /// The parameter's value in words, and all settings.
    points: Vec<(String, Setting)>,
}

/// The author of a coder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Whose {
    /// This program.
    Ours,
    /// The article, which describes it or compares its own coder with it.
    Article,
    /// Another author, by name.
    Other(&'static str),
}

impl Whose {
    /// The author and the name of a curve, in words.
    fn describe(self, curve: &str) -> String {
        match self {
            Whose::Ours => format!("lidarpc ({curve})"),
            Whose::Article => format!("the article's coders ({curve})"),
            Whose::Other(name) => name.to_owned(),
        }
    }
}

/// A coder and all of its settings.
enum Setting {
    /// A stream of this program.
    Stream(Box<EncoderConfig>),
    /// An octree, with the side of its voxels in micrometres.
    Octree(u32),
    /// A coder of Tu et al., with its target error in metres.
    Tu(Method, f64),
}

/// All curves.
pub struct Curves {
    /// The article's back-ends.
    article: Vec<Curve>,
    /// Other coders.
    others: Vec<Curve>,
}

impl Curves {
    /// The curves, with the columns of the image, the outlier filter and the regions of `base`; with fewer
    /// points each if `quick`.
    pub fn new(sample: &Sample, base: &EncoderConfig, quick: bool) -> Self {
        Curves { article: article_curves(sample, base, quick), others: other_curves(sample, base, quick) }
    }

    /// Number of frames to code in all.
    pub fn frames_to_code(&self, sample: &Sample) -> usize {
        let curves = self.article.iter().chain(&self.others);
        curves.map(|curve| curve.points.len()).sum::<usize>() * sample.inputs.len()
    }

    /// Measures all points; also says in one sentence which coder is best, if there is anything to compare.
    /// `base` and `scanner` are for the coders of Tu et al.
    ///
    /// # Errors
    /// If a back-end's library fails.
    pub fn measure(
        &self,
        sample: &Sample,
        scanner: &Hdl64,
        base: &EncoderConfig,
        on_frame: &(dyn Fn() + Sync),
    ) -> Result<(Vec<Section>, Option<String>)> {
        let measuring = Measuring { sample, scanner, base, on_frame };
        let (article, worst) = measuring.all(&self.article)?;
        let note = format!(
            "On {}, of each run all frames but the first, which is there to predict from. Bits are those of \
             the coded frames, everything included, for each return that comes back. RMSE: equation 12 over \
             the returns of both range images, the original's made of float32 ranges; at most {:.2} % of the \
             returns are in one of them only. It leaves out what the projection itself does to the points: \
             {:.1} % have no cell of their own or are outliers, and the ideal scanner's beams are not the \
             scanner's. Directly: nothing is predicted. In two passes, each of the error of those before, where \
             that leaves less. Floats: without loss. Tu-MPEG (blocks of the frame before) and Tu-SLAM (key frames, \
             moved) code the same range image, without the outlier filter, in JPEG 2000 instead of MPEG and JPEG. \
             The octree's RMSE is that of points, by place. The article's figure is a plot without values.",
            sample.describe(),
            100.0 * worst.alone,
            100.0 * worst.dropped,
        );
        let (others, _) = measuring.all(&self.others)?;
        let curves = self.article.iter().chain(&self.others);
        let measured = article.iter().chain(&others);
        let of =
            |series: &Series| curves.clone().find(|curve| curve.name == series.name).map(|curve| curve.of);
        let ahead = who_is_ahead(measured.filter_map(|series| Some((of(series)?, series))));
        let article = figure("Figure 15", "error against bit rate", note, article);
        let note = "As above, for coarser range steps. The calibrated image's RMSE is against ranges in the \
                    scanner's own steps of 2 mm. Bounded and exact mode have all points, in order; their RMSE \
                    is that of points. Exact mode has intensities too. Without a calibrated image, as of scans \
                    that were moved afterwards, there is no curve of it.";
        let others = figure("Figure 15, beyond", "other ways to spend bits", note.to_owned(), others);
        Ok((vec![article, others], ahead))
    }
}

/// The coder that takes the fewest bits at an error that all reach, and the ratio of the others' bits to its
/// own.
fn who_is_ahead<'a>(curves: impl Iterator<Item = (Whose, &'a Series)> + Clone) -> Option<String> {
    let mut parties: Vec<Whose> = Vec::new();
    for (of, _) in curves.clone() {
        if !parties.contains(&of) {
            parties.push(of);
        }
    }
    let best_of = |party: Whose, error: f64| {
        let own = curves.clone().filter(|(of, _)| *of == party);
        let own = own.filter_map(|(of, series)| Some((bits_at(&series.points, error)?, of, &series.name)));
        own.min_by(|a, b| a.0.total_cmp(&b.0))
    };
    let at = |error: &f64| -> Vec<_> { parties.iter().filter_map(|&party| best_of(party, *error)).collect() };
    let reached_by_all = |error: &&f64| at(error).len() == parties.len();
    let error = COMPARED_M.iter().find(reached_by_all)?;
    let mut best = at(error);
    best.sort_by(|a, b| a.0.total_cmp(&b.0));
    let [(fewest, first, curve), others @ ..] = &best[..] else { return None };
    let others: Vec<_> = others
        .iter()
        .map(|(bits, of, curve)| format!("{:.2} times as many for {}", bits / fewest, of.describe(curve)))
        .collect();
    let leads = format!(
        "Fewest bits at an RMSE of {} cm: {}, {fewest:.2} a point",
        100.0 * error,
        first.describe(curve),
    );
    Some(if others.is_empty() { leads } else { format!("{leads}; {}", others.join(", ")) })
}

/// The fewest bits per point at which a curve has at most this error; between two of its points, on the line
/// through their logarithms. `None` if no point has so small an error.
fn bits_at(points: &[Point], error: f64) -> Option<f64> {
    let small_enough = points.iter().filter(|point| point.y <= error).map(|point| point.x);
    let between = points.windows(2).filter_map(|pair| {
        let [a, b] = [&pair[0], &pair[1]];
        let is_between = a.y.min(b.y) > 0.0 && (a.y - error) * (b.y - error) < 0.0;
        let share = (error / a.y).ln() / (b.y / a.y).ln();
        is_between.then(|| a.x * (b.x / a.x).powf(share))
    });
    small_enough.chain(between).min_by(f64::total_cmp)
}

fn figure(number: &str, title: &str, note: String, series: Vec<Series>) -> Section {
    Section::Figure(Figure {
        number: number.into(),
        title: title.into(),
        note,
        x: Axis { name: "bit rate".into(), unit: "bits a point".into(), scale: Scale::Log },
        y: Axis { name: "RMSE".into(), unit: "m".into(), scale: Scale::Log },
        series,
    })
}

/// A curve with a single point.
fn one(name: &'static str, of: Whose, marker: Marker, setting: &str, config: EncoderConfig) -> Curve {
    Curve { name, of, marker, points: vec![(setting.to_owned(), stream(config))] }
}

fn stream(config: EncoderConfig) -> Setting {
    Setting::Stream(Box::new(config))
}

/// JPEG and JPEG 2000 at increasing rates, for the image itself and for residuals; lossless LZMA for
/// residuals; and the coders with which the article compares its own.
fn article_curves(sample: &Sample, base: &EncoderConfig, quick: bool) -> Vec<Curve> {
    let rates: &[f64] = if quick { &QUICK_RATES } else { &RATES };
    let by_rate = |name, marker, codec, prediction| {
        let at = |&rate: &f64| {
            let image = ImageConfig { rate: Rate::Bits(rate), ..base.image };
            let config = EncoderConfig { coder: Coder::Image(codec), prediction, image, ..base.clone() };
            (format!("{rate} bits"), stream(config))
        };
        Curve { name, of: Whose::Article, marker, points: rates.iter().map(at).collect() }
    };
    let floats = |prediction| EncoderConfig {
        projection: with_step(base.projection, FLOAT_RANGES),
        coder: Coder::Backend(backend::LZMA),
        intra: IntraConfig { models: RegionModels::Article, ..base.intra },
        prediction,
        ..base.clone()
    };
    let none = PredictionChoice::Always(Prediction::None);
    let (jpeg, jpeg2000) = (ImageCodec::Jpeg, ImageCodec::Jpeg2000);
    let mut curves = vec![
        by_rate("JPEG, directly", Marker::Square, jpeg, none),
        by_rate("JPEG, intra", Marker::Triangle, jpeg, INTRA),
        by_rate("JPEG 2000, directly", Marker::Circle, jpeg2000, none),
        by_rate("JPEG 2000, intra", Marker::Diamond, jpeg2000, INTRA),
        one("LZMA, intra, floats", Whose::Article, Marker::Cross, "float", floats(INTRA)),
    ];
    if sample.has_references() {
        curves.insert(2, by_rate("JPEG, inter", Marker::TriangleDown, jpeg, INTER));
        curves.insert(5, by_rate("JPEG 2000, inter", Marker::Star, jpeg2000, INTER));
        curves.push(one("LZMA, inter, floats", Whose::Article, Marker::Plus, "float", floats(INTER)));
    }
    curves.extend(rival_curves(quick));
    curves
}

/// The coders of other authors.
fn rival_curves(quick: bool) -> Vec<Curve> {
    let errors: &[f64] = if quick { &QUICK_ERRORS_M } else { &ERRORS_M };
    let markers = [Marker::Square, Marker::Circle];
    let tu = TU.into_iter().zip(markers).map(|((name, method), marker)| {
        let at = |&metres: &f64| (length((1e6 * metres).round() as u32), Setting::Tu(method, metres));
        Curve { name, of: Whose::Other(name), marker, points: errors.iter().map(at).collect() }
    });
    let voxels: &[u32] = if quick { &QUICK_STEPS_UM } else { &STEPS_UM };
    let points = voxels.iter().map(|&voxel_um| (length(voxel_um), Setting::Octree(voxel_um))).collect();
    let octree = Curve { name: "octree", of: Whose::Other("the octree"), marker: Marker::Diamond, points };
    tu.chain([octree]).collect()
}

/// Lossless coders with coarser steps, and the modes of this program.
fn other_curves(sample: &Sample, base: &EncoderConfig, quick: bool) -> Vec<Curve> {
    let steps: &[u32] = if quick { &QUICK_STEPS_UM } else { &STEPS_UM };
    let at = |step: u32, coder, prediction| EncoderConfig {
        projection: with_step(base.projection, step),
        coder,
        prediction,
        ..base.clone()
    };
    let by_step = |name, of, marker, coder, prediction| Curve {
        name,
        of,
        marker,
        points: steps.iter().map(|&step| (length(step), stream(at(step, coder, prediction)))).collect(),
    };
    let lzma = Coder::Backend(backend::LZMA);
    let smallest = PredictionChoice::Smallest;
    let calibrated = |step: u32| EncoderConfig {
        projection: ProjectionKind::Calibrated { range_step_um: Some(step) },
        outliers: None,
        ..at(step, Coder::Context, smallest)
    };
    // Such a coarse step removes the intensities.
    let intensity = IntensityFidelity::Rounded { step_millionths: MOST_INTENSITY_STEP_MILLIONTHS };
    let bounded = |max_error_um| EncoderConfig {
        threads: base.threads,
        intensity,
        ..EncoderConfig::preset(Mode::Bounded { max_error_um })
    };
    let coarser = || steps.iter().filter(|&&step| step >= RANGE_STEP_UM);
    let mut curves = vec![by_step("LZMA, intra", Whose::Article, Marker::Square, lzma, INTRA)];
    if sample.has_references() {
        curves.push(by_step("LZMA, inter", Whose::Article, Marker::Triangle, lzma, INTER));
    }
    curves.push(by_step("context, ideal image", Whose::Ours, Marker::Circle, Coder::Context, smallest));
    curves.push(Curve {
        name: "context, calibrated image",
        of: Whose::Ours,
        marker: Marker::Diamond,
        points: coarser().map(|&step| (length(step), stream(calibrated(step)))).collect(),
    });
    curves.push(Curve {
        name: "bounded mode, without intensities",
        of: Whose::Ours,
        marker: Marker::TriangleDown,
        points: coarser().map(|&error| (length(error), stream(bounded(error)))).collect(),
    });
    let exact = EncoderConfig { threads: base.threads, ..EncoderConfig::preset(Mode::Exact) };
    curves.push(one("exact mode, whole files", Whose::Ours, Marker::Star, "", exact));
    curves
}

/// The data and parameters for measuring curves.
struct Measuring<'a> {
    sample: &'a Sample,
    scanner: &'a Hdl64,
    base: &'a EncoderConfig,
    on_frame: &'a (dyn Fn() + Sync),
}

impl Measuring<'_> {
    /// Measures curves. Those without a measurable point are left out. Also returns the largest share of
    /// returns that only one image has, and that of dropped returns.
    fn all(&self, curves: &[Curve]) -> Result<(Vec<Series>, Missing)> {
        let mut series = Vec::new();
        let mut worst = Missing::default();
        for curve in curves {
            let mut points = Vec::new();
            for (setting, coder) in &curve.points {
                let Measured { bits, rmse, missing } = self.point(coder)?;
                worst.alone = worst.alone.max(missing.alone);
                worst.dropped = worst.dropped.max(missing.dropped);
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
        Ok((series, worst))
    }

    fn point(&self, setting: &Setting) -> Result<Measured> {
        let Measuring { sample, scanner, base, on_frame } = *self;
        match setting {
            Setting::Stream(config) => measure(sample, config, on_frame),
            Setting::Octree(voxel_um) => {
                Ok(Measured::of(sample, &rivals::octree(sample, *voxel_um, on_frame)?))
            }
            Setting::Tu(method, metres) => {
                let rival = rivals::tu(sample, scanner, base, *method, Aim::Error(*metres), on_frame)?;
                Ok(Measured::of(sample, &rival))
            }
        }
    }
}

/// A point of a curve.
struct Measured {
    /// Bits for each decoded return.
    bits: Option<f64>,
    /// Error in metres.
    rmse: Option<f64>,
    missing: Missing,
}

impl Measured {
    fn of(sample: &Sample, rival: &Rival) -> Self {
        let bytes = rival.sum(sample.compared(), |frame| frame.bytes);
        let points = rival.sum(sample.compared(), |frame| frame.points);
        Measured {
            bits: metrics::bits_per_point(bytes, points),
            rmse: rival.rmse(sample.compared()),
            missing: Missing::default(),
        }
    }
}

/// Returns not covered by an error.
#[derive(Clone, Copy, Default)]
struct Missing {
    /// The share of the returns that only one of the range images has.
    alone: f64,
    /// The share of the returns that were dropped.
    dropped: f64,
}

fn measure(sample: &Sample, config: &EncoderConfig, on_frame: &(dyn Fn() + Sync)) -> Result<Measured> {
    let coded = experiment::run(sample, config, on_frame)?;
    let frames = || sample.compared();
    let returns = sample.returns(frames());
    let none = sample.points(frames()) - returns;
    let decoded = frames().map(|frame| returns_of(&coded.frames[frame].decoded.scan.cloud)).sum();
    let distortion = coded.distortion(sample, config, frames());
    let ranges = &distortion.ranges;
    let alone = ranges.only_original + ranges.only_decoded;
    let sources = frames().filter_map(|frame| coded.frames[frame].decoded.source);
    let dropped: u64 = sources.map(|source| source.outliers + source.lost).sum();
    let part = |part: u64, whole: u64| part as f64 / whole.max(1) as f64;
    Ok(Measured {
        bits: metrics::bits_per_point(coded.bytes(frames()).round() as u64, decoded),
        rmse: distortion.rmse(),
        missing: Missing {
            alone: part(alone, alone + ranges.compared),
            dropped: part(dropped.saturating_sub(none), returns),
        },
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
pub fn length(micrometres: u32) -> String {
    let units = [(10_000, "cm"), (1000, "mm"), (1, "\u{b5}m")];
    let fitting = units.into_iter().find(|(unit, _)| micrometres.is_multiple_of(*unit));
    fitting.map_or_else(String::new, |(unit, name)| format!("{} {name}", micrometres / unit))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn series(name: &str, points: &[(f64, f64)]) -> Series {
        let points = points.iter().map(|&(x, y)| Point { x, y, label: String::new() });
        Series {
            name: name.into(),
            origin: Origin::Measured,
            line: true,
            marker: Marker::Circle,
            points: points.collect(),
        }
    }

    #[test]
    fn bits_between_points_are_on_the_line_of_logarithms() {
        let curve = series("", &[(8.0, 0.001), (2.0, 0.1)]).points;
        assert!((bits_at(&curve, 0.01).unwrap() - 4.0).abs() < 1e-12);
        assert_eq!(bits_at(&curve, 0.1), Some(2.0));
        assert_eq!(bits_at(&curve, 5.0), Some(2.0));
        assert_eq!(bits_at(&curve, 0.0005), None);
        let lossless = series("", &[(9.0, 0.0), (3.0, 0.2)]).points;
        assert_eq!(bits_at(&lossless, 0.1), Some(9.0), "0 has no logarithm");
    }

    #[test]
    fn the_fewest_bits_are_ahead_at_an_error_that_all_reach() {
        let ours = [series("bounded", &[(4.0, 0.001), (2.0, 0.05)]), series("ideal", &[(6.0, 0.001)])];
        let article = series("JPEG", &[(5.0, 0.05)]);
        let octree = series("octree", &[(16.0, 0.001), (8.0, 0.05)]);
        let others = [(Whose::Article, &article), (Whose::Other("the octree"), &octree)];
        let curves = ours.iter().map(|series| (Whose::Ours, series)).chain(others);
        assert_eq!(
            who_is_ahead(curves).unwrap(),
            "Fewest bits at an RMSE of 5 cm: lidarpc (bounded), 2.00 a point; 2.50 times as many for the article's \
             coders (JPEG), 4.00 times as many for the octree"
        );
        let far = series("JPEG", &[(5.0, 9.0)]);
        assert_eq!(who_is_ahead([(Whose::Article, &far)].into_iter()), None);
    }
}

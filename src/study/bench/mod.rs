//! The article's experiments (section VI) on any frames: its tables and figures, with this program's values
//! beside those of the article.
//!
//! Scans go in, a [`Report`](report::Report) comes out, which [`report`] turns into text, CSV, JSON or HTML.

pub mod published;
pub mod report;

mod experiment;
mod figure_13;
mod figure_15;
mod octree;
mod rivals;
mod sample;
mod tables;
mod times;
mod tu;
mod volumes;

pub use sample::Extent;

use crate::article::prediction::intra::RegionModels;
use crate::frame::IntensityFidelity;
use crate::frame::settings::{EncoderConfig, FrameOrder, ProjectionKind};
use crate::ground::error::{Error, Result};
use crate::scanner::hdl64::Hdl64;
use crate::scanner::{FLOAT_RANGES, Scanner, ideal_of};
use crate::stream::FrameInput;
use crate::stream::scanner_choice::scanner_seen;
use figure_15::Curves;
use report::Section;
use rivals::Rivals;
use sample::Sample;
use tables::Runs;

/// The frames for the tables.
const OF_TABLES: Extent = Extent { runs: 2, frames_a_run: 10 };
/// The frames for the figures, in which every point or bar needs another run.
const OF_FIGURES: Extent = Extent { runs: 2, frames_a_run: 3 };
/// The frames with `--quick`: the first ones.
const QUICK: Extent = Extent { runs: 1, frames_a_run: 3 };

/// All experiments, ready to be run.
pub struct Bench {
    base: EncoderConfig,
    of_tables: Sample,
    of_figures: Sample,
    curves: Curves,
    /// The fitted scanner, and the ideal scanner for its scans.
    found: Option<Scanner>,
    scanner: Hdl64,
}

/// The results of the experiments.
pub struct Findings {
    /// Which coder is best on these frames, and by how much, in one sentence; empty if there is nothing to
    /// compare.
    pub summary: String,
    /// Tables and figures, in the order of the article.
    pub sections: Vec<Section>,
}

impl Bench {
    /// Reads the required frames of a drive. `base` gives the experiments their ideal projection in steps,
    /// outlier filter, regions and registration; the experiments choose coders, predictions and P frames
    /// themselves, and there are no intensities except in exact mode.
    ///
    /// # Errors
    /// If `base` has another projection, if a frame cannot be read, or if none of them has any points.
    pub fn new(frames: &[FrameInput], base: &EncoderConfig, quick: bool) -> Result<Self> {
        let ProjectionKind::Ideal { columns, range_step_um } = base.projection else {
            return Err(no_steps());
        };
        if range_step_um == FLOAT_RANGES {
            return Err(no_steps());
        }
        let extents = if quick { [QUICK; 2] } else { [OF_TABLES, OF_FIGURES] };
        let of_tables = Sample::read(frames, extents[0])?;
        let of_figures = Sample::read(frames, extents[1])?;
        if of_tables.clouds.iter().chain(&of_figures.clouds).all(|cloud| cloud.positions.is_empty()) {
            return Err(Error::Usage("no points in any scan; give scans with points".into()));
        }
        let base =
            EncoderConfig { order: FrameOrder::Ratio, intensity: IntensityFidelity::None, ..base.clone() };
        let curves = Curves::new(&of_figures, &base, quick);
        let found = scanner_seen(&of_tables.inputs.iter().collect::<Vec<_>>(), &base)?;
        let scanner = ideal_of(found.as_ref(), columns, range_step_um);
        Ok(Bench { base, of_tables, of_figures, curves, found, scanner })
    }

    /// Number of times that a frame will be coded.
    pub fn frames_to_code(&self) -> usize {
        let figures = self.of_figures.inputs.len() + self.curves.frames_to_code(&self.of_figures);
        tables::frames_to_code(&self.of_tables) + rivals::frames_to_code(&self.of_tables) + figures
    }

    /// A description of the experiments for people: names and values.
    pub fn facts(&self) -> Vec<(String, String)> {
        let about = |sample: &Sample| {
            let points = sample.points(0..sample.inputs.len());
            format!("{}, {points} points", sample.describe())
        };
        let outliers = match self.base.outliers {
            Some(filter) => format!("fewer than {} points within {} m", filter.neighbours, filter.radius_m),
            None => "kept".to_owned(),
        };
        let regions = match self.base.intra.models {
            RegionModels::Article => "the article's",
            RegionModels::Fitted => "fitted; the article's where ranges are floats",
        };
        let level = self.base.level.number();
        let fact = |name: &str, value: String| (name.to_owned(), value);
        vec![
            fact("tables", about(&self.of_tables)),
            fact("figures", about(&self.of_figures)),
            fact("scanner", self.found.as_ref().map_or_else(|| "not found".to_owned(), Scanner::to_string)),
            fact("range image", self.image()),
            fact("outliers", outliers),
            fact("regions", regions.to_owned()),
            fact("back-ends", format!("level {level} of 9")),
        ]
    }

    /// The range image, in words.
    fn image(&self) -> String {
        let degrees = || (0..self.scanner.rows()).map(|row| self.scanner.elevation(row).to_degrees());
        format!(
            "ideal, {} rows from {:.2} to {:.2} degrees by {} columns, steps of {} mm unless a curve says otherwise",
            self.scanner.rows(),
            degrees().fold(f64::INFINITY, f64::min),
            degrees().fold(f64::NEG_INFINITY, f64::max),
            self.scanner.ticks,
            f64::from(self.scanner.range_step_um) / 1e3,
        )
    }

    /// Runs all experiments. `on_frame` is called, from any thread, after each frame was coded.
    ///
    /// # Errors
    /// If a setting is out of range, or a back-end's library fails.
    pub fn run(&self, on_frame: &(dyn Fn() + Sync)) -> Result<Findings> {
        let Bench { base, of_tables, of_figures, curves, scanner, .. } = self;
        let runs = Runs::run(of_tables, base, on_frame)?;
        let rivals = Rivals::run(of_tables, scanner, base, on_frame)?;
        let mut sections =
            vec![volumes::rates(of_tables, &runs, &rivals), volumes::octrees(of_tables, &rivals)];
        sections.extend(volumes::volumes(of_tables, &runs));
        sections.extend(times::steps(of_tables, &runs));
        sections.push(times::coding(of_tables, &runs, &rivals));
        sections.extend(figure_13::measure(of_figures, scanner, base, on_frame)?.sections());
        let (figures, ahead) = curves.measure(of_figures, scanner, base, on_frame)?;
        sections.extend(figures);
        let exact = runs.exact.rate(0..of_tables.inputs.len());
        let exact = exact.map(|rate| format!("byte for byte, lidarpc takes {rate:.2} % of the files"));
        let known: Vec<_> = ahead.into_iter().chain(exact).collect();
        let summary = if known.is_empty() { String::new() } else { format!("{}.", known.join("; ")) };
        Ok(Findings { summary, sections })
    }
}

fn no_steps() -> Error {
    let what =
        "the experiments need the ideal range image in steps; leave --projection and a step of float out";
    Error::InvalidSettings(what.to_owned())
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;
    use crate::frame::settings::Mode;
    use crate::study::synth::{SynthConfig, SynthScanner, drive};

    #[test]
    fn progress_ends_where_it_was_said_to() {
        let config = SynthConfig { frames: 2, thinning: 20, ..SynthConfig::default() };
        let frame = |(name, bytes)| FrameInput::memory(name, bytes);
        let frames: Vec<_> = drive(&config).map(|scan| frame((scan.name.clone(), scan.to_bin()))).collect();
        let base = EncoderConfig {
            projection: ProjectionKind::Ideal { columns: 150, range_step_um: 10_000 },
            ..EncoderConfig::preset(Mode::Paper)
        };
        for frames in [&frames[..], &frames[..1]] {
            let bench = Bench::new(frames, &base, true).unwrap();
            let done = AtomicUsize::new(0);
            let on_frame = || {
                done.fetch_add(1, Ordering::Relaxed);
            };
            let findings = bench.run(&on_frame).unwrap();
            assert_eq!(done.into_inner(), bench.frames_to_code());
            assert_eq!(findings.sections.len(), 12);
        }
    }

    #[test]
    fn rows_are_those_of_the_scanner_that_is_found() {
        let config = SynthConfig { scanner: SynthScanner::Vlp16, frames: 2, ..SynthConfig::default() };
        let frame = |(name, bytes)| FrameInput::memory(name, bytes);
        let frames: Vec<_> = drive(&config).map(|scan| frame((scan.name.clone(), scan.to_bin()))).collect();
        let base = EncoderConfig {
            projection: ProjectionKind::Ideal { columns: 900, range_step_um: 10_000 },
            ..EncoderConfig::preset(Mode::Paper)
        };
        let bench = Bench::new(&frames, &base, true).unwrap();
        let facts = bench.facts();
        let fact = |name: &str| &facts.iter().find(|(fact, _)| fact == name).unwrap().1;
        assert!(fact("scanner").starts_with("16 lasers from -15.00 to 15.00 degrees"), "{facts:?}");
        let image = "ideal, 16 rows from -15.00 to 15.00 degrees by 900 columns, steps of 10 mm";
        assert!(fact("range image").starts_with(image), "{facts:?}");
        let findings = bench.run(&|| ()).unwrap();
        assert!(findings.summary.starts_with("Fewest bits at an RMSE of "), "{}", findings.summary);
        let number = |section: &Section| section.number() == "Table II";
        let Some(Section::Table(volumes)) = findings.sections.into_iter().find(number) else {
            panic!("no Table II")
        };
        assert_eq!(volumes.rows[1].cells[0], Some(4.0 * 16.0 * 900.0 / 1e3), "after conversion");
    }
}

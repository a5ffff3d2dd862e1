//! The article's experiments (section VI) on any frames: its tables and figures, with this program's values
//! beside those of the article.
//!
//! Scans go in, a [`Report`](report::Report) comes out, which [`report`] turns into text, CSV, JSON or HTML.

pub mod published;
pub mod report;

mod experiment;
mod figure_13;
mod figure_15;
mod runs;
mod sample;
mod tables;
mod times;
mod volumes;

pub use sample::Extent;

use crate::article::prediction::intra::RegionModels;
use crate::frame::Intensity;
use crate::frame::settings::{EncoderConfig, FrameOrder, ProjectionKind};
use crate::ground::error::{Error, Result};
use crate::stream::FrameInput;
use figure_15::Curves;
use report::Section;
use runs::Runs;
use sample::Sample;

/// Frames for the tables.
const OF_TABLES: Extent = Extent { runs: 2, frames_a_run: 10 };
/// Frames for the figures, where every point or bar takes another run.
const OF_FIGURES: Extent = Extent { runs: 2, frames_a_run: 3 };
/// Frames with `--quick`: the first ones.
const QUICK: Extent = Extent { runs: 1, frames_a_run: 3 };

/// All experiments, ready to be run.
pub struct Bench {
    base: EncoderConfig,
    of_tables: Sample,
    of_figures: Sample,
    curves: Curves,
}

impl Bench {
    /// Reads the frames of a drive that are needed. `base` gives the experiments their ideal projection in
    /// steps, outlier filter, regions and registration; coders, predictions and the choice of P frames are
    /// the experiments' own, and there are no intensities except in exact mode.
    ///
    /// # Errors
    /// If `base` has another projection, if a frame cannot be read, or if none of them has any points.
    pub fn new(frames: &[FrameInput], base: &EncoderConfig, quick: bool) -> Result<Self> {
        figure_13::ideal_sensor(base)?;
        let extents = if quick { [QUICK; 2] } else { [OF_TABLES, OF_FIGURES] };
        let of_tables = Sample::read(frames, extents[0])?;
        let of_figures = Sample::read(frames, extents[1])?;
        if of_tables.clouds.iter().chain(&of_figures.clouds).all(|cloud| cloud.positions.is_empty()) {
            return Err(Error::InvalidConfig("no points in any scan; give scans with points".into()));
        }
        let base = EncoderConfig { order: FrameOrder::Ratio, intensity: Intensity::None, ..base.clone() };
        let curves = Curves::new(&of_figures, &base, quick);
        Ok(Bench { base, of_tables, of_figures, curves })
    }

    /// Number of times that a frame will be coded.
    pub fn frames_to_code(&self) -> usize {
        let figures = self.of_figures.inputs.len() + self.curves.frames_to_code(&self.of_figures);
        runs::frames_to_code(&self.of_tables) + figures
    }

    /// What is run, for people: names and values.
    pub fn facts(&self) -> Vec<(String, String)> {
        let about = |sample: &Sample| {
            let points = sample.points(0..sample.inputs.len());
            format!("{}, {points} points", sample.describe())
        };
        let image = match self.base.projection {
            ProjectionKind::Ideal { columns, range_step_um } => {
                let step = f64::from(range_step_um) / 1e3;
                format!(
                    "ideal, 64 rows by {columns} columns, steps of {step} mm unless a curve says otherwise"
                )
            }
            ProjectionKind::Calibrated { .. } => "calibrated".to_owned(),
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
            fact("range image", image),
            fact("outliers", outliers),
            fact("regions", regions.to_owned()),
            fact("back-ends", format!("level {level} of 9")),
        ]
    }

    /// Runs them all. `on_frame` is called, from any thread, whenever a frame has been coded.
    ///
    /// # Errors
    /// If a setting is out of range, or a back-end's library fails.
    pub fn run(&self, on_frame: &(dyn Fn() + Sync)) -> Result<Vec<Section>> {
        let runs = Runs::run(&self.of_tables, &self.base, on_frame)?;
        let mut sections = vec![volumes::rates(&self.of_tables, &runs)];
        sections.extend(volumes::volumes(&self.of_tables, &runs));
        sections.extend(times::steps(&self.of_tables, &runs));
        sections.push(times::coding(&self.of_tables, &runs));
        sections.extend(figure_13::measure(&self.of_figures, &self.base, on_frame)?.sections());
        sections.extend(self.curves.measure(&self.of_figures, on_frame)?);
        Ok(sections)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;
    use crate::frame::settings::Mode;
    use crate::study::synth::{SynthConfig, drive};

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
            let sections = bench.run(&on_frame).unwrap();
            assert_eq!(done.into_inner(), bench.frames_to_code());
            assert_eq!(sections.len(), 11);
        }
    }
}

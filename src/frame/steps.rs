//! Time and size of each coding step, as in the article's Tables II to VI.

use std::time::Duration;

use crate::container::{Section, SectionKind};
use crate::ground::clock::Instant;

/// The steps whose time is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// The outlier filter (III-A).
    Outliers,
    /// Conversion of points to a range image or back (IV-A).
    Conversion,
    /// Estimating the motion of the scanner (V-B).
    Registration,
    /// Ground removal and clustering (IV-B).
    Clustering,
    /// Fitting the models of regions, and predicting from them (IV-C).
    Prediction,
    /// The contour map (IV-D.1).
    Contour,
    /// Coding the ranges or their residuals (IV-D.2).
    Coding,
    /// Everything else: occupancy, intensities, corrections, order, other fields.
    Rest,
}

impl Step {
    /// All steps, in the order in which an encoder takes them.
    pub const ALL: [Step; 8] = [
        Step::Outliers,
        Step::Conversion,
        Step::Registration,
        Step::Clustering,
        Step::Prediction,
        Step::Contour,
        Step::Coding,
        Step::Rest,
    ];

    /// The step's name in reports: lower case.
    pub fn name(self) -> &'static str {
        match self {
            Step::Outliers => "outlier removal",
            Step::Conversion => "conversion",
            Step::Registration => "registration",
            Step::Clustering => "clustering",
            Step::Prediction => "prediction",
            Step::Contour => "contour map",
            Step::Coding => "coding of ranges",
            Step::Rest => "the rest",
        }
    }
}

/// Bytes and times, summed over frames.
#[derive(Clone, Copy, Debug, Default)]
pub struct StepReport {
    /// Number of frames.
    pub frames: u64,
    /// Bytes of the files.
    pub original: u64,
    /// Bytes of the range images, at four bytes a cell, as the article stores them.
    pub converted: u64,
    /// Bytes of the residuals before compression by a back-end; without a back-end, bytes of the ranges.
    pub predicted: u64,
    /// Coded bytes of the contour maps.
    pub contour: u64,
    /// Coded bytes of other side data: parameters and models of regions.
    pub side: u64,
    /// Coded bytes of the ranges or residuals.
    pub ranges: u64,
    /// Coded bytes of everything else.
    pub rest: u64,
    pub(crate) times: [Duration; Step::ALL.len()],
}

impl StepReport {
    /// Adds another report.
    pub fn add(&mut self, other: &StepReport) {
        self.frames += other.frames;
        self.original += other.original;
        self.converted += other.converted;
        self.predicted += other.predicted;
        self.contour += other.contour;
        self.side += other.side;
        self.ranges += other.ranges;
        self.rest += other.rest;
        for (time, more) in self.times.iter_mut().zip(other.times) {
            *time += more;
        }
    }

    /// Total coded bytes of the frames, without the container's.
    pub fn coded(&self) -> u64 {
        self.contour + self.side + self.ranges + self.rest
    }

    /// The time of a step.
    pub fn time(&self, step: Step) -> Duration {
        self.times[step as usize]
    }

    /// The total time of all steps.
    pub fn total_time(&self) -> Duration {
        self.times.iter().sum()
    }

    /// Runs a step and measures its time.
    pub(crate) fn timed<T>(&mut self, step: Step, run: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let result = run();
        self.times[step as usize] += start.elapsed();
        result
    }

    /// Adds the time since `start` to a step.
    pub(crate) fn took(&mut self, step: Step, start: Instant) {
        self.times[step as usize] += start.elapsed();
    }

    /// Adds the time since `start` to the step of sections of this kind, if it has one; otherwise the time
    /// counts as the rest.
    pub(crate) fn took_section(&mut self, kind: SectionKind, start: Instant) {
        match kind {
            SectionKind::Contour => self.took(Step::Contour, start),
            SectionKind::Range => self.took(Step::Coding, start),
            _ => {}
        }
    }

    /// Adds the time since `start` to the rest, minus the time added to any step since the total was
    /// `before`.
    pub(crate) fn took_rest(&mut self, start: Instant, before: Duration) {
        let others = self.total_time().saturating_sub(before);
        self.times[Step::Rest as usize] += start.elapsed().saturating_sub(others);
    }

    /// Adds a frame's sections.
    pub(crate) fn count_sections(&mut self, sections: &[Section]) {
        for section in sections {
            let bytes = section.payload.len() as u64;
            match section.kind {
                SectionKind::Contour => self.contour += bytes,
                SectionKind::Parameters | SectionKind::Regions => self.side += bytes,
                SectionKind::Range | SectionKind::Residual => self.ranges += bytes,
                _ => self.rest += bytes,
            }
        }
    }
}

//! Time and size of each stage of coding, as in the article's Tables II to VI.

use std::time::Duration;

use crate::container::{Section, SectionKind};
use crate::ground::clock::Instant;

/// The stages whose time is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
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

impl Stage {
    /// All stages, in the order in which an encoder takes them.
    pub const ALL: [Stage; 8] = [
        Stage::Outliers,
        Stage::Conversion,
        Stage::Registration,
        Stage::Clustering,
        Stage::Prediction,
        Stage::Contour,
        Stage::Coding,
        Stage::Rest,
    ];

    /// The stage's name in reports: lower case.
    pub fn name(self) -> &'static str {
        match self {
            Stage::Outliers => "outlier removal",
            Stage::Conversion => "conversion",
            Stage::Registration => "registration",
            Stage::Clustering => "clustering",
            Stage::Prediction => "prediction",
            Stage::Contour => "contour map",
            Stage::Coding => "coding of ranges",
            Stage::Rest => "the rest",
        }
    }
}

/// Bytes and times, summed over frames.
#[derive(Clone, Copy, Debug, Default)]
pub struct StageReport {
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
    pub(crate) times: [Duration; Stage::ALL.len()],
}

impl StageReport {
    /// Adds another report.
    pub fn add(&mut self, other: &StageReport) {
        self.frames += other.frames;
        // The stream tells the sizes of lossy frames' originals, and anything may stand there.
        self.original = self.original.saturating_add(other.original);
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

    /// The time of a stage.
    pub fn time(&self, stage: Stage) -> Duration {
        self.times[stage as usize]
    }

    /// The total time of all stages.
    pub fn total_time(&self) -> Duration {
        self.times.iter().sum()
    }

    /// Runs a stage and measures its time.
    pub(crate) fn timed<T>(&mut self, stage: Stage, run: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let result = run();
        self.times[stage as usize] += start.elapsed();
        result
    }

    /// Adds the time since `start` to a stage.
    pub(crate) fn took(&mut self, stage: Stage, start: Instant) {
        self.times[stage as usize] += start.elapsed();
    }

    /// Adds the time since `start` to the stage of sections of this kind, if it has one; otherwise the time
    /// counts as the rest.
    pub(crate) fn took_section(&mut self, kind: SectionKind, start: Instant) {
        match kind {
            SectionKind::Contour => self.took(Stage::Contour, start),
            SectionKind::Range => self.took(Stage::Coding, start),
            _ => {}
        }
    }

    /// Adds the time since `start` to the rest, minus the time added to any stage since the total was
    /// `before`.
    pub(crate) fn took_rest(&mut self, start: Instant, before: Duration) {
        let others = self.total_time().saturating_sub(before);
        self.times[Stage::Rest as usize] += start.elapsed().saturating_sub(others);
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

#[cfg(test)]
mod tests {
    use super::StageReport;

    #[test]
    fn sizes_that_a_stream_claims_do_not_overflow() {
        let claimed = StageReport { original: u64::MAX, ..StageReport::default() };
        let mut sum = claimed;
        sum.add(&claimed);
        assert_eq!(sum.original, u64::MAX);
    }
}

//! Tables IV to VI: times per frame.

use std::time::Duration;

use super::experiment::Coded;
use super::published::{self, PublishedCoder};
use super::report::{Column, Origin, Row, Section, Table};
use super::rivals::Rivals;
use super::sample::Sample;
use super::tables::{Method, Runs, column, rows_of_methods};
use crate::frame::Stage;

/// Tables IV and V: seconds of each stage of encoding a frame, for intra and for inter coding.
pub fn steps(sample: &Sample, runs: &Runs) -> Vec<Section> {
    let all: Vec<_> = (0..sample.inputs.len()).collect();
    let later: Vec<_> = sample.compared().collect();
    let intra = Steps {
        number: "Table IV",
        what: "intra",
        place: 0,
        frames: &all,
        coded: |runs, name| runs.of(name).map(|run| &run.intra),
        published: [Stage::Clustering, Stage::Prediction].into_iter().zip(published::INTRA_SECONDS).collect(),
        without: &[Stage::Registration],
    };
    let inter = Steps {
        number: "Table V",
        what: "inter",
        place: 1,
        frames: &later,
        coded: |runs, name| runs.of(name).and_then(|run| run.inter.as_ref()),
        published: [Stage::Registration, Stage::Prediction]
            .into_iter()
            .zip(published::INTER_SECONDS)
            .collect(),
        without: &[Stage::Clustering, Stage::Contour],
    };
    vec![intra.table(sample, runs), inter.table(sample, runs)]
}

/// One of the two tables.
struct Steps<'a> {
    number: &'a str,
    what: &'a str,
    /// Index into the published values: 0 intra, 1 inter.
    place: usize,
    frames: &'a [usize],
    coded: fn(&'a Runs, &str) -> Option<&'a Coded>,
    /// Seconds that do not depend on the coder.
    published: Vec<(Stage, f64)>,
    /// Steps that this kind of frame does not have.
    without: &'a [Stage],
}

impl<'a> Steps<'a> {
    fn table(&self, sample: &Sample, runs: &'a Runs) -> Section {
        let columns = self.columns(runs);
        let mut rows = Vec::new();
        for step in Stage::ALL.into_iter().filter(|step| !self.without.contains(step)) {
            let cell = |(coder, origin): &(&PublishedCoder, Origin)| match origin {
                Origin::Measured => self.mean(runs, coder.name, Some(step)),
                Origin::Published => self.published(coder, step),
            };
            rows.push(Row { name: step.name().into(), cells: columns.iter().map(cell).collect() });
        }
        let total = |(coder, origin): &(&PublishedCoder, Origin)| match origin {
            Origin::Measured => self.mean(runs, coder.name, None),
            Origin::Published => Some(coder.seconds[self.place][1]),
        };
        rows.push(Row { name: "total".into(), cells: columns.iter().map(total).collect() });
        let heading = |(coder, origin): &(&PublishedCoder, Origin)| {
            let decimals = Some(if *origin == Origin::Measured { 4 } else { 2 });
            column(&format!("{} & {}", self.what, coder.name), "s", decimals, *origin)
        };
        Section::Table(Table {
            number: self.number.into(),
            title: format!("seconds a frame of each step of {} coding", self.what),
            note: format!(
                "The mean of {}, on one thread. Where several predictions are tried for a frame, the \
                 steps of the one that is taken count; here there is only one.",
                sample.describe_some(self.frames.len()),
            ),
            label: "step".into(),
            columns: columns.iter().map(heading).collect::<Vec<Column>>(),
            rows,
        })
    }

    /// The measured coders, then those of the article.
    fn columns(&self, runs: &'a Runs) -> Vec<(&'static PublishedCoder, Origin)> {
        let coders = || published::CODERS.iter();
        let measured = coders().filter(|coder| (self.coded)(runs, coder.name).is_some());
        let measured = measured.map(|coder| (coder, Origin::Measured));
        measured.chain(coders().map(|coder| (coder, Origin::Published))).collect()
    }

    /// Seconds of a stage, or of all stages.
    fn mean(&self, runs: &'a Runs, name: &str, step: Option<Stage>) -> Option<f64> {
        let coded = (self.coded)(runs, name)?;
        coded.mean(self.frames.iter().copied(), |frame| {
            let time = step.map_or(frame.encoding.total_time(), |step| frame.encoding.time(step));
            time.as_secs_f64()
        })
    }

    fn published(&self, coder: &PublishedCoder, step: Stage) -> Option<f64> {
        match step {
            Stage::Coding => Some(coder.seconds[self.place][0]),
            _ => self.published.iter().find(|(other, _)| *other == step).map(|(_, seconds)| *seconds),
        }
    }
}

/// Table VI: seconds of encoding and decoding a frame.
pub fn coding(sample: &Sample, runs: &Runs, rivals: &Rivals) -> Section {
    let frames = sample.inputs.len().max(1) as f64;
    let a_frame = |times: [Duration; 2]| times.map(|time| Some(time.as_secs_f64() / frames));
    let seconds = |_: &Method<'_>, coded: &Coded| a_frame([coded.encoding_time, coded.decoding_time]);
    let mut measured: Vec<_> = runs.methods().iter().map(|method| method.measured(seconds)).collect();
    measured.extend(
        rivals
            .timed()
            .map(|(name, rival)| (name.to_owned(), a_frame([rival.encoding_time, rival.decoding_time]))),
    );
    let columns = [(Origin::Measured, Some(4)), (Origin::Published, None)]
        .into_iter()
        .flat_map(|(origin, decimals)| {
            ["encoding", "decoding"].map(|name| column(name, "s", decimals, origin))
        })
        .collect();
    Section::Table(Table {
        number: "Table VI".into(),
        title: "encoding and decoding time of a frame".into(),
        note: format!(
            "From files in memory to a stream in memory and back, on one thread: parsing, checksums, every \
             prediction that is tried and, in exact mode, the fit of the scanner included; that is why it is more \
             than the steps take. The mean of {}; of inter coding each run's first frame is an I frame. The octree, \
             with voxels of 1 mm, and the coders of Tu et al., at 8 bits a return, start from points in memory and end \
             there; Tu-SLAM finds the motion by registration, which in the article's reference 12 is known.",
            sample.describe(),
        ),
        label: "method".into(),
        columns,
        rows: rows_of_methods(measured, &published::CODING_SECONDS),
    })
}

//! What Tables I to VI have in common: the runs of the article's coders, intra and inter, and of this
//! program's own, and the rows and columns that show them beside the published values.

use super::experiment::{self, Coded};
use super::published::SCENES;
use super::report::{Column, Origin, Row};
use super::sample::Sample;
use crate::article::image_coding::{ImageCodec, ImageConfig, Rate};
use crate::backend;
use crate::frame::Prediction;
use crate::frame::settings::{Coder, EncoderConfig, Mode, PredictionChoice};
use crate::ground::error::Result;

/// A coder of residuals named in the article, run on the sample.
pub struct Run {
    /// The name in [`published::CODERS`](super::published::CODERS).
    pub name: &'static str,
    /// With every frame as an I frame.
    pub intra: Coded,
    /// With every frame that has one before it as a P frame; `None` if there is none.
    pub inter: Option<Coded>,
    /// With the prediction that makes each frame smallest.
    pub smallest: Coded,
}

/// All runs.
pub struct Runs {
    /// The article's coders.
    pub coders: Vec<Run>,
    /// The context coder, on the same image.
    pub context: Coded,
    /// Exact mode: whole files.
    pub exact: Coded,
}

/// The article's coders that are available here.
fn coders() -> [(&'static str, Coder); 2] {
    [("LZMA", Coder::Backend(backend::LZMA)), ("JPEG 2000", Coder::Image(ImageCodec::Jpeg2000))]
}

/// Half of the 16 bits that a range takes: the article's ratio of 2.
const RATE: Rate = Rate::Bits(8.0);

/// Number of frames to code in all.
pub fn frames_to_code(sample: &Sample) -> usize {
    let of_coder = if sample.has_references() { 3 } else { 2 };
    sample.inputs.len() * (of_coder * coders().len() + 2)
}

impl Runs {
    /// Codes the sample with every coder, on one thread, so that times can be compared.
    ///
    /// # Errors
    /// If a back-end's library fails.
    pub fn run(sample: &Sample, base: &EncoderConfig, on_frame: &(dyn Fn() + Sync)) -> Result<Self> {
        let image = ImageConfig { rate: RATE, ..base.image };
        let base = EncoderConfig { threads: 1, image, ..base.clone() };
        let run = |config: &EncoderConfig| experiment::run(sample, config, on_frame);
        let with = |coder, prediction| run(&EncoderConfig { coder, prediction, ..base.clone() });
        let mut measured = Vec::new();
        for (name, coder) in coders() {
            measured.push(Run {
                name,
                intra: with(coder, PredictionChoice::Always(Prediction::Intra))?,
                inter: match sample.has_references() {
                    true => Some(with(coder, PredictionChoice::EveryReference)?),
                    false => None,
                },
                smallest: with(coder, PredictionChoice::Smallest)?,
            });
        }
        Ok(Runs {
            coders: measured,
            context: with(Coder::Context, PredictionChoice::Smallest)?,
            exact: run(&EncoderConfig { threads: 1, ..EncoderConfig::preset(Mode::Exact) })?,
        })
    }

    /// The run of a coder; `None` if it is not measured.
    pub fn of(&self, name: &str) -> Option<&Run> {
        self.coders.iter().find(|run| run.name == name)
    }

    /// All of them, as rows of tables.
    pub fn methods(&self) -> Vec<Method<'_>> {
        let method = |name: String, coded| Method { name, coded, only_with_reference: false };
        let mut methods = Vec::new();
        for run in &self.coders {
            methods.push(method(format!("intra coding, {}", run.name), Some(&run.intra)));
            let inter = method(format!("inter coding, {}", run.name), run.inter.as_ref());
            methods.push(Method { only_with_reference: true, ..inter });
            methods.push(method(format!("any prediction, {}", run.name), Some(&run.smallest)));
        }
        methods.push(method("context coder, same image".to_owned(), Some(&self.context)));
        methods.push(method("exact mode, whole files".to_owned(), Some(&self.exact)));
        methods
    }
}

/// A coder that is measured, as a row of a table.
pub struct Method<'a> {
    /// Its name in the published values.
    pub name: String,
    /// The sample coded by it; `None` if it cannot be measured here.
    pub coded: Option<&'a Coded>,
    /// Whether only frames that have one before them count.
    pub only_with_reference: bool,
}

impl Method<'_> {
    /// The frames of the sample that count.
    pub fn frames(&self, sample: &Sample) -> Vec<usize> {
        match self.only_with_reference {
            true => sample.compared().collect(),
            false => (0..sample.inputs.len()).collect(),
        }
    }

    /// Its name, with its measured values.
    pub fn measured<const M: usize>(
        &self,
        measure: impl Fn(&Self, &Coded) -> [Option<f64>; M],
    ) -> (String, [Option<f64>; M]) {
        (self.name.clone(), self.coded.map_or([None; M], |coded| measure(self, coded)))
    }
}

/// A row for each measured method, with its measured and its published values, and a row for each method with
/// published values only.
pub fn rows_of_methods<const M: usize, const P: usize>(
    measured: Vec<(String, [Option<f64>; M])>,
    published: &[(&str, [f64; P])],
) -> Vec<Row> {
    let row = |name: &str, measured: [Option<f64>; M]| {
        let published = published.iter().find(|(other, _)| *other == name);
        let published = published.map_or([None; P], |(_, values)| values.map(Some));
        Row { name: name.to_owned(), cells: measured.into_iter().chain(published).collect() }
    };
    let is_measured = |name: &str| measured.iter().any(|(other, _)| other == name);
    let others =
        published.iter().filter(|(name, _)| !is_measured(name)).map(|(name, _)| row(name, [None; M]));
    let others: Vec<_> = others.collect();
    measured.into_iter().map(|(name, values)| row(&name, values)).chain(others).collect()
}

/// A column for the measured values, and one for each of the article's scenes.
pub fn columns_by_scene(unit: &str, [measured, published]: [usize; 2]) -> Vec<Column> {
    let scenes = SCENES.iter().map(|scene| column(scene, unit, Some(published), Origin::Published));
    [column("this drive", unit, Some(measured), Origin::Measured)].into_iter().chain(scenes).collect()
}

/// Creates a column.
pub fn column(name: &str, unit: &str, decimals: Option<usize>, origin: Origin) -> Column {
    Column { name: name.into(), unit: unit.into(), origin, decimals }
}

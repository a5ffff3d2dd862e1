//! Code shared by the tables.

use super::experiment::Coded;
use super::published::SCENES;
use super::report::{Column, Origin, Row};
use super::sample::Sample;

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

//! Figure 13 as a table and as plots.

use super::{BACKENDS, FORMS, Figure13, Form, Source};
use crate::study::bench::published;
use crate::study::bench::report::{Axis, Figure, Marker, Origin, Point, Row, Scale, Section, Series, Table};
use crate::study::bench::tables::column;

/// The back-end that does not compress: shown in the table, not in the plots.
const STORE: &str = "store";

impl Figure13 {
    /// The table in KB, and the plots of ratios: in floats and in integers.
    pub fn sections(&self) -> Vec<Section> {
        let floats = self.plot(
            "Figure 13, floats",
            true,
            "As in the article: the range image and what prediction leaves of it as 32-bit floats. The article's \
             figure is a plot; of its values the text states the best and the worst over all scenes."
                .to_owned(),
        );
        let integers = self.plot(
            "Figure 13, integers",
            false,
            "The same ranges as integers in steps, packed for each back-end. diff.: differences along the \
             snake's path."
                .to_owned(),
        );
        vec![self.table(), floats, integers]
    }

    /// Mean KB of a frame.
    fn kilobytes(&self, backend: usize, form: usize) -> Option<f64> {
        let is_measured =
            self.frames > 0 && (FORMS[form].source != Source::FrameBefore || self.has_references);
        is_measured.then(|| self.sizes[backend][form] as f64 / self.frames as f64 / 1e3)
    }

    fn table(&self) -> Section {
        let kilobytes = |bytes: u64| bytes as f64 / self.frames.max(1) as f64 / 1e3;
        let row = |(place, backend): (usize, &&dyn crate::backend::Backend)| Row {
            name: backend.name().into(),
            cells: (0..FORMS.len()).map(|form| self.kilobytes(place, form)).collect(),
        };
        Section::Table(Table {
            number: "Figure 13, table".into(),
            title: format!("KB a frame, of {:.0} KB", kilobytes(self.original)),
            note: format!(
                "The mean of {}: those that have one before them, if there are any. Float and integer forms as in the \
                 plots. Intra forms include {:.1} KB of contour map and models of regions. Which cells hold a \
                 return is counted nowhere.",
                self.sample,
                kilobytes(self.side),
            ),
            label: "back-end".into(),
            columns: FORMS.iter().map(|form| column(form.name, "KB", Some(1), Origin::Measured)).collect(),
            rows: BACKENDS.iter().enumerate().map(row).collect(),
        })
    }

    fn plot(&self, number: &str, floats: bool, note: String) -> Section {
        let backends: Vec<_> =
            BACKENDS.iter().enumerate().filter(|(_, backend)| backend.name() != STORE).collect();
        let forms = FORMS.iter().enumerate().filter(|(_, form)| form.floats == floats);
        let measured = forms.map(|(form, about)| {
            let ratio = |backend| self.kilobytes(backend, form).map(|kilobytes| self.percent(kilobytes));
            let points = backends.iter().enumerate().filter_map(|(row, (backend, _))| {
                Some(Point { x: ratio(*backend)?, y: row as f64, label: String::new() })
            });
            let name = about.name.into();
            Series {
                name,
                origin: Origin::Measured,
                line: false,
                marker: marker(about),
                points: points.collect(),
            }
        });
        let mut series: Vec<_> = measured.filter(|series| !series.points.is_empty()).collect();
        if floats {
            let names: Vec<_> = backends.iter().map(|(_, backend)| backend.name()).collect();
            series.extend(published_series(&names));
        }
        let names = backends.iter().map(|(_, backend)| backend.name().to_owned()).collect();
        Section::Figure(Figure {
            number: number.into(),
            title: "what prediction is worth to each back-end".into(),
            note,
            x: Axis { name: "compression rate".into(), unit: "%".into(), scale: Scale::Linear },
            y: Axis { name: "back-end".into(), unit: String::new(), scale: Scale::Categories(names) },
            series,
        })
    }

    /// Equation 11.
    fn percent(&self, kilobytes: f64) -> f64 {
        let original = self.original as f64 / self.frames.max(1) as f64;
        if original > 0.0 { 100.0 * kilobytes * 1e3 / original } else { 0.0 }
    }
}

/// The same marker for the same prediction, but different ones within a plot.
fn marker(form: &Form) -> Marker {
    match (form.source, form.snake && !form.floats) {
        (Source::Nothing, false) => Marker::Circle,
        (Source::Nothing, true) => Marker::Diamond,
        (Source::Regions, false) => Marker::Square,
        (Source::Regions, true) => Marker::Cross,
        (Source::FrameBefore, false) => Marker::Triangle,
        (Source::FrameBefore, true) => Marker::Plus,
    }
}

/// The values that the article's text states for the figure.
fn published_series(backends: &[&str]) -> Vec<Series> {
    let kinds = [("intra, extremes", Marker::Square), ("inter, extremes", Marker::Triangle)];
    let series = published::FIGURE_13.iter().zip(kinds).map(|(extremes, (name, marker))| {
        let points = extremes.iter().filter_map(|(backend, ratio)| {
            let row = backends.iter().position(|name| name == backend)?;
            Some(Point { x: *ratio, y: row as f64, label: String::new() })
        });
        let name = name.to_owned();
        Series { name, origin: Origin::Published, line: false, marker, points: points.collect() }
    });
    series.collect()
}

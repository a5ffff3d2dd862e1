//! The results of experiments as data, from which every form of output is produced: [`text`], [`csv`],
//! [`html`], and JSON by `serde`.

pub mod csv;
pub mod html;
pub mod text;

mod cells;
mod plot;
#[cfg(test)]
mod tests;

use serde::Serialize;

/// All results.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Report {
    /// What the report is about, such as the name of a folder.
    pub title: String,
    /// The most important result, in one sentence; may be empty.
    pub summary: String,
    /// A description of the experiments and their input for people: names and values.
    pub facts: Vec<(String, String)>,
    /// Tables and figures, in the order of the article.
    pub sections: Vec<Section>,
}

/// A table or a figure.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Section {
    /// Rows and columns.
    Table(Table),
    /// A plot.
    Figure(Figure),
}

impl Section {
    /// The number in the article: `Table I`, `Figure 15`.
    pub fn number(&self) -> &str {
        match self {
            Section::Table(table) => &table.number,
            Section::Figure(figure) => &figure.number,
        }
    }

    /// What it shows.
    pub fn title(&self) -> &str {
        match self {
            Section::Table(table) => &table.title,
            Section::Figure(figure) => &figure.title,
        }
    }

    /// How to read it; may be empty.
    pub fn note(&self) -> &str {
        match self {
            Section::Table(table) => &table.note,
            Section::Figure(figure) => &figure.note,
        }
    }
}

/// Where values come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Origin {
    /// From the user's frames, on this machine.
    #[default]
    Measured,
    /// From the article: other scenes and another machine.
    Published,
}

impl Origin {
    /// One word, lower case.
    pub fn name(self) -> &'static str {
        match self {
            Origin::Measured => "measured",
            Origin::Published => "published",
        }
    }
}

/// A table of numbers.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Table {
    /// Its number in the article: `Table I`.
    pub number: String,
    /// What it shows.
    pub title: String,
    /// How to read it; may be empty.
    pub note: String,
    /// The heading of the row names.
    pub label: String,
    /// The columns.
    pub columns: Vec<Column>,
    /// The rows; each has a cell for each column.
    pub rows: Vec<Row>,
}

/// A column of a table.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Column {
    /// Its heading.
    pub name: String,
    /// The unit of its values.
    pub unit: String,
    /// Where its values come from.
    pub origin: Origin,
    /// Number of decimals shown; `None`: as many as the value has.
    pub decimals: Option<usize>,
}

/// A row of a table.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Row {
    /// Its heading.
    pub name: String,
    /// Its values; `None` where a value is missing.
    pub cells: Vec<Option<f64>>,
}

/// A plot.
#[derive(Clone, Debug, Serialize)]
pub struct Figure {
    /// Its number in the article: `Figure 15`.
    pub number: String,
    /// What it shows.
    pub title: String,
    /// How to read it; may be empty.
    pub note: String,
    /// The horizontal axis.
    pub x: Axis,
    /// The vertical axis.
    pub y: Axis,
    /// What is plotted.
    pub series: Vec<Series>,
}

/// An axis of a plot.
#[derive(Clone, Debug, Serialize)]
pub struct Axis {
    /// What it shows.
    pub name: String,
    /// The unit of its values; may be empty.
    pub unit: String,
    /// How values are mapped to it.
    pub scale: Scale,
}

impl Axis {
    /// Name and unit.
    pub fn label(&self) -> String {
        if self.unit.is_empty() { self.name.clone() } else { format!("{} ({})", self.name, self.unit) }
    }
}

/// How values are mapped to an axis.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Scale {
    /// Linearly, from 0.
    Linear,
    /// By their logarithms; 0 has a position of its own.
    Log,
    /// Values are indices into these, from 0, top to bottom; only on the vertical axis.
    Categories(Vec<String>),
}

/// Points of a plot that belong together.
#[derive(Clone, Debug, Serialize)]
pub struct Series {
    /// Its name in the legend.
    pub name: String,
    /// Where its values come from.
    pub origin: Origin,
    /// Whether its points are joined by a line.
    pub line: bool,
    /// How its points are drawn.
    pub marker: Marker,
    /// Its points, in the order in which they are joined.
    pub points: Vec<Point>,
}

/// How a point is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[allow(missing_docs)] // Their names say what they are.
pub enum Marker {
    Circle,
    Square,
    Triangle,
    TriangleDown,
    Diamond,
    Cross,
    Plus,
    Star,
}

/// A point of a plot.
#[derive(Clone, Debug, Serialize)]
pub struct Point {
    /// The horizontal value.
    pub x: f64,
    /// The vertical value.
    pub y: f64,
    /// The setting that gives this point; may be empty.
    pub label: String,
}

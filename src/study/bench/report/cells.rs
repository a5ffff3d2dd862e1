//! Tables and figures as cells of text, for human-readable output, and numbers as such a reader wants them.

use super::{Axis, Figure, Origin, Scale, Section, Series, Table};

/// A grid of text. The first column holds the names of the rows.
pub struct Cells {
    /// The heading of the first column.
    pub label: String,
    /// The other columns.
    pub columns: Vec<Heading>,
    /// Rows: the name, then a cell for each other column.
    pub rows: Vec<(String, Vec<String>)>,
}

/// The heading of a column.
pub struct Heading {
    /// The name of the values.
    pub name: String,
    /// The unit; may be empty.
    pub unit: String,
    /// Where the values come from.
    pub origin: Origin,
}

impl Cells {
    /// The cells of a table, or the points of a figure.
    pub fn of(section: &Section) -> Self {
        match section {
            Section::Table(table) => of_table(table),
            Section::Figure(figure) => match &figure.y.scale {
                Scale::Categories(names) => of_categories(figure, names),
                Scale::Linear | Scale::Log => of_points(figure),
            },
        }
    }

    /// Runs of neighbouring columns with the same origin: the origin and the number of columns. Empty if no
    /// column is published.
    pub fn origins(&self) -> Vec<(Origin, usize)> {
        if self.columns.iter().all(|column| column.origin == Origin::Measured) {
            return Vec::new();
        }
        let groups = self.columns.chunk_by(|a, b| a.origin == b.origin);
        groups.map(|group| (group[0].origin, group.len())).collect()
    }
}

fn of_table(table: &Table) -> Cells {
    let heading = |column: &super::Column| Heading {
        name: column.name.clone(),
        unit: column.unit.clone(),
        origin: column.origin,
    };
    let cells = |row: &super::Row| {
        let cells = table.columns.iter().zip(&row.cells);
        (row.name.clone(), cells.map(|(column, cell)| decimals(*cell, column.decimals)).collect())
    };
    Cells {
        label: table.label.clone(),
        columns: table.columns.iter().map(heading).collect(),
        rows: table.rows.iter().map(cells).collect(),
    }
}

/// A row for each category, a column for each series.
fn of_categories(figure: &Figure, names: &[String]) -> Cells {
    let heading = |series: &Series| Heading {
        name: series.name.clone(),
        unit: figure.x.unit.clone(),
        origin: series.origin,
    };
    let cell = |series: &Series, category: usize| {
        let point = series.points.iter().find(|point| point.y as usize == category);
        decimals(point.map(|point| point.x), Some(2))
    };
    let row = |(category, name): (usize, &String)| {
        (name.clone(), figure.series.iter().map(|series| cell(series, category)).collect())
    };
    Cells {
        label: figure.y.name.clone(),
        columns: figure.series.iter().map(heading).collect(),
        rows: names.iter().enumerate().map(row).collect(),
    }
}

/// A row for each point.
fn of_points(figure: &Figure) -> Cells {
    let axis =
        |axis: &Axis| Heading { name: axis.name.clone(), unit: axis.unit.clone(), origin: Origin::Measured };
    let setting = Heading { name: "setting".into(), unit: String::new(), origin: Origin::Measured };
    let rows = figure.series.iter().flat_map(|series| {
        series.points.iter().map(|point| {
            let name = match series.origin {
                Origin::Measured => series.name.clone(),
                Origin::Published => format!("{} (published)", series.name),
            };
            (name, vec![point.label.clone(), significant(point.x), significant(point.y)])
        })
    });
    Cells {
        label: "series".into(),
        columns: vec![setting, axis(&figure.x), axis(&figure.y)],
        rows: rows.collect(),
    }
}

/// The number with this many decimals, or as many as it has; a dash if there is no value.
fn decimals(value: Option<f64>, decimals: Option<usize>) -> String {
    match (value, decimals) {
        (None, _) => "-".to_owned(),
        (Some(value), None) => value.to_string(),
        (Some(value), Some(decimals)) => format!("{value:.decimals$}"),
    }
}

/// The number with three or four significant digits, and no exponent.
pub fn significant(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let whole_digits = value.abs().log10().floor() as i32 + 1;
    let decimals = (4 - whole_digits).clamp(0, 9) as usize;
    let text = format!("{value:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_the_digits_that_say_something() {
        let cases = [
            (0.0, "0"),
            (1.0, "1"),
            (7.6049, "7.605"),
            (0.000_287_6, "0.0002876"),
            (0.05, "0.05"),
            (1978.4, "1978"),
            (123_456.7, "123457"),
        ];
        for (value, expected) in cases {
            assert_eq!(significant(value), expected);
        }
        assert_eq!(decimals(Some(3.456), Some(2)), "3.46");
        assert_eq!(decimals(Some(27.12), None), "27.12");
        assert_eq!(decimals(None, Some(2)), "-");
    }
}

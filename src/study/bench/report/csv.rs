//! A report as one CSV table (RFC 4180), with one line for each value:
//!
//! ```text
//! section,series,x,x_unit,y,y_unit,origin
//! ```
//!
//! For a table, `series` is the row, `x` the column and `y` the value. For a figure they are what their names
//! say; a category is given by its name.

use std::io::{self, Write};

use csv::{Terminator, Writer, WriterBuilder};

use super::{Axis, Figure, Report, Scale, Section, Table};

/// The names of the columns.
const HEADER: [&str; 7] = ["section", "series", "x", "x_unit", "y", "y_unit", "origin"];

/// Writes a report.
///
/// # Errors
/// If `out` fails.
pub fn write(report: &Report, out: &mut dyn Write) -> io::Result<()> {
    let mut csv = WriterBuilder::new().terminator(Terminator::CRLF).from_writer(out);
    csv.write_record(HEADER)?;
    for section in &report.sections {
        match section {
            Section::Table(table) => write_table(table, &mut csv)?,
            Section::Figure(figure) => write_figure(figure, &mut csv)?,
        }
    }
    csv.flush()
}

fn write_table(table: &Table, csv: &mut Writer<impl Write>) -> csv::Result<()> {
    for row in &table.rows {
        for (column, cell) in table.columns.iter().zip(&row.cells) {
            let Some(value) = cell else { continue };
            let (value, origin) = (value.to_string(), column.origin.name());
            csv.write_record([&table.number, &row.name, &column.name, "", &value, &column.unit, origin])?;
        }
    }
    Ok(())
}

fn write_figure(figure: &Figure, csv: &mut Writer<impl Write>) -> csv::Result<()> {
    for series in &figure.series {
        for point in &series.points {
            let (x, y) = (value_on(&figure.x, point.x), value_on(&figure.y, point.y));
            let (x_unit, y_unit) = (&figure.x.unit, &figure.y.unit);
            let origin = series.origin.name();
            csv.write_record([&figure.number, &series.name, &x, x_unit, &y, y_unit, origin])?;
        }
    }
    Ok(())
}

fn value_on(axis: &Axis, value: f64) -> String {
    match &axis.scale {
        Scale::Categories(names) => names.get(value as usize).cloned().unwrap_or_default(),
        Scale::Linear | Scale::Log => value.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::report;
    use super::*;

    #[test]
    fn every_value_has_a_line() {
        let mut out = Vec::new();
        write(&report(), &mut out).unwrap();
        let text = String::from_utf8(out).unwrap();
        let lines: Vec<_> = text.split("\r\n").collect();
        assert_eq!(
            lines,
            [
                "section,series,x,x_unit,y,y_unit,origin",
                "Table I,\"intra, <LZMA>\",this drive,,3.25,%,measured",
                "Table I,\"intra, <LZMA>\",city,,3.16,%,published",
                "Table I,octree,city,,20.14,%,published",
                "Figure 15,\"LZMA & \"\"co\"\"\",4.5,bits a point,0.001,m,measured",
                "Figure 15,\"LZMA & \"\"co\"\"\",2,bits a point,0.1,m,measured",
                "Figure 15,exact,9,bits a point,0,m,measured",
                "Figure 13,image,4.98,%,lzma,,measured",
                "",
            ]
        );
    }
}

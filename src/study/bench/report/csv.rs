//! A report as one CSV table (RFC 4180), with one line for each value:
//!
//! ```text
//! section,series,x,x_unit,y,y_unit,origin
//! ```
//!
//! For a table, `series` is the row, `x` the column and `y` the value. For a figure they mean what they say;
//! a category is given by its name.

use std::io::{self, Write};

use super::{Axis, Figure, Report, Scale, Section, Table};

/// The names of the columns.
const HEADER: [&str; 7] = ["section", "series", "x", "x_unit", "y", "y_unit", "origin"];

/// Writes a report.
///
/// # Errors
/// If `out` fails.
pub fn write(report: &Report, out: &mut dyn Write) -> io::Result<()> {
    write_line(out, &HEADER)?;
    for section in &report.sections {
        match section {
            Section::Table(table) => write_table(table, out)?,
            Section::Figure(figure) => write_figure(figure, out)?,
        }
    }
    Ok(())
}

fn write_table(table: &Table, out: &mut dyn Write) -> io::Result<()> {
    for row in &table.rows {
        for (column, cell) in table.columns.iter().zip(&row.cells) {
            let Some(value) = cell else { continue };
            let (value, origin) = (value.to_string(), column.origin.name());
            write_line(out, &[&table.number, &row.name, &column.name, "", &value, &column.unit, origin])?;
        }
    }
    Ok(())
}

fn write_figure(figure: &Figure, out: &mut dyn Write) -> io::Result<()> {
    for series in &figure.series {
        for point in &series.points {
            let (x, y) = (value_on(&figure.x, point.x), value_on(&figure.y, point.y));
            let (x_unit, y_unit) = (&figure.x.unit, &figure.y.unit);
            let origin = series.origin.name();
            write_line(out, &[&figure.number, &series.name, &x, x_unit, &y, y_unit, origin])?;
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

fn write_line(out: &mut dyn Write, fields: &[&str; 7]) -> io::Result<()> {
    writeln!(out, "{}\r", fields.map(quoted).join(","))
}

/// A field, in quotation marks if it needs them.
fn quoted(field: &str) -> String {
    if field.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", field.replace('"', "\"\""))
    } else {
        field.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::report;
    use super::*;

    #[test]
    fn fields_are_quoted_where_they_must_be() {
        assert_eq!(quoted("plain 1.5"), "plain 1.5");
        assert_eq!(quoted("a, b"), "\"a, b\"");
        assert_eq!(quoted("the \"best\""), "\"the \"\"best\"\"\"");
    }

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

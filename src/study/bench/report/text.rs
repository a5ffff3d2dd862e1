//! A report as text, for a terminal.

use std::io::{self, Write};

use super::cells::{Cells, Heading};
use super::{Report, Section};
use crate::study::bench::published;

/// The largest number of characters in a line of prose.
const WIDTH: usize = 100;
/// Characters between columns.
const GAP: usize = 2;

/// Writes a report.
///
/// # Errors
/// If `out` fails.
pub fn write(report: &Report, out: &mut dyn Write) -> io::Result<()> {
    writeln!(out, "{}\n", report.title)?;
    if !report.summary.is_empty() {
        write_wrapped(out, "", 0, &report.summary)?;
        writeln!(out)?;
    }
    let widest = report.facts.iter().map(|(name, _)| name.chars().count()).max().unwrap_or_default();
    for (name, value) in &report.facts {
        write_wrapped(out, &format!("{name:<widest$}  "), widest + GAP, value)?;
    }
    report.sections.iter().try_for_each(|section| write_section(section, out))
}

fn write_section(section: &Section, out: &mut dyn Write) -> io::Result<()> {
    writeln!(out, "\n{}: {}\n", section.number(), section.title())?;
    let cells = Cells::of(section);
    write_cells(&cells, out)?;
    if !cells.origins().is_empty() {
        writeln!(out, "\n* {}", published::REMARK)?;
    }
    if !section.note().is_empty() {
        writeln!(out)?;
        write_wrapped(out, "", 0, section.note())?;
    }
    Ok(())
}

fn write_cells(cells: &Cells, out: &mut dyn Write) -> io::Result<()> {
    let length = |text: &str| text.chars().count();
    let mark = |heading: &Heading| match heading.origin {
        super::Origin::Measured => heading.name.clone(),
        super::Origin::Published => format!("{}*", heading.name),
    };
    let names: Vec<_> = cells.columns.iter().map(mark).collect();
    let units: Vec<_> = cells.columns.iter().map(|column| column.unit.clone()).collect();
    let width = |column: usize| {
        let values = cells.rows.iter().map(|(_, values)| length(&values[column]));
        values.chain([length(&names[column]), length(&units[column])]).max().unwrap_or_default()
    };
    let widths: Vec<_> = (0..names.len()).map(width).collect();
    let labels = cells.rows.iter().map(|(name, _)| length(name)).chain([length(&cells.label)]).max();
    let mut line = |label: &str, values: &[String]| {
        let first = labels.unwrap_or_default();
        let values = values.iter().zip(&widths).map(|(value, &width)| format!("{value:>width$}"));
        let values: Vec<_> = values.collect();
        let line = format!("{label:<first$}{:GAP$}{}", "", values.join(&" ".repeat(GAP)));
        writeln!(out, "{}", line.trim_end())
    };
    line(&cells.label, &names)?;
    if units.iter().any(|unit| !unit.is_empty()) {
        line("", &units)?;
    }
    cells.rows.iter().try_for_each(|(name, values)| line(name, values))
}

/// Writes words in lines, the first after `start`, the others indented by `indent` spaces.
fn write_wrapped(out: &mut dyn Write, start: &str, indent: usize, text: &str) -> io::Result<()> {
    let (mut line, mut is_empty) = (start.to_owned(), true);
    for word in text.split_whitespace() {
        if !is_empty && line.chars().count() + 1 + word.chars().count() > WIDTH {
            writeln!(out, "{line}")?;
            (line, is_empty) = (" ".repeat(indent), true);
        }
        if !is_empty {
            line.push(' ');
        }
        line.push_str(word);
        is_empty = false;
    }
    writeln!(out, "{}", line.trim_end())
}

#[cfg(test)]
mod tests {
    use super::super::tests::report;
    use super::*;

    #[test]
    fn tables_are_aligned_and_say_what_is_published() {
        let mut out = Vec::new();
        write(&report(), &mut out).unwrap();
        let text = String::from_utf8(out).unwrap();
        let expected = "\
Table I: rates

method         this drive  city*
                        %      %
intra, <LZMA>        3.25   3.16
octree                  -  20.14

* published, other scenes and another machine

Smaller is better.
";
        assert!(text.contains(expected), "{text}");
        let expected = "\
series       setting          bits   RMSE
                      bits a point      m
LZMA & \"co\"     1 mm           4.5  0.001
LZMA & \"co\"    10 cm             2    0.1
exact                            9      0
";
        assert!(text.contains(expected), "{text}");
        assert!(text.starts_with("drive\n\nLZMA & \"co\" is ahead\n\nframes  2\n"), "{text}");
    }

    #[test]
    fn prose_is_wrapped() {
        let mut out = Vec::new();
        write_wrapped(&mut out, "name  ", 6, &"word ".repeat(30)).unwrap();
        let text = String::from_utf8(out).unwrap();
        let lines: Vec<_> = text.lines().collect();
        assert_eq!(lines.len(), 2);
        assert!(lines[0].starts_with("name  word") && lines[0].len() <= WIDTH);
        assert!(lines[1].starts_with("      word") && text.matches("word").count() == 30);
    }
}

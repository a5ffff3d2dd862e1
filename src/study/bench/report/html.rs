//! A report as one self-contained HTML file: no network, no scripts.

use std::io::{self, Write};

use super::cells::{Cells, Heading};
use super::plot::escape;
use super::{Origin, Report, Section, plot};
use crate::study::bench::published;

const STYLE: &str = include_str!("style.css");

/// Writes a report.
///
/// # Errors
/// If `out` fails.
pub fn write(report: &Report, out: &mut dyn Write) -> io::Result<()> {
    let title = escape(&report.title);
    writeln!(out, "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">")?;
    writeln!(out, "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">")?;
    writeln!(out, "<title>{title}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<h1>{title}</h1>")?;
    if !report.summary.is_empty() {
        writeln!(out, "<p class=\"summary\">{}</p>", escape(&report.summary))?;
    }
    writeln!(out, "<dl>")?;
    for (name, value) in &report.facts {
        writeln!(out, "<dt>{}</dt><dd>{}</dd>", escape(name), escape(value))?;
    }
    writeln!(out, "</dl>\n<nav>")?;
    for (place, section) in report.sections.iter().enumerate() {
        writeln!(out, "<a href=\"#s{place}\">{}</a>", escape(section.number()))?;
    }
    writeln!(out, "</nav>")?;
    for (place, section) in report.sections.iter().enumerate() {
        write_section(section, place, out)?;
    }
    writeln!(out, "</body>\n</html>")
}

fn write_section(section: &Section, place: usize, out: &mut dyn Write) -> io::Result<()> {
    let (number, title) = (escape(section.number()), escape(section.title()));
    writeln!(out, "<section id=\"s{place}\">\n<h2>{number}: {title}</h2>")?;
    let cells = Cells::of(section);
    match section {
        Section::Table(_) => write_table(&cells, out)?,
        Section::Figure(figure) => {
            writeln!(out, "<div class=\"wide\">\n{}</div>", plot::draw(figure))?;
            writeln!(out, "<details><summary>The values</summary>")?;
            write_table(&cells, out)?;
            writeln!(out, "</details>")?;
        }
    }
    if !section.note().is_empty() {
        writeln!(out, "<p class=\"note\">{}</p>", escape(section.note()))?;
    }
    writeln!(out, "</section>")
}

fn write_table(cells: &Cells, out: &mut dyn Write) -> io::Result<()> {
    writeln!(out, "<div class=\"wide\">\n<table>\n<thead>")?;
    let origins = cells.origins();
    if !origins.is_empty() {
        write!(out, "<tr class=\"origins\"><th></th>")?;
        for (origin, columns) in origins {
            let remark = match origin {
                Origin::Measured => "measured",
                Origin::Published => published::REMARK,
            };
            write!(out, "<th colspan=\"{columns}\" class=\"{}\">{remark}</th>", origin.name())?;
        }
        writeln!(out, "</tr>")?;
    }
    write_headings(cells, "names", &cells.label, |column| &column.name, out)?;
    if cells.columns.iter().any(|column| !column.unit.is_empty()) {
        write_headings(cells, "units", "", |column| &column.unit, out)?;
    }
    writeln!(out, "</thead>\n<tbody>")?;
    for (name, values) in &cells.rows {
        write!(out, "<tr><th scope=\"row\">{}</th>", escape(name))?;
        for (value, column) in values.iter().zip(&cells.columns) {
            write!(out, "<td class=\"{}\">{}</td>", column.origin.name(), escape(value))?;
        }
        writeln!(out, "</tr>")?;
    }
    writeln!(out, "</tbody>\n</table>\n</div>")
}

fn write_headings(
    cells: &Cells,
    class: &str,
    first: &str,
    of: impl Fn(&Heading) -> &String,
    out: &mut dyn Write,
) -> io::Result<()> {
    write!(out, "<tr class=\"{class}\"><th>{}</th>", escape(first))?;
    for column in &cells.columns {
        write!(out, "<th class=\"{}\">{}</th>", column.origin.name(), escape(of(column)))?;
    }
    writeln!(out, "</tr>")
}

#[cfg(test)]
mod tests {
    use super::super::tests::report;
    use super::*;

    fn page() -> String {
        let mut out = Vec::new();
        write(&report(), &mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    /// Checks that every element is closed, in the right order.
    fn check_nesting(page: &str) {
        let mut open = Vec::new();
        for tag in page.split('<').skip(1).map(|rest| &rest[..rest.find('>').unwrap()]) {
            let name = tag.split([' ', '\n']).next().unwrap();
            if let Some(name) = name.strip_prefix('/') {
                assert_eq!(open.pop(), Some(name), "closed");
            } else if !tag.ends_with('/') && !["!DOCTYPE", "meta"].contains(&name) {
                open.push(name);
            }
        }
        assert!(open.is_empty(), "left open: {open:?}");
    }

    #[test]
    fn the_page_is_well_formed_and_needs_nothing_else() {
        let page = page();
        check_nesting(&page);
        for loads in ["http://", "https://", "<script", "<link", "<img", "@import", "url("] {
            assert!(!page.contains(loads), "{loads}");
        }
        assert_eq!(page.matches("<svg ").count(), 2);
        assert_eq!(page.matches("<section ").count(), 3);
    }

    #[test]
    fn text_is_escaped_and_published_values_are_marked() {
        let page = page();
        assert!(page.contains("intra, &lt;LZMA&gt;") && !page.contains("<LZMA>"));
        assert!(page.contains("<td class=\"published\">3.16</td>"));
        assert!(page.contains("<td class=\"measured\">3.25</td>"));
        assert!(page.contains(published::REMARK));
        assert!(page.contains("<p class=\"summary\">LZMA &amp; &quot;co&quot; is ahead</p>"));
    }
}

//! A small report with everything that a report can contain.

use super::*;

/// A table with a published column, a plot of numbers with a 0 on a logarithmic axis, and one of categories.
pub fn report() -> Report {
    let column =
        |name: &str, origin| Column { name: name.into(), unit: "%".into(), origin, decimals: Some(2) };
    let axis = |name: &str, unit: &str, scale| Axis { name: name.into(), unit: unit.into(), scale };
    let point = |x, y, label: &str| Point { x, y, label: label.into() };
    let series = |name: &str, line, marker, points| Series {
        name: name.into(),
        origin: Origin::Measured,
        line,
        marker,
        points,
    };
    let table = Table {
        number: "Table I".into(),
        title: "rates".into(),
        note: "Smaller is better.".into(),
        label: "method".into(),
        columns: vec![column("this drive", Origin::Measured), column("city", Origin::Published)],
        rows: vec![
            Row { name: "intra, <LZMA>".into(), cells: vec![Some(3.25), Some(3.16)] },
            Row { name: "octree".into(), cells: vec![None, Some(20.14)] },
        ],
    };
    let curve = vec![point(4.5, 0.001, "1 mm"), point(2.0, 0.1, "10 cm")];
    let plot = Figure {
        number: "Figure 15".into(),
        title: "rate & distortion".into(),
        note: String::new(),
        x: axis("bits", "bits a point", Scale::Log),
        y: axis("RMSE", "m", Scale::Log),
        series: vec![
            series("LZMA & \"co\"", true, Marker::Circle, curve),
            series("exact", false, Marker::Star, vec![point(9.0, 0.0, "")]),
        ],
    };
    let bars = Figure {
        number: "Figure 13".into(),
        title: "back-ends".into(),
        note: String::new(),
        x: axis("ratio", "%", Scale::Linear),
        y: axis("back-end", "", Scale::Categories(vec!["bzip2".into(), "lzma".into()])),
        series: vec![series("image", false, Marker::Square, vec![point(4.98, 1.0, "")])],
    };
    let sections = vec![Section::Table(table), Section::Figure(plot), Section::Figure(bars)];
    Report {
        title: "drive".into(),
        summary: "LZMA & \"co\" is ahead".into(),
        facts: vec![("frames".into(), "2".into())],
        sections,
    }
}

#[test]
fn json_names_kinds_origins_and_values() {
    let json = serde_json::to_value(report()).unwrap();
    assert_eq!(json["summary"], "LZMA & \"co\" is ahead");
    let sections = json["sections"].as_array().unwrap();
    assert_eq!(sections[0]["kind"], "table");
    assert_eq!(sections[0]["columns"][1]["origin"], "published");
    assert_eq!(sections[0]["rows"][1]["cells"], serde_json::json!([null, 20.14]));
    assert_eq!(sections[1]["y"]["scale"], "log");
    assert_eq!(sections[1]["series"][0]["points"][1]["x"], 2.0);
    assert_eq!(sections[2]["y"]["scale"]["categories"][1], "lzma");
}

//! A figure as a picture: SVG for use in HTML, whose style sheet defines the colours. Series also differ in
//! markers and dashes.

use std::fmt::Write;

use super::axis::{Placed, Tick};
use super::escape::escape;
use super::marker::outline;
use super::number::significant;
use super::{Figure, Marker, Origin, Scale, Series};

/// Width of the picture, in pixels.
const WIDTH: f64 = 1000.0;
/// Pixels to the left of the plot and below it.
const MARGINS: [f64; 2] = [86.0, 58.0];
/// Pixels above the plot.
const TOP: f64 = 14.0;
/// Where the plot ends and the legend begins, in pixels.
const PLOT_END: f64 = 690.0;
/// Height of a line of the legend, in pixels.
const LEGEND_LINE: f64 = 24.0;
/// Height of a plot with numbers on its vertical axis, in pixels.
const HEIGHT: f64 = 440.0;
/// Height of a category, in pixels.
const CATEGORY_HEIGHT: f64 = 44.0;
/// Height within a category over which its series are spread, in pixels.
const CATEGORY_SPREAD: f64 = 28.0;
/// Number of colours in the style sheet.
const COLOURS: usize = 8;
/// Dash patterns of the lines, used in turn.
const DASHES: [&str; 5] = ["", "8 4", "2 4", "10 3 2 3", "16 5"];

/// Draws a figure.
pub fn draw(figure: &Figure) -> String {
    let categories = match &figure.y.scale {
        Scale::Categories(names) => Some(names.len()),
        Scale::Linear | Scale::Log => None,
    };
    let legend = TOP + LEGEND_LINE * figure.series.len() as f64;
    let height = categories.map_or(HEIGHT, |count| CATEGORY_HEIGHT * count as f64).max(legend);
    let bottom = TOP + height;
    let points = || figure.series.iter().flat_map(|series| &series.points);
    let x = Placed::new(&figure.x, points().map(|point| point.x), [MARGINS[0], PLOT_END]);
    let y_pixels = if categories.is_some() { [TOP, bottom] } else { [bottom, TOP] };
    let y = Placed::new(&figure.y, points().map(|point| point.y), y_pixels);

    let mut svg = Svg::default();
    let title = format!("{}: {}", figure.number, figure.title);
    svg.open(&title, bottom + MARGINS[1]);
    match categories {
        Some(count) => {
            svg.bands(count);
            svg.labels(&y.ticks());
        }
        None => svg.horizontal_lines(&y, &figure.y.label()),
    }
    svg.vertical_lines(&x, bottom, &figure.x.label());
    for (place, series) in figure.series.iter().enumerate() {
        let shift = match categories {
            Some(_) => {
                let count = figure.series.len() as f64;
                (place as f64 - 0.5 * (count - 1.0)) * (CATEGORY_SPREAD / count)
            }
            None => 0.0,
        };
        let places = series.points.iter().map(|point| [x.place(point.x), y.place(point.y) + shift]);
        svg.series(place, series, &places.collect::<Vec<_>>(), figure);
    }
    svg.legend(&figure.series);
    svg.close()
}

/// A picture under construction.
#[derive(Default)]
struct Svg(String);

impl Svg {
    fn add(&mut self, element: std::fmt::Arguments<'_>) {
        // Writing to a string does not fail.
        let _ = self.0.write_fmt(element);
        self.0.push('\n');
    }

    fn open(&mut self, title: &str, height: f64) {
        let title = escape(title);
        self.add(format_args!(
            "<svg viewBox=\"0 0 {WIDTH} {height}\" role=\"img\" aria-label=\"{title}\" class=\"plot\">"
        ));
    }

    fn close(mut self) -> String {
        self.0.push_str("</svg>\n");
        self.0
    }

    fn line(&mut self, class: &str, [x1, y1]: [f64; 2], [x2, y2]: [f64; 2]) {
        self.add(format_args!(
            "<line class=\"{class}\" x1=\"{x1:.1}\" y1=\"{y1:.1}\" x2=\"{x2:.1}\" y2=\"{y2:.1}\"/>"
        ));
    }

    fn text(&mut self, attributes: &str, [x, y]: [f64; 2], text: &str) {
        let text = escape(text);
        self.add(format_args!("<text x=\"{x:.1}\" y=\"{y:.1}\" {attributes}>{text}</text>"));
    }

    /// A band behind every other category.
    fn bands(&mut self, categories: usize) {
        let width = PLOT_END - MARGINS[0];
        for y in (0..categories).step_by(2).map(|category| TOP + CATEGORY_HEIGHT * category as f64) {
            self.add(format_args!(
                "<rect class=\"band\" x=\"{}\" y=\"{y}\" width=\"{width}\" height=\"{CATEGORY_HEIGHT}\"/>",
                MARGINS[0]
            ));
        }
    }

    /// The lines of the horizontal axis' ticks, with their numbers and its name below.
    fn vertical_lines(&mut self, axis: &Placed, bottom: f64, name: &str) {
        for tick in axis.ticks() {
            self.line("grid", [tick.at, TOP], [tick.at, bottom]);
            self.text("text-anchor=\"middle\"", [tick.at, bottom + 20.0], &tick.label);
        }
        let middle = 0.5 * (MARGINS[0] + PLOT_END);
        self.text("text-anchor=\"middle\" class=\"name\"", [middle, bottom + 46.0], name);
        self.line("axis", [MARGINS[0], bottom], [PLOT_END, bottom]);
    }

    /// The lines of the vertical axis' ticks, with their labels and its name to the left.
    fn horizontal_lines(&mut self, axis: &Placed, name: &str) {
        let ticks = axis.ticks();
        for tick in &ticks {
            let class = if axis.zero == Some(tick.at) { "grid zero" } else { "grid" };
            self.line(class, [MARGINS[0], tick.at], [PLOT_END, tick.at]);
        }
        self.labels(&ticks);
        if let (Some(first), Some(last)) = (ticks.first(), ticks.last()) {
            let middle = 0.5 * (first.at + last.at);
            let turned =
                format!("text-anchor=\"middle\" class=\"name\" transform=\"rotate(-90 16 {middle:.1})\"");
            self.text(&turned, [16.0, middle], name);
        }
    }

    /// Labels to the left of the plot.
    fn labels(&mut self, ticks: &[Tick]) {
        for tick in ticks {
            self.text("text-anchor=\"end\"", [MARGINS[0] - 10.0, tick.at + 4.5], &tick.label);
        }
    }

    fn series(&mut self, place: usize, series: &Series, places: &[[f64; 2]], figure: &Figure) {
        self.add(format_args!("<g class=\"{}\">", class(place, series)));
        if series.line {
            let points: Vec<_> = places.iter().map(|[x, y]| format!("{x:.1},{y:.1}")).collect();
            self.polyline(place, &points.join(" "));
        }
        for (point, &at) in series.points.iter().zip(places) {
            let setting = if point.label.is_empty() { String::new() } else { format!(", {}", point.label) };
            let height = match &figure.y.scale {
                Scale::Categories(names) => names.get(point.y as usize).cloned().unwrap_or_default(),
                Scale::Linear | Scale::Log => format!("{} {}", significant(point.y), figure.y.unit),
            };
            let x = significant(point.x);
            let tip = format!("{}{setting}: {x} {}, {height}", series.name, figure.x.unit);
            self.marker(series.marker, at, &tip);
        }
        self.add(format_args!("</g>"));
    }

    fn polyline(&mut self, place: usize, points: &str) {
        let dashes = DASHES[place % DASHES.len()];
        self.add(format_args!("<polyline points=\"{points}\" stroke-dasharray=\"{dashes}\"/>"));
    }

    fn marker(&mut self, marker: Marker, [x, y]: [f64; 2], tip: &str) {
        let tip = escape(tip);
        let path = outline(marker);
        self.add(format_args!(
            "<path transform=\"translate({x:.1} {y:.1})\" d=\"{path}\"><title>{tip}</title></path>"
        ));
    }

    fn legend(&mut self, series: &[Series]) {
        for (place, series) in series.iter().enumerate() {
            let y = TOP + LEGEND_LINE * (place as f64 + 0.5);
            let [start, middle, end] = [0.0, 22.0, 44.0].map(|shift| PLOT_END + 24.0 + shift);
            self.add(format_args!("<g class=\"{}\">", class(place, series)));
            if series.line {
                self.polyline(place, &format!("{start},{y} {end},{y}"));
            }
            self.marker(series.marker, [middle, y], &series.name);
            self.add(format_args!("</g>"));
            let name = match series.origin {
                Origin::Measured => series.name.clone(),
                Origin::Published => format!("{} (published)", series.name),
            };
            self.text("", [end + 10.0, y + 4.5], &name);
        }
    }
}

/// The class that defines the colour, and whether markers are filled.
fn class(place: usize, series: &Series) -> String {
    format!("series c{} {}", place % COLOURS, series.origin.name())
}

#[cfg(test)]
mod tests {
    use super::super::Section;
    use super::super::tests::report;
    use super::*;

    #[test]
    fn every_point_is_drawn_inside_the_picture() {
        for section in &report().sections {
            let Section::Figure(figure) = section else { continue };
            let svg = draw(figure);
            let points: usize = figure.series.iter().map(|series| series.points.len()).sum();
            // The legend has an additional marker for each series.
            assert_eq!(svg.matches("<path ").count(), points + figure.series.len());
            let lines = figure.series.iter().filter(|series| series.line).count();
            assert_eq!(svg.matches("<polyline ").count(), 2 * lines);
            for place in svg.split("translate(").skip(1) {
                let numbers: Vec<f64> =
                    place[..place.find(')').unwrap()].split(' ').map(|n| n.parse().unwrap()).collect();
                assert!((0.0..WIDTH).contains(&numbers[0]) && (0.0..600.0).contains(&numbers[1]), "{place}");
            }
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        }
    }

    #[test]
    fn names_are_escaped() {
        let report = report();
        let Section::Figure(figure) = &report.sections[1] else { panic!("a figure") };
        let svg = draw(figure);
        assert!(svg.contains("LZMA &amp; &quot;co&quot;") && !svg.contains("LZMA & "), "{svg}");
    }
}

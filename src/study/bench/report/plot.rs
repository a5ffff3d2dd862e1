//! A figure as a picture: SVG for use in HTML, whose style sheet defines the colours. Series also differ in
//! markers and dashes. Below the drawing are its axes with their ticks, the shapes of the markers, and the
//! escaping of text, which tables in HTML need as well.

use std::fmt::Write;

use super::cells::significant;
use super::{Axis, Figure, Marker, Origin, Scale, Series};

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

/// Pixels between 0 and the rest of a logarithmic axis.
const ZERO_GAP: f64 = 36.0;
/// The largest number of ticks on a linear axis.
const MOST_TICKS: f64 = 8.0;
/// A logarithmic axis of at most this many decades is also labelled at 2 and 5.
const FEW_DECADES: f64 = 3.5;

/// An axis with its position in the picture.
struct Placed {
    scale: Scale,
    /// Values at its ends; the smaller one of a logarithmic axis is not 0.
    ends: [f64; 2],
    /// The positions of these values, in pixels.
    pixels: [f64; 2],
    /// The position of 0 on a logarithmic axis, if 0 is on it.
    zero: Option<f64>,
}

/// A tick: its position and its label.
#[derive(Clone, Debug, PartialEq)]
struct Tick {
    /// Position in pixels.
    at: f64,
    /// The label; may be empty.
    label: String,
}

impl Placed {
    /// An axis for these values, from one pixel to another.
    fn new(axis: &Axis, values: impl Iterator<Item = f64> + Clone, mut pixels: [f64; 2]) -> Self {
        let finite = values.filter(|value| value.is_finite());
        let largest = finite.clone().fold(0.0, f64::max);
        let mut zero = None;
        let ends = match &axis.scale {
            Scale::Linear => {
                let step = linear_step(largest);
                [0.0, (largest / step).ceil().max(1.0) * step]
            }
            Scale::Log => {
                if finite.clone().any(|value| value <= 0.0) {
                    zero = Some(pixels[0]);
                    pixels[0] += ZERO_GAP * (pixels[1] - pixels[0]).signum();
                }
                let smallest = finite.filter(|value| *value > 0.0).fold(f64::INFINITY, f64::min);
                round_outwards(smallest, largest)
            }
            Scale::Categories(names) => [-0.5, names.len() as f64 - 0.5],
        };
        Placed { scale: axis.scale.clone(), ends, pixels, zero }
    }

    /// The position of a value, in pixels.
    fn place(&self, value: f64) -> f64 {
        let [low, high] = self.ends;
        let part = match (&self.scale, self.zero) {
            (Scale::Log, Some(zero)) if value <= 0.0 => return zero,
            (Scale::Log, _) => (value / low).ln() / (high / low).ln(),
            _ => (value - low) / (high - low),
        };
        self.pixels[0] + part.clamp(0.0, 1.0) * (self.pixels[1] - self.pixels[0])
    }

    /// Its ticks, in ascending order.
    fn ticks(&self) -> Vec<Tick> {
        let [low, high] = self.ends;
        let tick = |value: f64, label: String| Tick { at: self.place(value), label };
        match &self.scale {
            Scale::Categories(names) => {
                names.iter().enumerate().map(|(place, name)| tick(place as f64, name.clone())).collect()
            }
            Scale::Linear => {
                let step = linear_step(high);
                let count = (high / step).round() as usize;
                (0..=count).map(|i| i as f64 * step).map(|value| tick(value, significant(value))).collect()
            }
            Scale::Log => {
                let has_few = (high / low).log10() <= FEW_DECADES;
                let at = |value: f64| {
                    let is_decade = (value.log10() - value.log10().round()).abs() < 1e-9;
                    tick(value, if has_few || is_decade { significant(value) } else { String::new() })
                };
                let zero = self.zero.map(|at| Tick { at, label: "0".to_owned() });
                let values = one_two_fives(low, high).filter(|value| {
                    let (least, most) = (low * (1.0 - 1e-9), high * (1.0 + 1e-9));
                    (least..=most).contains(value)
                });
                zero.into_iter().chain(values.map(at)).collect()
            }
        }
    }
}

/// The distance of the ticks of an axis from 0 to `largest`: 1, 2 or 5 times a power of ten.
fn linear_step(largest: f64) -> f64 {
    if largest <= 0.0 {
        return 1.0;
    }
    let least = largest / MOST_TICKS;
    one_two_fives(least, 10.0 * least).find(|step| *step >= least * (1.0 - 1e-9)).unwrap_or(least)
}

/// The numbers 1, 2 and 5 times powers of ten, from below `low` to above `high`.
fn one_two_fives(low: f64, high: f64) -> impl DoubleEndedIterator<Item = f64> {
    let decades = low.log10().floor() as i32..=high.log10().ceil() as i32;
    decades.flat_map(|decade| [1.0, 2.0, 5.0].map(|digit| digit * 10f64.powi(decade)))
}

/// The closest two of the numbers 1, 2 and 5 times powers of ten between which all values lie.
fn round_outwards(smallest: f64, largest: f64) -> [f64; 2] {
    if !(smallest.is_finite() && largest > 0.0) {
        return [0.1, 1.0];
    }
    let low = one_two_fives(smallest, largest).rfind(|value| *value <= smallest * (1.0 + 1e-9));
    let high = one_two_fives(smallest, largest).find(|value| *value >= largest * (1.0 - 1e-9));
    let (low, high) = (low.unwrap_or(smallest), high.unwrap_or(largest));
    if high > low { [low, high] } else { [low / 2.0, high * 2.0] }
}

/// Half the size of a marker, in pixels.
const MARKER_RADIUS: f64 = 5.0;

/// The outline of a marker around the origin, as the `d` of an SVG path.
fn outline(marker: Marker) -> String {
    let polygon = |points: &[[f64; 2]]| {
        let points: Vec<_> = points
            .iter()
            .map(|[x, y]| format!("{:.2} {:.2}", x * MARKER_RADIUS, y * MARKER_RADIUS))
            .collect();
        format!("M{}Z", points.join("L"))
    };
    match marker {
        Marker::Circle => {
            let [r, d] = [MARKER_RADIUS, 2.0 * MARKER_RADIUS];
            format!("M-{r} 0a{r} {r} 0 1 0 {d} 0a{r} {r} 0 1 0 -{d} 0Z")
        }
        Marker::Square => polygon(&[[-0.9, -0.9], [0.9, -0.9], [0.9, 0.9], [-0.9, 0.9]]),
        Marker::Triangle => polygon(&[[0.0, -1.2], [1.1, 0.8], [-1.1, 0.8]]),
        Marker::TriangleDown => polygon(&[[0.0, 1.2], [1.1, -0.8], [-1.1, -0.8]]),
        Marker::Diamond => polygon(&[[0.0, -1.3], [1.1, 0.0], [0.0, 1.3], [-1.1, 0.0]]),
        Marker::Cross => polygon(&[
            [-1.2, -0.8],
            [-0.8, -1.2],
            [0.0, -0.4],
            [0.8, -1.2],
            [1.2, -0.8],
            [0.4, 0.0],
            [1.2, 0.8],
            [0.8, 1.2],
            [0.0, 0.4],
            [-0.8, 1.2],
            [-1.2, 0.8],
            [-0.4, 0.0],
        ]),
        Marker::Plus => polygon(&[
            [-0.3, -1.3],
            [0.3, -1.3],
            [0.3, -0.3],
            [1.3, -0.3],
            [1.3, 0.3],
            [0.3, 0.3],
            [0.3, 1.3],
            [-0.3, 1.3],
            [-0.3, 0.3],
            [-1.3, 0.3],
            [-1.3, -0.3],
            [-0.3, -0.3],
        ]),
        Marker::Star => polygon(&STAR),
    }
}

/// The corners of a star of five points.
const STAR: [[f64; 2]; 10] = [
    [0.0, -1.6],
    [0.38, -0.52],
    [1.52, -0.49],
    [0.61, 0.2],
    [0.94, 1.29],
    [0.0, 0.64],
    [-0.94, 1.29],
    [-0.61, 0.2],
    [-1.52, -0.49],
    [-0.38, -0.52],
];

/// The text with characters that have a meaning in HTML replaced; fit for elements and for attributes in
/// quotation marks.
pub fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\'' => escaped.push_str("&#39;"),
            // HTML accepts no other control characters.
            c if c.is_control() && c != '\n' && c != '\t' => escaped.push('\u{fffd}'),
            c => escaped.push(c),
        }
    }
    escaped
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

    fn placed(scale: Scale, values: &[f64], pixels: [f64; 2]) -> Placed {
        let axis = Axis { name: String::new(), unit: String::new(), scale };
        Placed::new(&axis, values.iter().copied(), pixels)
    }

    fn labels(axis: &Placed) -> Vec<String> {
        axis.ticks().into_iter().map(|tick| tick.label).collect()
    }

    #[test]
    fn linear_axes_begin_at_0_and_have_round_ticks() {
        let axis = placed(Scale::Linear, &[3.16, 10.56], [100.0, 700.0]);
        assert_eq!(labels(&axis), ["0", "2", "4", "6", "8", "10", "12"]);
        assert_eq!([0.0, 6.0, 12.0].map(|value| axis.place(value)), [100.0, 400.0, 700.0]);
        assert_eq!(labels(&placed(Scale::Linear, &[0.7], [0.0, 1.0])).last().unwrap(), "0.7");
        assert_eq!(labels(&placed(Scale::Linear, &[], [0.0, 1.0])).last().unwrap(), "1");
    }

    #[test]
    fn logarithmic_axes_have_a_place_for_0() {
        let axis = placed(Scale::Log, &[0.0003, 0.03, 0.0], [500.0, 20.0]);
        assert_eq!(
            labels(&axis),
            ["0", "0.0002", "0.0005", "0.001", "0.002", "0.005", "0.01", "0.02", "0.05"]
        );
        assert_eq!(axis.place(0.0), 500.0);
        assert_eq!((axis.place(0.0002), axis.place(0.05)), (500.0 - ZERO_GAP, 20.0));
        let ticks = axis.ticks();
        assert!(ticks.is_sorted_by(|a, b| a.at > b.at), "{ticks:?}");
    }

    #[test]
    fn long_logarithmic_axes_have_numbers_at_decades_only() {
        let axis = placed(Scale::Log, &[1e-6, 3.0], [0.0, 600.0]);
        let labels = labels(&axis);
        assert_eq!(labels.iter().filter(|label| !label.is_empty()).count(), 7);
        assert_eq!(labels.iter().filter(|label| label.is_empty()).count(), 14);
        assert_eq!(axis.zero, None);
    }

    #[test]
    fn any_values_have_an_axis() {
        for values in [&[][..], &[0.0], &[1.0], &[f64::NAN, f64::INFINITY], &[5.0, 5.0]] {
            for scale in [Scale::Linear, Scale::Log, Scale::Categories(vec!["a".into()])] {
                let axis = placed(scale, values, [0.0, 100.0]);
                assert!(values.iter().all(|value| !value.is_finite() || axis.place(*value).is_finite()));
                assert!(!axis.ticks().is_empty());
            }
        }
    }

    #[test]
    fn text_cannot_become_markup() {
        assert_eq!(escape("<a href='x'>&\"\u{1}"), "&lt;a href=&#39;x&#39;&gt;&amp;&quot;\u{fffd}");
    }
}

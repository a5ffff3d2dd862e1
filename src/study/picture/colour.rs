//! Colours whose perceived differences correspond to the differences of the numbers that they represent, and
//! the range of numbers that a map of colours covers.
//!
//! All of them are defined in Oklch (lightness, chroma, hue), in which equal distances look equal (B.
//! Ottosson, "A perceptual color space for image processing", 2020).

/// Red, green and blue in sRGB.
pub type Rgb = [u8; 3];

/// No return.
pub const BLACK: Rgb = [0; 3];
/// Text and marks.
pub const WHITE: Rgb = [255; 3];
/// A return that is only shown to exist.
pub const PLAIN: Rgb = [200; 3];
/// A return that belongs to no region.
pub const GREY: Rgb = [90; 3];

/// Number of colours of a map.
const SHADES: usize = 256;
/// Degrees between the hues of neighbouring labels: the golden angle, which fills the circle evenly for any
/// number of labels.
const GOLDEN_ANGLE: f64 = 137.507_764_05;

/// Colours for the numbers from 0 to 1.
pub struct ColourMap(Vec<Rgb>);

impl ColourMap {
    /// From small to large: dark blue, green, light yellow, with rising lightness.
    pub fn sequential() -> Self {
        Self::new(|part| oklch(0.38 + 0.57 * part, 0.15, 285.0 - 185.0 * part))
    }

    /// Blue below the middle, which is white, and red above.
    pub fn diverging() -> Self {
        Self::new(|part| {
            let side = 2.0 * part - 1.0;
            let hue = if side < 0.0 { 260.0 } else { 30.0 };
            oklch(0.97 - 0.52 * side.abs(), 0.21 * side.abs(), hue)
        })
    }

    fn new(colour: impl Fn(f64) -> Rgb) -> Self {
        ColourMap((0..SHADES).map(|shade| colour(shade as f64 / (SHADES - 1) as f64)).collect())
    }

    /// The colour of a number; numbers outside 0 to 1 have that of the nearer end.
    pub fn at(&self, part: f64) -> Rgb {
        self.0[(part.clamp(0.0, 1.0) * (SHADES - 1) as f64).round() as usize]
    }
}

/// The colour of a label: always the same, and unlike those of neighbouring labels.
pub fn of_label(label: u32) -> Rgb {
    let lightness = [0.62, 0.80, 0.70][label as usize % 3];
    oklch(lightness, 0.16, f64::from(label) * GOLDEN_ANGLE)
}

/// A brown for a piece of ground; pieces with neighbouring labels have different browns.
pub fn of_ground(label: u32) -> Rgb {
    oklch([0.42, 0.36, 0.48][label as usize % 3], 0.045, 70.0)
}

/// Lightness 0 to 1, chroma (0 is grey), hue in degrees; the chroma is reduced if it is outside sRGB.
fn oklch(lightness: f64, chroma: f64, hue: f64) -> Rgb {
    let (sin, cos) = hue.to_radians().sin_cos();
    let mut rgb = linear_rgb(lightness, chroma * cos, chroma * sin);
    for less in (0..20).rev().map(|part| chroma * f64::from(part) / 20.0) {
        if rgb.iter().all(|value| (-1e-9..=1.0 + 1e-9).contains(value)) {
            break;
        }
        rgb = linear_rgb(lightness, less * cos, less * sin);
    }
    rgb.map(|value| (gamma(value.clamp(0.0, 1.0)) * 255.0).round() as u8)
}

/// From Oklab to linear sRGB, with Ottosson's constants.
fn linear_rgb(lightness: f64, a: f64, b: f64) -> [f64; 3] {
    let l = (lightness + 0.396_337_777_4 * a + 0.215_803_757_3 * b).powi(3);
    let m = (lightness - 0.105_561_345_8 * a - 0.063_854_172_8 * b).powi(3);
    let s = (lightness - 0.089_484_177_5 * a - 1.291_485_548 * b).powi(3);
    [
        4.076_741_662_1 * l - 3.307_711_591_3 * m + 0.230_969_929_2 * s,
        -1.268_438_004_6 * l + 2.609_757_401_1 * m - 0.341_319_396_5 * s,
        -0.004_196_086_3 * l - 0.703_418_614_7 * m + 1.707_614_701 * s,
    ]
}

/// The transfer function of sRGB (IEC 61966-2-1).
fn gamma(linear: f64) -> f64 {
    if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

/// The numbers from one end of a colour map to the other, in metres or, for errors, millimetres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    low: f64,
    high: f64,
    spacing: Spacing,
}

/// The kind of change that is constant along a scale.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Spacing {
    /// Equal differences.
    Linear,
    /// Equal ratios.
    Ratio,
    /// Equal differences within this distance from 0, and equal ratios beyond.
    RatioBeyond(f64),
}

/// The least width of a scale, in its unit, for data that are all equal.
const LEAST_SPAN: f64 = 1e-3;
/// The lower end of a scale of ratios is at least this, in metres.
const LEAST_RANGE: f64 = 0.1;
/// The least ratio between the ends of a scale of ratios.
const LEAST_RATIO: f64 = 2.0;

impl Scale {
    /// For ranges (metres, in any order): by ratio, from the 1st to the 99th percentile, or 1 to 100 m if
    /// there are none. Predictions are best shown on the scale of the ranges that they predict.
    pub fn of_ranges(metres: impl Iterator<Item = f64>) -> Self {
        let sorted = sorted(metres.filter(|range| *range > 0.0));
        if sorted.is_empty() {
            return Scale { low: 1.0, high: 100.0, spacing: Spacing::Ratio };
        }
        let low = percentile(&sorted, 0.01).max(LEAST_RANGE);
        Scale { low, high: percentile(&sorted, 0.99).max(low * LEAST_RATIO), spacing: Spacing::Ratio }
    }

    /// For heights (metres): from the 2nd to the 98th percentile.
    pub fn of_heights(metres: impl Iterator<Item = f64>) -> Self {
        let sorted = sorted(metres);
        let low = percentile(&sorted, 0.02);
        // For large numbers a small difference would be lost to rounding.
        let least_span = LEAST_SPAN.max(low.abs() * 1e-6);
        let high = percentile(&sorted, 0.98).max(low + least_span);
        Scale { low, high, spacing: Spacing::Linear }
    }

    /// For errors (metres or millimetres): from 0 to the 98th percentile, by ratio beyond the median, since
    /// the small ones are noise, the large ones are edges, and both are of interest.
    pub fn of_errors(metres: impl Iterator<Item = f64>) -> Self {
        let sorted = sorted(metres);
        let high = percentile(&sorted, 0.98).max(LEAST_SPAN);
        let knee = percentile(&sorted, 0.5).clamp(LEAST_SPAN, high);
        Scale { low: 0.0, high, spacing: Spacing::RatioBeyond(knee) }
    }

    /// For residuals (metres): as for errors, extending as far below 0 as above.
    pub fn of_residuals(metres: impl Iterator<Item = f64>) -> Self {
        let errors = Self::of_errors(metres.map(f64::abs));
        Scale { low: -errors.high, ..errors }
    }

    /// The position of a number: 0 at the lower end, 1 at the upper one.
    pub fn part(&self, metres: f64) -> f64 {
        let [low, here, high] = [self.low, metres, self.high].map(|metres| match self.spacing {
            Spacing::Linear => metres,
            Spacing::Ratio => metres.ln(),
            Spacing::RatioBeyond(knee) => (metres / knee).asinh(),
        });
        (here - low) / (high - low)
    }

    /// Round numbers on the scale, in ascending order, each with its text.
    pub fn ticks(&self) -> Vec<(f64, String)> {
        match self.spacing {
            Spacing::Linear => self.linear_ticks(),
            Spacing::Ratio => self.round_numbers(self.low, &[1, 2, 5]),
            Spacing::RatioBeyond(knee) => self.ticks_beyond(knee),
        }
    }

    /// Numbers from `least` to the upper end with these digits in each decade.
    fn round_numbers(&self, least: f64, digits: &[i32]) -> Vec<(f64, String)> {
        let decades = (least.log10().floor() as i32)..=(self.high.log10().ceil() as i32);
        decades
            .flat_map(|decade| digits.iter().map(move |digit| (decade, f64::from(*digit))))
            .map(|(decade, digit)| (digit * 10f64.powi(decade), decimals(decade)))
            .filter(|(metres, _)| (least..=self.high).contains(metres))
            .map(|(metres, decimals)| (metres, format!("{metres:.decimals$}")))
            .collect()
    }

    /// Round numbers from `knee` on, zero, and the same below zero if the scale extends there; the more
    /// decades there are, the fewer numbers each has.
    fn ticks_beyond(&self, knee: f64) -> Vec<(f64, String)> {
        let above = match self.high / knee {
            100.0.. => self.round_numbers(knee, &[1]),
            10.0.. => self.round_numbers(knee, &[1, 3]),
            _ => self.round_numbers(knee / 3.0, &[1, 2, 5]),
        };
        let below = above.iter().rev().filter(|(metres, _)| -metres >= self.low);
        let mut ticks: Vec<_> = below.map(|(metres, text)| (-metres, format!("-{text}"))).collect();
        ticks.push((0.0, "0".to_owned()));
        ticks.extend(above);
        ticks
    }

    fn linear_ticks(&self) -> Vec<(f64, String)> {
        const INTERVALS: f64 = 6.0;
        let rough = (self.high - self.low) / INTERVALS;
        let unit = 10f64.powi(rough.log10().floor() as i32);
        let step = unit * [1.0, 2.0, 5.0].into_iter().find(|digit| digit * unit >= rough).unwrap_or(10.0);
        let decimals = decimals(step.log10().floor() as i32);
        let first = (self.low / step).ceil();
        (0..=(((self.high / step).floor() - first) as usize).min(INTERVALS as usize))
            // Adding zero turns -0 into 0.
            .map(|tick| (first + tick as f64) * step + 0.0)
            .map(|metres| (metres, format!("{metres:.decimals$}")))
            .collect()
    }
}

/// Number of digits after the decimal point that numbers of a decade need.
fn decimals(decade: i32) -> usize {
    decade.saturating_neg().clamp(0, 9) as usize
}

/// The finite numbers, in ascending order.
fn sorted(metres: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = metres.filter(|value| value.is_finite()).collect();
    values.sort_by(f64::total_cmp);
    values
}

/// The value that the share `part`, 0 to 1, of them does not exceed; 0 if there are none.
fn percentile(sorted: &[f64], part: f64) -> f64 {
    let place = (sorted.len() as f64 * part) as usize;
    sorted.get(place.min(sorted.len().saturating_sub(1))).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Luma of Rec. 709, which is close enough to lightness.
    fn luma([r, g, b]: Rgb) -> f64 {
        0.2126 * f64::from(r) + 0.7152 * f64::from(g) + 0.0722 * f64::from(b)
    }

    #[test]
    fn greys_are_grey_and_ends_are_black_and_white() {
        assert_eq!(oklch(0.0, 0.0, 0.0), BLACK);
        assert_eq!(oklch(1.0, 0.0, 123.0), WHITE);
        let [r, g, b] = oklch(0.5, 0.0, 45.0);
        assert!(r == g && g == b);
    }

    #[test]
    fn the_sequential_map_gets_ever_lighter() {
        let map = ColourMap::sequential();
        let lumas: Vec<f64> = (0..=16).map(|i| luma(map.at(f64::from(i) / 16.0))).collect();
        assert!(lumas.windows(2).all(|pair| pair[0] < pair[1]), "{lumas:?}");
        assert!(luma(map.at(0.0)) > 20.0, "the nearest is not taken for no return");
    }

    #[test]
    fn the_diverging_map_is_neutral_in_the_middle_only() {
        let map = ColourMap::diverging();
        let [r, g, b] = map.at(0.5);
        assert!(r.abs_diff(b) < 4 && r.abs_diff(g) < 4 && r > 230);
        let ([r, _, b], [r2, _, b2]) = (map.at(0.0), map.at(1.0));
        assert!(b > r + 60 && r2 > b2 + 60);
        assert_eq!((map.at(-5.0), map.at(f64::INFINITY)), (map.at(0.0), map.at(1.0)));
    }

    #[test]
    fn labels_near_each_other_differ() {
        let distance =
            |a: Rgb, b: Rgb| -> u32 { a.iter().zip(b).map(|(a, b)| u32::from(a.abs_diff(b))).sum() };
        for label in 1..500 {
            assert!((1..6).all(|next| distance(of_label(label), of_label(label + next)) > 40), "{label}");
            assert!(luma(of_label(label)) > 80.0, "{label} is not taken for no return or ground");
        }
    }

    fn texts(scale: &Scale) -> Vec<String> {
        scale.ticks().into_iter().map(|(_, text)| text).collect()
    }

    #[test]
    fn ranges_are_told_apart_by_ratio() {
        let scale = |low, high| Scale { low, high, spacing: Spacing::Ratio };
        let ends = scale(2.0, 50.0);
        assert_eq!((ends.part(2.0), ends.part(50.0)), (0.0, 1.0));
        assert!((ends.part(10.0) - 0.5).abs() < 1e-12);
        assert_eq!(texts(&ends), ["2", "5", "10", "20", "50"]);
        assert_eq!(texts(&scale(0.3, 2.5)), ["0.5", "1", "2"]);
    }

    #[test]
    fn heights_are_told_apart_by_difference() {
        let scale = Scale { low: -1.7, high: 3.3, spacing: Spacing::Linear };
        assert!((scale.part(0.8) - 0.5).abs() < 1e-12);
        assert_eq!(texts(&scale), ["-1", "0", "1", "2", "3"]);
        let narrow = Scale { low: -0.25, high: 0.25, spacing: Spacing::Linear };
        assert_eq!(texts(&narrow), ["-0.2", "-0.1", "0.0", "0.1", "0.2"]);
    }

    #[test]
    fn residuals_have_zero_in_the_middle_and_small_ones_room() {
        let scale = Scale::of_residuals((-100..=100).map(|i| f64::from(i).powi(5) * 1e-9));
        assert_eq!((scale.part(0.0), scale.low), (0.5, -scale.high));
        let (small, large) = (scale.part(1.0) - 0.5, scale.part(2.0) - 0.5);
        assert!(small > 0.6 * large && small < large);
        assert_eq!(texts(&scale), ["-3", "-1", "0", "1", "3"]);
    }

    #[test]
    fn outliers_do_not_stretch_a_scale() {
        let scale = Scale::of_errors((0..1000).map(|i| if i == 0 { 1e9 } else { 0.5 }));
        assert_eq!(scale.high, 0.5);
        let scale = Scale::of_heights((0..1000).map(|i| if i % 100 == 0 { -1e30 } else { f64::from(i) }));
        assert!(scale.low > 0.0 && scale.high < 1000.0);
    }

    #[test]
    fn scales_of_nothing_or_of_one_value_have_a_width() {
        let nothing = std::iter::empty::<f64>;
        let one = || std::iter::once(7.0);
        for scale in [
            Scale::of_ranges(nothing()),
            Scale::of_heights(nothing()),
            Scale::of_errors(nothing()),
            Scale::of_residuals(nothing()),
            Scale::of_ranges(one()),
            Scale::of_heights(one()),
            Scale::of_ranges([f64::NAN, f64::INFINITY, 0.0].into_iter()),
            Scale::of_heights([f64::from(f32::MIN), f64::from(f32::MAX)].into_iter()),
            Scale::of_heights(std::iter::once(f64::from(f32::MIN))),
        ] {
            assert!(scale.high > scale.low && scale.part(scale.high) == 1.0, "{scale:?}");
            assert!((1..=12).contains(&scale.ticks().len()), "{scale:?}");
        }
    }
}

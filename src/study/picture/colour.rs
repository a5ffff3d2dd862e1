//! Colours whose perceived differences correspond to the differences of the numbers that they represent.
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
}

//! The points from above.

use super::colour::{ColourMap, Scale, WHITE};
use super::painting::{GAP, Picture, TEXT_HEIGHT, with_legend};

/// Largest number of pixels on a side.
const LARGEST: f64 = 4096.0;
/// Length of the scale bar, in metres.
const YARD: f64 = 10.0;

/// A bird's-eye view: a square around the scanner, with x (forward) up and y (left) to the left, coloured by
/// height. Where several points share a pixel, the highest is shown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BirdsEye {
    /// Metres from the scanner to each side of the square.
    pub reach_m: f64,
    /// Width of a pixel, in metres.
    pub pixel_m: f64,
}

impl Default for BirdsEye {
    /// 50 m each way, 1000 pixels.
    fn default() -> Self {
        BirdsEye { reach_m: 50.0, pixel_m: 0.1 }
    }
}

impl BirdsEye {
    /// Draws points, with x, y and z in metres; those that are not finite or out of reach are left out. A
    /// side has 1 to 4096 pixels, whatever the settings.
    pub fn draw(&self, points: &[[f32; 3]]) -> Picture {
        let heights = self.heights(points);
        let side = self.side();
        let scale = Scale::of_heights(heights.iter().flatten().map(|&z| f64::from(z)));
        let map = ColourMap::sequential();
        let mut picture = Picture::new(side, side);
        for (cell, z) in heights.iter().enumerate() {
            if let Some(z) = z {
                picture.fill([cell % side, cell / side], [1, 1], map.at(scale.part(f64::from(*z))));
            }
        }
        self.draw_marks(&mut picture);
        with_legend(&picture, &map, &scale, "m")
    }

    /// Number of pixels of a side.
    fn side(&self) -> usize {
        let side = (2.0 * self.reach_m / self.pixel_m).round().clamp(0.0, LARGEST);
        // NaN has become 0.
        (side as usize).max(1)
    }

    /// The height of the highest point in each pixel.
    fn heights(&self, points: &[[f32; 3]]) -> Vec<Option<f32>> {
        let side = self.side();
        let mut heights = vec![None; side * side];
        for &[x, y, z] in points.iter().filter(|point| point.iter().all(|value| value.is_finite())) {
            if let (Some(right), Some(down)) = (self.place(y), self.place(x)) {
                let highest: &mut Option<f32> = &mut heights[down * side + right];
                *highest = Some(highest.map_or(z, |other| other.max(z)));
            }
        }
        heights
    }

    /// Distance in pixels from the side that a coordinate points to, if it is within reach.
    fn place(&self, coordinate: f32) -> Option<usize> {
        let side = self.side();
        let pixel = (self.reach_m - f64::from(coordinate)) / (2.0 * self.reach_m) * side as f64;
        (pixel >= 0.0 && pixel < side as f64).then_some(pixel as usize)
    }

    /// A cross at the scanner's position, and a scale bar.
    fn draw_marks(&self, picture: &mut Picture) {
        const ARM: usize = 4;
        let side = self.side();
        let middle = side / 2;
        picture.fill([middle.saturating_sub(ARM), middle], [2 * ARM + 1, 1], WHITE);
        picture.fill([middle, middle.saturating_sub(ARM)], [1, 2 * ARM + 1], WHITE);
        let length = (YARD / (2.0 * self.reach_m) * side as f64) as usize;
        let bottom = side.saturating_sub(GAP);
        picture.fill([GAP, bottom], [length, 2], WHITE);
        picture.write(&format!("{YARD} m"), [GAP, bottom.saturating_sub(TEXT_HEIGHT + GAP)], WHITE);
    }
}

#[cfg(test)]
mod tests {
    use super::super::colour::BLACK;
    use super::*;

    const VIEW: BirdsEye = BirdsEye { reach_m: 100.0, pixel_m: 0.5 };

    /// The pixel at the position (x, y).
    fn at(picture: &Picture, x: f64, y: f64) -> [u8; 3] {
        let pixel = |coordinate: f64| ((VIEW.reach_m - coordinate) / VIEW.pixel_m) as usize;
        picture.pixel(pixel(y), pixel(x)).unwrap()
    }

    #[test]
    fn x_is_up_and_y_is_left() {
        let picture = VIEW.draw(&[[80.0, 0.0, 0.0], [0.0, 60.0, 1.0]]);
        assert_ne!(at(&picture, 80.0, 0.0), BLACK);
        assert_ne!(at(&picture, 0.0, 60.0), BLACK);
        assert_eq!(at(&picture, -80.0, 0.0), BLACK);
        assert_eq!(at(&picture, 0.0, -60.0), BLACK);
    }

    #[test]
    fn the_highest_point_is_seen() {
        let (low, high) = ([40.0, 40.0, -1.0], [40.0, 40.0, 2.0]);
        let both = [[20.0, 0.0, -1.0], low, high, low];
        assert_eq!(at(&VIEW.draw(&both), 40.0, 40.0), at(&VIEW.draw(&both[..3]), 40.0, 40.0));
        assert_ne!(at(&VIEW.draw(&both), 40.0, 40.0), at(&VIEW.draw(&both), 20.0, 0.0));
    }

    #[test]
    fn points_out_of_reach_are_left_out() {
        let nowhere =
            [[f32::NAN, 0.0, 0.0], [1e30, 0.0, 0.0], [0.0, f32::INFINITY, 0.0], [5.0, 5.0, f32::NAN]];
        assert_eq!(VIEW.draw(&nowhere), VIEW.draw(&[]));
    }

    #[test]
    fn odd_views_are_pictures_too() {
        for (reach_m, pixel_m) in
            [(0.0, 0.1), (1.0, 10.0), (f64::NAN, 0.1), (-5.0, 0.1), (1.0, f64::INFINITY)]
        {
            let picture = BirdsEye { reach_m, pixel_m }.draw(&[[0.5, 0.5, 0.5], [0.0, 0.0, 0.0]]);
            assert!(picture.to_png().is_ok());
        }
        assert_eq!(BirdsEye { reach_m: 1e9, pixel_m: 0.0 }.side(), 4096);
    }
}

//! The points in perspective, as seen by a camera.

use super::colour::{ColourMap, Scale};
use super::painting::{Picture, with_legend};

/// A view from behind the scanner and above it, with x (forward) into the picture, coloured by height. Nearer
/// points cover farther ones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Perspective {
    /// Width and height of the picture, in pixels.
    pub size: [usize; 2],
    /// The position of the camera: x, y and z in metres from the scanner.
    pub eye: [f64; 3],
    /// The angle by which the camera looks down, in degrees.
    pub down: f64,
    /// The width of the field of view, in degrees.
    pub field: f64,
}

impl Default for Perspective {
    /// 1500 x 600 pixels, from 18 m behind the scanner and 9 m above, 72 degrees wide.
    fn default() -> Self {
        Perspective { size: [1500, 600], eye: [-18.0, 0.0, 9.0], down: 19.0, field: 72.0 }
    }
}

impl Perspective {
    /// Draws points, with x, y and z in metres; those that are not finite or behind the camera are left out.
    pub fn draw(&self, points: &[[f32; 3]]) -> Picture {
        /// The side of a point, in metres, and the smallest and largest size of its image, in pixels.
        const SIDE: f64 = 0.07;
        const SIDES: [f64; 2] = [1.0, 4.0];
        let mut seen: Vec<_> = points.iter().filter_map(|point| self.place(point)).collect();
        // The farthest first.
        seen.sort_by(|a, b| b.depth.total_cmp(&a.depth));
        let scale = Scale::of_heights(seen.iter().map(|point| point.height));
        let map = ColourMap::sequential();
        let mut picture = Picture::new(self.size[0], self.size[1]);
        for point in &seen {
            let side = (SIDE * self.pixels_at_one_metre() / point.depth).clamp(SIDES[0], SIDES[1]) as usize;
            picture.fill(point.pixel, [side; 2], map.at(scale.part(point.height)));
        }
        with_legend(&picture, &map, &scale, "m")
    }

    /// The width, in pixels, of an object one metre wide and one metre away.
    fn pixels_at_one_metre(&self) -> f64 {
        self.size[0] as f64 / (2.0 * (self.field.to_radians() / 2.0).tan())
    }

    /// The position of a point in the picture, if it is visible.
    fn place(&self, point: &[f32; 3]) -> Option<Placed> {
        /// Points nearer than this are not drawn, in metres.
        const NEAREST: f64 = 0.5;
        let [x, y, z] = [0, 1, 2].map(|axis| f64::from(point[axis]) - self.eye[axis]);
        let (sin, cos) = self.down.to_radians().sin_cos();
        let (depth, up) = (x * cos - z * sin, x * sin + z * cos);
        if !(depth >= NEAREST && depth.is_finite()) {
            return None;
        }
        let pixels = self.pixels_at_one_metre() / depth;
        let pixel = |middle: usize, metres: f64| {
            let place = middle as f64 / 2.0 - metres * pixels;
            (place >= 0.0 && place < middle as f64).then_some(place as usize)
        };
        let pixel = [pixel(self.size[0], y)?, pixel(self.size[1], up)?];
        Some(Placed { depth, height: f64::from(point[2]), pixel })
    }
}

/// A visible point.
struct Placed {
    /// Metres in front of the camera.
    depth: f64,
    /// Metres above the scanner.
    height: f64,
    /// Column and row of the pixel, from the left and from the top.
    pixel: [usize; 2],
}

#[cfg(test)]
mod tests {
    use super::*;

    const VIEW: Perspective = Perspective { size: [200, 100], eye: [0.0, 0.0, 0.0], down: 0.0, field: 90.0 };

    #[test]
    fn ahead_is_the_middle_and_left_is_left() {
        let pixel = |point: [f32; 3]| VIEW.place(&point).map(|placed| placed.pixel);
        assert_eq!(pixel([10.0, 0.0, 0.0]), Some([100, 50]));
        // 45 degrees reach to the sides; as the picture is half as high as wide, it ends at half that slope.
        // In the middle of a pixel.
        assert_eq!(pixel([10.0, 4.95, 1.95]), Some([50, 30]));
        assert_eq!(pixel([20.0, 9.9, 3.9]), Some([50, 30]));
        for out in [[-1.0, 0.0, 0.0], [10.0, 11.0, 0.0], [10.0, 0.0, 6.0], [f32::NAN; 3], [f32::INFINITY; 3]]
        {
            assert_eq!(pixel(out), None, "{out:?}");
        }
        let down = Perspective { down: 45.0, ..VIEW };
        assert_eq!(down.place(&[10.0, 0.0, -10.05]).unwrap().pixel, [100, 50]);
    }

    #[test]
    fn the_nearer_point_is_seen() {
        let (far, near, other) = ([40.0, 0.0, 0.0], [10.0, 0.0, 1.05], [10.0, 8.0, 0.0]);
        let [x, y] = VIEW.place(&near).unwrap().pixel;
        let colour = |points: &[[f32; 3]]| VIEW.draw(points).pixel(x, y);
        let behind = [far[0], 0.0, far[0] * near[2] / near[0]];
        assert_eq!(VIEW.place(&behind).unwrap().pixel, [x, y]);
        assert_eq!(colour(&[behind, near, other]), colour(&[near, behind, other]));
        assert_ne!(colour(&[behind, near, other]), colour(&[behind, other]));
    }
}

//! The shapes of markers.

use super::Marker;

/// Half the size of a marker, in pixels.
const RADIUS: f64 = 5.0;

/// The outline of a marker around the origin, as the `d` of an SVG path.
pub fn outline(marker: Marker) -> String {
    let polygon = |points: &[[f64; 2]]| {
        let points: Vec<_> =
            points.iter().map(|[x, y]| format!("{:.2} {:.2}", x * RADIUS, y * RADIUS)).collect();
        format!("M{}Z", points.join("L"))
    };
    match marker {
        Marker::Circle => {
            let [r, d] = [RADIUS, 2.0 * RADIUS];
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

//! Sweeps of an HDL-32E that were moved through a map in single precision, computed independently of the
//! codec's formulas.

use super::scans::Random;

/// Records of a firing.
pub const SLOTS: usize = 32;
/// Firings in a sweep, and ticks from one to the next.
const FIRINGS: usize = 1085;
const FIRING_TICKS: f64 = 33.2;

/// The motion of a car, and the final position of the scanner in the map.
pub struct Drive {
    /// Metres a second.
    velocity: [f64; 3],
    /// Radians a second.
    yaw_rate: f64,
    origin: [f64; 3],
    heading: f64,
}

pub const TURNING: Drive =
    Drive { velocity: [0.1, 8.1, 0.25], yaw_rate: -0.2, origin: [1201.234, 303.777, 1.84], heading: 0.7 };
pub const STRAIGHT: Drive =
    Drive { velocity: [-0.2, 11.3, 0.1], yaw_rate: 0.01, origin: [411.8, -902.25, 1.83], heading: 2.4 };

/// The elevation of a record's beam in degrees: multiples of four thirds of a degree, rounded as in the data
/// sheet, two of them towards zero.
pub fn elevation(slot: usize) -> f64 {
    let hundredths = ((slot as f64 * 4.0 - 92.0) * 100.0 / 3.0).round();
    (hundredths + if slot == 3 || slot == 18 { 1.0 } else { 0.0 }) / 100.0
}

/// The scanner's measurements in a street: (0, 0, 0) where there is no return.
pub fn street(seed: u64) -> Vec<[f32; 3]> {
    let mut random = Random(seed);
    let mut points = Vec::with_capacity(FIRINGS * SLOTS);
    for firing in 0..FIRINGS {
        for slot in 0..SLOTS {
            let place = if slot < 16 { 2 * slot } else { 2 * slot - 31 };
            // As in the scanner's driver: the blocks' ticks are whole numbers, and so are their differences.
            let at = |firing: usize| (18_100.0 + firing as f64 * FIRING_TICKS).floor();
            let next = if firing % 12 == 3 && firing > 0 {
                2.0 * at(firing) - at(firing - 1)
            } else {
                at(firing + 1)
            };
            let tick = at(firing) + ((next - at(firing)) * place as f64 / 40.0 + 0.5).floor();
            let azimuth = (tick % 36_000.0) * std::f64::consts::PI / 18_000.0;
            let up = elevation(slot).to_radians();
            let ground = 1.84 / (-up.sin()).max(0.02);
            let wall = 9.0 / (azimuth.sin().abs().max(0.05) * up.cos());
            let range = ground.min(wall);
            let is_lost = range > 60.0 || random.below(100) < 12;
            // A sum of uniformly distributed numbers is nearly normally distributed.
            let noise = (0..12).map(|_| random.below(1000) as f64 / 1000.0).sum::<f64>() - 6.0;
            let steps = if is_lost { 0.0 } else { (range / 0.002 + noise * 4.0).round() };
            let metres = steps as f32 * 0.002f32;
            let flat = metres * up.cos() as f32;
            points.push(if is_lost {
                [0.0; 3]
            } else {
                [flat * azimuth.cos() as f32, -(flat * azimuth.sin() as f32), metres * up.sin() as f32]
            });
        }
    }
    points
}

/// The points as in the file: moved to the map and back.
pub fn through_a_map(points: &[[f32; 3]], drive: &Drive) -> Vec<[f32; 3]> {
    let mut time = 0.0;
    let mut times = Vec::new();
    for firing in 0..FIRINGS {
        times.push(time * 1e-6);
        let packet = (firing + 9) / 12;
        time += if firing % 12 == 3 && packet % 25 != 5 { 47.0 } else { 46.0 };
    }
    let end = times[FIRINGS - 1];
    // The map's axes: a heading and a slight tilt.
    let (sin, cos) = drive.heading.sin_cos();
    let (tilt_sin, tilt_cos) = 0.02f64.sin_cos();
    let axes = [
        [cos, -sin * tilt_cos, sin * tilt_sin],
        [sin, cos * tilt_cos, -cos * tilt_sin],
        [0.0, tilt_sin, tilt_cos],
    ];
    let to_map = |v: [f64; 3]| -> [f32; 3] {
        std::array::from_fn(|row| {
            let along: f64 = (0..3).map(|column| axes[row][column] * v[column]).sum();
            (along + drive.origin[row]) as f32
        })
    };
    let from_map = |g: [f32; 3]| -> [f32; 3] {
        let off: [f64; 3] = std::array::from_fn(|row| f64::from(g[row]) - drive.origin[row]);
        std::array::from_fn(|column| (0..3).map(|row| axes[row][column] * off[row]).sum::<f64>() as f32)
    };
    let of_record = |(record, point): (usize, &[f32; 3])| {
        let left = times[record / SLOTS] - end;
        let (sin, cos) = (drive.yaw_rate * left).sin_cos();
        let [x, y, z] = point.map(f64::from);
        let place = drive.velocity.map(|v| v * left);
        from_map(to_map([x * cos - y * sin + place[0], x * sin + y * cos + place[1], z + place[2]]))
    };
    points.iter().enumerate().map(of_record).collect()
}

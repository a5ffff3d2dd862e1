//! A simulated drive: a Velodyne HDL-64E or VLP-16, a street generated from a seed, and scans in the form in
//! which KITTI or the ROS driver stores them.
//!
//! For tests and demonstrations that need scans with the structure of real ones, but without their data. The
//! simulation imitates the scanner: 64 beams with constants of their own, 2 mm range steps, 0.09 degree
//! azimuth ticks, columns that all beams share, coordinates rounded to the millimetre, 8.9 mm of range noise.
//! A seed gives the same bytes on every platform.
//!
//! ```
//! use lidarpc::internals::study::synth::{SynthConfig, drive};
//!
//! let config = SynthConfig { frames: 2, beams: 8, thinning: 16, ..SynthConfig::default() };
//! for frame in drive(&config) {
//!     println!("{}: {} points, {} bytes", frame.name, frame.points.len(), frame.to_bin().len());
//! }
//! ```

mod beams;
mod ground;
mod ray;
mod scanner;
mod street;
mod thing;
mod trajectory;
mod vlp16;

pub use beams::{BEAMS, Beam, STEP, TICKS};
pub use vlp16::VLP_16_ELEVATIONS;

use ground::Ground;
use scanner::Scanner;
use trajectory::Pose;

/// The scanner on the car's roof.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SynthScanner {
    /// Velodyne HDL-64E: beam by beam, rounded to the millimetre, as in KITTI.
    #[default]
    Hdl64,
    /// Velodyne VLP-16: firing by firing, by the single-precision arithmetic of the ROS driver.
    Vlp16,
}

/// What to simulate. The default is a car in a street of houses at 30 km/h, ten frames a second.
#[derive(Clone, Debug, PartialEq)]
pub struct SynthConfig {
    /// The scanner. Default HDL-64E.
    pub scanner: SynthScanner,
    /// Number of frames. Default 10.
    pub frames: usize,
    /// Determines the scanner, the street and the noise. Default 1.
    pub seed: u64,
    /// Beams of the HDL-64E, 1 to 64: every (64 / beams)-th one of the full scanner. Default 64.
    pub beams: usize,
    /// Only every `thinning`-th firing is kept, or block of two firings with the VLP-16; 1 keeps a whole
    /// turn. Default 1.
    pub thinning: usize,
    /// Distance from one frame to the next, in metres. Default 0.8.
    pub speed: f64,
    /// The heading swings from side to side; this is its fastest change, in radians a frame. Default 0.004.
    pub yaw_rate: f64,
    /// Whether the car moves while the head rotates. If so, the points are as the scanner saw them from its
    /// position at each firing, uncorrected, as in KITTI raw data. Default true.
    pub rolling: bool,
    /// Whether other cars drive too. Default true.
    pub traffic: bool,
    /// Sigma of the range noise, in metres. Default 0.0089.
    pub noise: f64,
    /// Share of returns lost at random, besides those that are too weak. Default 0.002.
    pub dropout: f64,
    /// Nearest range, in metres. Default 2.
    pub min_range: f64,
    /// Farthest range, in metres. Default 120.
    pub max_range: f64,
}

impl Default for SynthConfig {
    fn default() -> Self {
        SynthConfig {
            scanner: SynthScanner::default(),
            frames: 10,
            seed: 1,
            beams: BEAMS,
            thinning: 1,
            speed: 0.8,
            yaw_rate: 0.004,
            rolling: true,
            traffic: true,
            noise: 0.0089,
            dropout: 0.002,
            min_range: 2.0,
            max_range: 120.0,
        }
    }
}

impl SynthConfig {
    /// The drive in `testdata/drive`: three frames of all beams and every fourth firing. Each beam then has
    /// some hundred points for the fit of its constants, in less than 1.6 MB in total.
    #[cfg(any(test, feature = "internals"))]
    pub fn testdata() -> Self {
        SynthConfig { frames: 3, seed: 64, thinning: 4, ..SynthConfig::default() }
    }
}

/// One scan of the simulated drive.
#[derive(Clone, Debug, PartialEq)]
pub struct SynthFrame {
    /// File name as in KITTI: "0000000000.bin" is the first.
    pub name: String,
    /// x, y, z in metres and intensity. HDL-64E: beam by beam from the top, and by azimuth in each beam, with
    /// intensities from 0 to 0.99. VLP-16: firing by firing, with whole intensities from 0 to 255.
    pub points: Vec<[f32; 4]>,
    /// The pose of the scanner in the world, in the middle of its turn, when it faces ahead: rotation, and
    /// position in metres, as the first three rows of the matrix that maps points to the world.
    pub pose: [f64; 12],
}

impl SynthFrame {
    /// The bytes of the KITTI `.bin` file: four little-endian float32 a point.
    pub fn to_bin(&self) -> Vec<u8> {
        self.points.as_flattened().iter().flat_map(|value| value.to_le_bytes()).collect()
    }
}

/// Simulates a drive; each frame is computed when it is requested.
pub fn drive(config: &SynthConfig) -> impl Iterator<Item = SynthFrame> + use<> {
    let (config, ground, beams) = (config.clone(), Ground::new(config.seed), scanner_beams(config));
    (0..config.frames).map(move |frame| SynthFrame {
        name: format!("{frame:010}.bin"),
        points: match config.scanner {
            SynthScanner::Hdl64 => Scanner { config: &config, ground: &ground, beams: &beams }.scan(frame),
            SynthScanner::Vlp16 => vlp16::scan(&config, &ground, frame),
        },
        pose: Pose::at(&config, &ground, frame as f64).row_major(),
    })
}

/// The true constants of the simulated HDL-64E, from the top beam down: what a fit should find.
pub fn scanner_beams(config: &SynthConfig) -> Vec<Beam> {
    beams::beams(config.seed, config.beams)
}

#[cfg(test)]
mod tests;

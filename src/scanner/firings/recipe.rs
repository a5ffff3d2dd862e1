//! The programs that write scans: their axes, where their beams start, their cosines and sines. FORMAT.md 3.3.

use std::f64::consts::PI;

use super::glibc;
use crate::ground::angle;
use crate::ground::doubles::Choose;

/// A program that writes scans. A new one needs a number here, its description, and its
/// [arithmetic](super::arithmetic); the fit tries them all.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Recipe {
    /// ROS `velodyne_pointcloud`: single precision throughout, tables of cosine and sine, x ahead, y to the
    /// left, azimuth clockwise.
    VelodyneRos = 0,
    /// Double precision, rounded once; y ahead, azimuth clockwise: PCL's grabber, VeloView, Hesai's driver.
    DoubleYAhead = 1,
    /// Double precision, rounded once; x ahead, azimuth clockwise.
    DoubleXAhead = 2,
    /// As `DoubleXAhead`, with ranges in single precision: Ouster.
    SingleRangeXAhead = 3,
    /// RoboSense's `rs_driver`: single precision throughout, tables of hundredths of degrees, x ahead,
    /// azimuth clockwise, and beams that start away from the axis.
    RoboSense = 4,
    /// LSLiDAR's driver: double precision, rounded once, with 0.017453293 radians per degree; y ahead,
    /// azimuth clockwise, and beams that start away from the axis.
    LsLidar = 5,
    /// Autoware's `nebula` for Hesai's scanners since 2026: sums of angles in single precision, of constants
    /// that it converts to radians in single precision; glibc's cosine and sine of the sums; y ahead, azimuth
    /// clockwise.
    Nebula = 6,
    /// As `Nebula`, in its version of January 2023: sums of angles in double precision, rounded once.
    NebulaJanuary2023 = 7,
    /// As `VelodyneRos`, with glibc's cosine and sine.
    VelodyneRosGlibc = 8,
    /// Autoware's `nebula` for Velodyne's scanners: as `VelodyneRosGlibc`, with angles of ticks in double
    /// precision, rounded once.
    NebulaVelodyne = 9,
    /// As `VelodyneRos`, with ranges in double precision, rounded once, angles of ticks by one product, and
    /// turned to the right by a quarter of a turn: a driver of Hesai's Pandar64.
    Pandar64 = 10,
    /// Ouster's SDK for beams that start away from the axis: double precision, rounded once, x ahead, azimuth
    /// clockwise. Ranges are measured from the axis.
    Ouster = 11,
    /// As `Ouster`, with direction and start of each beam rounded to single precision: Ouster's ROS driver.
    OusterRos = 12,
    /// Apollo's driver for Velodyne's scanners: as `VelodyneRos`, with angles of ticks by a product with pi,
    /// products of x and y in double precision, and cosine and sine of glibc before 2.28.
    Apollo = 13,
    /// The ONCE data set: as `NebulaApril2023Pandar40`, with cosine and sine of glibc before 2.28.
    Once = 14,
    /// The Python package `velodyne-decoder`: as `VelodyneRosGlibc`, with angles of ticks by two products,
    /// and a height for each laser. Its beams intersect in a focal point in front of the axis.
    VelodyneDecoder = 15,
    /// As `VelodyneDecoder`, for the HDL-32E, whose heights it has in hundredths of millimetres.
    VelodyneDecoderHdl32e = 16,
    /// As `Ouster`, in Ouster's ROS driver of 2021: it turns directions to the frame of the case by half a
    /// turn, but not where beams start, which is therefore behind the axis.
    OusterEarly = 17,
    /// As `RoboSense`, in an early version of the driver: a hundredth of a degree is a float32, and
    /// elevations below 0 are taken from the end of the tables.
    RoboSenseEarly = 18,
    /// As `Nebula`, in its versions from June 2023 to 2025: it converts constants to radians in double
    /// precision.
    Nebula2025 = 19,
    /// As `Nebula2025`, in its version of June 2023 for the Pandar40P: ranges are products in single
    /// precision.
    NebulaJune2023Pandar40 = 20,
    /// As `NebulaJanuary2023`, in the version of April 2023: coordinates are products in double precision.
    NebulaApril2023 = 21,
    /// As `NebulaApril2023`, for the Pandar40P: so are ranges.
    NebulaApril2023Pandar40 = 22,
    /// Hesai's General SDK and the ROS driver built on it, for the Pandar20, 40P, 64, QT and XT: ranges in double
    /// precision, glibc's cosine and sine, offsets in whole ticks, y ahead, azimuth clockwise.
    HesaiGeneralSdk = 23,
    /// Hesai's SDK 2: single precision, angles in 1/256 of a hundredth of a degree, y ahead, azimuth clockwise.
    HesaiSdk2 = 24,
    /// RoboSense's `ros_rslidar`, before `rs_driver`: ranges and angles in single precision, all else in double
    /// precision, rounded once; x ahead, azimuth clockwise.
    RosRslidar = 25,
    /// As `Pandar64`, with angles of ticks as `VelodyneRos` has them: another version of the driver.
    Pandar64InDegrees = 26,
    /// As `RoboSense`, compiled for a processor with fused multiplication and addition, such as ARM64.
    RoboSenseFused = 27,
    /// As `RoboSenseEarly`, compiled for such a processor, with x fused with its other product.
    RoboSenseEarlyFused = 28,
}

/// Axes of the coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Axes {
    XAhead,
    YAhead,
}

impl Recipe {
    /// Every recipe, in the order in which the fit tries them.
    pub const ALL: [Recipe; 29] = [
        Recipe::VelodyneRos,
        Recipe::DoubleYAhead,
        Recipe::DoubleXAhead,
        Recipe::SingleRangeXAhead,
        Recipe::RoboSense,
        Recipe::LsLidar,
        Recipe::Nebula,
        Recipe::NebulaJanuary2023,
        Recipe::VelodyneRosGlibc,
        Recipe::NebulaVelodyne,
        Recipe::Pandar64,
        Recipe::Ouster,
        Recipe::OusterRos,
        Recipe::Apollo,
        Recipe::Once,
        Recipe::VelodyneDecoder,
        Recipe::VelodyneDecoderHdl32e,
        Recipe::OusterEarly,
        Recipe::RoboSenseEarly,
        Recipe::Nebula2025,
        Recipe::NebulaJune2023Pandar40,
        Recipe::NebulaApril2023,
        Recipe::NebulaApril2023Pandar40,
        Recipe::HesaiGeneralSdk,
        Recipe::HesaiSdk2,
        Recipe::RosRslidar,
        Recipe::Pandar64InDegrees,
        Recipe::RoboSenseFused,
        Recipe::RoboSenseEarlyFused,
    ];

    /// The recipe of this number in the stream.
    pub fn from_number(number: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|recipe| *recipe as u32 == number)
    }

    /// Whether it may be that of a scanner whose beams all start in one point, be it beside the axis, as some
    /// of RoboSense's do.
    pub(super) fn may_start_in_one_point(self) -> bool {
        self != Recipe::LsLidar && !self.measures_from_axis() && !self.starts_in_beam()
    }

    /// Whether ranges are measured from the axis although beams start away from it.
    pub fn measures_from_axis(self) -> bool {
        matches!(self, Recipe::Ouster | Recipe::OusterRos | Recipe::OusterEarly)
    }

    /// Whether beams start in the direction of the laser, not of the tick.
    pub(super) fn starts_in_beam(self) -> bool {
        matches!(self, Recipe::VelodyneDecoder | Recipe::VelodyneDecoderHdl32e)
    }

    /// By how much a range is more than the distance from the start of its beam, in metres, given the
    /// distance of the start from the axis and the cosine of the elevation.
    pub(super) fn farther(self, along: f64, cos: f64) -> f64 {
        match self {
            _ if self.measures_from_axis() => along,
            Recipe::VelodyneDecoder | Recipe::VelodyneDecoderHdl32e => along / cos,
            _ => 0.0,
        }
    }

    /// By how many metres a beam starts higher than one without elevation, given the distance of its start
    /// from the axis and the sine of its elevation.
    pub(super) fn higher(self, along: f64, sin: f64) -> f64 {
        match self {
            Recipe::OusterEarly => 2.0 * along * sin,
            _ => 0.0,
        }
    }

    /// About where the beams of all lasers cross, in metres from the axis, given where they start.
    pub(super) fn crossing(self, along: f64) -> f64 {
        match self {
            Recipe::OusterEarly => -along,
            _ => along,
        }
    }

    /// How it computes a direction, if it takes cosine and sine of the sum of a tick's and a laser's angle.
    pub(super) fn sum(self) -> Option<SumPrecision> {
        match self {
            Recipe::Nebula | Recipe::Nebula2025 | Recipe::NebulaJune2023Pandar40 => {
                Some(SumPrecision::Radians)
            }
            Recipe::NebulaJanuary2023
            | Recipe::NebulaApril2023
            | Recipe::NebulaApril2023Pandar40
            | Recipe::Once => Some(SumPrecision::Degrees),
            _ => None,
        }
    }

    /// Whether it rounds sums of angles, or of products of their cosines and sines, to single precision.
    pub(super) fn adds_in_single(self) -> bool {
        !matches!(
            self,
            Recipe::DoubleYAhead | Recipe::DoubleXAhead | Recipe::SingleRangeXAhead | Recipe::RosRslidar
        )
    }

    /// The program, as a description; no two are alike.
    pub fn program(self) -> &'static str {
        match self {
            Recipe::VelodyneRos => "arithmetic of ROS velodyne_pointcloud",
            Recipe::DoubleYAhead => "double precision with y ahead (PCL, VeloView, Hesai)",
            Recipe::DoubleXAhead => "double precision with x ahead",
            Recipe::SingleRangeXAhead => {
                "double precision of ranges in single precision with x ahead (Ouster)"
            }
            Recipe::RoboSense => "arithmetic of RoboSense's rs_driver and of nuScenes",
            Recipe::RoboSenseEarly => "arithmetic of RoboSense's early rs_driver",
            Recipe::LsLidar => "arithmetic of LSLiDAR's driver",
            Recipe::Nebula => "arithmetic of Autoware's nebula for Hesai since 2026",
            Recipe::Nebula2025 => "arithmetic of Autoware's nebula for Hesai until 2025",
            Recipe::NebulaJune2023Pandar40 => {
                "arithmetic of Autoware's nebula of June 2023 for the Pandar40P"
            }
            Recipe::NebulaApril2023 => "arithmetic of Autoware's nebula for Hesai of April 2023",
            Recipe::NebulaApril2023Pandar40 => {
                "arithmetic of Autoware's nebula of April 2023 for the Pandar40P"
            }
            Recipe::NebulaJanuary2023 => "arithmetic of Autoware's nebula for Hesai of January 2023",
            Recipe::VelodyneRosGlibc => "arithmetic of ROS velodyne_pointcloud with glibc",
            Recipe::NebulaVelodyne => "arithmetic of Autoware's nebula for Velodyne",
            Recipe::Pandar64 => "arithmetic of a ROS driver of the Pandar64",
            Recipe::Pandar64InDegrees => "arithmetic of a ROS driver of the Pandar64, angles in degrees",
            Recipe::HesaiGeneralSdk => "arithmetic of Hesai's General SDK",
            Recipe::HesaiSdk2 => "arithmetic of Hesai's SDK 2",
            Recipe::RosRslidar => "arithmetic of RoboSense's ros_rslidar",
            Recipe::RoboSenseFused => "arithmetic of RoboSense's rs_driver with fused multiplication (ARM64)",
            Recipe::RoboSenseEarlyFused => {
                "arithmetic of RoboSense's early rs_driver with fused multiplication"
            }
            Recipe::Ouster => "arithmetic of Ouster's SDK",
            Recipe::OusterRos => "arithmetic of Ouster's ROS driver",
            Recipe::OusterEarly => "arithmetic of Ouster's ROS driver of 2021",
            Recipe::Apollo => "arithmetic of Apollo's driver for Velodyne",
            Recipe::Once => "arithmetic of the ONCE data set",
            Recipe::VelodyneDecoder => "arithmetic of velodyne-decoder",
            Recipe::VelodyneDecoderHdl32e => "arithmetic of velodyne-decoder for the HDL-32E",
        }
    }

    pub(super) fn axes(self) -> Axes {
        match self {
            Recipe::VelodyneRos
            | Recipe::VelodyneRosGlibc
            | Recipe::NebulaVelodyne
            | Recipe::DoubleXAhead
            | Recipe::SingleRangeXAhead
            | Recipe::RoboSense
            | Recipe::RoboSenseEarly
            | Recipe::RoboSenseFused
            | Recipe::RoboSenseEarlyFused
            | Recipe::RosRslidar
            | Recipe::Ouster
            | Recipe::OusterRos
            | Recipe::OusterEarly
            | Recipe::Apollo
            | Recipe::VelodyneDecoder
            | Recipe::VelodyneDecoderHdl32e => Axes::XAhead,
            Recipe::DoubleYAhead
            | Recipe::LsLidar
            | Recipe::Nebula
            | Recipe::Nebula2025
            | Recipe::NebulaJune2023Pandar40
            | Recipe::NebulaJanuary2023
            | Recipe::NebulaApril2023
            | Recipe::NebulaApril2023Pandar40
            | Recipe::Pandar64
            | Recipe::Pandar64InDegrees
            | Recipe::HesaiGeneralSdk
            | Recipe::HesaiSdk2
            | Recipe::Once => Axes::YAhead,
        }
    }

    /// Cosine and sine of an angle in single precision, as the program's C library computes them.
    pub(super) fn cos_sin(self, radians: f32) -> [f32; 2] {
        match self {
            Recipe::Apollo | Recipe::Once => glibc::old_cos_sin(radians),
            Recipe::VelodyneRosGlibc
            | Recipe::NebulaVelodyne
            | Recipe::VelodyneDecoder
            | Recipe::VelodyneDecoderHdl32e
            | Recipe::HesaiGeneralSdk => [glibc::cosf(radians), glibc::sinf(radians)],
            _ if self.sum().is_some() => [glibc::cosf(radians), glibc::sinf(radians)],
            _ => [libm::cos(f64::from(radians)) as f32, libm::sin(f64::from(radians)) as f32],
        }
    }

    /// The resolution of lasers' angles, in degrees: that of a float32 in radians or degrees, or seven
    /// digits.
    pub(super) fn angle_step(self, degrees: f64) -> f64 {
        let ulp = |value: f64| {
            let single = value.abs() as f32;
            f64::from(single.next_up() - single)
        };
        match self {
            Recipe::VelodyneRos
            | Recipe::VelodyneRosGlibc
            | Recipe::NebulaVelodyne
            | Recipe::Pandar64
            | Recipe::Pandar64InDegrees
            | Recipe::HesaiGeneralSdk
            | Recipe::RosRslidar
            | Recipe::Apollo => ulp(radians(degrees)).to_degrees(),
            Recipe::HesaiSdk2 => 360.0 / f64::from(FINE_TICKS),
            Recipe::VelodyneDecoder | Recipe::VelodyneDecoderHdl32e => ulp(degrees),
            _ if self.sum().is_some() => ulp(degrees),
            _ => 1e-7,
        }
    }

    /// The approximate azimuths of points, in radians from -pi to pi.
    #[inline(always)]
    pub(super) fn azimuth<V: Choose>(self, x: V, y: V) -> V {
        let (across, along) = match self.axes() {
            Axes::XAhead => (y * -1.0, x),
            Axes::YAhead => (x, y),
        };
        angle::atan2(across, along)
    }
}

/// Angles in a turn in the tables of [`Recipe::HesaiSdk2`].
pub(super) const FINE_TICKS: u32 = 36_000 * 256;

/// Degrees in radians, by the operations that most programs use.
pub(super) fn radians(degrees: f64) -> f64 {
    degrees * PI / 180.0
}

/// In which precision a recipe adds the angle of a tick and that of a laser.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SumPrecision {
    /// Of angles in degrees, in double precision; the sum in radians is rounded to single precision.
    Degrees,
    /// Of angles in radians, in single precision.
    Radians,
}

/// Where beams start: this far from the axis in the direction of the tick, and this far above the scanner's
/// origin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Origin {
    /// In micrometres.
    pub along_um: i32,
    /// In micrometres.
    pub up_um: i32,
}

impl Origin {
    /// Metres along the tick's direction, and up.
    pub(super) fn metres(self) -> [f64; 2] {
        [self.along_um, self.up_um].map(|um| f64::from(um) * 1e-6)
    }
}

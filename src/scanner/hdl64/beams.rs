//! Assigns the points of a sample to beams without knowledge of the scanner: files hold one beam after the
//! other, each covering one turn, and the points of a beam lie on a cone.
//!
//! The scans of a sequence need not agree: one may lack a beam, be cut short, or come from another scanner.
//! The scan with which most others agree is the reference; the beams of the others are assigned to the cones
//! on which their points lie.

use std::f64::consts::TAU;

use pulp::NullaryFnOnce;
use rayon::prelude::*;

use super::model::ON_CONE;
use crate::ground::angle;
use crate::ground::lanes::{dispatch, lanes};
use crate::scanner::{AT_ONCE, thinned};

/// A point in the form needed by the fit, in metres and radians.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Point {
    pub position: [f64; 3],
    /// Horizontal distance from the axis.
    pub rho: f64,
    /// Azimuth from 0 to 2 pi.
    pub azimuth: f64,
}

impl Point {
    pub fn z(&self) -> f64 {
        self.position[2]
    }
}

/// Splits the points of a scan into beams, where the azimuth falls back; a short step back over the seam does
/// not start a new beam. Points without a direction are left out. Empty if there are too many beams: then the
/// points are in another order.
pub(crate) fn split_beams(positions: &[[f32; 3]]) -> Vec<Vec<Point>> {
    dispatch(Splitting(positions))
}

/// The argument of [`split_beams`], for a function compiled for several vector units.
struct Splitting<'a>(&'a [[f32; 3]]);

impl NullaryFnOnce for Splitting<'_> {
    type Output = Vec<Vec<Point>>;

    #[inline(always)]
    fn call(self) -> Vec<Vec<Point>> {
        let mut beams = Beams { beams: vec![Vec::new()], row: 0, last: None };
        let (blocks, rest) = self.0.as_chunks::<AT_ONCE>();
        for block in blocks {
            if !beams.take(&points(block)) {
                return Vec::new();
            }
        }
        for position in rest {
            if !beams.take(&points(std::array::from_ref(position))) {
                return Vec::new();
            }
        }
        beams.beams
    }
}

/// Points in the form needed by the fit. A distance that is not positive, or a coordinate that is not finite,
/// marks a point without a direction.
#[inline(always)]
fn points<const N: usize>(positions: &[[f32; 3]; N]) -> [Point; N] {
    let [x, y, z]: [[f64; N]; 3] = [
        lanes(|i| f64::from(positions[i][0])),
        lanes(|i| f64::from(positions[i][1])),
        lanes(|i| f64::from(positions[i][2])),
    ];
    let rho: [f64; N] = lanes(|i| (x[i] * x[i] + y[i] * y[i]).sqrt());
    let azimuth: [f64; N] = lanes(|i| {
        let turned = angle::atan2(y[i], x[i]);
        turned + if turned < 0.0 { TAU } else { 0.0 }
    });
    lanes(|i| Point { position: [x[i], y[i], z[i]], rho: rho[i], azimuth: azimuth[i] })
}

/// Beams to which points are added in the order of the file.
struct Beams {
    beams: Vec<Vec<Point>>,
    row: usize,
    /// The azimuth of the last point.
    last: Option<f64>,
}

impl Beams {
    /// Adds points; false if there are too many beams.
    #[inline(always)]
    fn take(&mut self, points: &[Point]) -> bool {
        /// With more beams, the file does not have the points of a scanner beam by beam.
        const MOST_BEAMS: usize = 256;
        /// In radians. Within a beam, even points out of order fall back by far less. Scans may be cut to a
        /// sector that is not much wider.
        const FALL: f64 = 0.2;
        /// In radians: a rise of at least this much is a step back over the seam. In a scan that is cut to a
        /// sector around the seam, the azimuth rises by less from one end of a beam to the other.
        const RISE: f64 = TAU - 0.1;
        for point in points {
            let [x, y, z] = point.position;
            if !(point.rho > 0.0 && x.is_finite() && y.is_finite() && z.is_finite()) {
                continue;
            }
            let step = point.azimuth - self.last.replace(point.azimuth).unwrap_or(point.azimuth);
            if step < -FALL {
                self.row += 1;
            } else if step > RISE {
                self.row = self.row.saturating_sub(1);
            }
            if self.row >= MOST_BEAMS {
                return false;
            }
            if self.row == self.beams.len() {
                let length = self.beams.last().map_or(0, Vec::len);
                self.beams.push(Vec::with_capacity(length));
            }
            self.beams[self.row].push(*point);
        }
        true
    }
}

/// A beam's points, scan by scan.
pub(crate) struct Beam<'a> {
    cone: Cone,
    /// One entry for each scan: its points in one or more pieces; empty if the scan has no such beam.
    pub scans: Vec<Vec<&'a [Point]>>,
}

impl Beam<'_> {
    /// All points.
    pub fn points(&self) -> Vec<Point> {
        self.scans.iter().flatten().copied().flatten().copied().collect()
    }

    /// Number of points that the beam has in a scan.
    pub fn points_in(&self, scan: usize) -> usize {
        self.scans[scan].iter().map(|points| points.len()).sum()
    }
}

/// Matches the beams of several scans, in the order of the file. Scans that have little in common with the
/// others are left out.
pub(crate) fn align<'a>(scans: &[&'a [Vec<Point>]]) -> Vec<Beam<'a>> {
    let cones: Vec<Vec<Option<Cone>>> =
        scans.par_iter().map(|beams| beams.iter().map(|points| Cone::of(points)).collect()).collect();
    let matched = |reference: usize, scan: usize| {
        let known: Vec<Cone> = cones[reference].iter().flatten().copied().collect();
        let mut place = 0;
        let mut points = 0;
        for beam in scans[scan] {
            if let Some(found) = matching(&known, place, beam) {
                (place, points) = (found + 1, points + beam.len());
            }
        }
        points
    };
    let total = |reference: &usize| (0..scans.len()).map(|scan| matched(*reference, scan)).sum::<usize>();
    // The first of several equal ones.
    let Some(reference) = (0..scans.len()).rev().max_by_key(total) else { return Vec::new() };
    let alike = |scan: &usize| {
        *scan != reference && matched(reference, *scan) * 2 > scans[*scan].iter().map(Vec::len).sum()
    };

    let mut beams: Vec<Beam<'a>> = Vec::new();
    for scan in std::iter::once(reference).chain((0..scans.len()).filter(alike)) {
        let mut place = 0;
        for (points, cone) in scans[scan].iter().zip(&cones[scan]) {
            let known: Vec<Cone> = beams.iter().map(|beam| beam.cone).collect();
            let found = matching(&known, place, points).or_else(|| {
                beams.insert(place, Beam { cone: (*cone)?, scans: vec![Vec::new(); scans.len()] });
                Some(place)
            });
            if let Some(found) = found {
                beams[found].scans[scan].push(points);
                place = found + 1;
            }
        }
    }
    beams
}

/// The number of the cone on which the points lie; the search starts at `place`.
fn matching(cones: &[Cone], place: usize, points: &[Point]) -> Option<usize> {
    let after = place.min(cones.len());
    (after..cones.len()).chain(0..after).find(|&i| cones[i].holds(points))
}

/// The cone of a beam: z = height + slope * rho.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cone {
    pub height: f64,
    pub slope: f64,
}

impl Cone {
    /// The cone of a beam's points, if they lie on one.
    fn of(points: &[Point]) -> Option<Self> {
        /// Fewer points than this lie on many cones.
        const FEWEST: usize = 20;
        /// Number of points that the fit uses.
        const SAMPLE: usize = 400;
        let sample: Vec<Point> = thinned(points, SAMPLE).copied().collect();
        let cone = Cone::fit(&sample);
        (points.len() >= FEWEST && cone.holds(points)).then_some(cone)
    }

    /// Whether most of the points lie on the cone.
    fn holds(&self, points: &[Point]) -> bool {
        const SAMPLE: usize = 30;
        let (mut on, mut seen) = (0, 0);
        for point in thinned(points, SAMPLE) {
            seen += 1;
            on += usize::from((point.z() - self.height - self.slope * point.rho).abs() < ON_CONE);
        }
        on * 3 > seen * 2
    }

    /// Least squares, with weights that decrease with the distance from the cone.
    pub fn fit(points: &[Point]) -> Self {
        /// In metres: the fit has converged when an iteration moves the cone by less.
        const SETTLED: f64 = 1e-5;
        let mut cone = Cone { height: 0.0, slope: 0.0 };
        for round in 0..15 {
            let [mut n, mut r, mut rr, mut z, mut rz] = [0.0; 5];
            for p in points {
                let miss = (p.z() - cone.height - cone.slope * p.rho).abs();
                let weight = match round {
                    0 => 1.0,
                    _ if miss > 0.02 && round > 2 => 0.0,
                    _ => 1.0 / miss.max(3e-4),
                };
                n += weight;
                r += weight * p.rho;
                rr += weight * p.rho * p.rho;
                z += weight * p.z();
                rz += weight * p.rho * p.z();
            }
            let determinant = n * rr - r * r;
            // All points are at one distance, so any cone with this height there fits.
            if determinant < 1e-9 * n * rr {
                break;
            }
            let slope = (n * rz - r * z) / determinant;
            let next = Cone { height: (z - slope * r) / n, slope };
            let change = (next.slope - cone.slope).abs() * r / n + (next.height - cone.height).abs();
            cone = next;
            if round > 3 && change < SETTLED {
                break;
            }
        }
        cone
    }
}

//! A first estimate of a scanner's motion when all that is known is which points share a laser: the cones of
//! the lasers determine all of the motion except the rotation about their axis, and the azimuths, which are
//! whole ticks, determine that.

use std::f64::consts::TAU;

use super::find::Point;
use crate::scan::Channel;
use crate::scanner::channel_of_lasers;
use crate::scanner::motion::cones::Cones;
use crate::scanner::motion::many::Seen;
use crate::scanner::motion::{Motion, Mover};
use crate::scanner::thinned;

/// The motion, as accurately as the size of ticks and steps allows. None if no channel distinguishes the
/// lasers, or no motion brings their points onto cones.
pub fn motion(points: &[Point], channels: &[Channel]) -> Option<Motion> {
    let beams = beams(points, channels)?;
    let seen = |point: &Point| Seen { position: point.position.map(f64::from), part: point.part };
    let undone = |mover: &Mover, seen: &mut [Seen]| {
        seen.iter().map(|seen| mover.at(seen.part).undone(seen.position)).collect()
    };
    let mut cones = Cones::new(&beams, seen)?;
    let mut motion = cones.improved(Motion::default(), undone)?;
    // Cones are fitted as if there were no rotation about z, until that rotation is known.
    for _ in 0..2 {
        motion = with_yaw(motion, &beams)?;
        motion = cones.improved(motion, undone)?;
    }
    with_yaw(motion, &beams)
}

/// The points of each laser, if a channel tells the lasers.
fn beams(points: &[Point], channels: &[Channel]) -> Option<Vec<Vec<Point>>> {
    let channel = channel_of_lasers(channels)?;
    let key = |point: &Point| channel.value(point.number);
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| key(a).cmp(key(b)));
    Some(sorted.chunk_by(|a, b| key(a) == key(b)).map(<[Point]>::to_vec).collect())
}

/// A point's azimuth before the rotation about z is undone, and its part of the motion.
struct Azimuth {
    beam: usize,
    radians: f64,
    part: f64,
}

/// The motion with the rotation about z that brings azimuths onto ticks. None if no rotation does.
fn with_yaw(motion: Motion, beams: &[Vec<Point>]) -> Option<Motion> {
    /// Numbers of ticks in a turn that scanners have, the usual one first.
    const TICKS: [f64; 5] = [36_000.0, 1024.0, 2048.0, 512.0, 4096.0];
    /// Minimum coherence of azimuths that are on ticks.
    const COHERENT: f64 = 0.6;
    /// Share of the best coherence that counts as equally good.
    const AS_GOOD: f64 = 0.95;
    /// Radians in a scan by which a skidding car may turn more, or less, than the motion says.
    const FARTHEST: f64 = 0.3;
    /// The first part of the motion that is examined, and the factor by which it grows each time.
    const FIRST: f64 = 0.02;
    const GROWTH: f64 = 4.0;
    /// The resolution, in ticks, at the largest part; the number of values to either side that are tried
    /// later; and the largest number of azimuths.
    const FINE: f64 = 0.1;
    const NEAR: i32 = 10;
    const MOST: usize = 4000;
    let mover = Mover::new(&motion);
    let mut azimuths: Vec<Azimuth> = Vec::new();
    for (beam, points) in beams.iter().enumerate() {
        azimuths.extend(points.iter().map(|point| {
            let [x, y, _] = mover.at(point.part).undone(point.position.map(f64::from));
            Azimuth { beam, radians: libm::atan2(y, x), part: point.part }
        }));
    }
    azimuths.sort_by(|a, b| a.part.abs().total_cmp(&b.part.abs()));
    for ticks in TICKS {
        let coherence = |yaw: f64, azimuths: &[&Azimuth]| {
            let mut sums = vec![[0.0; 2]; beams.len()];
            for azimuth in azimuths {
                let (sin, cos) = libm::sincos((azimuth.radians - yaw * azimuth.part) * ticks);
                let sum = &mut sums[azimuth.beam];
                (sum[0], sum[1]) = (sum[0] + cos, sum[1] + sin);
            }
            sums.iter().map(|[cos, sin]| libm::hypot(*cos, *sin)).sum::<f64>() / azimuths.len().max(1) as f64
        };
        let (mut yaw, mut part) = (0.0, FIRST);
        let mut places = (FARTHEST * FIRST / (FINE * TAU / ticks)).ceil() as i32;
        let best = loop {
            let within = azimuths.partition_point(|azimuth| azimuth.part.abs() <= part);
            let near: Vec<&Azimuth> = thinned(&azimuths[..within], MOST).collect();
            let tried = (-places..=places).map(|place| yaw + f64::from(place) * FINE * TAU / ticks / part);
            let tried: Vec<(f64, f64)> = tried.map(|yaw| (coherence(yaw, &near), yaw)).collect();
            let best = tried.iter().map(|(coherence, _)| *coherence).fold(0.0, f64::max);
            // Time stamps are evenly spaced, so rotations that differ by whole ticks per time stamp look the
            // same: the smallest is the right one, since a car turns by less.
            let as_good = tried.into_iter().filter(|(coherence, _)| *coherence >= AS_GOOD * best);
            let is_first = part == FIRST;
            yaw = match is_first {
                true => as_good.map(|(_, yaw)| yaw).min_by(|a, b| a.abs().total_cmp(&b.abs()))?,
                false => as_good.max_by(|a, b| a.0.total_cmp(&b.0))?.1,
            };
            if part >= 1.0 || best < COHERENT {
                break best;
            }
            (part, places) = ((part * GROWTH).min(1.0), NEAR);
        };
        if best >= COHERENT {
            let [x, y, z] = motion.rotation;
            return Some(Motion { rotation: [x, y, z + yaw], ..motion });
        }
    }
    None
}

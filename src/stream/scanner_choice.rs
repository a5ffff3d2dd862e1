//! The sensor model of a sequence: fitted to a sample of it, or the article's.

use rayon::prelude::*;

use super::input::FrameInput;
use super::ordered::pool;
use crate::files::parse_with;
use crate::frame::settings::{EncoderConfig, ProjectionKind, resolve_threads};
use crate::ground::error::Result;
use crate::scan::ScanFile;
use crate::scanner::motion;
use crate::scanner::{self, SensorModel};

/// Larger files than this, in bytes, are left out of the sample, which is in memory all at once.
const SAMPLE_FILE_BYTES: u64 = 64 << 20;

/// The sensor model of a sequence that these frames are of.
pub(crate) fn choose_sensor(frames: &[FrameInput], config: &EncoderConfig) -> Result<Option<SensorModel>> {
    Ok(match config.projection {
        ProjectionKind::Calibrated { range_step_um } => {
            let pool = pool(resolve_threads(config.threads))?;
            let fitted = pool.install(|| sample(frames, config).map(|sample| scanner::fit(&sample)))?;
            fitted.map(|sensor| range_step_um.into_iter().fold(sensor, SensorModel::with_range_step))
        }
        ProjectionKind::Ideal { columns, range_step_um } => Some(scanner::ideal(columns, range_step_um)),
    })
}

/// The frames that the sensor model is fitted to, spread over the sequence.
fn sample(frames: &[FrameInput], config: &EncoderConfig) -> Result<Vec<ScanFile>> {
    let places: Vec<usize> = sample_places(frames.len(), config.sample_frames()).collect();
    let scans =
        places.into_par_iter().map(|place| scan_of(&frames[place], config)).collect::<Result<Vec<_>>>();
    Ok(scans?.into_iter().flatten().collect())
}

/// A frame of the sample, as it was measured; none if it is too large.
fn scan_of(frame: &FrameInput, config: &EncoderConfig) -> Result<Option<ScanFile>> {
    if frame.size()? > SAMPLE_FILE_BYTES {
        return Ok(None);
    }
    let mut scan = parse_with(frame.name()?, frame.read()?, config.headerless.as_ref());
    let undone = config.undoes_compensation().then(|| motion::undo(&scan.cloud.positions));
    if let Some((positions, _)) = undone.flatten() {
        scan.cloud.positions = positions;
    }
    Ok(Some(scan))
}

/// Where a sample of at most so many frames is taken: the first frame, the last, and others evenly between.
fn sample_places(frames: usize, most: usize) -> impl Iterator<Item = usize> {
    let count = most.min(frames);
    (0..count).map(move |i| i * (frames - 1) / (count - 1).max(1))
}

#[cfg(test)]
mod tests {
    use super::sample_places;

    #[test]
    fn the_sample_is_spread_over_the_sequence() {
        let places = |frames| sample_places(frames, 6).collect::<Vec<_>>();
        assert_eq!(places(0), [0; 0]);
        assert_eq!(places(1), [0]);
        assert_eq!(places(3), [0, 1, 2]);
        assert_eq!(places(6), (0..6).collect::<Vec<_>>());
        assert_eq!(places(51), (0..6).map(|i| 10 * i).collect::<Vec<_>>());
    }
}

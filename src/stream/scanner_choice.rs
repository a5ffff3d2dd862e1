//! The scanners of a sequence: fitted to a sample of each stream, or the article's.

use rayon::prelude::*;

use super::input::FrameInput;
use super::ordered::pool;
use super::source::record_of;
use crate::frame::settings::{EncoderConfig, ProjectionKind, resolve_threads};
use crate::ground::error::Result;
use crate::scan::ScanFile;
use crate::scanner::motion;
use crate::scanner::{self, Scanner};
use crate::stream::container::ScannerRecord;

/// Larger files than this, in bytes, are left out of the sample, which is in memory all at once.
const SAMPLE_FILE_BYTES: u64 = 64 << 20;

/// The scanners of a sequence.
pub(crate) struct Scanners {
    /// That of each stream, if there is a model that it fits.
    pub models: Vec<Option<Scanner>>,
    /// The numbers of these among the records; 1 is the first, 0 is none.
    pub numbers: Vec<u64>,
    /// What is written of them: each once.
    pub records: Vec<ScannerRecord>,
}

impl Scanners {
    fn new(models: Vec<Option<Scanner>>) -> Self {
        let mut records = Vec::new();
        let mut number = |model: &Option<Scanner>| {
            let Some(record) = model.as_ref().map(record_of) else { return 0 };
            let place = records.iter().position(|other| *other == record).unwrap_or(records.len());
            if place == records.len() {
                records.push(record);
            }
            place as u64 + 1
        };
        let numbers = models.iter().map(&mut number).collect();
        Scanners { models, numbers, records }
    }
}

/// The scanners of a sequence that these frames are of.
///
/// # Errors
/// If a file cannot be read.
pub(crate) fn choose_scanners(frames: &[FrameInput], config: &EncoderConfig) -> Result<Scanners> {
    let last = frames.iter().map(|frame| frame.stamp().stream).max().unwrap_or(0);
    let model = |stream| {
        let frames: Vec<_> = frames.iter().filter(|frame| frame.stamp().stream == stream).collect();
        choose_model(&frames, config)
    };
    Ok(Scanners::new((0..=last).map(model).collect::<Result<_>>()?))
}

/// The model of the scanner of a stream that these frames are of.
fn choose_model(frames: &[&FrameInput], config: &EncoderConfig) -> Result<Option<Scanner>> {
    Ok(match config.projection {
        ProjectionKind::Calibrated { range_step_um } => {
            let pool = pool(resolve_threads(config.threads))?;
            let fitted = pool.install(|| sample(frames, config).map(|sample| Scanner::fit(&sample)))?;
            fitted.map(|scanner| range_step_um.into_iter().fold(scanner, Scanner::with_range_step))
        }
        ProjectionKind::Ideal { columns, range_step_um } => {
            Some(Scanner::Hdl64(scanner::ideal(columns, range_step_um)))
        }
    })
}

/// The frames that the scanner model is fitted to, spread over the sequence.
fn sample(frames: &[&FrameInput], config: &EncoderConfig) -> Result<Vec<ScanFile>> {
    let places: Vec<usize> = sample_places(frames.len(), config.sample_frames()).collect();
    let scans =
        places.into_par_iter().map(|place| scan_of(frames[place], config)).collect::<Result<Vec<_>>>();
    Ok(scans?.into_iter().flatten().collect())
}

/// A frame of the sample, as it was measured; none if it is too large.
fn scan_of(frame: &FrameInput, config: &EncoderConfig) -> Result<Option<ScanFile>> {
    if frame.size()? > SAMPLE_FILE_BYTES {
        return Ok(None);
    }
    let mut scan = frame.clone().into_frame(config.headerless.as_ref())?.scan;
    let undone =
        config.undoes_compensation().then(|| motion::measured(&scan.cloud.positions, config.undoes_map()));
    if let Some(positions) = undone.flatten() {
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

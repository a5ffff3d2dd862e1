//! The scanners of a sequence: fitted to a sample of each track, or the article's.

use std::borrow::Cow;
use std::sync::Arc;

use rayon::prelude::*;

use super::input::FrameInput;
use super::source::record_of;
use crate::container::{FrameKind, ScannerId, ScannerRecord};
use crate::files::HeaderlessLayout;
use crate::frame::settings::{EncoderConfig, ProjectionKind};
use crate::ground::error::Result;
use crate::ground::team::pool;
use crate::scan::{PointCloud, ScanFile, fullest, sorted};
use crate::scanner::motion;
use crate::scanner::{self, LEAST_EXPLAINED, Orientation, Scanner, hdl64};

/// Larger files, in bytes, are left out of the sample, all of which is in memory at once.
const SAMPLE_FILE_BYTES: u64 = 64 << 20;

/// The scanners of a drive.
pub struct DriveScanners {
    /// The scanner of each track, if one fits.
    pub scanners: Vec<Option<Scanner>>,
    /// The references to these scanners in groups.
    pub ids: Vec<Option<ScannerId>>,
    /// The records to be written, each once.
    pub records: Vec<ScannerRecord>,
    /// Whether a track has frames of several scanners: each frame is then coded in its scanner's track.
    pub are_mixed: bool,
}

impl DriveScanners {
    /// The scanners of a drive, one for each track.
    pub fn new(scanners: Vec<Option<Scanner>>) -> Self {
        let mut records = Vec::new();
        let mut name = |scanner: &Option<Scanner>| {
            let record = record_of(scanner.as_ref()?);
            let id = record.id();
            if !records.contains(&record) {
                records.push(record);
            }
            Some(id)
        };
        let ids = scanners.iter().map(&mut name).collect();
        DriveScanners { scanners, ids, records, are_mixed: false }
    }
}

/// The scanners of the drives of these frames, by drive number; at least one drive.
///
/// # Errors
/// If a file cannot be read.
pub(crate) fn choose_scanners(frames: &[FrameInput], config: &EncoderConfig) -> Result<Vec<DriveScanners>> {
    let last = frames.iter().map(FrameInput::drive).max().unwrap_or(0);
    let mut scanners: Vec<_> = (0..=last).map(|_| DriveScanners::new(vec![None])).collect();
    for frames in frames.chunk_by(|one, next| one.drive() == next.drive()) {
        if frames[0].stamp().kind != FrameKind::Beside {
            scanners[frames[0].drive()] = scanners_of_drive(frames, config)?;
        }
    }
    Ok(scanners)
}

/// The scanners of frames that are coded one by one: those fitted to one of the first frames. Recordings often
/// begin with empty or partial scans, so a fit is replaced until it explains the next frame.
#[derive(Clone, Default)]
pub(crate) struct KeptScanners {
    kept: Option<Arc<DriveScanners>>,
    /// Number of frames to which a fit was attempted, but for those with few points.
    tries: usize,
    /// Number of those with few points.
    small: usize,
    is_settled: bool,
}

impl KeptScanners {
    /// The scanners for the next frame. `frame` is called only if the frame is needed for the fit; it returns
    /// `None` for data that are not a scan.
    ///
    /// # Errors
    /// If the frame cannot be read.
    pub fn for_next(
        &mut self,
        frame: impl FnOnce() -> Option<FrameInput>,
        config: &EncoderConfig,
    ) -> Result<Arc<DriveScanners>> {
        /// Largest numbers of frames to which a fit is attempted: of all but those with few points, and of these.
        const MOST_TRIES: [usize; 2] = [5, 50];
        /// Fewer points do not show a scanner well.
        const FEW: usize = 1000;
        /// A scanner with this score has measured the frame: it explains nearly all points or reproduces many.
        const MEASURED: f64 = 0.97;
        if let Some(kept) = self.kept.as_ref().filter(|_| self.is_settled) {
            return Ok(Arc::clone(kept));
        }
        let frame = frame();
        let scan = frame.clone().map(|frame| frame.into_frame(config.headerless.as_ref())).transpose()?;
        let scan = scan.map(|frame| frame.scan).unwrap_or_default();
        let is_small = scan.cloud.measured() < FEW;
        let score = |scanners: &DriveScanners| scanners.score(&scan, config);
        let before = self.kept.take().map(|kept| (score(&kept), kept));
        if let Some((_, kept)) = before.as_ref().filter(|(score, _)| !is_small && *score >= MEASURED) {
            self.is_settled = true;
            return Ok(Arc::clone(self.kept.insert(Arc::clone(kept))));
        }
        *(if is_small { &mut self.small } else { &mut self.tries }) += 1;
        self.is_settled = self.tries >= MOST_TRIES[0] || self.small >= MOST_TRIES[1];
        let fitted = Arc::new(scanners_of_drive(frame.as_slice(), config)?);
        let fitted = (score(&fitted), fitted);
        let (_, best) = match before {
            Some(before) if before.0 >= fitted.0 => before,
            _ => fitted,
        };
        Ok(Arc::clone(self.kept.insert(best)))
    }
}

/// The records of the scanners of several drives, each once.
pub(crate) fn records_of(scanners: &[DriveScanners]) -> Vec<ScannerRecord> {
    let mut records: Vec<ScannerRecord> = Vec::new();
    for record in scanners.iter().flat_map(|scanners| &scanners.records) {
        if !records.contains(record) {
            records.push(record.clone());
        }
    }
    records
}

fn scanners_of_drive(frames: &[FrameInput], config: &EncoderConfig) -> Result<DriveScanners> {
    let last = frames.iter().map(|frame| frame.stamp().track).max().unwrap_or(0);
    let mut scanners = Vec::new();
    for track in 0..=last {
        let frames: Vec<_> = frames.iter().filter(|frame| frame.stamp().track == track).collect();
        let mut of_track = scanners_of_track(&frames, config)?.into_iter();
        scanners.push(of_track.next());
        if last == 0 {
            scanners.extend(of_track.map(Some));
        }
    }
    let are_mixed = last == 0 && scanners.len() > 1;
    Ok(DriveScanners { are_mixed, ..DriveScanners::new(scanners) })
}

impl DriveScanners {
    /// The track in which a frame is coded: its own or, if scanners are mixed, that of the scanner that
    /// explains most of it.
    pub fn track_of(&self, own: u8, scan: &ScanFile, config: &EncoderConfig) -> u8 {
        if !self.are_mixed {
            return own;
        }
        self.best_track(own, scan, config).0
    }

    /// How well the best of the scanners explains a scan.
    fn score(&self, scan: &ScanFile, config: &EncoderConfig) -> f64 {
        self.best_track(0, scan, config).1
    }

    /// The track of the scanner that explains most of a scan, as it is or as it was measured, and how much that is.
    fn best_track(&self, own: u8, scan: &ScanFile, config: &EncoderConfig) -> (u8, f64) {
        let along_axes = |scanner: &Scanner| scanner.along_axes(&scan.cloud);
        let measured = |scanner: &Scanner| {
            Cow::Owned(as_measured(along_axes(scanner).into_owned(), config.undoes_compensation()))
        };
        match self.track_by_points(own, along_axes) {
            (track, explained) if explained >= LEAST_EXPLAINED => (track, explained),
            _ => self.track_by_points(own, measured),
        }
    }

    /// The track of the scanner that explains most of the points that it would see, and how much that is;
    /// `own` if none explains any.
    fn track_by_points<'c>(&self, own: u8, seen_by: impl Fn(&Scanner) -> Cow<'c, PointCloud>) -> (u8, f64) {
        let score = |scanner: &Scanner| scanner.score(&seen_by(scanner));
        let of = |scanner: &Option<Scanner>| scanner.as_ref().map_or(0.0, score);
        let tracks = (0u8..).zip(&self.scanners).map(|(track, scanner)| (track, of(scanner)));
        // The first one wins ties.
        tracks.fold((own, 0.0), |best, next| if next.1 > best.1 { next } else { best })
    }
}

/// The scanners of a track with these frames: more than one if the first does not explain the whole sample.
fn scanners_of_track(frames: &[&FrameInput], config: &EncoderConfig) -> Result<Vec<Scanner>> {
    Ok(match config.projection {
        ProjectionKind::Calibrated { range_step_um } => {
            let in_steps = |scanner| range_step_um.into_iter().fold(scanner, Scanner::with_range_step);
            fitted(frames, Sampling::of(config))?.into_iter().map(in_steps).collect()
        }
        ProjectionKind::Ideal { columns, range_step_um } => {
            let seen = scanner_seen(frames, config)?;
            let orientation = seen.as_ref().map_or_else(Orientation::default, Scanner::orientation);
            let ideal = scanner::ideal_of(seen.as_ref(), columns, range_step_um);
            vec![Scanner::from(ideal).oriented(orientation)]
        }
    })
}

/// The scanner fitted to these frames, whose beams an image of an ideal scanner uses: fitted to the scans as
/// they are or, if that fails, as they were measured.
///
/// # Errors
/// If a file cannot be read.
pub(crate) fn scanner_seen(frames: &[&FrameInput], config: &EncoderConfig) -> Result<Option<Scanner>> {
    let sampling = Sampling::of(config);
    let found = fitted(frames, sampling)?.into_iter().next();
    if found.is_some() || sampling.undoes_compensation {
        return Ok(found);
    }
    let as_measured = Sampling { undoes_compensation: true, ..sampling };
    Ok(fitted(frames, as_measured)?.into_iter().next())
}

/// How frames are read for the fit.
#[derive(Clone, Copy)]
struct Sampling<'a> {
    headerless: Option<&'a HeaderlessLayout>,
    /// The axes along which points are returned.
    orientation: Orientation,
    /// Whether points are moved back to where they were measured.
    undoes_compensation: bool,
    /// Number of frames to begin with.
    frames: usize,
    threads: usize,
}

impl<'a> Sampling<'a> {
    fn of(config: &'a EncoderConfig) -> Self {
        Sampling {
            headerless: config.headerless.as_ref(),
            orientation: Orientation::default(),
            undoes_compensation: config.undoes_compensation(),
            frames: config.sample_frames(),
            threads: config.threads,
        }
    }

    /// At most `most` frames, spread over the sequence, to which the scanner is fitted.
    fn sample(self, frames: &[&FrameInput], most: usize) -> Result<Vec<ScanFile>> {
        let places: Vec<usize> = sample_places(frames.len(), most).collect();
        let scans = places.into_par_iter().map(|place| self.scan(frames[place])).collect::<Result<Vec<_>>>();
        Ok(scans?.into_iter().flatten().collect())
    }

    /// A frame of the sample, as it was measured and in the order of arrival; `None` if it is too large.
    fn scan(self, frame: &FrameInput) -> Result<Option<ScanFile>> {
        if frame.size()? > SAMPLE_FILE_BYTES {
            return Ok(None);
        }
        let scan = frame.clone().into_frame(self.headerless)?.scan;
        let mut cloud = scan.cloud;
        self.orientation.turn_to_scanner(&mut cloud.positions);
        Ok(Some(ScanFile { cloud: as_measured(cloud, self.undoes_compensation), ..scan }))
    }
}

impl Sampling<'_> {
    /// The sampling along the scanner's axes, if these are rows of an HDL-64E in files with others. `sample` is
    /// one along the axes of the files.
    fn of_rows_with_other_axes(self, frames: &[&FrameInput], sample: &[ScanFile]) -> Result<Option<Self>> {
        let orientation = fullest(sample).and_then(|scan| Orientation::of_rows(&scan.cloud.positions));
        let Some(orientation) =
            orientation.filter(|found| !found.is_default() && self.orientation.is_default())
        else {
            return Ok(None);
        };
        let turned = Sampling { orientation, ..self };
        let sample = turned.sample(frames, turned.frames)?;
        let is_evident = fullest(&sample).is_some_and(|scan| hdl64::is_evident(&scan.cloud.positions));
        Ok(is_evident.then_some(turned))
    }
}

/// The scanners fitted to a sample of these frames: to more of them if there are several scanners.
fn fitted(frames: &[&FrameInput], sampling: Sampling) -> Result<Vec<Scanner>> {
    /// Number of frames.
    const SAMPLE_OF_MIXED: usize = 16;
    pool(sampling.threads)?.install(|| {
        let sample = sampling.sample(frames, sampling.frames)?;
        if let Some(turned) = sampling.of_rows_with_other_axes(frames, &sample)? {
            let found = fitted(frames, turned)?.into_iter();
            let along_axes_of_file = |scanner: Scanner| {
                let orientation = scanner.orientation().after(turned.orientation);
                scanner.oriented(orientation)
            };
            return Ok(found.map(along_axes_of_file).collect());
        }
        let (found, explain_all) = fit_all(sample);
        if sampling.frames >= frames.len().min(SAMPLE_OF_MIXED) {
            return Ok(found);
        }
        let are_mixed = match &found[..] {
            [] => false,
            [only] => take_turns(only, explain_all, frames, sampling)?,
            _ => true,
        };
        if are_mixed { Ok(fit_all(sampling.sample(frames, SAMPLE_OF_MIXED)?).0) } else { Ok(found) }
    })
}

/// Whether the first two of these frames are of different scanners: if two scanners take turns, a sample that
/// is spread evenly may have caught frames of one alone. `only` is the scanner found in the sample, of which
/// the first frame is part; `explains_all`: it explains the whole sample.
fn take_turns(
    only: &Scanner,
    explains_all: bool,
    frames: &[&FrameInput],
    sampling: Sampling,
) -> Result<bool> {
    let second = sampling.scan(frames[1])?;
    // If it explains the first frame, this one only tells whether it does so to the last bit.
    let needs_first = !explains_all || only.has_recipe();
    let first = if needs_first { sampling.scan(frames[0])? } else { None };
    let reproduces = only.reproduces_any(first.iter().chain(&second));
    let unknown = if explains_all { None } else { first.as_ref() };
    Ok(second.iter().chain(unknown).any(|scan| !only.has_measured(scan, reproduces)))
}

/// The scans of a sample that are not of this scanner, which was fitted to some of them.
fn without_scans_of(scanner: &Scanner, mut scans: Vec<ScanFile>) -> Vec<ScanFile> {
    let reproduces = scanner.reproduces_any(&scans);
    scans.retain(|scan| !scanner.has_measured(scan, reproduces));
    scans
}

/// Scanners that together explain the scans of a sample, as far as fits succeed, and whether they explain
/// all.
fn fit_all(mut sample: Vec<ScanFile>) -> (Vec<Scanner>, bool) {
    /// The largest number of scanners in one folder, and the number of failed fits after which no more are
    /// tried.
    const MOST: usize = 8;
    const MOST_FAILURES: usize = 2;
    let (mut found, mut failures) = (Vec::new(), 0);
    sample.retain(|scan| !scan.cloud.positions.is_empty());
    while !sample.is_empty() && found.len() < MOST && failures < MOST_FAILURES {
        let before = sample.len();
        let scanner = Scanner::fit(&sample);
        if let Some(scanner) = scanner {
            sample = without_scans_of(&scanner, sample);
            found.push(scanner);
        }
        if sample.len() == before {
            // A fit that explains nothing of its own sample has failed, perhaps because of its largest scan.
            failures += 1;
            let largest = (0..before).max_by_key(|&place| sample[place].cloud.measured());
            largest.map(|place| sample.swap_remove(place));
        }
    }
    (found, failures == 0 && sample.is_empty())
}

/// Points in the order of arrival and, if wanted, as they were measured.
fn as_measured(cloud: PointCloud, undoes_compensation: bool) -> PointCloud {
    let mut cloud = sorted::in_order_of_arrival(&cloud).map_or(cloud, |(_, cloud)| cloud);
    let undone = undoes_compensation.then(|| motion::measured(&cloud.positions));
    if let Some(positions) = undone.flatten() {
        cloud.positions = positions;
    }
    cloud
}

/// The indices of a sample of at most `most` frames: the first frame, the last, and others evenly spaced
/// between them.
pub(crate) fn sample_places(frames: usize, most: usize) -> impl Iterator<Item = usize> {
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

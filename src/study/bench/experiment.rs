//! One experiment: a sample, encoded with some settings in memory, decoded and measured.

use std::time::{Duration, Instant};

use super::sample::Sample;
use crate::frame::settings::{EncoderConfig, ProjectionKind};
use crate::frame::{PositionFidelity, StageReport};
use crate::ground::error::Result;
use crate::scan::PointCloud;
use crate::scanner::hdl64::{RANGE_STEP_UM, project_nearest};
use crate::scanner::{FLOAT_RANGES, REACH, RangeImage, Scanner};
use crate::stream::{self, DecodeOptions, DecodedFrame};
use crate::study::metrics::{PointErrors, RangeErrors};

/// A sample, encoded and decoded.
pub struct Coded {
    /// The frames of the sample.
    pub frames: Vec<CodedFrame>,
    /// Bytes of the stream.
    pub stream_bytes: u64,
    /// The time of encoding, from files in memory to a stream in memory.
    pub encoding_time: Duration,
    /// The time of decoding, likewise.
    pub decoding_time: Duration,
}

/// A frame, encoded and decoded.
pub struct CodedFrame {
    /// Time and size of each stage of encoding. If several predictions were tried, those of the chosen one.
    pub encoding: StageReport,
    /// The decoded frame.
    pub decoded: DecodedFrame,
}

impl CodedFrame {
    /// Whether it was predicted from the frame before.
    pub fn is_inter(&self) -> bool {
        self.decoded.image.as_ref().is_some_and(|image| image.motion.is_some())
    }
}

/// Codes a sample, each run of frames as a group. `on_frame` is called, from any thread, after each frame was
/// encoded.
///
/// # Errors
/// If the settings are out of range, or a back-end's library fails.
pub fn run(sample: &Sample, config: &EncoderConfig, on_frame: &(dyn Fn() + Sync)) -> Result<Coded> {
    let config = EncoderConfig { gop: sample.run.max(1), ..config.clone() };
    let start = Instant::now();
    let mut stream = Vec::new();
    let encoded = stream::encode(&sample.inputs, &config, &mut stream, on_frame)?;
    let encoding_time = start.elapsed();

    let options = DecodeOptions { threads: config.threads, images: true, ..DecodeOptions::default() };
    let mut decoded = Vec::new();
    let start = Instant::now();
    stream::decode(&stream[..], &options, DecodedFrame::checked, |frame| {
        decoded.push(frame);
        Ok(())
    })?;
    let decoding_time = start.elapsed();
    let frames = encoded.frame_stages.into_iter().zip(decoded);
    let frames = frames.map(|(encoding, decoded)| CodedFrame { encoding, decoded }).collect();
    Ok(Coded { frames, stream_bytes: encoded.stream_bytes, encoding_time, decoding_time })
}

impl Coded {
    /// Bytes of the stream outside all sections of frames: headers, names, checksums, the index, and the
    /// scanner's record.
    pub fn container_bytes(&self) -> u64 {
        let sections: u64 = self.frames.iter().map(|frame| frame.encoding.coded()).sum();
        self.stream_bytes.saturating_sub(sections)
    }

    /// Bytes of the frames with these indices, with an equal share of the container's.
    pub fn bytes(&self, frames: impl Iterator<Item = usize>) -> f64 {
        let share = self.container_bytes() as f64 / self.frames.len().max(1) as f64;
        frames.map(|frame| self.frames[frame].encoding.coded() as f64 + share).sum()
    }

    /// Coded bytes as a percentage of the files' bytes (equation 11), for the frames with these indices;
    /// `None` if these files are empty.
    pub fn rate(&self, frames: impl Iterator<Item = usize> + Clone) -> Option<f64> {
        let original: f64 = frames.clone().map(|frame| self.frames[frame].encoding.original as f64).sum();
        (original > 0.0).then(|| 100.0 * self.bytes(frames) / original)
    }

    /// The mean of a value over the frames with these indices; `None` if there are none.
    pub fn mean(
        &self,
        frames: impl Iterator<Item = usize>,
        figure: impl Fn(&CodedFrame) -> f64,
    ) -> Option<f64> {
        let figures: Vec<_> = frames.map(|frame| figure(&self.frames[frame])).collect();
        (!figures.is_empty()).then(|| figures.iter().sum::<f64>() / figures.len() as f64)
    }

    /// The distortion of the frames with these indices.
    pub fn distortion(
        &self,
        sample: &Sample,
        config: &EncoderConfig,
        frames: impl Iterator<Item = usize>,
    ) -> Distortion {
        let mut distortion = Distortion::default();
        for frame in frames {
            distortion.add(&sample.clouds[frame], &self.frames[frame].decoded, config);
        }
        distortion
    }
}

/// The errors of decoded frames.
#[derive(Clone, Copy, Debug, Default)]
pub struct Distortion {
    /// Errors cell by cell (equation 12), if decoding returns a range image.
    pub ranges: RangeErrors,
    /// Errors point by point, if decoding returns all points in the order of the file. Scans that should be
    /// range images but have none, because no scanner fits them, are compared in neither way.
    pub points: PointErrors,
}

impl Distortion {
    /// The root mean square error, in metres; `None` if nothing could be compared.
    pub fn rmse(&self) -> Option<f64> {
        self.ranges.rmse().or(self.points.rmse())
    }

    fn add(&mut self, original: &PointCloud, decoded: &DecodedFrame, config: &EncoderConfig) {
        match (&decoded.image, config.positions) {
            (Some(image), PositionFidelity::Formula) => {
                let (scanner, reference) = reference_image(original, &image.scanner, config);
                self.ranges.add((&scanner, &reference), (&image.scanner, &image.image));
            }
            (None, PositionFidelity::Formula) => {}
            _ => self.points.add(original, &decoded.scan.cloud),
        }
    }
}

/// The range image of the points that remain after the outlier filter, with the finest possible steps:
/// float32 for the ideal scanner, the scanner's own for a calibrated one.
fn reference_image(
    original: &PointCloud,
    scanner: &Scanner,
    config: &EncoderConfig,
) -> (Scanner, RangeImage) {
    let filtered = config.outliers.map(|filter| filter.filter(original));
    let cloud = &scanner.along_axes(filtered.as_ref().unwrap_or(original));
    match (config.projection, scanner.hdl64()) {
        (ProjectionKind::Ideal { .. }, Some(ideal)) => {
            let ideal = ideal.clone().with_range_step(FLOAT_RANGES);
            let image = project_nearest(&ideal, cloud).image;
            (Scanner::from(ideal), image)
        }
        _ => {
            let scanner = scanner.clone().with_range_step(RANGE_STEP_UM);
            let image = scanner.project(cloud, REACH).image;
            (scanner, image)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend;
    use crate::frame::Prediction;
    use crate::frame::settings::{Coder, Mode, PredictionChoice};
    use crate::stream::FrameInput;
    use crate::study::bench::sample::Extent;
    use crate::study::synth::{SynthConfig, drive};

    fn sample() -> Sample {
        let config = SynthConfig { frames: 4, thinning: 10, ..SynthConfig::default() };
        let frame = |frame: crate::study::synth::SynthFrame| {
            let bytes = frame.to_bin();
            FrameInput::memory(frame.name, bytes)
        };
        let frames: Vec<_> = drive(&config).map(frame).collect();
        Sample::read(&frames, Extent { runs: 1, frames_a_run: 4 }).unwrap()
    }

    fn paper(range_step_um: u32, prediction: PredictionChoice) -> EncoderConfig {
        EncoderConfig {
            projection: ProjectionKind::Ideal { columns: 300, range_step_um },
            coder: Coder::Backend(backend::LZMA),
            prediction,
            ..EncoderConfig::preset(Mode::Paper)
        }
    }

    #[test]
    fn parts_add_up_to_the_stream() {
        let sample = sample();
        let coded = run(&sample, &paper(1000, PredictionChoice::EveryReference), &|| ()).unwrap();
        assert_eq!(coded.frames.len(), 4);
        let inter: Vec<_> = coded.frames.iter().map(CodedFrame::is_inter).collect();
        assert_eq!(inter, [false, true, true, true], "every frame with one before it is a P frame");
        assert!((coded.bytes(0..4) - coded.stream_bytes as f64).abs() < 1e-6);
        assert!((1..2000).contains(&coded.container_bytes()), "{}", coded.container_bytes());
        let parts = coded.bytes(0..1) + coded.bytes(1..4);
        assert!((parts - coded.stream_bytes as f64).abs() < 1e-6);
        let first = coded.mean(0..1, |frame| frame.encoding.original as f64);
        assert_eq!(first, Some(16.0 * sample.points(0..1) as f64));
        assert_eq!(coded.mean(0..0, |_| 1.0), None);
    }

    #[test]
    fn errors_are_those_of_rounding_to_steps() {
        let sample = sample();
        let intra = PredictionChoice::Always(Prediction::Intra);
        let distortion =
            |config: &EncoderConfig| run(&sample, config, &|| ()).unwrap().distortion(&sample, config, 1..4);
        let floats = distortion(&paper(FLOAT_RANGES, intra));
        assert_eq!(floats.rmse(), Some(0.0));
        assert!(floats.ranges.compared > 10_000 && floats.ranges.only_original == 0);
        for step in [10_000, 50_000] {
            let metres = f64::from(step) * 1e-6;
            let coarse = distortion(&paper(step, intra));
            // Rounding errors are uniformly distributed over a step.
            let expected = metres / 12f64.sqrt();
            assert!((coarse.rmse().unwrap() / expected - 1.0).abs() < 0.05, "{:?}", coarse.rmse());
            assert!(coarse.ranges.max().unwrap() < 1.001 * metres);
        }
        let exact = distortion(&EncoderConfig::preset(Mode::Exact));
        assert_eq!((exact.rmse(), exact.points.lost, exact.ranges.compared), (Some(0.0), 0, 0));
        assert_eq!(exact.points.paired, sample.points(1..4));
    }
}

//! Other authors' coders, run on a sample: the octree coder, and those of Tu et al.

use std::time::{Duration, Instant};

use super::octree;
use super::sample::{Sample, is_return};
use super::tu::{Aim, Coder, Method};
use crate::frame::settings::EncoderConfig;
use crate::ground::error::Result;
use crate::scan::PointCloud;
use crate::scanner::hdl64::{Hdl64, project_nearest};
use crate::scanner::{FLOAT_RANGES, RangeImage, Scanner};
use crate::study::metrics::{NearestErrors, NearestPoints, RangeErrors};

/// Sides of the octree's voxels in Table I, in micrometres.
pub const VOXELS_UM: [u32; 3] = [1000, 5000, 10_000];
/// The octree's side in Table VI: the article does not state it; this is the one that takes longest.
const TIMED_UM: u32 = VOXELS_UM[0];
/// Bits per return for the coders of Table VI, as for the article's own JPEG 2000.
const TIMED_BITS: f64 = 8.0;

/// A frame, coded and decoded.
#[derive(Clone, Copy, Debug, Default)]
pub struct RivalFrame {
    /// Coded size in bytes.
    pub bytes: u64,
    /// Number of decoded points.
    pub points: u64,
    /// Number of occupied voxels, for an octree.
    pub voxels: u64,
    /// Number of points or ranges with a known error.
    compared: u64,
    /// Root mean square error, in metres: for an octree, the distance of each original point from the nearest
    /// decoded one; for range images, equation 12.
    rmse_m: f64,
    /// The largest of these distances, in metres; for an octree only.
    pub max_m: f64,
}

/// A sample, coded by another author's coder.
#[derive(Default)]
pub struct Rival {
    /// The frames of the sample.
    pub frames: Vec<RivalFrame>,
    /// The time of encoding, from points in memory.
    pub encoding_time: Duration,
    /// The time of decoding, to points in memory.
    pub decoding_time: Duration,
}

impl Rival {
    /// The sum of a value over the frames with these indices.
    pub fn sum(&self, frames: impl Iterator<Item = usize>, figure: impl Fn(&RivalFrame) -> u64) -> u64 {
        frames.map(|frame| figure(&self.frames[frame])).sum()
    }

    /// The root mean square error of the frames with these indices, in metres; `None` if nothing could be
    /// compared.
    pub fn rmse(&self, frames: impl Iterator<Item = usize> + Clone) -> Option<f64> {
        let squares = frames.clone().map(|frame| &self.frames[frame]);
        let squares: f64 = squares.map(|frame| frame.compared as f64 * frame.rmse_m * frame.rmse_m).sum();
        let compared = self.sum(frames, |frame| frame.compared);
        (compared > 0).then(|| (squares / compared as f64).sqrt())
    }
}

/// The coders for the tables.
pub struct Rivals {
    /// The octree coder with each of [`VOXELS_UM`].
    pub octrees: Vec<Rival>,
    /// The range image coders, with their names in Table VI.
    pub tu: Vec<(&'static str, Rival)>,
}

/// The coders of Tu et al., by their names in Table VI.
pub const TU: [(&str, Method); 2] = [("Tu-MPEG", Method::Video), ("Tu-SLAM", Method::Slam)];

/// Number of frames to code for the tables.
pub fn frames_to_code(sample: &Sample) -> usize {
    sample.inputs.len() * (VOXELS_UM.len() + TU.len())
}

impl Rivals {
    /// Codes the sample with each, one frame after the other.
    ///
    /// # Errors
    /// If the image coder's library fails.
    pub fn run(
        sample: &Sample,
        scanner: &Hdl64,
        base: &EncoderConfig,
        on_frame: &(dyn Fn() + Sync),
    ) -> Result<Self> {
        let octrees = VOXELS_UM.iter().map(|&voxel_um| octree(sample, voxel_um, on_frame));
        let tu = TU.into_iter().map(|(name, method)| {
            Ok((name, tu(sample, scanner, base, method, Aim::Bits(TIMED_BITS), on_frame)?))
        });
        Ok(Rivals { octrees: octrees.collect::<Result<_>>()?, tu: tu.collect::<Result<_>>()? })
    }

    /// The rows of Table VI: names there, and the coders.
    pub fn timed(&self) -> impl Iterator<Item = (&'static str, &Rival)> {
        let timed = VOXELS_UM.iter().zip(&self.octrees).filter(|(voxel_um, _)| **voxel_um == TIMED_UM);
        timed.map(|(_, rival)| ("octree", rival)).chain(self.tu.iter().map(|(name, rival)| (*name, rival)))
    }
}

/// Codes a sample as octrees with voxels of this side.
///
/// # Errors
/// If a stream does not decode.
pub fn octree(sample: &Sample, voxel_um: u32, on_frame: &(dyn Fn() + Sync)) -> Result<Rival> {
    let mut rival = Rival::default();
    for cloud in &sample.clouds {
        let start = Instant::now();
        let encoded = octree::encode(&cloud.positions, voxel_um);
        rival.encoding_time += start.elapsed();
        let start = Instant::now();
        let decoded = octree::decode(&encoded.bytes)?;
        rival.decoding_time += start.elapsed();
        let errors = place_errors(cloud, decoded);
        rival.frames.push(RivalFrame {
            bytes: encoded.bytes.len() as u64,
            points: encoded.points,
            voxels: encoded.voxels,
            compared: if errors.rmse().is_some() { encoded.points } else { 0 },
            rmse_m: errors.rmse().unwrap_or_default(),
            max_m: errors.max().unwrap_or_default(),
        });
        on_frame();
    }
    Ok(rival)
}

/// The distances of a scan's returns from the nearest of other points.
fn place_errors(cloud: &PointCloud, decoded: Vec<[f32; 3]>) -> NearestErrors {
    let returns = cloud.positions.iter().filter(|point| is_return(point)).copied().collect();
    let of = |positions| NearestPoints::of(&PointCloud { positions, ..PointCloud::default() });
    let mut errors = NearestErrors::default();
    if let (Some(returns), Some(decoded)) = (of(returns), of(decoded)) {
        errors.add_nearest(&returns, &decoded.nearest_to_all(&returns));
    }
    errors
}

/// Codes a sample, run by run, as range images of a scanner.
///
/// # Errors
/// If the image coder's library fails.
pub fn tu(
    sample: &Sample,
    scanner: &Hdl64,
    base: &EncoderConfig,
    method: Method,
    aim: Aim,
    on_frame: &(dyn Fn() + Sync),
) -> Result<Rival> {
    let coder = Coder { method, scanner, registration: base.registration };
    let of_family = Scanner::from(scanner.clone());
    let floats = scanner.clone().with_range_step(FLOAT_RANGES);
    let in_floats = Scanner::from(floats.clone());
    let mut rival = Rival::default();
    for run in sample.clouds.chunks(sample.run.max(1)) {
        let start = Instant::now();
        let images: Vec<RangeImage> = run.iter().map(|cloud| project_nearest(scanner, cloud).image).collect();
        let payloads = coder.encode(&images, aim)?;
        rival.encoding_time += start.elapsed();
        let start = Instant::now();
        let decoded = coder.decode(&payloads)?;
        let positions = |image: &RangeImage| of_family.positions(&of_family.file_order(image), 0.0, false);
        let points: Vec<_> = decoded.iter().map(positions).collect();
        rival.decoding_time += start.elapsed();
        for (((cloud, image), payload), points) in run.iter().zip(&decoded).zip(&payloads).zip(&points) {
            let mut errors = RangeErrors::default();
            errors.add((&in_floats, &project_nearest(&floats, cloud).image), (&of_family, image));
            rival.frames.push(RivalFrame {
                bytes: payload.len() as u64,
                points: points.len() as u64,
                compared: errors.compared,
                rmse_m: errors.rmse().unwrap_or_default(),
                ..RivalFrame::default()
            });
            on_frame();
        }
    }
    Ok(rival)
}

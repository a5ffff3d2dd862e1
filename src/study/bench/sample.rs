//! The frames on which experiments run. A drive may be long, so they are taken in runs of consecutive frames,
//! spread over the drive.

use crate::files::parse;
use crate::ground::error::Result;
use crate::scan::PointCloud;
use crate::stream::FrameInput;

/// The size of the sample of a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Extent {
    /// The largest number of runs.
    pub runs: usize,
    /// The largest number of consecutive frames in a run.
    pub frames_a_run: usize,
}

impl Extent {
    /// The numbers of the frames to take from a drive, and the number of frames in a run: the first run is at
    /// the start, the last at the end, others evenly spaced between; all frames are one run if there are no
    /// more than that.
    pub fn places(self, frames: usize) -> (Vec<usize>, usize) {
        if frames <= self.runs * self.frames_a_run {
            return ((0..frames).collect(), frames);
        }
        let start = |run: usize| run * (frames - self.frames_a_run) / (self.runs - 1).max(1);
        let run = |start: usize| start..start + self.frames_a_run;
        ((0..self.runs).map(start).flat_map(run).collect(), self.frames_a_run)
    }
}

/// Frames in memory, so that no experiment measures the disk.
pub struct Sample {
    /// The numbers of the frames within the drive.
    pub places: Vec<usize>,
    /// The files.
    pub inputs: Vec<FrameInput>,
    /// Their points.
    pub clouds: Vec<PointCloud>,
    /// Number of frames in a run.
    pub run: usize,
}

impl Sample {
    /// Reads a sample of the frames of a drive.
    ///
    /// # Errors
    /// If one cannot be read.
    pub fn read(frames: &[FrameInput], extent: Extent) -> Result<Self> {
        let (places, run) = extent.places(frames.len());
        let (mut inputs, mut clouds) = (Vec::new(), Vec::new());
        for frame in places.iter().map(|&place| &frames[place]) {
            let (name, bytes) = (frame.name()?.to_owned(), frame.read()?);
            inputs.push(FrameInput::memory(name.clone(), bytes.clone()));
            clouds.push(parse(&name, bytes).cloud);
        }
        Ok(Sample { places, inputs, clouds, run })
    }

    /// Whether any frame has one before it.
    pub fn has_references(&self) -> bool {
        self.run > 1
    }

    /// Whether a frame of the sample has one before it in its run.
    pub fn has_reference(&self, frame: usize) -> bool {
        !frame.is_multiple_of(self.run)
    }

    /// The frames on which prediction from the frame before is compared with other predictions: those that
    /// have one before them; all frames if none has.
    pub fn compared(&self) -> impl Iterator<Item = usize> + Clone {
        (0..self.inputs.len()).filter(|&frame| self.has_reference(frame) || !self.has_references())
    }

    /// Number of points in the frames with these indices.
    pub fn points(&self, frames: impl Iterator<Item = usize>) -> u64 {
        frames.map(|frame| self.clouds[frame].positions.len() as u64).sum()
    }

    /// Number of returns among these points.
    pub fn returns(&self, frames: impl Iterator<Item = usize>) -> u64 {
        frames.map(|frame| returns_of(&self.clouds[frame])).sum()
    }

    /// The frames in words: `20 frames (0 to 9, 40 to 49)`.
    pub fn describe(&self) -> String {
        self.describe_some(self.places.len())
    }

    /// `count` of the frames in words: `18 of 20 frames (0 to 9, 40 to 49)`.
    pub fn describe_some(&self, count: usize) -> String {
        let run = |run: &[usize]| match run {
            [only] => only.to_string(),
            [first, .., last] => format!("{first} to {last}"),
            [] => String::new(),
        };
        let runs: Vec<_> = self.places.chunk_by(|a, b| a + 1 == *b).map(run).collect();
        let plural = if self.places.len() == 1 { "" } else { "s" };
        let all = self.places.len();
        let of = if count == all { String::new() } else { format!("{count} of ") };
        format!("{of}{all} frame{plural} ({})", runs.join(", "))
    }
}

/// Whether a point is a return: some files store records without one as a point at the scanner, or as NaN.
pub fn is_return(point: &[f32; 3]) -> bool {
    point.iter().all(|metres| metres.is_finite()) && point.iter().any(|metres| *metres != 0.0)
}

/// Number of returns among the points of a scan.
pub fn returns_of(cloud: &PointCloud) -> u64 {
    cloud.positions.iter().filter(|point| is_return(point)).count() as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_are_spread_over_the_drive() {
        let extent = Extent { runs: 3, frames_a_run: 2 };
        assert_eq!(extent.places(0), (vec![], 0));
        assert_eq!(extent.places(5), (vec![0, 1, 2, 3, 4], 5));
        assert_eq!(extent.places(7), (vec![0, 1, 2, 3, 5, 6], 2));
        assert_eq!(extent.places(102), (vec![0, 1, 50, 51, 100, 101], 2));
        assert_eq!(Extent { runs: 1, frames_a_run: 3 }.places(9), (vec![0, 1, 2], 3));
    }

    #[test]
    fn samples_know_which_frames_have_a_reference() {
        let frame = |n: usize| FrameInput::memory(format!("{n}.bin"), vec![0; 16 * (n + 1)]);
        let frames: Vec<_> = (0..10).map(frame).collect();
        let sample = Sample::read(&frames, Extent { runs: 2, frames_a_run: 3 }).unwrap();
        assert_eq!(sample.describe(), "6 frames (0 to 2, 7 to 9)");
        assert_eq!(sample.describe_some(4), "4 of 6 frames (0 to 2, 7 to 9)");
        assert_eq!(sample.compared().collect::<Vec<_>>(), [1, 2, 4, 5]);
        assert_eq!(sample.points(sample.compared()), 2 + 3 + 9 + 10);
        let single = Sample::read(&frames[..1], Extent { runs: 2, frames_a_run: 3 }).unwrap();
        assert_eq!(single.compared().collect::<Vec<_>>(), [0]);
        assert_eq!(single.describe(), "1 frame (0)");
    }
}

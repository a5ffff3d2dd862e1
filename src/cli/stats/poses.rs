//! `lidarpc stats --poses`: the trajectory of the scanner.

use std::io::Write;
use std::path::Path;

use crate::frame::DecodedImage;
use crate::inter::registration::{Pose, RegistrationConfig, RigidMotion, Surface, register};
use crate::scanner::Orientation;
use crate::stream::{self, DecodeOptions, DecodedFrame};
use anyhow::Result;

use crate::cli::args::StatsArgs;
use crate::cli::console::Console;
use crate::cli::errors::about;
use crate::cli::input::{name_of, open};
use crate::cli::output::{FileOutput, about_output, keep_inputs, name_of_output};

pub fn run(args: &StatsArgs, path: &Path, console: Console) -> Result<()> {
    keep_inputs(path, std::slice::from_ref(&args.input))?;
    let mut output = FileOutput::create(path, args.force)?;
    let input = open(&args.input)?;
    let options = DecodeOptions {
        threads: args.threads.threads,
        limits: args.limits.limits(),
        images: true,
        ..DecodeOptions::default()
    };
    let bar = console.bar(input.frame_count(options.limits), "decoding");
    let mut way = Way::default();
    let mut poses = Vec::new();
    let decoded = stream::decode(input.reader(), &options, DecodedFrame::checked, |frame| {
        bar.inc(1);
        poses.push(way.follow(frame));
        Ok(())
    });
    bar.finish_and_clear();
    decoded.map_err(|error| about(error, &name_of(&args.input)))?;
    let mut writer = output.writer();
    let mut lines = poses.iter().map(line);
    let written = lines.try_for_each(|line| writeln!(writer, "{line}")).and_then(|()| writer.flush());
    drop(writer);
    written.map_err(|error| about_output(error.into(), path))?;
    output.finish().map_err(|error| about(error, &name_of_output(path)))?;
    let lost = way.lost;
    if lost > 0 {
        let frames = poses.len();
        console.say(format_args!(
            "{lost} of {frames} frames could not be registered; they go on as the one before"
        ));
    }
    Ok(())
}

/// The position of the scanner, frame after frame.
#[derive(Default)]
struct Way {
    /// The motion from the frame to the first one.
    to_first: RigidMotion,
    /// The motion from the frame before to the frame.
    last: Pose,
    before: Option<DecodedImage>,
    lost: u64,
}

impl Way {
    /// Uses the motion in the stream, or estimates it if there is none.
    fn follow(&mut self, frame: DecodedFrame) -> RigidMotion {
        let in_stream = frame.image.as_ref().and_then(|image| image.motion);
        if self.before.is_some() {
            match in_stream.or_else(|| self.register(frame.image.as_ref()?)) {
                Some(motion) => self.last = motion,
                None => self.lost += 1,
            }
            self.to_first = self.last.motion().inverse().then(&self.to_first);
        }
        self.before = frame.image.or_else(|| self.before.take());
        let orientation = self.before.as_ref().map(|image| image.scanner.orientation());
        along_axes_of_file(&self.to_first, orientation.unwrap_or_default())
    }

    fn register(&self, current: &DecodedImage) -> Option<Pose> {
        let DecodedImage { scanner, image, .. } = self.before.as_ref()?;
        let surface = Surface::of(scanner.hdl64()?, &image.columns, &image.steps);
        let config = RegistrationConfig::default();
        let found = register(&surface, &current.image, current.scanner.hdl64()?, &self.last, &config);
        found.map(|found| found.pose)
    }
}

/// A motion along the axes of the scanner as one along those of the file.
fn along_axes_of_file(motion: &RigidMotion, orientation: Orientation) -> RigidMotion {
    let columns = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|axis| {
        let axis = orientation.to_scanner(axis);
        orientation.to_file(motion.rotation.map(|row| (0..3).map(|along| row[along] * axis[along]).sum()))
    });
    RigidMotion {
        rotation: [0, 1, 2].map(|row| columns.map(|column| column[row])),
        translation: orientation.to_file(motion.translation),
    }
}

/// The rows of the matrix of rotation and translation.
fn line(motion: &RigidMotion) -> String {
    let rows = motion.rotation.iter().zip(motion.translation);
    let numbers = rows.flat_map(|(row, along)| row.iter().copied().chain([along]).collect::<Vec<_>>());
    numbers.map(|number| format!("{number:.9e}")).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn motions_are_along_the_axes_of_the_file() {
        let pose = Pose { yaw: 0.1, pitch: -0.2, roll: 0.3, translation: [4.0, 5.0, 6.0] };
        let moved = |motion: &RigidMotion, point: [f64; 3]| {
            [0, 1, 2].map(|row| {
                let turned: f64 = (0..3).map(|axis| motion.rotation[row][axis] * point[axis]).sum();
                turned + motion.translation[row]
            })
        };
        for number in 0..48 {
            let orientation = Orientation::from_number(number).unwrap();
            let point = [7.0, -8.0, 9.5];
            let of_scanner = orientation.to_file(moved(&pose.motion(), orientation.to_scanner(point)));
            let of_file = moved(&along_axes_of_file(&pose.motion(), orientation), point);
            for (a, b) in of_scanner.into_iter().zip(of_file) {
                assert!((a - b).abs() < 1e-12, "{orientation}: {of_file:?} instead of {of_scanner:?}");
            }
        }
    }
}

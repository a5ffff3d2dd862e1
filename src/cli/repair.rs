//! `lidarpc repair`

use std::io::BufReader;
use std::path::PathBuf;

use crate::edit::{self, Named};
use crate::stream::FrameRange;
use anyhow::Result;
use serde::Serialize;

use super::args::RepairArgs;
use super::console::Console;
use super::errors::about;
use super::input::{name_of, open, refuse_recordings};
use super::losses::{LossReport, Losses};
use super::output::{FileOutput, check_json, keep_inputs, name_of_output, print_json};
use super::readable;

/// The machine-readable report.
#[derive(Serialize)]
struct Report {
    file: String,
    frames: u64,
    /// Empty if the file is whole.
    lost: Vec<LossReport>,
}

pub fn run(args: &RepairArgs, console: Console) -> Result<()> {
    check_json("repair", args.json, &args.output);
    let input = std::slice::from_ref(&args.input);
    refuse_recordings("repair", input, "`encode` and `decode` take all of it that can be read");
    let input = name_of(&args.input);
    let stream = open(&args.input)?.rewindable().map_err(|error| about(error, &input))?;
    keep_inputs(&args.output, std::slice::from_ref(&args.input))?;
    let mut output = FileOutput::binary(&args.output, args.force)?;
    let mut losses = Losses::new(&args.input, FrameRange::default());
    let named = Named { path: PathBuf::from(input), stream: BufReader::new(stream) };
    let limits = args.limits.limits();
    let frames = output.write(|out| edit::repair(named, &limits, out, |lost| losses.report_loss(&lost)));
    let name = name_of_output(&args.output);
    let frames = frames.map_err(|error| about(error, &name))?;
    output.finish().map_err(|error| about(error, &name))?;
    if args.json {
        let lost = losses.report().into_iter().collect();
        print_json(&Report { file: name, frames, lost })?;
    } else {
        console.say(format_args!("{} copied", readable::count(frames, "frame")));
    }
    losses.check(frames)
}

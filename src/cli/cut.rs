//! `lidarpc cut`

use std::io::{BufReader, Write};
use std::path::PathBuf;
use std::time::Instant;

use crate::edit::{self, Cut, Named};
use crate::stream::FrameRange;
use anyhow::{Result, ensure};
use serde::Serialize;

use super::args::CutArgs;
use super::console::Console;
use super::errors::about;
use super::input::{ChosenFrames, Input, name_of, open, refuse_recordings, report_files_left_out};
use super::output::{FileOutput, check_json, keep_inputs, name_of_output, print_json};
use super::readable;

/// The machine-readable report.
#[derive(Serialize)]
struct Report {
    file: String,
    frames: u64,
    copied: u64,
    recoded: u64,
    files_left_out: u64,
    stream_bytes: u64,
    seconds: f64,
}

pub fn run(args: &CutArgs, console: Console) -> Result<()> {
    check_json("cut", args.json, &args.output);
    let start = Instant::now();
    let inputs = std::slice::from_ref(&args.input);
    refuse_recordings("cut", inputs, "encode its clouds to FILE.lpc, and cut that");
    let input = open(&args.input)?;
    keep_inputs(&args.output, inputs)?;
    let chosen =
        ChosenFrames::of("cut", &args.input, (args.frames, args.time), args.limits.limits(), console)?;
    ensure!(
        chosen.times.is_none(),
        "{}: has frames of other times between those of that time; cut by --frames, or decode by --time",
        name_of(&args.input)
    );
    let mut output = FileOutput::binary(&args.output, args.force)?;
    let name = name_of_output(&args.output);
    let cut = output
        .write(|out| cut_stream(args, input, chosen.range, out))
        .map_err(|error| about(error, &name))?;
    output.finish().map_err(|error| about(error, &name))?;
    report_files_left_out(&args.input, cut.files_left_out, console);
    let seconds = start.elapsed().as_secs_f64();
    if args.json {
        let Cut { copied, recoded, files_left_out, stream_bytes } = cut;
        let frames = copied + recoded;
        print_json(&Report { file: name, frames, copied, recoded, files_left_out, stream_bytes, seconds })?;
    } else {
        console.say(format_args!("{} in {seconds:.1} s", summary(&cut)));
    }
    Ok(())
}

/// Copies the frames. If the input is seekable, only the necessary groups are read.
fn cut_stream(
    args: &CutArgs,
    input: Input,
    frames: FrameRange,
    out: &mut impl Write,
) -> crate::ground::error::Result<Cut> {
    let (path, limits) = (PathBuf::from(name_of(&args.input)), args.limits.limits());
    match input {
        Input::File(file) => {
            edit::cut_indexed(Named { path, stream: BufReader::new(file) }, frames, &limits, out)
        }
        pipe => edit::cut(Named { path, stream: pipe.reader() }, frames, &limits, out),
    }
}

fn summary(cut: &Cut) -> String {
    let frames = readable::count(cut.copied + cut.recoded, "frame");
    let (copied, recoded, size) = (cut.copied, cut.recoded, readable::bytes(cut.stream_bytes));
    format!("{frames}: {copied} copied, {recoded} coded again; {size}")
}

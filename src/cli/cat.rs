//! `lidarpc cat`

use std::io::Read;
use std::path::{Path, PathBuf};
use std::time::Instant;

use crate::container::StreamReader;
use crate::edit::{self, Joined, Named};
use crate::ground::error::{self, Limits};
use anyhow::Result;
use serde::Serialize;

use super::args::CatArgs;
use super::console::Console;
use super::errors::about;
use super::input::{Input, check_stdin_once, name_of, refuse_recordings};
use super::output::{FileOutput, check_json, keep_inputs, name_of_output, print_json};
use super::readable;

/// The machine-readable report.
#[derive(Serialize)]
struct Report {
    file: String,
    streams: u64,
    frames: u64,
    stream_bytes: u64,
    seconds: f64,
}

pub fn run(args: &CatArgs, console: Console) -> Result<()> {
    check_stdin_once("cat", &args.inputs);
    check_json("cat", args.json, &args.output);
    let start = Instant::now();
    refuse_recordings("cat", &args.inputs, "encode the clouds of each to FILE.lpc, and join these");
    keep_inputs(&args.output, &args.inputs)?;
    let mut output = FileOutput::binary(&args.output, args.force)?;
    let name = name_of_output(&args.output);
    let streams = args.inputs.iter().map(|path| open(path, args.limits.limits()));
    let joined = output.write(|out| edit::cat(streams, out)).map_err(|error| about(error, &name))?;
    output.finish().map_err(|error| about(error, &name))?;
    let seconds = start.elapsed().as_secs_f64();
    if args.json {
        let Joined { streams, frames, stream_bytes, .. } = joined;
        print_json(&Report { file: name, streams, frames, stream_bytes, seconds })?;
    } else {
        console.say(format_args!("{} in {seconds:.1} s", summary(&joined)));
    }
    Ok(())
}

fn summary(joined: &Joined) -> String {
    let streams = readable::count(joined.streams, "stream");
    let (frames, size) = (readable::count(joined.frames, "frame"), readable::bytes(joined.stream_bytes));
    format!("{streams}: {frames}, {size}")
}

type Reader = StreamReader<Box<dyn Read + Send>>;

/// Opens a stream and reads its header. Files are opened only when needed, as there may be more of them than
/// the system allows to be open.
fn open(path: &Path, limits: Limits) -> error::Result<Named<Reader>> {
    let open = || StreamReader::open(Input::open(path)?.reader(), limits);
    let stream = open().map_err(|error: error::Error| error.at(name_of(path)))?;
    Ok(Named { path: PathBuf::from(name_of(path)), stream })
}

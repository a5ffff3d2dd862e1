//! `lidarpc cat`

use crate::edit;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::time::Instant;

use crate::edit::{Joined, Named};
use crate::ground::error::{self, Limits};
use crate::stream::container::StreamReader;
use anyhow::Result;
use clap::{CommandFactory, error::ErrorKind};

use super::args::{Args, CatArgs};
use super::errors::about;
use super::input::{Input, is_dash, name_of};
use super::output::{FileOutput, name_of_output};
use super::table;

pub fn run(args: &CatArgs, quiet: bool) -> Result<()> {
    if args.inputs.iter().filter(|path| is_dash(path)).count() > 1 {
        let what = "stdin can be read only once; give `-` once";
        Args::command().error(ErrorKind::ArgumentConflict, what).exit();
    }
    let start = Instant::now();
    let mut output = FileOutput::create(&args.output, args.force)?;
    let name = name_of_output(&args.output);
    let joined =
        write_stream(&args.inputs, args.limits.limits(), &mut output).map_err(|error| about(error, &name))?;
    output.finish().map_err(|error| about(error, &name))?;
    if !quiet {
        eprintln!("{} in {:.1} s", summary(&joined), start.elapsed().as_secs_f64());
    }
    Ok(())
}

fn write_stream(inputs: &[PathBuf], limits: Limits, output: &mut FileOutput) -> error::Result<Joined> {
    let mut writer = output.writer();
    let joined = edit::cat(inputs.iter().map(|path| open(path, limits)), &mut writer)?;
    writer.flush()?;
    Ok(joined)
}

fn summary(joined: &Joined) -> String {
    let streams = table::count(joined.streams, "stream");
    let (frames, size) = (table::count(joined.frames, "frame"), table::bytes(joined.stream_bytes));
    format!("{streams}: {frames}, {size}")
}

type Reader = StreamReader<Box<dyn Read + Send>>;

/// Opens a stream and reads its header. Files are opened as their turn comes: there may be more of them than the
/// system allows to be open.
fn open(path: &Path, limits: Limits) -> error::Result<Named<Reader>> {
    let open = || StreamReader::open(Input::open(path)?.reader(), limits);
    let stream = open().map_err(|error: error::Error| error.at(name_of(path)))?;
    Ok(Named { path: PathBuf::from(name_of(path)), stream })
}

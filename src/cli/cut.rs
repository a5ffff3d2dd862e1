//! `lidarpc cut`

use crate::edit;
use std::io::{BufReader, Write};
use std::path::PathBuf;
use std::time::Instant;

use crate::edit::{Cut, Named};
use anyhow::Result;

use super::args::CutArgs;
use super::errors::about;
use super::input::{Input, name_of, open};
use super::output::{FileOutput, name_of_output};
use super::table;

pub fn run(args: &CutArgs, quiet: bool) -> Result<()> {
    let start = Instant::now();
    let input = open(&args.input)?;
    let mut output = FileOutput::create(&args.output, args.force)?;
    let name = name_of_output(&args.output);
    let cut = write_stream(args, input, &mut output).map_err(|error| about(error, &name))?;
    output.finish().map_err(|error| about(error, &name))?;
    if !quiet {
        eprintln!("{} in {:.1} s", summary(&cut), start.elapsed().as_secs_f64());
    }
    Ok(())
}

/// Reads only the groups that it needs, if the input can be sought in.
fn write_stream(args: &CutArgs, input: Input, output: &mut FileOutput) -> crate::ground::error::Result<Cut> {
    let (path, limits) = (PathBuf::from(name_of(&args.input)), args.limits.limits());
    let mut writer = output.writer();
    let cut = match input {
        Input::File(file) => {
            let input = Named { path, stream: BufReader::new(file) };
            edit::cut_indexed(input, args.frames, &limits, &mut writer)
        }
        pipe => {
            let input = Named { path, stream: pipe.reader() };
            edit::cut(input, args.frames, &limits, &mut writer)
        }
    }?;
    writer.flush()?;
    Ok(cut)
}

fn summary(cut: &Cut) -> String {
    let frames = table::count(cut.copied + cut.recoded, "frame");
    let (copied, recoded, size) = (cut.copied, cut.recoded, table::bytes(cut.stream_bytes));
    format!("{frames}: {copied} copied, {recoded} coded again; {size}")
}

//! `lidarpc repair`

use crate::edit;
use std::io::{BufReader, Write};
use std::path::PathBuf;

use crate::edit::Named;
use anyhow::Result;

use super::args::RepairArgs;
use super::errors::about;
use super::input::{name_of, open};
use super::losses::Losses;
use super::output::{FileOutput, name_of_output};
use super::table;

pub fn run(args: &RepairArgs, quiet: bool) -> Result<()> {
    let input = name_of(&args.input);
    let stream = open(&args.input)?.rewindable().map_err(|error| about(error, &input))?;
    let mut output = FileOutput::create(&args.output, args.force)?;
    let mut losses = Losses::new(&args.input);
    let mut writer = output.writer();
    let named = Named { path: PathBuf::from(input), stream: BufReader::new(stream) };
    let frames = edit::repair(named, &args.limits.limits(), &mut writer, |lost| losses.tell(&lost))
        .and_then(|frames| Ok(writer.flush().map(|()| frames)?));
    drop(writer);
    let name = name_of_output(&args.output);
    let frames = frames.map_err(|error| about(error, &name))?;
    output.finish().map_err(|error| about(error, &name))?;
    if !quiet {
        eprintln!("{} copied", table::count(frames, "frame"));
    }
    losses.check(frames)
}

//! `lidarpc synth`

use crate::study::synth::{SynthConfig, SynthScanner, drive};
use anyhow::Result;

use super::args::{SimulatedScanner, SynthArgs};
use super::console::Console;
use super::output::FolderOutput;
use super::readable;

pub fn run(args: &SynthArgs, console: Console) -> Result<()> {
    let folder = FolderOutput::create(&args.output, args.force)?;
    let scanner = match args.scanner {
        SimulatedScanner::Hdl64 => SynthScanner::Hdl64,
        SimulatedScanner::Vlp16 => SynthScanner::Vlp16,
    };
    let config = SynthConfig { scanner, frames: args.frames, seed: args.seed, ..SynthConfig::default() };
    let bar = console.bar(Some(args.frames as u64), "driving");
    let mut points = 0;
    for frame in drive(&config) {
        points += frame.points.len() as u64;
        folder.write(&frame.name, |give| give(&frame.to_bin()))?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    folder.finish()?;
    let frames = readable::count(args.frames as u64, "frame");
    console.say(format_args!("{frames}, {}", readable::count(points, "point")));
    Ok(())
}

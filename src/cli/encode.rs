//! `lidarpc encode` for scans: folders and files, or frames from stdin, to one stream.

use std::iter;
use std::time::Instant;

use crate::files::{ArrivedFile, ArrivingFrames};
use crate::frame::EncoderConfig;
use crate::ground::error::Error;
use crate::stream::{self, FrameInput};
use crate::study::metrics;
use anyhow::{Result, ensure};

use super::args::EncodeArgs;
use super::console::{Console, to_stderr};
use super::encoding::{Done, create_output, encode_inputs, finish_output};
use super::errors::about;
use super::frames;
use super::input::is_dash;
use super::output::{name_of_output, print_json};
use super::readable;
use super::report::{StreamReport, summary};
use super::signals::LiveStdin;

pub fn run(args: &EncodeArgs, mut config: EncoderConfig, console: Console) -> Result<()> {
    let start = Instant::now();
    if args.inputs.iter().any(|input| is_dash(input)) {
        let done = encode_stdin(args, &config, console)?;
        return report(args, &config, &done, start, console);
    }
    let found = frames::find(args, console)?;
    let place = frames::name_of_inputs(&args.inputs);
    frames::settle(&found.frames, &mut config, &place, console)?;
    let done = encode_inputs(args, &config, &found, console)?;
    report(args, &config, &done, start, console)?;
    if args.rm {
        found.delete(&args.inputs, &done.encoded, (&place, console))?;
    }
    Ok(())
}

/// Encodes frames from stdin as they arrive.
fn encode_stdin(args: &EncodeArgs, config: &EncoderConfig, console: Console) -> Result<Done> {
    let name = name_of_output(args.output());
    let mut output = create_output(args, console)?;
    let bar = console.bar(None, "encoding");
    let mut arriving = ArrivingFrames::new(LiveStdin::new());
    let input = |ArrivedFile { name, bytes }| FrameInput::memory(name, bytes);
    // What arrived before a fault is kept.
    let mut fault = None;
    let files = iter::from_fn(|| if LiveStdin::is_over() { None } else { arriving.next() });
    let frames = files.map_while(|file| match file {
        Ok(file) => Some(Ok(input(file))),
        Err(error) => {
            fault = Some(error);
            None
        }
    });
    let encoded = output.write(|out| stream::encode_live(frames, config, out, &|| bar.inc(1)));
    bar.finish_and_clear();
    let encoded = encoded.map_err(|error| about(error, &name))?;
    let left_out = arriving.left_out().clone();
    // From here on a signal ends the program.
    drop(arriving);
    frames::check_left_out(&left_out, "stdin", args.strict, console)?;
    if LiveStdin::was_ended() {
        fault = Some(Error::Usage("interrupted".to_owned()));
    }
    if let Some(error) = fault.take_if(|_| encoded.frames.is_empty() || args.strict) {
        return Err(about(error, "stdin"));
    }
    if encoded.frames.is_empty() {
        ensure!(!args.strict, "stdin: held no frame; check what writes to it, or encode without --strict");
        console.say(format_args!("lidarpc: stdin: held no frame, and so does {name}"));
    }
    finish_output(args, output, &encoded, console)?;
    if let Some(error) = fault {
        let kept = readable::count(encoded.frames.len() as u64, "frame");
        return Err(about(error, "stdin").context(format!("{name}: ends early, after {kept}")));
    }
    Ok(Done { encoded, left_out, was_complete: false })
}

/// Reports what was encoded: frame by frame if that is wanted, then as JSON or in a line.
fn report(
    args: &EncodeArgs,
    config: &EncoderConfig,
    done: &Done,
    start: Instant,
    console: Console,
) -> Result<()> {
    let seconds = start.elapsed().as_secs_f64();
    let Done { encoded, left_out, was_complete } = done;
    if args.verbose {
        for (frame, stages) in encoded.frames.iter().zip(&encoded.frame_stages) {
            let (name, original, coded) = (frame.name.escape_debug(), stages.original, stages.coded());
            let share = readable::percent(metrics::ratio(original, coded));
            to_stderr(format_args!(
                "{name}: {} -> {} ({share})",
                readable::bytes(original),
                readable::bytes(coded)
            ));
        }
    }
    if args.json {
        let mut report = StreamReport::of(args, config, encoded, left_out, seconds);
        report.was_complete = *was_complete;
        print_json(&report)?;
    } else if *was_complete {
        let name = name_of_output(args.output());
        let frames = readable::count(encoded.frames.len() as u64, "frame");
        let verified = if args.verify { ", verified" } else { "" };
        console
            .say(format_args!("{name}: already complete, from these {frames} with these settings{verified}"));
    } else {
        console.say(format_args!("{} in {seconds:.1} s", summary(args, config, encoded)));
    }
    Ok(())
}

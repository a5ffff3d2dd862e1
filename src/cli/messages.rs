//! Messages: frames that arrive one by one and are encoded to a stream each, or such streams that arrive and
//! are decoded. Each frame or stream follows a line with its name, a space and its size in bytes.

use std::io::{self, Write};
use std::time::Instant;

use crate::files::{ArrivedFile, ArrivingFrames, MOST_NAME_BYTES, collected};
use crate::frame::EncoderConfig;
use crate::ground::error;
use crate::ground::team::resolve_threads;
use crate::stream::encoder::MessageCoder;
use crate::stream::{self, DecodeOptions, DecodedFrame, FrameInput};
use crate::study::metrics;
use anyhow::Result;
use serde::Serialize;

use super::args::{DecodeArgs, EncodeArgs, check_usage, wrong_usage};
use super::console::Console;
use super::conversion::{Converter, File};
use super::errors::about;
use super::frames;
use super::input::{is_dash, name_of, open};
use super::output::{FileOutput, FolderOutput, name_of_output, print_json};
use super::readable;
use super::report::{FidelityReport, fidelity};

/// The machine-readable report.
#[derive(Serialize)]
struct Report {
    file: String,
    /// Only after encoding.
    #[serde(flatten)]
    fidelity: Option<FidelityReport>,
    messages: u64,
    file_bytes: u64,
    stream_bytes: u64,
    seconds: f64,
}

/// `encode - --messages`: each frame is written before the next is read.
pub fn encode(args: &EncodeArgs, config: &EncoderConfig, console: Console) -> Result<()> {
    let is_stdin = args.inputs.iter().all(|input| is_dash(input));
    check_usage(
        "encode",
        [
            (!is_stdin, "--messages takes frames from stdin: give `-`"),
            (args.verify, "--verify compares a whole stream, not messages"),
        ],
    );
    let start = Instant::now();
    let mut arriving = ArrivingFrames::new(io::stdin()).with_any_names();
    let mut output = FileOutput::binary(args.output(), args.force)?;
    let (mut sizes, mut coder) = (Sizes::default(), MessageCoder::new(config.clone())?);
    let mut writer = output.writer();
    let encoded = arriving.by_ref().try_for_each(|file| {
        let ArrivedFile { name, bytes } = file.map_err(|error| match error {
            error::Error::Io(_) => error.at("stdin"),
            _ => error,
        })?;
        sizes.messages += 1;
        sizes.file_bytes += bytes.len() as u64;
        let payload = coder.encode(FrameInput::memory(name.clone(), bytes))?;
        sizes.stream_bytes += payload.len() as u64;
        write_message(&mut writer, &name, &payload)
    });
    drop(writer);
    encoded.map_err(|error| about(error, &name_of_output(args.output())))?;
    frames::check_left_out(arriving.left_out(), "stdin", args.strict, console)?;
    output.finish().map_err(|error| about(error, &name_of_output(args.output())))?;
    sizes.report(args.json, console, name_of_output(args.output()), Some(config), start)
}

/// `decode --messages`: into a folder, or to stdout in the format of the input.
pub fn decode(args: &DecodeArgs, console: Console) -> Result<()> {
    let [input] = &args.inputs[..] else {
        wrong_usage("decode", "--messages takes one input");
    };
    if args.keep_going {
        wrong_usage("decode", "--keep-going saves what is left of a stream, not of messages");
    }
    let start = Instant::now();
    let folder = match is_dash(args.output()) {
        true => None,
        false => Some(FolderOutput::create(args.output(), args.force)?.keeping(&args.inputs)),
    };
    let converter = Converter::new(args.format).with_any_names();
    let mut sizes = Sizes::default();
    let options = DecodeOptions {
        // A message has a single group, whose frame has two halves.
        threads: resolve_threads(args.threads.threads).min(2),
        limits: args.limits.limits(),
        ..DecodeOptions::default()
    };
    let mut arriving = ArrivingFrames::new(open(input)?.reader()).with_any_names();
    let decoded = (0..).zip(&mut arriving).try_for_each(|(number, message)| {
        let ArrivedFile { name, bytes } = message?;
        sizes.stream_bytes += bytes.len() as u64;
        let sink = |file: File| {
            sizes.messages += 1;
            sizes.file_bytes += match &folder {
                Some(folder) => folder.write(file.name(), |give| file.write(give))?,
                None => {
                    let whole = collected(|give| file.write(give))?;
                    write_message(&mut io::stdout().lock(), file.name(), &whole)?;
                    whole.len() as u64
                }
            };
            Ok(())
        };
        // Each is the first frame of its stream; frames without names are named by their numbers.
        let numbered = |frame| converter.file(DecodedFrame { number, ..frame });
        stream::decode(&bytes[..], &options, numbered, sink).map_err(|error| error.at(&name)).map(drop)
    });
    decoded.map_err(|error| about(error, &name_of(input)))?;
    if let Some(folder) = folder {
        folder.finish()?;
    }
    converter.report_unconverted(console);
    sizes.report(args.json, console, name_of_output(args.output()), None, start)
}

/// Writes a message after its line, and flushes it.
///
/// # Errors
/// If a reader would not take the line, and if writing fails.
fn write_message(out: &mut dyn Write, name: &str, bytes: &[u8]) -> error::Result<()> {
    if name.len() > MOST_NAME_BYTES || name.contains(char::is_control) {
        let what = "is a name that does not fit into the line of a message; decode into a folder";
        return Err(error::Error::Input { path: name.into(), what: what.to_owned() });
    }
    writeln!(out, "{name} {}", bytes.len())?;
    out.write_all(bytes)?;
    Ok(out.flush()?)
}

/// Total sizes of the messages so far.
#[derive(Default)]
struct Sizes {
    messages: u64,
    file_bytes: u64,
    stream_bytes: u64,
}

impl Sizes {
    /// Reports them; `config`: the settings, if messages were encoded.
    fn report(
        &self,
        json: bool,
        console: Console,
        file: String,
        config: Option<&EncoderConfig>,
        start: Instant,
    ) -> Result<()> {
        let Sizes { messages, file_bytes, stream_bytes } = *self;
        let seconds = start.elapsed().as_secs_f64();
        if json {
            let fidelity = config.map(FidelityReport::of);
            return print_json(&Report { file, fidelity, messages, file_bytes, stream_bytes, seconds });
        }
        console.say(format_args!(
            "{}: files of {}, streams of {} ({}){} in {seconds:.1} s",
            readable::count(messages, "message"),
            readable::bytes(file_bytes),
            readable::bytes(stream_bytes),
            readable::percent(metrics::ratio(file_bytes, stream_bytes)),
            match config {
                Some(config) => format!(", {}", fidelity(config, None)),
                None => String::new(),
            },
        ));
        Ok(())
    }
}

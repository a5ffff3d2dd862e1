//! `lidarpc encode` and `lidarpc decode`: chooses by the kinds of the input and the output what encodes or
//! decodes them.

use std::path::PathBuf;

use crate::files::sequence::STREAM_EXTENSION;
use crate::frame::EncoderConfig;
use anyhow::Result;

use super::args::{DecodeArgs, EncodeArgs, check_usage, encoder_config, wrong_usage};
use super::console::Console;
use super::input::{check_stdin_once, is_dash, is_named_as_recording, is_recording};
use super::output::{check_json, print_json};
use super::{decode, encode, messages, recording, tree};

/// `encode`: messages, a recording, a tree of drives, or scans.
pub fn encode(args: &EncodeArgs, console: Console) -> Result<()> {
    let output = args.output.clone().unwrap_or_else(|| default_stream(args));
    let args = &EncodeArgs { output: Some(output), verify: args.verify || args.rm, ..args.clone() };
    let config = encoder_config("encode", &args.coding, args.threads.threads);
    check_encode(args, &config);
    if args.messages {
        return messages::encode(args, &config, console);
    }
    if args.inputs.iter().any(|input| is_recording(input)) {
        return recording::encode(args, &config, console);
    }
    if !args.topic.is_empty() {
        wrong_usage("encode", "--topic chooses clouds of a recording; the input is none");
    }
    if is_named_as_recording(args.output()) {
        wrong_usage("encode", "only a recording is encoded to a recording; give -o FILE.lpc");
    }
    if tree::is_folder(args.output()) && !args.inputs.iter().any(|input| is_dash(input)) {
        return tree::encode(args, &config, console);
    }
    if args.jobs.is_some() {
        wrong_usage("encode", "--jobs counts the drives that are encoded into a folder; the output is none");
    }
    encode::run(args, config, console)
}

/// Ends the program if the options do not go together, whatever the kind of the input.
fn check_encode(args: &EncodeArgs, config: &EncoderConfig) {
    let is_piped = args.inputs.iter().any(|input| is_dash(input));
    let is_stdout = is_dash(args.output());
    check_usage(
        "encode",
        [
            (args.rm && is_stdout, "--rm needs an output that can be read again, not stdout"),
            (args.rm && is_piped, "--rm deletes files; stdin is none"),
            (args.verify && is_stdout, "--verify needs an output that can be read again, not stdout"),
            (args.resume && is_stdout, "--resume needs an output that stays, not stdout"),
            (args.resume && is_piped, "--resume needs inputs that can be read again, not stdin"),
            (args.all && is_piped, "--all keeps the files of folders, not of stdin"),
            (is_piped && args.inputs.len() > 1, "`-`, for frames from stdin, stands alone"),
        ],
    );
    check_json("encode", args.json, args.output());
    let is_lossy = !config.is_exact();
    check_usage(
        "encode",
        [(
            args.rm && is_lossy,
            "--rm deletes only what comes back as it was: leave out what makes the output lossy",
        )],
    );
}

/// The output of `encode` if none is given: a file beside the input, with its name and the extension of
/// streams.
fn default_stream(args: &EncodeArgs) -> PathBuf {
    let only = match &args.inputs[..] {
        [input] => Some(input),
        _ => None,
    };
    if only.is_some_and(|input| is_recording(input)) {
        let what = "say where to: by -o FILE.mcap the whole recording, by -o FILE.lpc the clouds alone";
        wrong_usage("encode", what);
    }
    let named = only.filter(|input| !is_dash(input)).and_then(|input| Some((input, input.file_name()?)));
    let Some((input, name)) = named else {
        wrong_usage("encode", "say where to, by -o FILE: the input gives no name for the output");
    };
    let mut name = name.to_owned();
    name.push(".");
    name.push(STREAM_EXTENSION);
    input.with_file_name(name)
}

/// `decode`: a tree of streams, a recording, streams, or messages.
pub fn decode(args: &DecodeArgs, console: Console) -> Result<()> {
    let output = args.output.clone().unwrap_or_else(|| default_folder(args));
    let args = &DecodeArgs { output: Some(output), ..args.clone() };
    check_stdin_once("decode", &args.inputs);
    check_json("decode", args.json, args.output());
    if args.inputs.iter().any(|input| input.is_dir()) {
        let mut reports = Vec::new();
        let decoded = tree::decode(args, |args| decode_streams(args, &mut reports, console));
        if args.json {
            print_json(&reports)?;
        }
        return decoded;
    }
    if args.inputs.iter().any(|input| is_recording(input)) {
        return recording::decode(args, console);
    }
    let mut reports = Vec::new();
    let decoded = decode_streams(args, &mut reports, console);
    if let Some(report) = reports.first().filter(|_| args.json) {
        print_json(report)?;
    }
    decoded
}

/// Decodes streams, or messages. The machine-readable reports on streams are added to `reports`.
fn decode_streams(args: &DecodeArgs, reports: &mut Vec<decode::Report>, console: Console) -> Result<()> {
    if !args.topic.is_empty() {
        wrong_usage("decode", "--topic chooses clouds of a recording; the input is none");
    }
    if is_named_as_recording(args.output()) {
        wrong_usage("decode", "only a recording is decoded to a recording; give -o FOLDER");
    }
    match args.messages {
        true => messages::decode(args, console),
        false => decode::run(args, reports, console),
    }
}

/// The output of `decode` if none is given: a folder beside the input, with its name.
fn default_folder(args: &DecodeArgs) -> PathBuf {
    match &args.inputs[..] {
        [input] if input.extension().is_some_and(|ending| ending == STREAM_EXTENSION) => {
            input.with_extension("")
        }
        _ => wrong_usage("decode", "say where to, by -o FOLDER: the input gives no name for the output"),
    }
}

//! The command line: arguments, files and reports around the library.

mod args;
mod bench;
mod cat;
mod cleanup;
mod coding;
mod cut;
mod decode;
mod encode;
mod errors;
mod estimate;
mod frames;
mod in_memory;
mod info;
mod input;
mod length;
mod losses;
mod manual;
mod messages;
mod output;
mod partial;
mod poses;
mod progress;
mod record_length;
mod recording;
mod regions;
mod repair;
mod stats;
mod steps;
mod synth;
mod table;
mod temporary;
mod time_range;
mod tree;
mod verify;
mod view;

use std::ffi::OsString;
use std::process::ExitCode;

use args::{Args, Command};
use clap::Parser;
use errors::report;

/// The whole program: arguments in, exit code out.
pub fn main() -> ExitCode {
    main_of(std::env::args_os()).into()
}

/// As [`main`], with these arguments, the first of which is the program's name. Wrong usage ends the process.
pub fn main_of(args: impl IntoIterator<Item = OsString>) -> u8 {
    keep_memory();
    let args = Args::parse_from(args.into_iter().map(level_in_short));
    match run(&args) {
        Ok(()) => errors::DONE,
        Err(error) => report(&error),
    }
}

/// What users of other compressors type, `-9`, as `--level=9`.
fn level_in_short(arg: OsString) -> OsString {
    match arg.as_encoded_bytes() {
        [b'-', level @ b'1'..=b'9'] => format!("--level={}", level - b'0').into(),
        _ => arg,
    }
}

/// Lets memory that is freed be used again, rather than go back to the system and be asked for, page by page, for the
/// next frame: glibc's `malloc` keeps as much as the largest block that was freed before.
///
/// Encoding the city drive on two threads takes 0.92 of the CPU time that it takes without at level 1, 0.96 at level 6, and
/// 5 to 10 MB more memory; decoding as long (medians of nine pairs of runs).
fn keep_memory() {
    /// Bytes: the largest that it takes notice of is 32 MiB.
    const LARGEST: usize = 31 << 20;
    drop(std::hint::black_box(Vec::<u8>::with_capacity(LARGEST)));
}

/// Does what the arguments say.
///
/// # Errors
/// [`report`] says them and chooses the exit code.
fn run(args: &Args) -> anyhow::Result<()> {
    cleanup::on_signals();
    match &args.command {
        Command::Encode(command) => encode::run(command, args.quiet),
        Command::Decode(command) => decode::run(command, args.quiet),
        Command::Stats(command) => stats::run(command, args.quiet),
        Command::Info(command) => info::run(command),
        Command::Verify(command) => verify::run(command, args.quiet),
        Command::Cut(command) => cut::run(command, args.quiet),
        Command::Cat(command) => cat::run(command, args.quiet),
        Command::Repair(command) => repair::run(command, args.quiet),
        Command::View(command) => view::run(command, args.quiet),
        Command::Bench(command) => bench::run(command, args.quiet),
        Command::Synth(command) => synth::run(command, args.quiet),
        Command::Estimate(command) => estimate::run(command, args.quiet),
        Command::Completions(command) => manual::completions(command),
        Command::Man(command) => manual::man(command),
    }
}

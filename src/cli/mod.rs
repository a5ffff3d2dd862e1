//! The command line: arguments, files and reports around the library.

mod args;
mod bench;
mod cat;
mod coding;
mod console;
mod conversion;
mod cut;
mod decode;
mod dispatch;
mod encode;
mod encoding;
mod errors;
mod estimate;
mod frames;
mod info;
mod input;
mod losses;
mod manual;
mod messages;
mod output;
mod partial;
mod readable;
mod record_length;
mod recording;
mod repair;
mod report;
mod signals;
mod stats;
mod synth;
mod temporary;
mod time_range;
mod tree;
mod verify;
mod view;

use std::ffi::OsString;
use std::process::ExitCode;

use args::{Args, Command};
use clap::Parser;
use console::Console;

/// The whole program: arguments in, exit code out.
pub fn main() -> ExitCode {
    keep_memory();
    main_of(std::env::args_os()).into()
}

/// Like [`main`], within a process that may do other things, and with these arguments, the first of which is
/// the program's name. Wrong usage ends the process.
pub fn main_of(args: impl IntoIterator<Item = OsString>) -> u8 {
    let args = Args::parse_from(levels_in_short(args));
    match run(&args) {
        Ok(()) => errors::DONE,
        Err(error) => errors::report(&error),
    }
}

/// Rewrites `-9`, the notation of other compressors, as `--level=9`; arguments after `--` are names.
fn levels_in_short(args: impl IntoIterator<Item = OsString>) -> impl Iterator<Item = OsString> {
    let mut are_names = false;
    args.into_iter().map(move |arg| {
        are_names |= arg == "--";
        match arg.as_encoded_bytes() {
            [b'-', level @ b'1'..=b'9'] if !are_names => format!("--level={}", level - b'0').into(),
            _ => arg,
        }
    })
}

/// Keeps freed memory for the next frame instead of returning it to the system and requesting it again page
/// by page, and lets all threads reuse it instead of only the thread that freed it.
///
/// With the first measure, encoding the city drive on two threads takes 0.92 of the CPU time at level 1 and
/// 0.96 at level 6 (medians of nine pairs of runs). With the second, 60 frames of the road drive take 78 to
/// 85 MB instead of 103 to 124 MB on two threads, in the same time.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
fn keep_memory() {
    /// In bytes: the largest value that glibc accepts.
    const LARGEST_BLOCK: i32 = 32 << 20;
    const MOST_KEPT: i32 = 2 * LARGEST_BLOCK;
    // SAFETY: mallopt takes numbers only, and no other thread has been started.
    #[allow(unsafe_code)]
    unsafe {
        libc::mallopt(libc::M_MMAP_THRESHOLD, LARGEST_BLOCK);
        libc::mallopt(libc::M_TRIM_THRESHOLD, MOST_KEPT);
        libc::mallopt(libc::M_ARENA_MAX, 1);
    }
}

/// Allocators of other systems keep their settings.
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
fn keep_memory() {}

/// Executes the command in the arguments.
///
/// # Errors
/// All errors; [`errors::report`] prints them and chooses the exit code.
fn run(args: &Args) -> anyhow::Result<()> {
    signals::on_signals();
    let console = Console { is_quiet: args.quiet };
    match &args.command {
        Command::Encode(command) => dispatch::encode(command, console),
        Command::Decode(command) => dispatch::decode(command, console),
        Command::Stats(command) => stats::run(command, console),
        Command::Info(command) => info::run(command),
        Command::Verify(command) => verify::run(command, console),
        Command::Cut(command) => cut::run(command, console),
        Command::Cat(command) => cat::run(command, console),
        Command::Repair(command) => repair::run(command, console),
        Command::View(command) => view::run(command, console),
        Command::Bench(command) => bench::run(command, console),
        Command::Synth(command) => synth::run(command, console),
        Command::Estimate(command) => estimate::run(command, console),
        Command::Completions(command) => manual::completions(command),
        Command::Man(command) => manual::man(command),
    }
}

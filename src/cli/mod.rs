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
    let args = Args::parse_from(levels_in_short(args));
    match run(&args) {
        Ok(()) => errors::DONE,
        Err(error) => report(&error),
    }
}

/// What users of other compressors type, `-9`, as `--level=9`; behind `--` stand names.
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

/// Lets memory that is freed be used again for the next frame, by any thread, rather than go back to the system and be
/// asked for page by page, or be kept for the thread that freed it.
///
/// On the first of these, encoding the city drive on two threads takes 0.92 of the CPU time at level 1 and 0.96 at level 6
/// (medians of nine pairs of runs). On the second, 60 frames of the road drive take 78 to 85 MB instead of 103 to 124 on
/// two threads, in the same time.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
fn keep_memory() {
    /// Bytes: the most that glibc takes.
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

/// Other systems' allocators are left as they are.
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
fn keep_memory() {}

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

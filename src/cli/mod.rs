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
mod in_memory;
mod info;
mod input;
mod length;
mod losses;
mod output;
mod partial;
mod poses;
mod progress;
mod regions;
mod repair;
mod stats;
mod steps;
mod synth;
mod table;
mod temporary;
mod verify;
mod view;

pub use args::Args;
pub use errors::report;

use args::Command;

/// Does what the arguments say.
///
/// # Errors
/// [`report`] says them and chooses the exit code.
pub fn run(args: &Args) -> anyhow::Result<()> {
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
        Command::View(command) => view::run(command),
        Command::Bench(command) => bench::run(command, args.quiet),
        Command::Synth(command) => synth::run(command, args.quiet),
    }
}

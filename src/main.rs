//! The `lidarpc` program; see `lidarpc --help`.

use std::process::ExitCode;

use clap::Parser;

mod cli;

fn main() -> ExitCode {
    keep_memory();
    let args = cli::Args::parse();
    match cli::run(&args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => cli::report(&error),
    }
}

/// Lets memory that is freed be used again, rather than go back to the system and be asked for, page by page, for the
/// next frame: glibc's `malloc` keeps as much as the largest block that was freed before.
fn keep_memory() {
    /// Bytes: the largest that it takes notice of is 32 MiB.
    const LARGEST: usize = 31 << 20;
    drop(std::hint::black_box(Vec::<u8>::with_capacity(LARGEST)));
}

//! The `lidarpc` program; see `lidarpc --help`.

use std::process::ExitCode;

fn main() -> ExitCode {
    lidarpc::cli::main()
}

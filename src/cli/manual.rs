//! `lidarpc completions` and `lidarpc man`: files for package maintainers to install.

use std::io::{self, Write};

use anyhow::{Context, Result};
use clap::CommandFactory;

use super::args::{Args, CompletionsArgs, ManArgs};
use super::output::create_folders;

/// The name of the program in shells.
const PROGRAM: &str = "lidarpc";

pub fn completions(args: &CompletionsArgs) -> Result<()> {
    // The crate would panic at a closed pipe.
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Args::command(), PROGRAM, &mut script);
    Ok(io::stdout().write_all(&script)?)
}

pub fn man(args: &ManArgs) -> Result<()> {
    let Some(folder) = &args.output else {
        return Ok(clap_mangen::Man::new(Args::command()).render(&mut io::stdout().lock())?);
    };
    let name = folder.display().to_string();
    create_folders(folder)?;
    clap_mangen::generate_to(Args::command(), folder).with_context(|| name)
}

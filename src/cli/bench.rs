//! `lidarpc bench`

use std::ffi::OsString;
use std::io::{self, Write};
use std::path::Path;

use crate::files::sequence::find_frames;
use crate::stream::FrameInput;
use crate::study::bench::report::{Report, csv, html, text};
use crate::study::bench::{Bench, Findings};
use anyhow::{Result, ensure};

use super::args::{ARTICLE, BenchArgs, encoder_config, wrong_usage};
use super::console::Console;
use super::errors::about;
use super::input::{is_dash, is_stream, name_of};
use super::output::{FileOutput, name_of_output, print_json};

pub fn run(args: &BenchArgs, console: Console) -> Result<()> {
    let is_page_only = args.html.as_deref().is_some_and(is_dash);
    if is_page_only && (args.json || args.csv) {
        let what = "--html - takes stdout; write the page to a file, or leave --json and --csv out";
        wrong_usage("bench", what);
    }
    ensure!(
        !is_stream(&args.input),
        "{}: is a lidarpc stream; bench takes scans: decode it first, as by `lidarpc decode FILE -o FOLDER`",
        name_of(&args.input)
    );
    let config = encoder_config("bench", &args.coding.in_paper_mode(), args.threads.threads);
    // Created first, so that an error does not waste the work.
    let mut page = args.html.as_deref().map(|path| FileOutput::create(path, args.force)).transpose()?;
    let frames = find_frames(std::slice::from_ref(&args.input))?.frames;
    let frames = FrameInput::from_files(frames);
    let in_input = |error| about(error, &args.input.display().to_string());
    let bench = Bench::new(&frames, &config, args.quick).map_err(in_input)?;
    let bar = console.bar(Some(bench.frames_to_code() as u64), "measuring");
    let findings = bench.run(&|| bar.inc(1));
    bar.finish_and_clear();

    let name = name_of_folder(&args.input);
    let mut facts = vec![
        ("program".to_owned(), format!("lidarpc {}", env!("CARGO_PKG_VERSION"))),
        ("command".to_owned(), command_line(std::env::args_os())),
    ];
    facts.extend(bench.facts());
    facts.push(("article".to_owned(), ARTICLE.to_owned()));
    let title = format!("The article's tables and figures on {name}");
    let Findings { summary, sections } = findings.map_err(in_input)?;
    let report = Report { title, summary, facts, sections };
    if let (Some(output), Some(path)) = (page.take(), &args.html) {
        write_page(output, &report).map_err(|error| error.context(name_of_output(path)))?;
    }
    if is_page_only {
        return Ok(());
    }
    if args.json {
        return print_json(&report);
    }
    let mut out = io::BufWriter::new(io::stdout().lock());
    if args.csv {
        csv::write(&report, &mut out)?;
    } else {
        text::write(&report, &mut out)?;
    }
    out.flush()?;
    Ok(())
}

fn write_page(mut output: FileOutput, report: &Report) -> Result<()> {
    let mut writer = output.writer();
    html::write(report, &mut writer)?;
    writer.flush()?;
    drop(writer);
    output.finish()?;
    Ok(())
}

/// The last part of a path; `scans` if it has none, like `..`.
fn name_of_folder(path: &Path) -> String {
    path.file_name().map_or_else(|| "scans".to_owned(), |name| name.to_string_lossy().into_owned())
}

/// The command line for publication: absolute paths are reduced to their last part.
fn command_line(args: impl Iterator<Item = OsString>) -> String {
    let shown = |text: &str| {
        let path = Path::new(text);
        if path.is_absolute() { name_of_folder(path) } else { text.to_owned() }
    };
    let shown = |arg: OsString| {
        let arg = arg.to_string_lossy().into_owned();
        match arg.split_once('=') {
            Some((option, value)) if option.starts_with("--") => format!("{option}={}", shown(value)),
            _ => shown(&arg),
        }
    };
    let args: Vec<_> = args.skip(1).map(shown).collect();
    format!("lidarpc {}", args.join(" "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn command_lines_are_shown_without_absolute_paths() {
        let args =
            ["/usr/bin/lidarpc", "bench", "/home/me/drive", "--html=/tmp/out.html", "--step", "1cm", "../x"];
        let shown = command_line(args.into_iter().map(OsString::from));
        assert_eq!(shown, "lidarpc bench drive --html=out.html --step 1cm ../x");
    }
}

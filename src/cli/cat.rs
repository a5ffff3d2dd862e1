//! `lidarpc cat`

use crate::edit;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::time::Instant;

use crate::edit::{Joined, Named};
use crate::ground::error::{self, Limits};
use crate::stream::container::{StreamHeader, StreamReader};
use anyhow::Result;
use clap::{CommandFactory, error::ErrorKind};

use super::args::{Args, CatArgs};
use super::errors::about;
use super::input::{Input, is_dash, name_of};
use super::output::{FileOutput, name_of_output};
use super::table;

pub fn run(args: &CatArgs, quiet: bool) -> Result<()> {
    if args.inputs.iter().filter(|path| is_dash(path)).count() > 1 {
        let what = "stdin can be read only once; give `-` once";
        Args::command().error(ErrorKind::ArgumentConflict, what).exit();
    }
    let start = Instant::now();
    let inputs = args.inputs.iter().map(|path| Piece::open(path, args.limits.limits()));
    let inputs = inputs.collect::<error::Result<Vec<_>>>()?;
    let mut output = FileOutput::create(&args.output, args.force)?;
    let name = name_of_output(&args.output);
    let joined =
        write_stream(inputs, args.limits.limits(), &mut output).map_err(|error| about(error, &name))?;
    output.finish().map_err(|error| about(error, &name))?;
    if !quiet {
        eprintln!("{} in {:.1} s", summary(&joined), start.elapsed().as_secs_f64());
    }
    Ok(())
}

fn write_stream(inputs: Vec<Piece>, limits: Limits, output: &mut FileOutput) -> error::Result<Joined> {
    let header = inputs.iter().map(|piece| piece.header).reduce(StreamHeader::joined).unwrap_or_default();
    let mut writer = output.writer();
    let joined = edit::cat(&header, inputs.into_iter().map(|piece| piece.stream(limits)), &mut writer)?;
    writer.flush()?;
    Ok(joined)
}

fn summary(joined: &Joined) -> String {
    let streams = table::count(joined.streams, "stream");
    let (frames, size) = (table::count(joined.frames, "frame"), table::bytes(joined.stream_bytes));
    format!("{streams}: {frames}, {size}")
}

type Reader = StreamReader<Box<dyn Read + Send>>;

/// A stream to join, its header known.
struct Piece {
    path: PathBuf,
    header: StreamHeader,
    /// What must stay open as it cannot be opened twice. Files are not kept open: there may be more of
    /// them than the system allows.
    pipe: Option<Reader>,
}

impl Piece {
    fn open(path: &Path, limits: Limits) -> error::Result<Self> {
        let (reader, is_pipe) = open(path, limits)?;
        let header = *reader.header();
        Ok(Piece { path: path.to_path_buf(), header, pipe: is_pipe.then_some(reader) })
    }

    /// The stream, after its header.
    fn stream(self, limits: Limits) -> error::Result<Named<Reader>> {
        let stream = match self.pipe {
            Some(reader) => reader,
            None => open(&self.path, limits)?.0,
        };
        Ok(Named { path: PathBuf::from(name_of(&self.path)), stream })
    }
}

/// Opens a stream and reads its header; also tells whether it is a pipe.
fn open(path: &Path, limits: Limits) -> error::Result<(Reader, bool)> {
    let open = || {
        let input = Input::open(path)?;
        let is_pipe = matches!(input, Input::Pipe(_));
        Ok((StreamReader::open(input.reader(), limits)?, is_pipe))
    };
    open().map_err(|error: error::Error| error.at(name_of(path)))
}

//! Joins streams into one, copying their groups as they are.

use std::io::{Read, Write};
use std::path::PathBuf;

use super::{GroupCopier, Named};
use crate::container::StreamReader;
use crate::files::names::{FileNames, NameConflict};
use crate::ground::error::{Error, Result};
use crate::stream::options::FrameRange;
use crate::stream::source::{GroupJob, StreamedGroups};

/// The result of joining streams.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Joined {
    /// Streams that were read.
    pub streams: u64,
    /// Total number of their frames.
    pub frames: u64,
    /// Bytes of the new stream.
    pub stream_bytes: u64,
}

/// Joins streams. They are read from front to back and checked, one after the other; only one group, and the
/// names of all frames, are in memory.
///
/// # Errors
/// Naming the stream: if it cannot be read or is damaged, or if it holds a frame that no decoder could write
/// into the same folder as the earlier ones, because of its name. Without a name: if the output fails. The
/// output is not a complete stream then.
pub fn cat<R: Read>(
    inputs: impl IntoIterator<Item = Result<Named<StreamReader<R>>>>,
    out: impl Write,
) -> Result<Joined> {
    let mut copier = GroupCopier::create(out)?;
    let (mut known, mut joined) = (Known::default(), Joined::default());
    for input in inputs {
        let Named { path, stream } = input?;
        known.paths.push(path.clone());
        for job in StreamedGroups::new(stream, FrameRange::default()) {
            let job = job.and_then(|job| known.add(&job).map(|()| job)).map_err(|e| e.at(&path))?;
            joined.frames += job.group.frames.len() as u64;
            copier.write(&job)?;
        }
        joined.streams += 1;
    }
    joined.stream_bytes = copier.finish()?;
    Ok(joined)
}

/// The streams so far, and the names of their frames.
#[derive(Default)]
struct Known {
    /// The paths of the streams.
    paths: Vec<PathBuf>,
    /// The names, each with the index of its stream and the frame's number there.
    names: FileNames<(usize, u64)>,
}

impl Known {
    /// Adds the names of a group of the last stream.
    ///
    /// # Errors
    /// If no decoder could write one of the files beside those before.
    fn add(&mut self, job: &GroupJob) -> Result<()> {
        let stream = self.paths.len() - 1;
        let frames = (job.first_frame..).zip(&job.group.frames);
        for (number, frame) in frames.filter(|(_, frame)| frame.header.names_file()) {
            let name = &frame.header.name;
            let conflict = match self.names.add(name, (stream, number)) {
                Ok(()) => continue,
                Err(NameConflict::SameName((other, first))) => {
                    format!("has the same name as frame {first} of {}", self.paths[other].display())
                }
                Err(NameConflict::FileAndFolder) => "needs a file and a folder of one name".to_owned(),
            };
            return Err(Error::Usage(format!(
                "frame {number} ({name:?}) {conflict}; leave one out by `lidarpc cut`, or keep the streams apart"
            )));
        }
        Ok(())
    }
}

//! Joins streams into one, copying their groups as they are.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::io::{Read, Write};
use std::path::PathBuf;

use super::copier::{GroupCopier, Named};
use crate::container::StreamReader;
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
/// Naming the stream: if it cannot be read or is damaged, or if it holds a frame with the same name as an
/// earlier one, which no decoder could write into the same folder. Without a name: if the output fails. The
/// output is not a complete stream then.
pub fn cat<R: Read>(
    inputs: impl IntoIterator<Item = Result<Named<StreamReader<R>>>>,
    out: impl Write,
) -> Result<Joined> {
    let mut copier = GroupCopier::create(out)?;
    let (mut names, mut joined) = (Names::default(), Joined::default());
    for input in inputs {
        let Named { path, stream } = input?;
        names.paths.push(path.clone());
        for job in StreamedGroups::new(stream, FrameRange::default()) {
            let job = job.and_then(|job| names.check(&job).map(|()| job)).map_err(|e| e.at(&path))?;
            joined.frames += job.group.frames.len() as u64;
            copier.write(&job)?;
        }
        joined.streams += 1;
    }
    joined.stream_bytes = copier.finish()?;
    Ok(joined)
}

/// The names of the frames so far.
#[derive(Default)]
struct Names {
    /// The paths of the streams.
    paths: Vec<PathBuf>,
    /// For each name, the index of its stream and the frame's number there.
    places: HashMap<String, (usize, u64)>,
}

impl Names {
    /// Adds the names of a group of the last stream, if they are new.
    fn check(&mut self, job: &GroupJob) -> Result<()> {
        let stream = self.paths.len() - 1;
        // Points in memory need no name, and empty names do not conflict.
        let frames = (job.first_frame..).zip(&job.group.frames);
        for (number, frame) in frames.filter(|(_, frame)| !frame.header.name.is_empty()) {
            match self.places.entry(frame.header.name.clone()) {
                Entry::Vacant(free) => drop(free.insert((stream, number))),
                Entry::Occupied(taken) => {
                    let (other, first) = *taken.get();
                    let (name, other) = (&frame.header.name, self.paths[other].display());
                    let what = format!(
                        "frame {number} ({name:?}) has the same name as frame {first} of {other}; \
                         leave one out by `lidarpc cut`, or keep the streams apart"
                    );
                    return Err(Error::Usage(what));
                }
            }
        }
        Ok(())
    }
}

//! The frames to encode, and warnings about unusual ones before they are encoded: users who archive a folder
//! should know.

use std::collections::HashMap;
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use crate::backend;
use crate::files::sequence::{FoundFile, LeftOut, advice_on_recording, find_all, find_frames};
use crate::files::{EXTENSIONS, parse_like, starts_as_scan};
use crate::frame::Prediction;
use crate::frame::settings::{Coder, EncoderConfig, PredictionChoice, ProjectionKind};
use crate::ground::error::one_line;
use crate::stream::{self, DecodeOptions, DecodedFrame, EncodeStatistics, FrameInput};
use crate::study::metrics::{self, nearest_distances};
use anyhow::{Result, bail, ensure};

use super::args::EncodeArgs;
use super::console::{Console, to_stderr};
use super::errors::about;
use super::input::is_stream;
use super::output::keep_inputs;
use super::record_length::{self, Sample, Verdict};
use super::{partial, readable};

/// The files to encode.
#[derive(Default)]
pub struct InputFiles {
    /// The scans, drive by drive.
    pub frames: Vec<FoundFile>,
    /// The files beside them that are stored.
    pub beside: Vec<FoundFile>,
    /// The contents of their folders that are not stored.
    pub left_out: LeftOut,
}

impl InputFiles {
    /// The inputs of the encoder.
    pub fn inputs(&self) -> Vec<FrameInput> {
        let mut inputs = FrameInput::from_files(self.frames.iter().cloned());
        // Separate from the scans, which have scanners.
        let drive = inputs.last().map_or(0, |last| last.drive() + 1);
        let beside = self.beside.iter().cloned();
        inputs.extend(beside.map(|file| FrameInput::beside(file.path, file.name).of_drive(drive)));
        inputs
    }

    /// Deletes the files, and the folders that this leaves empty, up to these inputs, and tells how many files
    /// of `place`. A file that is write-protected, or no longer what was `encoded`, is kept.
    ///
    /// # Errors
    /// If a file cannot be read or deleted, or if it was kept.
    pub fn delete(
        &self,
        inputs: &[PathBuf],
        encoded: &EncodeStatistics,
        (place, console): (&str, Console),
    ) -> Result<()> {
        let known = encoded.frames.iter().map(|frame| (&frame.name[..], (frame.file_size, frame.file_crc)));
        let known: HashMap<&str, (u64, u32)> = known.collect();
        let (mut deleted, mut kept) = (0, None);
        for FoundFile { path, name, .. } in self.frames.iter().chain(&self.beside) {
            let at = |error: io::Error| about(error.into(), &path.display().to_string());
            let bytes = if path.is_dir() { Vec::new() } else { fs::read(path).map_err(at)? };
            if known.get(&name[..]) != Some(&(bytes.len() as u64, crc32c::crc32c(&bytes))) {
                kept.get_or_insert((path, "changed after it was encoded, so it is kept; encode it again"));
                continue;
            }
            // Where the system does not refuse, as to its administrator.
            if fs::symlink_metadata(path).map_err(at)?.permissions().readonly() {
                kept.get_or_insert((path, "is write-protected, so it is kept; delete it by other means"));
                continue;
            }
            let removed = if path.is_dir() { fs::remove_dir(path) } else { fs::remove_file(path) };
            removed.map_err(at)?;
            deleted += 1;
            let above = path.ancestors().skip(1);
            let above = above.take_while(|above| inputs.iter().any(|input| above.starts_with(input)));
            // Folders that are not empty remain.
            above.take_while(|above| fs::remove_dir(above).is_ok()).for_each(drop);
        }
        console.say(format_args!("lidarpc: {place}: deleted {}", readable::count(deleted, "file")));
        kept.map_or(Ok(()), |(path, what)| bail!("{}: {what}", path.display()))
    }
}

/// Finds the files, and reports what is left out.
///
/// # Errors
/// If there is no scan, or if an explicitly named file is not a scan or would be overwritten; with
/// `--strict`, if anything is left out.
pub fn find(args: &EncodeArgs, console: Console) -> Result<InputFiles> {
    let mut found = if args.all { find_all(&args.inputs)? } else { find_frames(&args.inputs)? };
    if !args.force_bytes {
        args.inputs.iter().filter(|input| input.is_file()).try_for_each(|input| check_scan(input))?;
    }
    let mut inputs = found.paths();
    // A stream at the output path is an earlier output of this program; any other file is an input.
    if !is_stream(args.output()) {
        inputs.extend(found.beside.iter().map(|file| file.path.clone()));
    }
    keep_inputs(args.output(), &inputs)?;
    let own = partial::outputs(args.output()).map(|path| fs::canonicalize(path).ok());
    // The output may be a folder of streams in one of the inputs, but not a parent folder of one.
    let holds_input = |own: &Path| {
        args.inputs.iter().any(|input| fs::canonicalize(input).is_ok_and(|input| input.starts_with(own)))
    };
    let own: Vec<_> = own.into_iter().flatten().filter(|own| !holds_input(own)).collect();
    let is_own =
        |path: &Path| fs::canonicalize(path).is_ok_and(|path| own.iter().any(|own| path.starts_with(own)));
    found.beside.retain(|file| !is_own(&file.path));
    let mut left_out = LeftOut::default();
    for (kind, path) in found.left_out {
        if !is_own(&path) {
            // Links and unreadable files have no size of their own.
            let bytes =
                fs::symlink_metadata(&path).ok().filter(fs::Metadata::is_file).map_or(0, |about| about.len());
            if args.verbose {
                to_stderr(format_args!("lidarpc: left out {} {}", kind.name(), one_line(path.display())));
            }
            left_out.add(kind, path.display().to_string(), bytes);
        }
    }
    check_left_out(&left_out, &name_of_inputs(&args.inputs), args.strict, console)?;
    for list in &found.unmatched_lists {
        let list = one_line(list.display());
        console.say(format_args!(
            "lidarpc: {list}: has no time for each scan of its folder, so its times are not stored; it needs a line \
             a scan, each a date or a number of seconds"
        ));
    }
    Ok(InputFiles { frames: found.frames, beside: found.beside, left_out })
}

/// The name of several inputs in messages.
pub fn name_of_inputs(inputs: &[PathBuf]) -> String {
    match inputs {
        [input] => input.display().to_string(),
        _ => "inputs".to_owned(),
    }
}

/// Completes the settings according to the scans, and warns about anything unusual in them. `input`: their
/// name in messages.
///
/// # Errors
/// If a scan cannot be read.
pub fn settle(frames: &[FoundFile], config: &mut EncoderConfig, input: &str, console: Console) -> Result<()> {
    settle_layout(frames, config, input, console)?;
    let first = frames.first().cloned();
    if let Some(warning) =
        FrameInput::from_files(first).first().and_then(|first| loss_of_paper_mode(first, config))
    {
        console.say(format_args!("lidarpc: {input}: {warning}"));
    }
    Ok(())
}

/// As [`settle`], for the layout of `.bin` records only.
///
/// # Errors
/// If a scan cannot be read.
pub fn settle_layout(
    frames: &[FoundFile],
    config: &mut EncoderConfig,
    input: &str,
    console: Console,
) -> Result<()> {
    match record_length::examine(&samples(frames)?, config.headerless.as_ref()) {
        Verdict::Agrees => {}
        Verdict::Rather(layout) => {
            let letters = layout.to_string();
            let bytes = 4 * letters.len();
            let (says, advice) = match &config.headerless {
                None => ("taken as", "name the fields by --layout, or take KITTI's by --layout xyzi"),
                Some(_) => ("which would be", "leave that out, or give the right one"),
            };
            let given = config
                .headerless
                .as_ref()
                .map_or(String::new(), |given| format!(", not as --layout {given} has it"));
            console.say(format_args!(
                "lidarpc: {input}: .bin files look like records of {bytes} bytes{given}, {says} --layout {letters}; \
                 {advice}"
            ));
            config.headerless.get_or_insert(layout);
        }
        Verdict::NoFloats => {
            let come_back = if config.is_exact() { "they come back exactly, but if" } else { "if" };
            console.say(format_args!(
                "lidarpc: {input}: .bin files do not look like float32 x, y, z, intensity; {come_back} --layout says \
                 what they hold, they may get smaller"
            ));
        }
        Verdict::OtherLength(bytes) => console.say(format_args!(
            "lidarpc: {input}: .bin files are no whole number of records of {bytes} bytes, as --layout has them; \
             give the right layout, or none"
        )),
    }
    Ok(())
}

/// Reports in one line what will not be restored.
///
/// # Errors
/// If `strict`.
pub fn check_left_out(left_out: &LeftOut, input: &str, strict: bool, console: Console) -> Result<()> {
    if left_out.is_empty() {
        return Ok(());
    }
    let what = one_line(left_out);
    if strict {
        bail!("{input}: holds what would not come back: {what}; move it away, or encode without --strict");
    }
    console.say(format_args!("lidarpc: {input}: left out {what}"));
    Ok(())
}

/// Rejects an explicitly named file that is not a scan: it would be stored as bytes, and compressed no better
/// than by other programs.
fn check_scan(path: &Path) -> Result<()> {
    /// Upper limit of the size of a header, in bytes.
    const HEADER: u64 = 1 << 20;
    let start = start_of(path, HEADER)?;
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    if let Some(advice) = advice_on_recording(path) {
        bail!("{}: {advice}", path.display());
    }
    let what = match is_stream(path) {
        true => "is a lidarpc stream already".to_owned(),
        false => format!("holds no scan that is known ({EXTENSIONS})"),
    };
    ensure!(
        starts_as_scan(&name, &start),
        "{}: {what}; --force-bytes takes it as plain bytes",
        path.display()
    );
    Ok(())
}

fn start_of(path: &Path, most: u64) -> Result<Vec<u8>> {
    let mut start = Vec::new();
    let read = File::open(path).and_then(|file| file.take(most).read_to_end(&mut start));
    read.map_err(|error: io::Error| about(error.into(), &path.display().to_string()))?;
    Ok(start)
}

/// The parts of a few files from which the record length can be estimated.
fn samples(frames: &[FoundFile]) -> Result<Vec<Sample>> {
    let mut places = vec![0, frames.len() / 2, frames.len().saturating_sub(1)];
    places.dedup();
    let mut samples = Vec::new();
    for FoundFile { path, .. } in places.into_iter().filter_map(|place| frames.get(place)) {
        let size =
            fs::metadata(path).map_err(|error| about(error.into(), &path.display().to_string()))?.len();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        samples.push(Sample { name, start: start_of(path, record_length::SAMPLE)?, size });
    }
    Ok(samples)
}

/// A warning about the effect of paper mode's ideal range image on a frame of another scanner than the
/// HDL-64E, if the effect is large.
fn loss_of_paper_mode(frame: &FrameInput, config: &EncoderConfig) -> Option<String> {
    /// For an HDL-64E, one point in six is lost, and the others move by at most 0.25 m.
    const MOST_DROPPED: f64 = 0.25;
    const FARTHEST_M: f64 = 0.5;
    if !matches!(config.projection, ProjectionKind::Ideal { .. }) {
        return None;
    }
    // Neither depends on how the image is coded.
    let quick = EncoderConfig {
        prediction: PredictionChoice::Always(Prediction::None),
        coder: Coder::Backend(backend::ZSTD),
        ..config.clone()
    };
    let (mut coded, mut decoded) = (Vec::new(), None);
    let keep = |frame: DecodedFrame| {
        decoded = Some(frame);
        Ok(())
    };
    // Errors will be reported when the frame is encoded.
    stream::encode(std::slice::from_ref(frame), &quick, &mut coded, &|| ()).ok()?;
    stream::decode(&coded[..], &DecodeOptions::default(), DecodedFrame::checked, keep).ok()?;
    let decoded = decoded?;
    let original = parse_like(&decoded.scan, &decoded.scan.name, frame.read().ok()?);
    let source = decoded.source?;
    let dropped = metrics::ratio(source.points, source.outliers + source.lost)?;
    let distances = nearest_distances(&original.cloud, &decoded.scan.cloud);
    let farthest = distances.into_iter().flatten().fold(0.0, f64::max);
    (dropped > MOST_DROPPED || farthest > FARTHEST_M).then(|| {
        format!(
            "paper mode does not suit this scanner: of the first frame it drops {} of the points and moves others by up \
             to {farthest:.2} m; --max-error keeps every point",
            readable::percent(Some(dropped)),
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::container::FrameHeader;

    #[test]
    fn a_file_that_changed_after_it_was_encoded_is_not_deleted() {
        let folder = tempfile::tempdir().unwrap();
        let (mut files, mut encoded) = (InputFiles::default(), EncodeStatistics::default());
        for name in ["1.bin", "2.bin", "3.bin"] {
            let path = folder.path().join(name);
            fs::write(&path, name).unwrap();
            files.frames.push(FoundFile { path, name: name.to_owned(), ..FoundFile::default() });
            encoded.frames.push(FrameHeader::of(name, name.as_bytes(), 0));
        }
        fs::write(folder.path().join("2.bin"), "4.bin").unwrap();
        let refused = files
            .delete(&[folder.path().to_path_buf()], &encoded, ("seq", Console::SILENT))
            .unwrap_err()
            .to_string();
        assert!(refused.contains("2.bin: changed after it was encoded"), "{refused}");
        let left = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name());
        assert_eq!(left.collect::<Vec<_>>(), ["2.bin"]);
    }
}

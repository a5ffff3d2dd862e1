//! `lidarpc view`

mod page;
mod pictures;

use std::io::{Cursor, Read, Seek, SeekFrom, Write};
use std::path::Path;

use crate::files::sequence::find_frames;
use crate::files::{parse_like, rounded_by_file};
use crate::frame::settings::EncoderConfig;
use crate::ground::error::Error;
use crate::library::Decoder;
use crate::stream::{self, DecodeOptions, DecodedFrame, FrameInput, FrameRange};
use crate::study::metrics::{nearest_distances, paired_distances};
use crate::study::picture::{self, BirdsEye, Perspective, Picture};
use anyhow::{Context, Result, ensure};

use super::args::{PictureKind, ViewArgs, encoder_config, wrong_usage};
use super::console::Console;
use super::encoding::encode_in_memory;
use super::errors::about;
use super::input::{Originals, is_stream, name_of, open, refuse_recordings};
use super::output::{FileOutput, about_output, keep_inputs, name_of_output};
use pictures::{PICTURES, Pictures};

pub fn run(args: &ViewArgs, console: Console) -> Result<()> {
    let input = std::slice::from_ref(&args.input);
    refuse_recordings("view", input, "encode its clouds to FILE.lpc, and view that");
    match (&args.html, &args.output) {
        (Some(page), _) => write_page(args, page, console),
        (None, Some(picture)) => write_picture(args, picture),
        (None, None) => wrong_usage("view", "-o names the picture to write, --html the page"),
    }
}

/// Writes a frame as a picture.
fn write_picture(args: &ViewArgs, path: &Path) -> Result<()> {
    if path.extension().is_some_and(|extension| !extension.eq_ignore_ascii_case("png")) {
        wrong_usage("view", "pictures are PNG; give -o a name that ends in .png");
    }
    keep_inputs(path, std::slice::from_ref(&args.input))?;
    let config = encoder_config("view", &args.coding, 1);
    let picture = draw(args, &decode(args, &config)?, &config)?;
    let mut output = FileOutput::binary(path, args.force)?;
    let mut writer = output.writer();
    let written = writer.write_all(&picture.to_png()?).and_then(|()| writer.flush());
    drop(writer);
    written.map_err(|error| about_output(error.into(), path))?;
    output.finish().map_err(|error| about(error, &name_of_output(path)))
}

/// Writes the frames as a page.
fn write_page(args: &ViewArgs, path: &Path, console: Console) -> Result<()> {
    keep_inputs(path, std::slice::from_ref(&args.input))?;
    let name = name_of(&args.input);
    if is_stream(&args.input) {
        let stream = open(&args.input)?.rewindable().map_err(|error| about(error, &name))?;
        return page_of(args, path, (stream, &name), console);
    }
    let config = encoder_config("view", &args.coding, 0);
    let frames = FrameInput::from_files(find_frames(std::slice::from_ref(&args.input))?.frames);
    let (_, stream) = encode_in_memory(&frames, &config, console)?;
    page_of(args, path, (Cursor::new(stream), &name), console)
}

fn page_of<R: Read + Seek + Send>(
    args: &ViewArgs,
    path: &Path,
    (mut stream, name): (R, &str),
    console: Console,
) -> Result<()> {
    let bytes = stream.seek(SeekFrom::End(0))?;
    let decoder = Decoder::open(stream).map_err(|error| about(error, name))?;
    let mut decoder = decoder.with_range_images(true).with_threads(0);
    let frames = args.frames.unwrap_or_default();
    frames.check(decoder.len()).map_err(|error| about(error, name))?;
    let numbers = frames.start..frames.end.unwrap_or(decoder.len());
    let mut output = FileOutput::create(path, args.force)?;
    let bar = console.bar(Some(numbers.end - numbers.start), "decoding");
    let mut writer = output.writer();
    let written = page::write(&mut decoder, (name, bytes), numbers, &mut writer, || bar.inc(1));
    bar.finish_and_clear();
    let written = written.and_then(|()| Ok(writer.flush()?));
    drop(writer);
    written.map_err(|error| about_output(error, path))?;
    output.finish().map_err(|error| about(error, &name_of_output(path)))
}

/// A frame, and its original file, if known.
struct Compared {
    frame: DecodedFrame,
    original: Option<Vec<u8>>,
}

/// The selected frame.
fn decode(args: &ViewArgs, config: &EncoderConfig) -> Result<Compared> {
    let name = name_of(&args.input);
    let only = |number: u64| FrameRange { start: number, end: number.checked_add(1) };
    let (frame, mut original) = if is_stream(&args.input) {
        let stream = open(&args.input)?.rewindable().map_err(|error| about(error, &name))?;
        (decode_one(stream, only(args.frame)), None)
    } else {
        let frames = find_frames(std::slice::from_ref(&args.input))?.frames;
        only(args.frame).check(frames.len() as u64).map_err(|error| about(error, &name))?;
        let frame = FrameInput::from_files(frames)
            .into_iter()
            .nth(args.frame as usize)
            .map(|frame| frame.of_drive(0));
        let (_, stream) = encode_in_memory(frame.as_slice(), config, Console::SILENT)?;
        (decode_one(Cursor::new(stream), only(0)), frame.map(|frame| frame.read()).transpose()?)
    };
    let frame = frame.map_err(|error| about(error, &name))?;
    if !args.against.is_empty() {
        original = Some(Originals::find(&args.against)?.take(&frame.header.name)?);
    }
    Ok(Compared { frame, original })
}

fn decode_one(
    stream: impl Read + Seek + Send,
    frames: FrameRange,
) -> crate::ground::error::Result<DecodedFrame> {
    let options = DecodeOptions { frames, images: true, ..DecodeOptions::default() };
    let mut found = None;
    stream::decode_indexed(stream, &options, DecodedFrame::checked, |frame| {
        found = Some(frame);
        Ok(())
    })?;
    found.ok_or_else(|| Error::corrupt("the frame is missing"))
}

impl Compared {
    /// The distance of each point of the file from the original, in metres, if known.
    fn errors(&self) -> Option<Vec<Option<f64>>> {
        let rounded = rounded_by_file(&self.frame.scan, self.frame.to_bytes().ok()?);
        let decoded = rounded.as_ref().unwrap_or(&self.frame.scan);
        let original = parse_like(decoded, &decoded.name, self.original.clone()?);
        let measure = if self.frame.keeps_order { paired_distances } else { nearest_distances };
        Some(measure(&original.cloud, &decoded.cloud))
    }
}

fn draw(args: &ViewArgs, compared: &Compared, config: &EncoderConfig) -> Result<Picture> {
    let frame = &compared.frame;
    let name = &frame.header.name;
    let positions = &frame.scan.cloud.positions;
    ensure!(!positions.is_empty(), "{name}: has no points to draw; choose another frame by --frame");
    match args.kind {
        PictureKind::BirdsEye => return Ok(BirdsEye::default().draw(positions)),
        PictureKind::Perspective => return Ok(Perspective::default().draw(positions)),
        // Without a range image this is the only possible picture, unless another one was requested.
        PictureKind::All if frame.image.is_none() => return Ok(BirdsEye::default().draw(positions)),
        _ => {}
    }
    let none = || format!("{name}: has no range image; --kind birds-eye shows its points");
    let image = frame.image.as_ref().with_context(none)?;
    let pictures = Pictures::of(image, compared.errors().as_deref(), config, args.scale);
    if args.kind == PictureKind::Overview {
        let range = pictures.draw(PictureKind::Range).with_context(none)?;
        // As wide as the range image.
        let size = [range.width(), range.width() * 2 / 5];
        let points = Perspective { size, ..Perspective::default() }.draw(positions);
        return Ok(picture::stack(&[("range, m", range), ("height, m", points)]));
    }
    if args.kind != PictureKind::All {
        let unknown = || format!("{name}: the original is not known; give it by --against FOLDER");
        return pictures.draw(args.kind).with_context(unknown);
    }
    let titled = PICTURES.iter().filter_map(|&(kind, title)| Some((title, pictures.draw(kind)?)));
    Ok(picture::stack(&titled.collect::<Vec<_>>()))
}

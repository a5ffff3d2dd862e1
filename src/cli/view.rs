//! `lidarpc view`

mod pictures;

use std::io::{Cursor, Read, Seek, Write};

use anyhow::{Context, Result};
use lidarpc::codec::{self, DecodeOptions, DecodedFrame, EncoderConfig, FrameInput, FrameRange};
use lidarpc::error::Error;
use lidarpc::io::sequence::find_frames;
use lidarpc::picture::{self, BirdsEye, Picture};

use super::args::{Threads, ViewArgs};
use super::errors::about;
use super::input::{name_of, open};
use super::output::FileOutput;
use super::{coding, in_memory};

pub use pictures::Kind;
use pictures::{PICTURES, Pictures};

pub fn run(args: &ViewArgs) -> Result<()> {
    let config = coding::config(&args.coding, &Threads { threads: 1 });
    let picture = draw(args, decode(args, &config)?, &config)?;
    let mut output = FileOutput::create(&args.output, args.force)?;
    let mut writer = output.writer();
    writer.write_all(&picture.to_png()?)?;
    writer.flush()?;
    drop(writer);
    output.finish()?;
    Ok(())
}

/// The frame that is asked for.
fn decode(args: &ViewArgs, config: &EncoderConfig) -> Result<DecodedFrame> {
    let name = name_of(&args.input);
    let only = |number: u64| FrameRange { start: number, end: number.checked_add(1) };
    let frame = if in_memory::is_stream(&args.input) {
        let stream = open(&args.input)?.rewindable().map_err(|error| about(error, &name))?;
        decode_one(stream, only(args.frame))
    } else {
        let frames = find_frames(std::slice::from_ref(&args.input))?.frames;
        only(args.frame).check(frames.len() as u64).map_err(|error| about(error, &name))?;
        let frame = frames.into_iter().nth(args.frame as usize).map(FrameInput::File);
        let (_, stream) = in_memory::encode(frame.as_slice(), config, true)?;
        decode_one(Cursor::new(stream), only(0))
    };
    frame.map_err(|error| about(error, &name))
}

fn decode_one(stream: impl Read + Seek, frames: FrameRange) -> lidarpc::error::Result<DecodedFrame> {
    let options = DecodeOptions { frames, images: true, scans: true, ..DecodeOptions::default() };
    let mut found = None;
    codec::decode_indexed(stream, &options, |frame| {
        found = Some(frame);
        Ok(())
    })?;
    found.ok_or_else(|| Error::corrupt("the frame is missing"))
}

fn draw(args: &ViewArgs, frame: DecodedFrame, config: &EncoderConfig) -> Result<Picture> {
    if args.kind == Kind::BirdsEye {
        let points = frame.scan.unwrap_or_default().cloud.positions;
        return Ok(BirdsEye::default().draw(&points));
    }
    let none = || format!("{}: has no range image; --kind birds-eye shows its points", frame.header.name);
    let pictures = Pictures::of(frame.image.as_ref().with_context(none)?, config, args.scale);
    if args.kind != Kind::All {
        return Ok(pictures.draw(args.kind));
    }
    let titled: Vec<_> = PICTURES.iter().map(|&(kind, title)| (title, pictures.draw(kind))).collect();
    Ok(picture::stack(&titled))
}

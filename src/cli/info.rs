//! `lidarpc info`

use std::collections::{BTreeMap, HashMap};
use std::io::{self, Read, Write};

use crate::container::{FrameKind, Index, Record, ScannerId, Stamp, StreamReader};
use crate::frame::FrameParameters;
use crate::ground::error::{Error, Limits};
use crate::stream::source::StoredScanner;
use anyhow::Result;
use serde::Serialize;

use super::args::InfoArgs;
use super::console::Console;
use super::errors::about;
use super::input::{for_each_file, is_recording, name_of, open, with_folders_searched};
use super::output::print_json;
use super::{readable, recording};

/// The contents of a stream.
#[derive(Default, Serialize)]
struct Info {
    file: String,
    version: u16,
    flags: u16,
    stream_bytes: u64,
    file_bytes: u64,
    points: u64,
    scanners: Vec<ScannerInfo>,
    groups: Vec<GroupInfo>,
    frames: Vec<FrameInfo>,
    /// The damage after everything listed here, if there is any.
    #[serde(skip_serializing_if = "Option::is_none")]
    damage: Option<String>,
    /// The numbers of the scanners.
    #[serde(skip)]
    numbers: HashMap<ScannerId, u64>,
}

#[derive(Serialize)]
struct ScannerInfo {
    family: u64,
    /// The description of the scanner in words.
    description: String,
    bytes: u64,
}

#[derive(Serialize)]
struct GroupInfo {
    offset: u64,
    bytes: u64,
    first_frame: u64,
    frames: u64,
    /// The number of each track's scanner, from 1 on; 0: none.
    scanners: Vec<u64>,
}

#[derive(Serialize)]
struct FrameInfo {
    number: u64,
    name: String,
    kind: &'static str,
    /// Index of its track in the group.
    track: u8,
    /// Nanoseconds since 1970.
    #[serde(skip_serializing_if = "Option::is_none")]
    time: Option<i64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    time_source: Option<&'static str>,
    points: u64,
    file_bytes: u64,
    file_crc32c: String,
    coded_bytes: u64,
    /// A short form of how it is coded.
    coding: String,
    /// Names of the sections.
    sections: Vec<&'static str>,
}

/// The contents of a file.
#[derive(Serialize)]
#[serde(untagged)]
enum Listed {
    Stream(Info),
    Recording(recording::Listing),
}

pub fn run(args: &InfoArgs) -> Result<()> {
    let inputs = with_folders_searched(&args.inputs)?;
    let is_one = inputs.len() == 1 && inputs == args.inputs;
    let mut infos = Vec::new();
    let mut out = io::BufWriter::new(io::stdout().lock());
    let read = for_each_file("info", &inputs, |path| {
        let (info, damage) = match is_recording(path) {
            true => {
                let listing = recording::examine(path, None, 1, Console::SILENT)?;
                let damage = listing.check().err();
                (Listed::Recording(listing), damage)
            }
            false => {
                let info = Info::read(name_of(path), open(path)?.reader(), args.limits.limits());
                let (info, damage) = info.map_err(|error| about(error, &name_of(path)))?;
                (Listed::Stream(info), damage.map(|error| about(error, &name_of(path))))
            }
        };
        if !args.json {
            if !is_one {
                let before = if infos.is_empty() { "" } else { "\n" };
                writeln!(out, "{before}{}:", name_of(path).escape_debug())?;
            }
            match &info {
                Listed::Stream(info) => print(info, &mut out)?,
                Listed::Recording(contents) => recording::print(contents, &mut out)?,
            }
            out.flush()?;
        }
        infos.push(info);
        damage.map_or(Ok(()), Err)
    });
    drop(out);
    if args.json {
        match &infos[..] {
            [] => {}
            [info] if is_one => print_json(info)?,
            infos => print_json(&infos)?,
        }
    }
    read
}

impl Info {
    /// Reads a stream. Of a damaged one, returns the contents before the damage, and the error.
    fn read(
        file: String,
        input: impl Read,
        limits: Limits,
    ) -> crate::ground::error::Result<(Self, Option<Error>)> {
        let mut reader = StreamReader::open(input, limits)?;
        let mut info =
            Info { file, version: reader.header().version, flags: reader.header().flags, ..Info::default() };
        let damage = loop {
            match reader.next_record() {
                Ok(Some(record)) => {
                    if let Err(error) = info.add(record, reader.index()) {
                        break Some(error);
                    }
                }
                Ok(None) => break None,
                Err(error) => break Some(error),
            }
        };
        info.stream_bytes = reader.position();
        info.file_bytes = info.frames.iter().map(|frame| frame.file_bytes).sum();
        info.points = info.frames.iter().map(|frame| frame.points).sum();
        info.damage = damage.as_ref().map(ToString::to_string);
        Ok((info, damage))
    }

    fn add(&mut self, record: Record, index: &Index) -> crate::ground::error::Result<()> {
        match record {
            Record::Scanner(record) => {
                self.numbers.insert(record.id(), self.numbers.len() as u64 + 1);
                let (family, bytes) = (record.family, record.payload.len() as u64);
                let description = StoredScanner::parse(record)?.description();
                self.scanners.push(ScannerInfo { family, description, bytes });
            }
            Record::Group(group) => {
                let Some(entry) = index.groups.last() else { return Ok(()) };
                let mut frames = Vec::new();
                for ((number, frame), entry) in (entry.first_frame..).zip(group.frames).zip(&entry.frames) {
                    let Stamp { kind, track, time } = entry.stamp;
                    let parameters = FrameParameters::of(&frame);
                    let parameters = parameters.map_err(|e| e.within_frame(number, &frame.header.name))?;
                    frames.push(FrameInfo {
                        coding: parameters.to_string(),
                        number,
                        kind: kind.name(),
                        track,
                        time: time.map(|time| time.nanoseconds),
                        time_source: time.map(|time| time.source.name()),
                        points: frame.header.point_count,
                        file_bytes: frame.header.file_size,
                        file_crc32c: format!("{:08x}", frame.header.file_crc),
                        name: frame.header.name,
                        coded_bytes: entry.size,
                        sections: frame.sections.iter().map(|section| section.kind.name()).collect(),
                    });
                }
                self.groups.push(GroupInfo {
                    offset: entry.offset,
                    bytes: entry.length,
                    first_frame: entry.first_frame,
                    frames: frames.len() as u64,
                    // The reader returns no group before its scanners.
                    scanners: group.scanners.iter().map(|id| id.map_or(0, |id| self.numbers[&id])).collect(),
                });
                self.frames.extend(frames);
            }
        }
        Ok(())
    }
}

fn print(info: &Info, out: &mut impl Write) -> io::Result<()> {
    let scanners = readable::count(info.scanners.len() as u64, "scanner");
    let groups = info.groups.len() as u64;
    let beside = info.frames.iter().filter(|frame| frame.kind == FrameKind::Beside.name()).count() as u64;
    let frames = info.frames.len() as u64 - beside;
    writeln!(out, "format version {}, {scanners}", info.version)?;
    for (number, scanner) in (1..).zip(&info.scanners) {
        writeln!(out, "scanner {number}: {}", scanner.description)?;
    }
    if info.damage.is_some() {
        writeln!(out, "damaged behind byte {}; of what stands before:", info.stream_bytes)?;
    }
    let beside = match beside {
        0 => String::new(),
        files => format!(" and {} beside the scans", readable::count(files, "file")),
    };
    writeln!(out, "{}{beside} in {}", readable::count(frames, "frame"), readable::count(groups, "group"))?;
    let (points, files) = (info.points, readable::bytes(info.file_bytes));
    writeln!(
        out,
        "{} in {files}, coded in {}",
        readable::count(points, "point"),
        readable::bytes(info.stream_bytes)
    )?;
    let mut codings = BTreeMap::<_, u64>::new();
    info.frames.iter().for_each(|frame| *codings.entry(&frame.coding).or_default() += 1);
    for (coding, frames) in codings {
        writeln!(out, "{}: {coding}", readable::count(frames, "frame"))?;
    }
    writeln!(out)?;
    writeln!(
        out,
        "{:>7} {:>6} {:>10} {:>12} {:>12}  name",
        "frame", "group", "points", "file bytes", "coded bytes"
    )?;
    for (place, group) in info.groups.iter().enumerate() {
        let first = group.first_frame as usize;
        for frame in &info.frames[first..first + group.frames as usize] {
            let FrameInfo { number, points, file_bytes, coded_bytes, name, .. } = frame;
            let name = name.escape_debug();
            writeln!(out, "{number:>7} {place:>6} {points:>10} {file_bytes:>12} {coded_bytes:>12}  {name}")?;
        }
    }
    Ok(())
}

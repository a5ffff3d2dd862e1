//! `lidarpc info`

use std::collections::{BTreeMap, HashMap};
use std::io::{self, Read, Write};

use crate::frame::FrameParameters;
use crate::ground::error::Limits;
use crate::scanner::Scanner;
use crate::stream::container::{Record, ScannerRecord, Stamp, StreamReader};
use anyhow::Result;
use serde::Serialize;

use super::args::InfoArgs;
use super::errors::about;
use super::input::{name_of, open};
use super::table;

/// What a stream holds.
#[derive(Serialize)]
struct Info {
    version: u16,
    flags: u16,
    stream_bytes: u64,
    file_bytes: u64,
    points: u64,
    scanners: Vec<ScannerInfo>,
    groups: Vec<GroupInfo>,
    frames: Vec<FrameInfo>,
}

#[derive(Serialize)]
struct ScannerInfo {
    family: u64,
    /// What was found of it, in words.
    description: String,
    bytes: u64,
}

#[derive(Serialize)]
struct GroupInfo {
    offset: u64,
    bytes: u64,
    first_frame: u64,
    frames: u64,
    /// Of each stream, its number among the scanners, from 1 on; 0: none.
    scanners: Vec<u64>,
}

#[derive(Serialize)]
struct FrameInfo {
    number: u64,
    name: String,
    unit: &'static str,
    /// Its place among the streams of the group.
    stream: u8,
    /// Nanoseconds since 1970.
    #[serde(skip_serializing_if = "Option::is_none")]
    time: Option<i64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    time_source: Option<&'static str>,
    points: u64,
    file_bytes: u64,
    file_crc32c: String,
    coded_bytes: u64,
    /// How it is coded, in short.
    coding: String,
    /// Names of the sections.
    sections: Vec<&'static str>,
}

pub fn run(args: &InfoArgs) -> Result<()> {
    let info = read(open(&args.input)?.reader(), args.limits.limits());
    let info = info.map_err(|error| about(error, &name_of(&args.input)))?;
    let mut out = io::BufWriter::new(io::stdout().lock());
    if args.json {
        serde_json::to_writer_pretty(&mut out, &info).map_err(io::Error::from)?;
        writeln!(out)?;
    } else {
        print(&info, &mut out)?;
    }
    out.flush()?;
    Ok(())
}

fn read(input: impl Read, limits: Limits) -> crate::ground::error::Result<Info> {
    let mut reader = StreamReader::open(input, limits)?;
    // The reader passes no group of a scanner that has not come.
    let mut numbers = HashMap::new();
    let (mut scanners, mut groups, mut frames) = (Vec::new(), Vec::new(), Vec::new());
    while let Some(record) = reader.next_record()? {
        match record {
            Record::Scanner(record) => {
                numbers.insert(record.id(), numbers.len() as u64 + 1);
                let ScannerRecord { family, payload } = record;
                let known = Scanner::of_record(family, &payload)?;
                let description =
                    known.map_or_else(|| format!("of family {family}"), |known| known.to_string());
                scanners.push(ScannerInfo { family, description, bytes: payload.len() as u64 });
            }
            Record::Group(group) => {
                let Some(entry) = reader.index().groups.last() else { continue };
                groups.push(GroupInfo {
                    offset: entry.offset,
                    bytes: entry.length,
                    first_frame: entry.first_frame,
                    frames: group.frames.len() as u64,
                    scanners: group.scanners.iter().map(|id| id.map_or(0, |id| numbers[&id])).collect(),
                });
                for ((number, frame), entry) in (entry.first_frame..).zip(group.frames).zip(&entry.frames) {
                    let Stamp { unit, stream, time } = entry.stamp;
                    frames.push(FrameInfo {
                        coding: FrameParameters::of(&frame)?.to_string(),
                        number,
                        unit: unit.name(),
                        stream,
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
            }
        }
    }
    Ok(Info {
        version: reader.header().version,
        flags: reader.header().flags,
        stream_bytes: reader.position(),
        file_bytes: frames.iter().map(|frame: &FrameInfo| frame.file_bytes).sum(),
        points: frames.iter().map(|frame| frame.points).sum(),
        scanners,
        groups,
        frames,
    })
}

fn print(info: &Info, out: &mut impl Write) -> io::Result<()> {
    let scanners = table::count(info.scanners.len() as u64, "scanner");
    let (frames, groups) = (info.frames.len() as u64, info.groups.len() as u64);
    writeln!(out, "format version {}, {scanners}", info.version)?;
    for (number, scanner) in (1..).zip(&info.scanners) {
        writeln!(out, "scanner {number}: {}", scanner.description)?;
    }
    writeln!(out, "{} in {}", table::count(frames, "frame"), table::count(groups, "group"))?;
    let (points, files) = (info.points, table::bytes(info.file_bytes));
    writeln!(
        out,
        "{} in {files}, coded in {}",
        table::count(points, "point"),
        table::bytes(info.stream_bytes)
    )?;
    let mut codings = BTreeMap::<_, u64>::new();
    info.frames.iter().for_each(|frame| *codings.entry(&frame.coding).or_default() += 1);
    for (coding, frames) in codings {
        writeln!(out, "{}: {coding}", table::count(frames, "frame"))?;
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

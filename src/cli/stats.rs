//! `lidarpc stats`

use std::io::{self, BufReader, Read, Seek, Write};

use anyhow::Result;
use lidarpc::bitstream::{Record, SectionKind, StreamReader};
use lidarpc::codec::{self, DecodeOptions};
use lidarpc::error::Limits;
use lidarpc::metrics::{self, PointErrors};
use serde::Serialize;

use super::args::StatsArgs;
use super::errors::about;
use super::input::{Input, Originals, name_of, open};
use super::{progress, table};

/// All that is reported.
#[derive(Serialize)]
struct Stats {
    frames: u64,
    groups: u64,
    points: u64,
    file_bytes: u64,
    stream_bytes: u64,
    /// Equation 11 of the article: coded / original.
    ratio: Option<f64>,
    bits_per_point: Option<f64>,
    /// Where the stream's bytes are; they add up to `stream_bytes`.
    sections: Vec<Part>,
    #[serde(skip_serializing_if = "Option::is_none")]
    against: Option<Against>,
}

/// A part of the stream.
#[derive(Serialize)]
struct Part {
    name: &'static str,
    bytes: u64,
    bits_per_point: Option<f64>,
}

/// The comparison with the originals.
#[derive(Default, Serialize)]
struct Against {
    identical_files: u64,
    differing_files: u64,
    rmse_m: Option<f64>,
    max_error_m: Option<f64>,
    lost_points: u64,
    added_points: u64,
    non_finite_changed: u64,
}

pub fn run(args: &StatsArgs, quiet: bool) -> Result<()> {
    let input = open(&args.input)?;
    let stats = read(args, input, quiet).map_err(|error| about(error, &name_of(&args.input)))?;
    let mut out = io::BufWriter::new(io::stdout().lock());
    if args.json {
        serde_json::to_writer_pretty(&mut out, &stats).map_err(io::Error::from)?;
        writeln!(out)?;
    } else {
        print(&stats, &mut out)?;
    }
    out.flush()?;
    Ok(())
}

fn read(args: &StatsArgs, input: Input, quiet: bool) -> lidarpc::error::Result<Stats> {
    if args.against.is_empty() {
        return measure(input.reader());
    }
    let originals = Originals::find(&args.against)?;
    let mut file = input.rewindable()?;
    let mut stats = measure(BufReader::new(&file))?;
    file.rewind()?;
    stats.against = Some(compare(args, &file, originals, stats.frames, quiet)?);
    Ok(stats)
}

/// Adds up the sizes of all parts, without decoding.
fn measure(input: impl Read) -> lidarpc::error::Result<Stats> {
    let mut reader = StreamReader::open(input, Limits::default())?;
    let mut by_kind = SectionKind::ALL.map(|_| 0u64);
    let (mut frames, mut points, mut file_bytes, mut sensor_bytes) = (0, 0, 0u64, 0);
    while let Some(record) = reader.next_record()? {
        match record {
            Record::SensorModel(bytes) => sensor_bytes += bytes.len() as u64,
            Record::Group(group) => {
                for frame in &group.frames {
                    frames += 1;
                    points += frame.header.point_count;
                    file_bytes += frame.header.file_size;
                    for section in &frame.sections {
                        let place = SectionKind::ALL.iter().position(|kind| *kind == section.kind);
                        by_kind[place.unwrap_or_default()] += section.payload.len() as u64;
                    }
                }
            }
        }
    }
    let stream_bytes = reader.position();
    let part = |name, bytes| Part { name, bytes, bits_per_point: metrics::bits_per_point(bytes, points) };
    let mut sections = vec![part("sensor", sensor_bytes)];
    sections.extend(SectionKind::ALL.iter().zip(by_kind).map(|(kind, bytes)| part(kind.name(), bytes)));
    let payloads: u64 = sections.iter().map(|part| part.bytes).sum();
    sections.push(part("container", stream_bytes - payloads));
    Ok(Stats {
        frames,
        groups: reader.index().groups.len() as u64,
        points,
        file_bytes,
        stream_bytes,
        ratio: metrics::ratio(file_bytes, stream_bytes),
        bits_per_point: metrics::bits_per_point(stream_bytes, points),
        sections,
        against: None,
    })
}

/// Decodes all frames and measures how far they are from the originals.
fn compare(
    args: &StatsArgs,
    input: impl Read,
    mut originals: Originals,
    frames: u64,
    quiet: bool,
) -> lidarpc::error::Result<Against> {
    let options = DecodeOptions { threads: args.threads.threads, ..DecodeOptions::default() };
    let bar = progress::bar(Some(frames), "comparing", quiet);
    let (mut errors, mut against) = (PointErrors::default(), Against::default());
    let compared = codec::decode(BufReader::new(input), &options, |frame| {
        bar.inc(1);
        let name = &frame.header.name;
        let original = originals.take(name)?;
        if original == frame.bytes {
            against.identical_files += 1;
        } else {
            against.differing_files += 1;
        }
        let (original, decoded) = (lidarpc::io::parse(name, original), lidarpc::io::parse(name, frame.bytes));
        errors.add(&original.cloud, &decoded.cloud);
        Ok(())
    });
    bar.finish_and_clear();
    compared?;
    against.rmse_m = errors.rmse();
    against.max_error_m = errors.max();
    against.lost_points = errors.lost;
    against.added_points = errors.added;
    against.non_finite_changed = errors.non_finite_changed;
    Ok(against)
}

fn print(stats: &Stats, out: &mut impl Write) -> io::Result<()> {
    let (frames, points) = (table::count(stats.frames, "frame"), table::count(stats.points, "point"));
    writeln!(out, "{frames} in {}, {points}", table::count(stats.groups, "group"))?;
    writeln!(out, "original     {:>14} bytes", stats.file_bytes)?;
    writeln!(out, "coded        {:>14} bytes", stats.stream_bytes)?;
    writeln!(out, "ratio        {:>14}", table::percent(stats.ratio))?;
    writeln!(out, "bits a point {:>14}", table::decimals(stats.bits_per_point))?;
    if let Some(against) = &stats.against {
        print_against(against, out)?;
    }
    writeln!(out)?;
    writeln!(out, "{:<12} {:>14} {:>9} {:>12}", "section", "bytes", "share", "bits a point")?;
    for part in stats.sections.iter().filter(|part| part.bytes > 0) {
        let share = table::percent(metrics::ratio(stats.stream_bytes, part.bytes));
        let bits = table::decimals(part.bits_per_point);
        writeln!(out, "{:<12} {:>14} {share:>9} {bits:>12}", part.name, part.bytes)?;
    }
    let bits = table::decimals(stats.bits_per_point);
    writeln!(out, "{:<12} {:>14} {:>9} {bits:>12}", "total", stats.stream_bytes, "100.00 %")
}

fn print_against(against: &Against, out: &mut impl Write) -> io::Result<()> {
    let metres = |error: Option<f64>| error.map_or_else(|| "-".to_owned(), |error| format!("{error:.6}"));
    let files = against.identical_files + against.differing_files;
    writeln!(out, "RMSE         {:>14} m", metres(against.rmse_m))?;
    writeln!(out, "max error    {:>14} m", metres(against.max_error_m))?;
    writeln!(out, "identical    {:>14} of {}", against.identical_files, table::count(files, "file"))?;
    for (name, count) in [
        ("lost points", against.lost_points),
        ("added points", against.added_points),
        ("NaN changed", against.non_finite_changed),
    ] {
        if count > 0 {
            writeln!(out, "{name:<12} {count:>14}")?;
        }
    }
    Ok(())
}

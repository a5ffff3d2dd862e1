//! `lidarpc stats`

mod comparison;
mod poses;
mod scanners;
mod steps;

use std::collections::BTreeMap;
use std::io::{self, BufReader, Read, Seek, Write};

use crate::container::{
    CodedFrame, FrameHeader, FrameKind, Record, SectionKind, StreamReader, payload_bytes_of,
};
use crate::frame::{FrameParameters, OriginalFile};
use crate::ground::error::Limits;
use crate::study::metrics;
use anyhow::Result;
use serde::Serialize;

use super::args::{StatsArgs, wrong_usage};
use super::console::Console;
use super::errors::about;
use super::input::{Input, Originals, is_recording, name_of, open};
use super::output::print_json;
use super::{readable, recording};
use comparison::{Against, compare};
use scanners::{KnownScanners, ScannerStats};

/// The complete report.
#[derive(Serialize)]
struct Stats {
    frames: u64,
    /// Files beside the scans; they are included in all following values except `points`.
    files_beside: u64,
    groups: u64,
    /// Number of points in the original files.
    points: u64,
    /// Points removed by the outlier filter.
    outliers_dropped: u64,
    /// Points lost because the range image had no separate cell for them.
    points_lost: u64,
    /// Total size of the original files.
    file_bytes: u64,
    stream_bytes: u64,
    /// Equation 11 of the article: coded / original.
    ratio: Option<f64>,
    bits_per_point: Option<f64>,
    /// The number of frames, files beside the scans excluded, by how accurately they are restored.
    fidelity: BTreeMap<String, u64>,
    scanners: Vec<ScannerStats>,
    /// The stream's bytes by section; the sum is `stream_bytes`.
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

pub fn run(args: &StatsArgs, console: Console) -> Result<()> {
    if args.steps {
        return steps::run(args, console);
    }
    if let Some(output) = &args.poses {
        return poses::run(args, output, console);
    }
    if is_recording(&args.input) {
        if !args.against.is_empty() {
            wrong_usage("stats", "--against compares scans; a recording is compared by `encode --verify`");
        }
        return recording::stats(args, console);
    }
    let input = open(&args.input)?;
    let stats = read(args, input, console).map_err(|error| about(error, &name_of(&args.input)))?;
    if args.json {
        return print_json(&stats);
    }
    let mut out = io::BufWriter::new(io::stdout().lock());
    print(&stats, &mut out)?;
    out.flush()?;
    Ok(())
}

fn read(args: &StatsArgs, input: Input, console: Console) -> crate::ground::error::Result<Stats> {
    if args.against.is_empty() {
        return measure(input.reader(), args.limits.limits());
    }
    let originals = Originals::find(&args.against)?;
    let mut file = input.rewindable()?;
    let mut stats = measure(BufReader::new(&file), args.limits.limits())?;
    file.rewind()?;
    stats.against = Some(compare(args, &file, originals, stats.frames, console)?);
    Ok(stats)
}

/// Sums over the frames of a stream.
#[derive(Default)]
struct Sums {
    frames: u64,
    files_beside: u64,
    originals: OriginalFile,
    /// As in [`Stats`].
    fidelity: BTreeMap<String, u64>,
    /// Bytes of the sections of each kind, in the order of [`SectionKind::ALL`].
    by_kind: [u64; SectionKind::ALL.len()],
}

impl Sums {
    /// Adds the next frame.
    fn add(&mut self, frame: &CodedFrame) -> crate::ground::error::Result<()> {
        let FrameHeader { name, stamp, .. } = &frame.header;
        let number = self.frames + self.files_beside;
        let parameters = FrameParameters::of(frame).map_err(|error| error.within_frame(number, name))?;
        self.originals.add(&parameters.original_of(&frame.header));
        if stamp.kind == FrameKind::Beside {
            self.files_beside += 1;
        } else {
            self.frames += 1;
            *self.fidelity.entry(parameters.fidelity()).or_default() += 1;
        }
        // Sections that this program does not know count as the container's.
        for (kind, bytes) in SectionKind::ALL.into_iter().zip(&mut self.by_kind) {
            *bytes += payload_bytes_of(&frame.sections, kind) as u64;
        }
        Ok(())
    }
}

/// Adds up the sizes of all parts; decodes only one scan of each scanner.
fn measure(input: impl Read, limits: Limits) -> crate::ground::error::Result<Stats> {
    let mut reader = StreamReader::open(input, limits)?;
    let (mut sums, mut scanners, mut scanner_bytes) = (Sums::default(), KnownScanners::default(), 0);
    while let Some(record) = reader.next_record()? {
        match record {
            Record::Scanner(record) => {
                scanner_bytes += record.payload.len() as u64;
                scanners.add(&record)?;
            }
            Record::Group(group) => {
                scanners.sample(sums.frames + sums.files_beside, &group, &limits)?;
                group.frames.iter().try_for_each(|frame| sums.add(frame))?;
            }
        }
    }
    let Sums { frames, files_beside, originals, fidelity, by_kind } = sums;
    let stream_bytes = reader.position();
    let OriginalFile { file_size: file_bytes, points, outliers, lost } = originals;
    let part = |name, bytes| Part { name, bytes, bits_per_point: metrics::bits_per_point(bytes, points) };
    let mut sections = vec![part("scanner", scanner_bytes)];
    sections.extend(SectionKind::ALL.iter().zip(by_kind).map(|(kind, bytes)| part(kind.name(), bytes)));
    let payloads: u64 = sections.iter().map(|part| part.bytes).sum();
    sections.push(part("container", stream_bytes - payloads));
    Ok(Stats {
        frames,
        files_beside,
        groups: reader.index().groups.len() as u64,
        points,
        outliers_dropped: outliers,
        points_lost: lost,
        file_bytes,
        stream_bytes,
        ratio: metrics::ratio(file_bytes, stream_bytes),
        bits_per_point: metrics::bits_per_point(stream_bytes, points),
        fidelity,
        scanners: scanners.report(),
        sections,
        against: None,
    })
}

fn print(stats: &Stats, out: &mut impl Write) -> io::Result<()> {
    let (frames, points) = (readable::count(stats.frames, "frame"), readable::count(stats.points, "point"));
    writeln!(out, "{frames} in {}, {points}", readable::count(stats.groups, "group"))?;
    if stats.files_beside > 0 {
        writeln!(
            out,
            "and {} beside them, whose bytes are counted too",
            readable::count(stats.files_beside, "file")
        )?;
    }
    writeln!(out, "original     {:>14} bytes", stats.file_bytes)?;
    writeln!(out, "coded        {:>14} bytes", stats.stream_bytes)?;
    writeln!(out, "ratio        {:>14}", readable::percent(stats.ratio))?;
    writeln!(out, "bits a point {:>14}", readable::decimals(stats.bits_per_point))?;
    for (name, count) in [("outliers", stats.outliers_dropped), ("no cell", stats.points_lost)] {
        if count > 0 {
            let share = readable::percent(metrics::ratio(stats.points, count));
            writeln!(out, "{name:<12} {count:>14} points dropped ({share})")?;
        }
    }
    for (fidelity, frames) in &stats.fidelity {
        writeln!(out, "{}: {fidelity}", readable::count(*frames, "frame"))?;
    }
    for (number, scanner) in (1..).zip(&stats.scanners) {
        scanner.print(number, out)?;
    }
    if let Some(against) = &stats.against {
        against.print(out)?;
    }
    writeln!(out)?;
    writeln!(out, "{:<12} {:>14} {:>9} {:>12}", "section", "bytes", "share", "bits a point")?;
    for part in stats.sections.iter().filter(|part| part.bytes > 0) {
        let share = readable::percent(metrics::ratio(stats.stream_bytes, part.bytes));
        let bits = readable::decimals(part.bits_per_point);
        writeln!(out, "{:<12} {:>14} {share:>9} {bits:>12}", part.name, part.bytes)?;
    }
    let bits = readable::decimals(stats.bits_per_point);
    writeln!(out, "{:<12} {:>14} {:>9} {bits:>12}", "total", stats.stream_bytes, "100.00 %")
}

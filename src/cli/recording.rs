//! Recordings as inputs and outputs: `encode drive.mcap`, `decode small.mcap`.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use crate::files::{FileFormat, convert, write};
use crate::frame::settings::EncoderConfig;
use crate::frame::{IntensityFidelity, PositionFidelity};
use crate::ground::error::{Error, Limits};
use crate::library::Settings;
use crate::recordings::{self, Clouds, Contents, CopySummary, Topic, TopicFilter};
use crate::stream::{self, FrameInput};
use crate::study::metrics;
use anyhow::{Result, bail, ensure};
use serde::Serialize;

use super::args::{DecodeArgs, EncodeArgs, FormatArg, StatsArgs, check_usage, wrong_usage};
use super::console::Console;
use super::conversion::name_of_points;
use super::errors::{NotWhole, about};
use super::input::{is_dash, is_named_as_recording};
use super::output::{FileOutput, FolderOutput, keep_inputs, name_of_output, print_json};
use super::readable;
use super::report::{FidelityReport, fidelity};

/// The machine-readable report.
#[derive(Serialize)]
struct Report {
    file: String,
    /// Only after encoding.
    #[serde(flatten)]
    fidelity: Option<FidelityReport>,
    messages: u64,
    clouds: u64,
    points: u64,
    /// Messages on topics of clouds that lidarpc does not support, which were copied unchanged.
    kept: u64,
    attachments: u64,
    cloud_bytes_before: u64,
    cloud_bytes_after: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    damage: Option<String>,
    /// Messages on topics of clouds that have no place in a stream of clouds alone.
    left_out: u64,
    verified: bool,
    seconds: f64,
}

impl Report {
    /// The report on clouds that were copied. `encoded`: the settings, and whether the output was verified,
    /// if they were encoded.
    fn of(
        output: &Path,
        copied: &CopySummary,
        left_out: u64,
        encoded: Option<(&EncoderConfig, bool)>,
        start: Instant,
    ) -> Self {
        Report {
            file: output.display().to_string(),
            fidelity: encoded.map(|(config, _)| FidelityReport::of(config)),
            messages: copied.messages,
            clouds: copied.clouds,
            points: copied.points,
            kept: copied.kept,
            attachments: copied.attachments,
            cloud_bytes_before: copied.cloud_bytes_before,
            cloud_bytes_after: copied.cloud_bytes_after,
            damage: copied.damage.clone(),
            left_out,
            verified: encoded.is_some_and(|(_, verified)| verified),
            seconds: start.elapsed().as_secs_f64(),
        }
    }

    /// Prints the report as JSON, or as this line.
    fn print(&self, json: bool, console: Console, line: impl FnOnce(&Self) -> String) -> Result<()> {
        if json {
            print_json(self)?;
        } else {
            console.say(line(self));
        }
        Ok(())
    }

    /// The report on a recording in a line. `config`: the settings, if clouds were encoded.
    fn summary(&self, config: Option<&EncoderConfig>) -> String {
        let (before, after) = (self.cloud_bytes_before, self.cloud_bytes_after);
        let sizes = match before {
            0 if after == 0 => "no bytes".to_owned(),
            _ if before == 0 || after >= before => readable::bytes(after),
            _ => self.savings(),
        };
        let kept = match self.kept {
            0 => String::new(),
            kept => format!(", {} of a topic of clouds copied as they are", readable::count(kept, "message")),
        };
        let fidelity = match config {
            Some(config) if self.clouds > 0 => format!(", {}", fidelity(config, None)),
            _ => String::new(),
        };
        format!(
            "{}, {}: {sizes}{kept}{fidelity}{}{} in {:.1} s",
            readable::count(self.messages, "message"),
            readable::count(self.clouds, "cloud"),
            self.left_out(),
            if self.verified { ", verified" } else { "" },
            self.seconds,
        )
    }

    /// The report on a stream of the clouds alone in a line. `fidelity`: how accurately their points are
    /// restored.
    fn summary_of_clouds(&self, fidelity: &str) -> String {
        format!(
            "{}: {}, the clouds alone, {fidelity}{} in {:.1} s",
            readable::count(self.clouds, "cloud"),
            self.savings(),
            self.left_out(),
            self.seconds,
        )
    }

    /// The sizes of the clouds before and after.
    fn savings(&self) -> String {
        let (before, after) = (self.cloud_bytes_before, self.cloud_bytes_after);
        let share = readable::percent(metrics::ratio(before, after));
        format!("{} -> {} ({share})", readable::bytes(before), readable::bytes(after))
    }

    /// The messages that were left out.
    fn left_out(&self) -> String {
        match self.left_out {
            0 => String::new(),
            messages => format!(", {} of a topic of clouds left out", readable::count(messages, "message")),
        }
    }
}

/// `encode` for a recording: to one with compressed clouds, or to a stream of the clouds alone.
pub fn encode(args: &EncodeArgs, config: &EncoderConfig, console: Console) -> Result<()> {
    let [input] = &args.inputs[..] else {
        wrong_usage("encode", "recordings are encoded one by one");
    };
    check_usage(
        "encode",
        [
            (args.resume, "--resume takes scans, not a recording"),
            (args.all, "--all keeps the files of folders; all that a recording holds is kept without it"),
            (args.rm, "--rm deletes scans, not a recording"),
            (args.jobs.is_some(), "--jobs is for folders of drives; give --threads"),
            (
                args.coding.layout.is_some(),
                "--layout is for files without a header; clouds name their fields",
            ),
        ],
    );
    keep_inputs(args.output(), &args.inputs)?;
    match is_named_as_recording(args.output()) {
        true => pack(args, input, config, console),
        false => encode_clouds(args, input, config, console),
    }
}

/// Copies a recording and compresses its clouds.
fn pack(args: &EncodeArgs, input: &Path, config: &EncoderConfig, console: Console) -> Result<()> {
    check_usage(
        "encode",
        [
            (
                config.positions == PositionFidelity::Formula || config.intensity == IntensityFidelity::None,
                "paper mode drops points and intensities, which messages keep; give --max-error, or -o FILE.lpc",
            ),
            (
                args.verify && !config.is_exact(),
                "--verify compares byte for byte; leave it out, or what makes the clouds lossy",
            ),
            (
                args.coding.gop.is_some() || args.coding.predict.is_some(),
                "--gop and --predict need -o FILE.lpc: in a recording, each cloud is compressed alone",
            ),
        ],
    );
    let start = Instant::now();
    let bar = console.bar(None, "packing");
    let filter = TopicFilter { topics: args.topic.clone() };
    let settings = Settings::of_config(config.clone());
    let (copied, output) = copy(input, args.output(), args.force, |input, out| {
        recordings::pack(input, out, &settings, &filter, &|| bar.inc(1))
    })?;
    bar.finish_and_clear();
    check_topics(input, &args.topic, &copied.topics)?;
    if args.strict {
        check_whole(input, copied.damage.as_deref())?;
    }
    if args.verify {
        verify(input, &output, &copied, args.threads.threads)?;
    }
    output.finish().map_err(|error| about(error, &name_of_output(args.output())))?;
    let report = Report::of(args.output(), &copied, 0, Some((config, args.verify)), start);
    report.print(args.json, console, |report| report.summary(Some(config)))?;
    check_whole(input, copied.damage.as_deref())
}

/// Encodes the clouds alone, as frames of a stream with their times.
fn encode_clouds(args: &EncodeArgs, input: &Path, config: &EncoderConfig, console: Console) -> Result<()> {
    if args.verify {
        wrong_usage("encode", "--verify compares a recording with a recording; give -o FILE.mcap");
    }
    let name = name_of_output(args.output());
    let start = Instant::now();
    let bar = console.bar(None, "encoding");
    let mut output = FileOutput::binary(args.output(), args.force)?;
    let filter = TopicFilter { topics: args.topic.clone() };
    let at_input = |error| about(error, &input.display().to_string());
    let clouds = open(input).and_then(|file| Clouds::open(file, &filter, Limits::default()));
    let mut clouds = clouds.map_err(at_input)?;
    let frames = clouds.by_ref().map(|cloud| {
        let (scan, stamp) = cloud.map_err(|error| error.at(input))?.into_parts();
        Ok(FrameInput::scan(scan).stamped(stamp))
    });
    let encoded = output.write(|out| stream::encode_live(frames, config, out, &|| bar.inc(1)));
    bar.finish_and_clear();
    let encoded = encoded.map_err(|error| about(error, &name))?;
    let left_out = clouds.left_out;
    let copied = CopySummary {
        messages: encoded.frames.len() as u64,
        clouds: encoded.frames.len() as u64,
        points: encoded.points,
        cloud_bytes_before: encoded.file_bytes(),
        cloud_bytes_after: encoded.stream_bytes,
        damage: clouds.damage(),
        ..CopySummary::default()
    };
    let damage = copied.damage.as_deref();
    check_topics(input, &args.topic, &clouds.topics)?;
    if args.strict {
        check_whole(input, damage)?;
        ensure!(
            left_out == 0,
            "{}: holds what would not come back: {}; give -o FILE.mcap, or encode without --strict",
            input.display(),
            readable::count(left_out, "message")
        );
    }
    let because = damage.map_or(String::new(), |damage| format!(" ({damage})"));
    ensure!(copied.clouds > 0, "{}: holds no cloud that can be encoded{because}", input.display());
    output.finish().map_err(|error| about(error, &name))?;
    let report = Report::of(args.output(), &copied, left_out, Some((config, false)), start);
    report.print(args.json, console, |report| report.summary_of_clouds(&fidelity(config, Some(&encoded))))?;
    check_whole(input, damage)
}

/// `decode` for a recording: to one with the original clouds, or to a folder of scans.
pub fn decode(args: &DecodeArgs, console: Console) -> Result<()> {
    let [input] = &args.inputs[..] else {
        wrong_usage("decode", "recordings are decoded one by one");
    };
    let is_to_recording = is_named_as_recording(args.output());
    check_usage(
        "decode",
        [
            (
                args.frames.is_some() || args.time.is_some() || args.keep_going,
                "--frames, --time and --keep-going take a stream, not a recording",
            ),
            (args.messages, "--messages takes messages from a pipe, not a recording"),
            (
                is_to_recording && (!args.topic.is_empty() || args.format.is_some()),
                "--topic and --format need a folder as the output; a recording comes back whole",
            ),
        ],
    );
    let start = Instant::now();
    let (copied, left_out) = match is_to_recording {
        true => (unpack(args, input, console)?, 0),
        false => decode_clouds(args, input, console)?,
    };
    let report = Report::of(args.output(), &copied, left_out, None, start);
    report.print(args.json, console, |report| report.summary(None))?;
    check_whole(input, copied.damage.as_deref())
}

/// Copies a recording and decodes its clouds.
fn unpack(args: &DecodeArgs, input: &Path, console: Console) -> Result<CopySummary> {
    keep_inputs(args.output(), &args.inputs)?;
    let bar = console.bar(None, "unpacking");
    let (copied, output) = copy(input, args.output(), args.force, |input, out| {
        recordings::unpack(input, out, args.threads.threads, args.limits.limits(), &|| bar.inc(1))
    })?;
    bar.finish_and_clear();
    output.finish().map_err(|error| about(error, &name_of_output(args.output())))?;
    Ok(copied)
}

/// Decodes the clouds to files in a folder. Returns also the number of messages that were left out.
fn decode_clouds(args: &DecodeArgs, input: &Path, console: Console) -> Result<(CopySummary, u64)> {
    if is_dash(args.output()) {
        wrong_usage("decode", "a recording is decoded into a folder, or to FILE.mcap");
    }
    let format = args.format.map_or(FileFormat::Pcd, FormatArg::format);
    let at = |error| about(error, &input.display().to_string());
    let filter = TopicFilter { topics: args.topic.clone() };
    let clouds = open(input).and_then(|file| Clouds::open(file, &filter, args.limits.limits()));
    let mut clouds = clouds.map_err(at)?;
    let folder = FolderOutput::create(args.output(), args.force)?.keeping(&args.inputs);
    let bar = console.bar(None, "decoding");
    let mut copied = CopySummary::default();
    for (number, cloud) in clouds.by_ref().enumerate() {
        let (mut scan, _) = cloud.map_err(at)?.into_parts();
        scan.name = name_of_points(&scan.name, number as u64);
        let file = convert(&scan, format).map_err(at)?;
        let bytes = folder.write(&file.name, |give| write(&file, give)).map_err(at)?;
        copied.messages += 1;
        copied.clouds += 1;
        copied.points += scan.records as u64;
        copied.cloud_bytes_after += bytes;
        bar.inc(1);
    }
    bar.finish_and_clear();
    copied.damage = clouds.damage();
    check_topics(input, &args.topic, &clouds.topics)?;
    folder.finish()?;
    Ok((copied, clouds.left_out))
}

/// The contents of a recording, for `info`, `stats` and `verify`.
#[derive(Serialize)]
pub struct Listing {
    file: String,
    file_bytes: u64,
    topics: Vec<TopicListing>,
    attachments: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    damage: Option<String>,
}

#[derive(Serialize)]
struct TopicListing {
    topic: String,
    schema: String,
    messages: u64,
    bytes: u64,
    /// Messages that are compressed clouds.
    compressed: u64,
    /// Number of points in these, and their size before compression, if they were decoded.
    #[serde(skip_serializing_if = "Option::is_none")]
    points: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    cloud_bytes: Option<u64>,
    /// The number of these by how accurately they are restored, likewise.
    #[serde(skip_serializing_if = "Option::is_none")]
    fidelity: Option<BTreeMap<String, u64>>,
}

/// Lists the contents of a recording; with limits, every compressed cloud is decoded within them.
pub fn examine(path: &Path, decoding: Option<Limits>, threads: usize, console: Console) -> Result<Listing> {
    let at = |error| about(error, &path.display().to_string());
    let file = open(path).map_err(at)?;
    let file_bytes = file.get_ref().metadata().map_err(|error| at(error.into()))?.len();
    let bar = console.bar(None, "reading");
    let contents = recordings::examine(file, decoding, threads, &|| bar.inc(1));
    bar.finish_and_clear();
    let Contents { topics, attachments, damage } = contents.map_err(at)?;
    let listing = |topic: Topic| TopicListing {
        topic: topic.name,
        schema: topic.schema,
        messages: topic.messages,
        bytes: topic.bytes,
        compressed: topic.clouds,
        points: decoding.map(|_| topic.points),
        cloud_bytes: decoding.map(|_| topic.cloud_bytes),
        fidelity: decoding.map(|_| topic.fidelity),
    };
    let topics = topics.into_iter().map(listing).collect();
    Ok(Listing { file: path.display().to_string(), file_bytes, topics, attachments, damage })
}

impl Listing {
    /// Number of messages.
    pub fn messages(&self) -> u64 {
        self.topics.iter().map(|topic| topic.messages).sum()
    }

    /// Number of compressed clouds.
    pub fn clouds(&self) -> u64 {
        self.topics.iter().map(|topic| topic.compressed).sum()
    }

    /// Their size before compression, if they were decoded.
    pub fn cloud_bytes(&self) -> u64 {
        self.topics.iter().filter_map(|topic| topic.cloud_bytes).sum()
    }

    /// Checks that the recording is complete.
    ///
    /// # Errors
    /// If it is cut short or damaged.
    pub fn check(&self) -> Result<()> {
        check_whole(Path::new(&self.file), self.damage.as_deref())
    }
}

/// Prints the list of topics.
pub fn print(listing: &Listing, out: &mut impl Write) -> std::io::Result<()> {
    let channels = readable::count(listing.topics.len() as u64, "channel");
    writeln!(
        out,
        "recording (MCAP) of {}: {} in {channels}, {} of attachments and metadata",
        readable::bytes(listing.file_bytes),
        readable::count(listing.messages(), "message"),
        readable::count(listing.attachments, "record"),
    )?;
    if let Some(what) = &listing.damage {
        writeln!(out, "cut short or damaged ({what}); of what can be read:")?;
    }
    writeln!(out)?;
    writeln!(out, "{:>9} {:>12} {:>10}  topic (schema)", "messages", "bytes", "compressed")?;
    for TopicListing { topic, schema, messages, bytes, compressed, .. } in &listing.topics {
        let (topic, schema) = (topic.escape_debug(), schema.escape_debug());
        writeln!(out, "{messages:>9} {bytes:>12} {compressed:>10}  {topic} ({schema})")?;
    }
    Ok(())
}

/// `stats` for a recording: the savings by its compressed clouds.
pub fn stats(args: &StatsArgs, console: Console) -> Result<()> {
    let listing = examine(&args.input, Some(args.limits.limits()), args.threads.threads, console)?;
    if args.json {
        print_json(&listing)?;
        return listing.check();
    }
    let mut out = std::io::stdout().lock();
    print(&listing, &mut out)?;
    writeln!(out)?;
    writeln!(out, "{:>14} {:>12} {:>9} {:>12}  topic", "original", "coded", "share", "bits a point")?;
    for topic in listing.topics.iter().filter(|topic| topic.compressed > 0) {
        let (before, points) = (topic.cloud_bytes.unwrap_or_default(), topic.points.unwrap_or_default());
        let share = readable::percent(metrics::ratio(before, topic.bytes));
        let bits = readable::decimals(metrics::bits_per_point(topic.bytes, points));
        writeln!(
            out,
            "{before:>14} {:>12} {share:>9} {bits:>12}  {}",
            topic.bytes,
            topic.topic.escape_debug()
        )?;
        for (fidelity, clouds) in topic.fidelity.iter().flatten() {
            writeln!(out, "{:>14} {fidelity}", format!("{}:", readable::count(*clouds, "cloud")))?;
        }
    }
    drop(out);
    listing.check()
}

fn open(path: &Path) -> crate::ground::error::Result<BufReader<File>> {
    Ok(BufReader::with_capacity(1 << 20, File::open(path)?))
}

/// A recording that is read, and whether that has failed: an error of the system does not tell whether it is
/// about the input or the output.
struct Input<'a> {
    file: BufReader<File>,
    has_failed: &'a AtomicBool,
}

impl Input<'_> {
    fn noted<T>(&self, result: io::Result<T>) -> io::Result<T> {
        self.has_failed.fetch_or(result.is_err(), Ordering::Relaxed);
        result
    }
}

impl Read for Input<'_> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let read = self.file.read(out);
        self.noted(read)
    }
}

impl Seek for Input<'_> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let place = self.file.seek(to);
        self.noted(place)
    }
}

/// Writes a recording that is renamed when complete.
fn copy(
    input: &Path,
    path: &Path,
    force: bool,
    write: impl FnOnce(Input, &mut BufWriter<&mut File>) -> std::result::Result<CopySummary, Error>,
) -> Result<(CopySummary, FileOutput)> {
    let at_input = |error| about(error, &input.display().to_string());
    let has_failed = AtomicBool::new(false);
    let reader = Input { file: open(input).map_err(at_input)?, has_failed: &has_failed };
    let mut output = FileOutput::create(path, force)?;
    let FileOutput::Temporary { file, .. } = &mut output else {
        bail!("{}: a recording needs a file that can be sought in, not a pipe", path.display());
    };
    let mut out = BufWriter::with_capacity(1 << 20, file.as_file_mut());
    let copied = write(reader, &mut out).map_err(|error| match error {
        Error::Io(_) if !has_failed.load(Ordering::Relaxed) => about(error, &path.display().to_string()),
        Error::InvalidSettings(_) => error.into(),
        _ => at_input(error),
    })?;
    out.flush().map_err(|error| about(error.into(), &path.display().to_string()))?;
    drop(out);
    Ok((copied, output))
}

/// Unpacks the output and compares it with the input, message by message.
fn verify(input: &Path, output: &FileOutput, copied: &CopySummary, threads: usize) -> Result<()> {
    let at = |error| about(error, &input.display().to_string());
    let Some(packed) = output.reopen()? else { bail!("--verify needs a file that can be read again") };
    let mut restored = tempfile::tempfile().map_err(|error| at(error.into()))?;
    let limits = Limits::default();
    recordings::unpack(BufReader::new(packed), &mut restored, threads, limits, &|| ()).map_err(at)?;
    restored.rewind().map_err(|error| at(error.into()))?;
    let same = recordings::same_messages(open(input).map_err(at)?, BufReader::new(restored)).map_err(at)?;
    ensure!(
        same == Some(copied.messages),
        "{}: its copy decodes to something else, so it is not kept; please report this",
        input.display()
    );
    Ok(())
}

/// Checks that the recording has clouds on each of the selected topics.
fn check_topics(input: &Path, selected: &[String], found: &BTreeSet<String>) -> Result<()> {
    let missing = selected.iter().find(|topic| !found.contains(*topic));
    missing.map_or(Ok(()), |topic| {
        bail!("{}: has no clouds on the topic {topic:?}; `info` lists its topics", input.display())
    })
}

/// Checks that the whole recording was processed.
///
/// # Errors
/// If it is cut short or damaged: all that can be read was processed, and the output exists.
fn check_whole(input: &Path, damage: Option<&str>) -> Result<()> {
    match damage {
        None => Ok(()),
        Some(what) => Err(NotWhole(format!(
            "{}: is cut short or damaged ({what}); all that can be read was taken",
            input.display()
        ))
        .into()),
    }
}

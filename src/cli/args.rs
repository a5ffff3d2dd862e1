//! The arguments, and the help that explains them.

use std::path::{Path, PathBuf};

use crate::files::FileFormat;
use crate::frame::settings::EncoderConfig;
use crate::ground::error::Limits;
use crate::stream::FrameRange;
use crate::study::synth::SynthConfig;
use clap::error::ErrorKind;
use clap::{CommandFactory, Parser, Subcommand, ValueEnum};

use super::coding::CodingArgs;
use super::time_range::TimeRange;

const EXAMPLES: &str = "\
Examples:
  lidarpc encode drive/ -o drive.lpc           a folder of scans into one file
  lidarpc decode drive.lpc -o drive/           and back, byte for byte
  lidarpc stats drive.lpc --against drive/     size by part, and a comparison with the originals
  lidarpc verify drive.lpc                     check that the file is intact
  lidarpc cut drive.lpc --frames 10..20 -o part.lpc

Exit codes: 0 done, 1 failed, 2 wrong usage, 3 input damaged, intact parts processed.";

/// Compresses folders of LiDAR scans, losslessly by default.
#[derive(Debug, Parser)]
#[command(name = "lidarpc", version, about, after_help = EXAMPLES, max_term_width = 100)]
pub struct Args {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
    /// Print errors and requested reports only.
    #[arg(short, long, global = true)]
    pub quiet: bool,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Encode scans into one file.
    Encode(EncodeArgs),
    /// Decode a file into a folder of scans.
    #[command(long_flag = "decompress", short_flag = 'd')]
    Decode(DecodeArgs),
    /// Report ratio, bits a point and bytes by section; with --against also the error.
    Stats(StatsArgs),
    /// List the contents of a file, without decoding points.
    #[command(long_flag = "list", short_flag = 'l')]
    Info(InfoArgs),
    /// Check a file: every checksum, and that every frame decodes.
    #[command(long_flag = "test", short_flag = 't')]
    Verify(VerifyArgs),
    /// Copy a range of frames into a file of its own, without loss.
    Cut(CutArgs),
    /// Join files into one, without encoding them again.
    Cat(CatArgs),
    /// Write the intact frames of a damaged file as a new file.
    Repair(RepairArgs),
    /// Draw a frame as a PNG, or a whole drive as an HTML page: points, range image, regions, prediction.
    View(ViewArgs),
    /// Run the experiments of the article behind `--mode paper`: its tables and figures, as text or as an
    /// HTML page.
    Bench(BenchArgs),
    /// Write a synthetic drive: KITTI .bin scans of a simulated scanner.
    Synth(SynthArgs),
    /// Estimate from a sample how much encoding would save and how long it would take.
    Estimate(EstimateArgs),
    /// Write a shell completion script for commands and options.
    Completions(CompletionsArgs),
    /// Write the manual pages.
    Man(ManArgs),
}

/// Ends the program as clap does for wrong usage of this subcommand.
pub fn wrong_usage(subcommand: &str, what: impl std::fmt::Display) -> ! {
    let mut program = Args::command();
    // Before this, subcommands do not know the name of the program.
    program.build();
    let command = program.find_subcommand_mut(subcommand);
    match command {
        Some(command) => command.error(ErrorKind::ArgumentConflict, what).exit(),
        None => program.error(ErrorKind::ArgumentConflict, what).exit(),
    }
}

/// Ends the program with the first of these messages whose condition is true.
pub fn check_usage<const N: usize>(subcommand: &str, wrong: [(bool, &str); N]) {
    if let Some((_, what)) = wrong.into_iter().find(|(is_wrong, _)| *is_wrong) {
        wrong_usage(subcommand, what);
    }
}

/// The encoder's settings according to these options of a subcommand. If they do not fit together, ends the
/// program.
pub fn encoder_config(subcommand: &str, coding: &CodingArgs, threads: usize) -> EncoderConfig {
    coding.config(threads).unwrap_or_else(|error| wrong_usage(subcommand, error))
}

/// Full name of what other help texts call the article.
pub const ARTICLE: &str = "\
The article is \"A Novel Coding Scheme for Large-Scale Point Cloud Sequences Based on Clustering and \
Registration\"; sections, equations, tables and figures are its own.";

const ENCODE_EXAMPLES: &str = "\
Examples:
  lidarpc encode drive/ -o drive.lpc --verify
  lidarpc encode drive/ -o drive.lpc --max-error 1cm
  ssh host 'tar c --sort=name drive' | lidarpc encode - -o drive.lpc";

const ENCODE_MORE_EXAMPLES: &str = "\
Examples:
  lidarpc encode drive/ -o drive.lpc --verify
  lidarpc encode a.bin b.bin -o two.lpc -9
  lidarpc encode drive/ -o drive.lpc --max-error 1cm
  lidarpc encode drive/ -o drive.lpc --all        images, poses and times beside the scans too
  lidarpc encode tree/ -o tree.lpc                all drives below, in one file
  lidarpc encode tree/ -o out/                    a file for each drive
  lidarpc encode drive/ -o drive.lpc --resume     if interrupted, the same command continues
  lidarpc encode drive/ -o drive.lpc --mode paper --step 1cm
  lidarpc encode drive.mcap -o small.mcap         a ROS recording, its clouds compressed
  ssh host 'tar c --sort=name drive' | lidarpc encode - -o drive.lpc
  lidarpc encode drive/ -o - | ssh host 'cat > drive.lpc'

Names and bytes of files are restored; for a tree with several folders of scans, paths too. Times and permissions, \
hidden files, links to folders and files of other kinds are not stored. What is left out of a folder is counted on \
stderr; --all stores other files too, --strict makes it an error. Times of scans are taken from timestamps.txt (or times.txt) \
beside them, or from names that are nanoseconds or microseconds.

";

#[derive(Clone, Debug, clap::Args)]
#[command(after_help = ENCODE_EXAMPLES, after_long_help = format!("{ENCODE_MORE_EXAMPLES}{ARTICLE}"))]
pub struct EncodeArgs {
    /// Folders of scans, single scans, a recording (.mcap), or `-` for frames from stdin.
    ///
    /// With FILE.mcap as output, a recording is copied and its clouds are compressed; with any other FILE,
    /// only the clouds are encoded.
    ///
    /// Frames are sorted by the numbers in their names. Frames from stdin are encoded as they arrive: stdin
    /// is a tar archive or, for each frame, a line with its name, a space and its size in bytes, followed by
    /// its bytes.
    #[arg(required = true, value_name = "INPUT")]
    pub inputs: Vec<PathBuf>,
    /// File to write; `-` for stdout; or a folder, to write a file for each drive. Default: INPUT.lpc.
    ///
    /// FILE is taken as a folder if it is one, or if it ends in a slash. Each drive of a tree becomes a file
    /// under its path. A drive is a folder of scans, without a trailing `velodyne_points/data`,
    /// `sensors/lidar`, `velodyne` or `data`.
    #[arg(short, long, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// Keep all other files of the folders too, byte for byte.
    ///
    /// This includes hidden files and empty folders, but not links, times and permissions. Scans and files
    /// are then restored under their paths relative to the folder. Files that are already compressed are
    /// stored as they are.
    #[arg(long)]
    pub all: bool,
    #[command(flatten)]
    pub threads: Threads,
    /// Drives to encode in parallel into a folder. Default: one per thread if there are at least as many
    /// drives, else 1.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..), hide_short_help = true)]
    pub jobs: Option<u16>,
    /// Decode the written file and compare it with the input, before it gets its final name.
    #[arg(long)]
    pub verify: bool,
    /// Delete the encoded files once the output is verified; implies --verify.
    ///
    /// Only in exact mode. Files that are not stored are kept.
    #[arg(long, hide_short_help = true)]
    pub rm: bool,
    /// Make the run resumable.
    ///
    /// Writes to FILE.partial, which remains after any interruption; the same command then continues after
    /// the last complete group of frames, with the same result. FILE.partial.journal records the inputs and
    /// settings. Both are removed when the output is complete. An output that is complete already is compared
    /// with the inputs and settings, and left as it is. If the output is a folder, all this holds for the
    /// file of each drive.
    #[arg(long)]
    pub resume: bool,
    /// Overwrite the output if it exists.
    #[arg(short, long)]
    pub force: bool,
    /// Fail if anything in the input would be left out.
    ///
    /// This means other files, hidden files, links and pipes, but not times and permissions; also an empty
    /// stdin. Without --strict, a line on stderr counts what is left out.
    #[arg(long)]
    pub strict: bool,
    /// Store explicitly named files that are not scans as plain bytes.
    #[arg(long, hide_short_help = true)]
    pub force_bytes: bool,
    /// Encode each frame from stdin to a stream of its own, and write it before the next frame is read.
    ///
    /// Each stream follows a line with its name, a space and its size in bytes, and can be decoded
    /// independently; `decode --messages` decodes them one by one. The scanner is fitted to the first frame
    /// and kept.
    #[arg(long, hide_short_help = true)]
    pub messages: bool,
    /// Recordings: compress only the clouds of this topic; may be given several times. Default: all.
    #[arg(long, value_name = "TOPIC", hide_short_help = true)]
    pub topic: Vec<String>,
    /// List everything that is left out, and each frame with its size.
    #[arg(short, long)]
    pub verbose: bool,
    /// Print the report as JSON on stdout.
    ///
    /// Sizes are in bytes, lengths in metres, times in seconds.
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub coding: CodingArgs,
}

impl DecodeArgs {
    /// The output path, once the default has been filled in.
    pub fn output(&self) -> &Path {
        self.output.as_deref().unwrap_or(Path::new("-"))
    }
}

impl EncodeArgs {
    /// The output path, once the default has been filled in.
    pub fn output(&self) -> &Path {
        self.output.as_deref().unwrap_or(Path::new("-"))
    }
}

/// How many threads to use.
#[derive(Clone, Debug, clap::Args)]
pub struct Threads {
    /// Threads to use; 0: one for each processor.
    ///
    /// More threads need more memory; the result is the same.
    #[arg(long, value_name = "N", default_value_t = 0,
          value_parser = |text: &str| match text.parse::<usize>() {
              Ok(threads) if threads <= 1024 => Ok(threads),
              _ => Err("not a number from 0 to 1024"),
          })]
    pub threads: usize,
}

/// Limits on the resources that reading a stream may use.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct LimitArgs {
    /// Refuse frames of more points, or range images of more cells.
    #[arg(long, value_name = "N", default_value_t = Limits::default().points)]
    #[arg(help_heading = "Limits", hide_short_help = true)]
    pub max_points: u64,
    /// Refuse frames, and groups of frames, that decode to more bytes.
    #[arg(long, value_name = "BYTES", default_value_t = Limits::default().file_bytes)]
    #[arg(help_heading = "Limits", hide_short_help = true)]
    pub max_file_bytes: u64,
    /// Refuse records of more bytes (in practice: groups of frames).
    #[arg(long, value_name = "BYTES", default_value_t = Limits::default().record_bytes)]
    #[arg(help_heading = "Limits", hide_short_help = true)]
    pub max_group_bytes: u64,
}

impl LimitArgs {
    /// The limits.
    pub fn limits(&self) -> Limits {
        let LimitArgs { max_points: points, max_file_bytes: file_bytes, max_group_bytes: record_bytes } =
            *self;
        Limits { points, file_bytes, record_bytes }
    }
}

const DECODE_EXAMPLES: &str = "\
Examples:
  lidarpc decode drive.lpc -o drive/
  lidarpc decode drive.lpc -o part/ --frames 10..20     frames 10 to 19, the first being 0
  lidarpc decode drive.lpc -o - --frames 5 > frame5.bin
  lidarpc decode damaged.lpc -o drive/ --keep-going     the intact frames
  lidarpc decode drive.lpc -o part/ --time 12s..15s     since the first frame
  lidarpc decode drive.lpc -o clouds/ --format pcd      in another format
  lidarpc decode out/ -o tree/                          a tree of streams, each into its folder
  lidarpc decode small.mcap -o drive.mcap               a recording as it was
  ssh host 'cat drive.lpc' | lidarpc decode - -o drive/";

/// File formats that scans can be converted to.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum FormatArg {
    /// KITTI .bin: float32 x, y, z, intensity; intensity is 0 if there is none.
    Bin,
    /// Binary PCD, for PCL.
    Pcd,
    /// Binary little-endian PLY.
    Ply,
    /// Text: a header line, then a line for each point, separated by commas.
    Csv,
    /// NumPy: a structured array.
    Npy,
}

impl FormatArg {
    /// The library's value for this format.
    pub fn format(self) -> FileFormat {
        match self {
            FormatArg::Bin => FileFormat::Bin,
            FormatArg::Pcd => FileFormat::Pcd,
            FormatArg::Ply => FileFormat::Ply,
            FormatArg::Csv => FileFormat::Csv,
            FormatArg::Npy => FileFormat::Npy,
        }
    }
}

#[derive(Clone, Debug, clap::Args)]
#[command(after_help = DECODE_EXAMPLES)]
pub struct DecodeArgs {
    /// Files to decode, all into one folder; `-` for stdin; a recording (.mcap); or a folder of files, each
    /// of which is decoded into a folder named after it.
    #[arg(required = true, value_name = "FILE")]
    pub inputs: Vec<PathBuf>,
    /// Folder to write the scans into, created if missing; `-` for stdout (a single frame only); FILE.mcap,
    /// to restore a recording with its original clouds. Default: FILE without `.lpc`.
    #[arg(short, long, value_name = "FOLDER")]
    pub output: Option<PathBuf>,
    /// Frames to decode, counted from 0: `5`, `10..20` (without 20), `10..=20`, `10..`, `..20`.
    #[arg(long, allow_negative_numbers = true, value_name = "RANGE")]
    pub frames: Option<FrameRange>,
    /// Frames to decode, by time since the first frame: `12s..15s` (without 15 s), `1m30s..`, `..0.5`.
    #[arg(long, allow_negative_numbers = true, value_name = "RANGE", conflicts_with = "frames")]
    pub time: Option<TimeRange>,
    /// Decode the intact frames of a damaged file, report which are lost, and exit with 3 if any are. In a
    /// group, a damaged frame takes those after it along.
    #[arg(long)]
    pub keep_going: bool,
    /// Convert the scans from any format. Coordinates keep every bit (in text, except for the payload of a
    /// NaN); unnamed fields and all other bytes of the files are left out.
    #[arg(long, value_enum)]
    pub format: Option<FormatArg>,
    /// Decode the output of `encode --messages`, frame by frame as it arrives: into the folder, or to stdout,
    /// where each frame follows a line with its name, a space and its size in bytes.
    #[arg(long, conflicts_with_all = ["frames", "time"])]
    pub messages: bool,
    /// Recordings: decode only the clouds of this topic into the folder; may be given several times. Default:
    /// all.
    #[arg(long, value_name = "TOPIC")]
    pub topic: Vec<String>,
    #[command(flatten)]
    pub threads: Threads,
    /// Overwrite scans that exist.
    #[arg(short, long)]
    pub force: bool,
    /// Print the report as JSON on stdout.
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub limits: LimitArgs,
}

const STATS_NOTES: &str = "\
Ratio is coded size / original size. RMSE and max error are 3-D distances in metres between points
paired by their order. 'container' is everything except the payloads of sections and the first
record of each scanner: headers, names, lengths, checksums, repeated records of scanners and the
index. The sum of all bytes is the file's size. D1 and D2 PSNR are 10 log10(3 p^2 / MSE) with
p = 59.70 m and the MSE of the worse direction, as mpeg-pcc-dmetric computes them.";

#[derive(Debug, clap::Args)]
#[command(after_help = STATS_NOTES)]
pub struct StatsArgs {
    /// File to report on; `-` for stdin. With --steps also a folder of scans or a single scan, which is
    /// encoded in memory with the options below.
    #[arg(value_name = "FILE")]
    pub input: PathBuf,
    /// Report the time of each coding step and the bytes it produces, like Tables II to VI of the article
    /// behind --mode paper.
    #[arg(long, conflicts_with = "against")]
    pub steps: bool,
    /// Decode, and measure the error against these original scans.
    #[arg(long, value_name = "FOLDER", num_args = 1)]
    pub against: Vec<PathBuf>,
    /// Measure PSNR too, point to point (D1) and point to plane (D2), as MPEG does.
    #[arg(long, requires = "against")]
    pub psnr: bool,
    /// Decode, and write the trajectory of the scanner to this file in KITTI's pose format: a line of 12
    /// numbers for each frame, the rows of the 3 x 4 matrix that maps its points (metres, axes of the
    /// scanner) to the coordinates of the first frame. The poses are accumulated from frame-to-frame
    /// registration; they are not ground truth.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["steps", "against"])]
    pub poses: Option<PathBuf>,
    /// Overwrite the poses if they exist.
    #[arg(short, long, requires = "poses")]
    pub force: bool,
    #[command(flatten)]
    pub threads: Threads,
    /// Print the report as JSON; sizes in bytes, errors in metres, times in seconds.
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub coding: CodingArgs,
    #[command(flatten)]
    pub limits: LimitArgs,
}

#[derive(Debug, clap::Args)]
pub struct InfoArgs {
    /// Files to list, or folders, of which all streams are listed; `-` for stdin.
    #[arg(required = true, value_name = "FILE")]
    pub inputs: Vec<PathBuf>,
    /// Print the report as JSON; sizes and offsets in bytes.
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub limits: LimitArgs,
}

#[derive(Debug, clap::Args)]
pub struct VerifyArgs {
    /// Files to check, or folders, of which all streams are checked; `-` for stdin. All are checked, even if
    /// one is damaged.
    #[arg(required = true, value_name = "FILE")]
    pub inputs: Vec<PathBuf>,
    /// Compare with these original scans, byte for byte, and report missing ones.
    #[arg(long, value_name = "FOLDER", num_args = 1)]
    pub against: Vec<PathBuf>,
    /// Decode with the scalar code path instead of SIMD.
    ///
    /// Processors without these vector units use the scalar code path. The tests check that both give the
    /// same bytes; this option checks it for these files.
    #[arg(long)]
    pub deep: bool,
    #[command(flatten)]
    pub threads: Threads,
    /// Print the report as JSON on stdout.
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub limits: LimitArgs,
}

const CUT_EXAMPLES: &str = "\
Examples:
  lidarpc cut drive.lpc --frames 10..20 -o part.lpc     frames 10 to 19, the first being 0
  lidarpc cut drive.lpc --frames 600.. -o rest.lpc
  ssh host 'cat drive.lpc' | lidarpc cut - --frames ..5 -o start.lpc

Groups of frames are copied. Only if the range begins inside a group, the frames from there to the
group's end are coded again; they decode to the same bytes as before, even if they are lossy.";

#[derive(Debug, clap::Args)]
#[command(after_help = CUT_EXAMPLES)]
pub struct CutArgs {
    /// File to copy frames from; `-` for stdin.
    #[arg(value_name = "FILE")]
    pub input: PathBuf,
    /// Frames to copy, counted from 0: `5`, `10..20` (without 20), `10..=20`, `10..`, `..20`.
    #[arg(long, allow_negative_numbers = true, value_name = "RANGE", required_unless_present = "time")]
    pub frames: Option<FrameRange>,
    /// Frames to copy, by time since the first frame: `12s..15s` (without 15 s), `1m30s..`, `..0.5`.
    #[arg(long, allow_negative_numbers = true, value_name = "RANGE", conflicts_with = "frames")]
    pub time: Option<TimeRange>,
    /// File to write; `-` for stdout.
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
    /// Overwrite the output if it exists.
    #[arg(short, long)]
    pub force: bool,
    /// Print the report as JSON on stdout.
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub limits: LimitArgs,
}

const CAT_EXAMPLES: &str = "\
Examples:
  lidarpc cat morning.lpc evening.lpc -o day.lpc
  lidarpc cut drive.lpc --frames 10..20 -o - | lidarpc cat first.lpc - -o both.lpc

Frames keep their names, which must be unique, and are in the order of the files.";

#[derive(Debug, clap::Args)]
#[command(after_help = CAT_EXAMPLES)]
pub struct CatArgs {
    /// Files to join, in this order; `-` for stdin, at most once.
    #[arg(required = true, value_name = "FILE")]
    pub inputs: Vec<PathBuf>,
    /// File to write; `-` for stdout.
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
    /// Overwrite the output if it exists.
    #[arg(short, long)]
    pub force: bool,
    /// Print the report as JSON on stdout.
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub limits: LimitArgs,
}

#[derive(Debug, clap::Args)]
pub struct RepairArgs {
    /// Damaged file; `-` for stdin.
    #[arg(value_name = "FILE")]
    pub input: PathBuf,
    /// File to write; `-` for stdout.
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
    /// Overwrite the output if it exists.
    #[arg(short, long)]
    pub force: bool,
    /// Print the report as JSON on stdout.
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub limits: LimitArgs,
}

const VIEW_EXAMPLES: &str = "\
Examples:
  lidarpc view drive.lpc -o frame.png
  lidarpc view drive/ --mode paper --frame 7 --kind labels -o labels.png
  lidarpc view drive.lpc --against drive/ --kind error -o error.png
  lidarpc view drive.lpc --kind birds-eye -o above.png";

#[derive(Debug, clap::Args)]
#[command(after_help = VIEW_EXAMPLES)]
pub struct ViewArgs {
    /// Stream, or a folder of scans or a single scan, which is encoded in memory with the options below; `-`
    /// for a stream from stdin.
    #[arg(value_name = "INPUT")]
    pub input: PathBuf,
    /// Picture to write; `-` for stdout.
    #[arg(short, long, value_name = "FILE", required_unless_present = "html")]
    pub output: Option<PathBuf>,
    /// HTML page to write instead, which shows all frames in 3-D and plays them in any browser; `-` for
    /// stdout.
    ///
    /// The page is a single file that needs no server and no network. Its points are rounded: coordinates to
    /// 1 cm, other fields to 256 values.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["output", "frame", "kind", "against", "scale"])]
    pub html: Option<PathBuf>,
    /// Frames of the page, counted from 0: N, or A..B (without B). Default: all.
    #[arg(long, value_name = "FRAMES", requires = "html", conflicts_with = "output")]
    pub frames: Option<FrameRange>,
    /// Frame to draw, counted from 0.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub frame: u64,
    /// What to draw.
    #[arg(long, value_enum, default_value = "all")]
    pub kind: PictureKind,
    /// The original scans, to compute the error; needed for streams only.
    #[arg(long, value_name = "FOLDER", num_args = 1)]
    pub against: Vec<PathBuf>,
    /// Width of a range image column in pixels; a row is four times as high. Default: chosen so that the
    /// picture is about 1500 pixels wide.
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u16).range(1..=16))]
    pub scale: Option<u16>,
    /// Overwrite the picture or page if it exists.
    #[arg(short, long)]
    pub force: bool,
    #[command(flatten)]
    pub coding: CodingArgs,
}

/// Kinds of pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PictureKind {
    /// The range image, in metres.
    Range,
    /// Which cells hold a return.
    Occupancy,
    /// Ground brown, each object in a colour of its own, other returns grey.
    Labels,
    /// The regions that ranges are predicted from, each in a colour of its own; regions with a plane brown.
    Regions,
    /// The ranges predicted by the models of the regions, in metres.
    Prediction,
    /// The prediction residuals, in metres.
    Residual,
    /// The distances of points from the originals, in millimetres: from the points at the same place in the
    /// order or, if the order has changed, from the nearest points.
    Error,
    /// The points from above, coloured by height.
    BirdsEye,
    /// The points from behind the scanner and above, coloured by height.
    Perspective,
    /// The range image, and the points in perspective below it.
    Overview,
    /// All pictures of the range image, one below the other.
    All,
}

const BENCH_EXAMPLES: &str = "\
Examples:
  lidarpc bench drive/ --quick
  lidarpc bench drive/ --step 1cm --html report.html
  lidarpc bench drive/ --csv > report.csv

Frames are taken in runs spread over the drive: two runs of 10 for the tables, two of 3 for the figures.
The experiments choose coders, predictions and, for curves, steps themselves; of the options above only
--columns, --step, --level and those of outliers, registration and regions have an effect.

";

#[derive(Debug, clap::Args)]
#[command(after_help = format!("{BENCH_EXAMPLES}{ARTICLE}"))]
pub struct BenchArgs {
    /// Folder of scans, or a scan.
    #[arg(value_name = "INPUT")]
    pub input: PathBuf,
    /// Measure only the first three frames, with fewer points on the curves.
    #[arg(long)]
    pub quick: bool,
    #[command(flatten)]
    pub threads: Threads,
    /// Print the report as JSON.
    #[arg(long, conflicts_with = "csv")]
    pub json: bool,
    /// Print the report as one CSV table with a line for each value: section, series (row), x (column), its
    /// unit, y (value), its unit, and whether it is measured or published.
    #[arg(long)]
    pub csv: bool,
    /// Also write a self-contained HTML page with plots to this file; `-` for stdout, instead of text.
    #[arg(long, value_name = "FILE")]
    pub html: Option<PathBuf>,
    /// Overwrite the page if it exists.
    #[arg(short, long, requires = "html")]
    pub force: bool,
    #[command(flatten)]
    pub coding: CodingArgs,
}

#[derive(Debug, clap::Args)]
pub struct EstimateArgs {
    /// Folders of scans, or scans.
    #[arg(required = true, value_name = "INPUT")]
    pub inputs: Vec<PathBuf>,
    #[command(flatten)]
    pub threads: Threads,
    /// Print the report as JSON on stdout.
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub coding: CodingArgs,
}

#[derive(Debug, clap::Args)]
pub struct CompletionsArgs {
    /// The shell.
    #[arg(value_enum, value_name = "SHELL")]
    pub shell: clap_complete::Shell,
}

#[derive(Debug, clap::Args)]
pub struct ManArgs {
    /// Folder to write `lidarpc.1` and a page for each command into, created if missing. Default: write only
    /// the page of the program, to stdout.
    #[arg(short, long, value_name = "FOLDER")]
    pub output: Option<PathBuf>,
}

#[derive(Debug, clap::Args)]
pub struct SynthArgs {
    /// Folder to write the scans into, created if missing.
    #[arg(short, long, value_name = "FOLDER")]
    pub output: PathBuf,
    /// Number of scans; ten of them are one second of driving.
    #[arg(long, value_name = "N", default_value_t = SynthConfig::default().frames)]
    pub frames: usize,
    /// Seed of the random numbers: the same seed gives the same drive.
    #[arg(long, value_name = "S", default_value_t = SynthConfig::default().seed)]
    pub seed: u64,
    /// The scanner to simulate.
    #[arg(long, value_enum, default_value_t)]
    pub scanner: SimulatedScanner,
    /// Overwrite scans that exist.
    #[arg(short, long)]
    pub force: bool,
}

/// The scanners of the simulator.
#[derive(Clone, Copy, Debug, Default, ValueEnum)]
pub enum SimulatedScanner {
    /// Velodyne HDL-64E, as KITTI stores its scans.
    #[default]
    Hdl64,
    /// Velodyne VLP-16, as the ROS driver computes its points.
    Vlp16,
}

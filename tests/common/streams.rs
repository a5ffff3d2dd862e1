//! Small streams that use every section, as a basis for damage.

use std::sync::LazyLock;

use lidarpc::internals::article::image_coding::ImageCodec;
use lidarpc::internals::backend::{self, BACKENDS, Level};
use lidarpc::internals::container::{FrameHeader, Group, ScannerRecord, Section, SectionKind};
use lidarpc::internals::files::parse;
use lidarpc::internals::frame::settings::{Coder, EncoderConfig, Mode, PredictionChoice, ProjectionKind};
use lidarpc::internals::scanner::Scanner;
use lidarpc::internals::scanner::firings::Recipe;
use lidarpc::internals::scanner::motion::world::{Correction, Knot, Pose, Times, World};
use lidarpc::internals::stream::{DriveScanners, FrameInput, encode_known};

use super::firings::{image, made_up, moved_by_stamps, points, sorted, timed, with_echoes};
use super::formats::{kitti, pcd_extra, pcd_stamped, pcd_text};
use super::scans::{Points, compensated, random_points, scans, small};
use super::{File, decode_files, encode_files, put_together, take_apart};

/// Scanners and groups.
pub type Parts = (Vec<ScannerRecord>, Vec<Group>);

/// Small streams that together use every section, as parts: frames have some two hundred points, so that a
/// fuzzer makes hundreds of executions a second.
pub static STREAMS: LazyLock<Vec<Parts>> = LazyLock::new(|| {
    let [beams, firings @ ..] = &KNOWN[..] else { panic!("no scanners") };
    let frames = &beams.frames;
    let mut odd = frames[1].clone();
    odd.swap(40, 150);
    odd.splice(100..100, random_points(40, 1));
    odd[7][3] = f32::NAN;
    let scanner =
        vec![("0.bin", kitti(&frames[0])), ("1.bin", kitti(&odd)), ("2.pcd", pcd_extra(&frames[2]))];
    let still = vec![("0.bin", kitti(&frames[0])), ("1.bin", kitti(&frames[0]))];
    let random = random_points(100, 2);
    let others = vec![
        ("0.bin", [kitti(&random), vec![1; 9]].concat()),
        ("1.pcd", pcd_extra(&random)),
        ("2.pcd", pcd_text(&random)),
        ("3.bin", Vec::new()),
        ("4.ply", b"ply, or not".to_vec()),
    ];
    let coded = |known: &Known, files: &[(&str, Vec<u8>)], config: EncoderConfig| {
        let files: Vec<File> = files.iter().map(|(name, bytes)| (name.to_string(), bytes.clone())).collect();
        take_apart(&known.encode(&files, &config))
    };
    let no_scanner = Known::default();
    let mut streams = vec![
        coded(beams, &scanner, at_level(1)),
        coded(beams, &scanner, at_level(2)),
        coded(beams, &scanner, at_level(3)),
        coded(beams, &scanner, at_level(8)),
        coded(beams, &scanner, EncoderConfig::default()),
        coded(beams, &scanner, at_level(9)),
        coded(&no_scanner, &others, EncoderConfig::default()),
        moved(),
        moved_through_a_map(&firings[0]),
        stamped(),
        coded(&Known::ideal(), &scanner, with_back_end(backend::LZMA)),
        // P frames: by the context coder, as tokens and by a back-end.
        coded(beams, &still, at_level(9)),
        coded(beams, &still, EncoderConfig::default()),
        coded(beams, &scanner, halved(EncoderConfig::default())),
        coded(beams, &still, halved(at_level(8))),
        coded(beams, &still, halved(at_level(9))),
        coded(
            &Known::ideal(),
            &still,
            EncoderConfig { prediction: PredictionChoice::Smallest, ..with_back_end(backend::LZMA) },
        ),
    ];
    let by_image = |codec| EncoderConfig { coder: Coder::Image(codec), ..with_back_end(backend::LZMA) };
    streams.extend(ImageCodec::ALL.map(|codec| coded(&Known::ideal(), &still, by_image(codec))));
    let bounded = EncoderConfig::preset(Mode::Bounded { max_error_um: 20_000 });
    streams.extend([coded(beams, &scanner, bounded.clone()), coded(&no_scanner, &others, bounded.clone())]);
    streams.extend(
        BACKENDS.iter().map(|backend| coded(&Known::ideal(), &scanner[..1], with_back_end(backend.id()))),
    );
    for (number, known) in firings.iter().enumerate() {
        let [one, other] = [0, 1].map(|frame| &known.frames[frame % known.frames.len()]);
        let files = [("0.bin", kitti(one)), ("1.pcd", pcd_extra(other))];
        let levels = [1, 3, 6, 9];
        streams.push(coded(known, &files, at_level(levels[number % levels.len()])));
        if number % 4 == 0 {
            streams.push(coded(known, &files, bounded.clone()));
        }
    }
    streams
});

/// A scan that was compensated for the scanner's motion; more points are needed to detect this.
fn moved() -> Parts {
    let mut moved = compensated(&scans(&small(3, 1))[0], [0.001, 0.0, 0.03], [-0.8, 0.1, 0.02]);
    moved[3] = [f32::NAN, 1.0, -1.0, 0.5];
    let config = EncoderConfig { threads: 1, ..EncoderConfig::default() };
    take_apart(&encode_files(&[("0.bin".to_owned(), kitti(&moved))], &config))
}

/// A scan that was moved through the coordinates of a map. This is detected in whole turns only, so the
/// section that describes it is inserted into a small stream, after the sections of the measured points.
pub fn moved_through_a_map(known: &Known) -> Parts {
    let points = &known.frames[0];
    let measured: Vec<[f32; 3]> = points.iter().map(|&[x, y, z, _]| [x, y, z]).collect();
    let knot = |time, x| Knot { time, pose: Pose { position: [x, -x, 1 << 25], rotation: [1 << 28, -x, 7] } };
    let world = World {
        rotation: [0.1, -0.2, 3.0],
        origin: [1500.0, -20.0, 1.5],
        lattices: [Some(-13), None],
        times: Times { border: 1, short: 2 },
        first: vec![Pose { position: [1 << 20, 2, 3], rotation: [-4, 5, -6] }; 2],
        knots: vec![knot(0, -100), knot(400, 1 << 29), knot(401, 9)],
        corrections: vec![
            Correction { record: 3, steps: [1, 0], units: [0; 3] },
            Correction { record: 32, steps: [0, 0], units: [1 << 20, -1, 0] },
            Correction { record: 99, steps: [0; 2], units: [0, 0, -70_000] },
        ],
    };
    let mut moved = measured.clone();
    world.apply(&mut moved);
    let moved: Points = moved.iter().zip(points).map(|(&[x, y, z], point)| [x, y, z, point[3]]).collect();
    let (name, file) = ("0.bin".to_owned(), kitti(&moved));
    let (scanners, mut groups) =
        take_apart(&known.encode(&[(name.clone(), kitti(points))], &EncoderConfig::default()));
    let frame = &mut groups[0].frames[0];
    frame.header =
        FrameHeader { stamp: frame.header.stamp, ..FrameHeader::of(&name, &file, points.len() as u64) };
    frame.sections.push(Section { kind: SectionKind::World, payload: world.to_payload(&measured) });
    let decoded = decode_files(&put_together(&scanners, &groups)).expect("decodes");
    assert!(decoded == [(name, file)], "the section moves the points");
    (scanners, groups)
}

/// A scan that was compensated by time stamps, and sorted by them; more points are needed to detect this,
/// too.
fn stamped() -> Parts {
    let scanner = made_up(Recipe::Pandar64);
    let (mut points, rows, times) = super::firings::stamped(&scanner, &image(&scanner, 45), 2);
    points = moved_by_stamps(&points, &times, [2e-5, -3e-5, 4e-5], [1e-4, 2e-4, -3e-5]);
    points[30][2] += 0.25;
    let file = pcd_stamped(&sorted(&points, &times), &sorted(&rows, &times), &times);
    let known = Known { scanner: Some(Scanner::from(scanner)), frames: Vec::new() };
    take_apart(&known.encode(&[("0.pcd".to_owned(), file)], &EncoderConfig::default()))
}

/// A known scanner, which need not be fitted, and small scans of it.
#[derive(Default)]
pub struct Known {
    pub scanner: Option<Scanner>,
    pub frames: Vec<Points>,
}

/// One scanner with beams, then one of the `firings` family for each recipe, alternately with second returns
/// and interpolated ticks.
pub static KNOWN: LazyLock<Vec<Known>> = LazyLock::new(|| {
    let scans = scans(&small(3, 3));
    let files: Vec<_> = scans.iter().map(|points| parse("0.bin", kitti(points))).collect();
    // A part of the turn.
    let sector = |points: &Points| -> Points {
        points.iter().filter(|point| point[0] > 0.0 && point[1].abs() < 0.45 * point[0]).copied().collect()
    };
    let beams = Known { scanner: Scanner::fit(&files), frames: scans.iter().map(sector).collect() };
    assert!(beams.scanner.is_some() && beams.frames.iter().all(|points| (160..300).contains(&points.len())));
    let firings = Recipe::ALL.into_iter().enumerate().map(|(number, recipe)| {
        let scanner = made_up(recipe);
        let scanner = if number % 3 == 1 { timed(&scanner) } else { scanner };
        let mut images = vec![image(&scanner, 200), image(&scanner, 250)];
        if number % 2 == 1 {
            images = images.into_iter().map(with_echoes).collect();
        }
        let frames = images.iter().map(|image| points(&scanner, image)).collect();
        Known { scanner: Some(Scanner::from(scanner)), frames }
    });
    [beams].into_iter().chain(firings).collect()
});

impl Known {
    /// The article's scanner, with a small image.
    fn ideal() -> Self {
        let scanner = lidarpc::internals::scanner::ideal_of(None, 200, 10_000);
        Known { scanner: Some(Scanner::from(scanner)), frames: Vec::new() }
    }

    /// Encodes files as a stream of one group, with this scanner.
    pub fn encode(&self, files: &[File], config: &EncoderConfig) -> Vec<u8> {
        let inputs = files.iter().map(|(name, bytes)| FrameInput::memory(name.clone(), bytes.clone()));
        let config = EncoderConfig { gop: files.len().max(1), threads: 1, ..config.clone() };
        encode_known(inputs.collect(), &DriveScanners::new(vec![self.scanner.clone()]), &config)
            .expect("encodes")
    }
}

/// Exact mode at a level.
pub fn at_level(level: u8) -> EncoderConfig {
    EncoderConfig { level: Level::new(level).unwrap(), ..EncoderConfig::default() }
}

/// The same settings, but images are split into halves, however small.
pub fn halved(config: EncoderConfig) -> EncoderConfig {
    EncoderConfig { halved_from: 1, ..config }
}

/// Paper mode with a back-end and a small image.
pub fn with_back_end(id: u8) -> EncoderConfig {
    EncoderConfig {
        projection: ProjectionKind::Ideal { columns: 200, range_step_um: 10_000 },
        coder: Coder::Backend(id),
        ..EncoderConfig::preset(Mode::Paper)
    }
}

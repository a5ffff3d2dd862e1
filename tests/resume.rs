//! An interrupted encode continues to the same stream, or reports why it cannot; it never produces a
//! different one.

use std::fs::{self, File};
use std::sync::LazyLock;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::common::formats::kitti;
use crate::common::scans::{random_points, scans, small};
use crate::common::streams::with_back_end;
use crate::common::{File as Scan, encode_files, put_together, take_apart};
use lidarpc::internals::backend;
use lidarpc::internals::container::{FrameKind, Stamp};
use lidarpc::internals::edit::{PartialFiles, encode_resuming};
use lidarpc::internals::frame::settings::{EncoderConfig, Mode};
use lidarpc::internals::ground::error::Result;
use lidarpc::internals::stream::{EncodeStatistics, FrameInput, encode};
use serde_json::Value;
use tempfile::TempDir;

/// Seven frames, one of which is not a scan.
static FILES: LazyLock<Vec<Scan>> = LazyLock::new(|| {
    let frames = scans(&small(3, 7));
    let mut files: Vec<Scan> =
        (0..).zip(&frames).map(|(n, frame)| (format!("{n}.bin"), kitti(frame))).collect();
    files[1].1 = b"no scan".to_vec();
    files
});

fn exact() -> EncoderConfig {
    EncoderConfig { gop: 2, threads: 2, ..EncoderConfig::default() }
}

/// One mode of each kind: frame headers describe the input in the first only.
fn modes() -> [EncoderConfig; 3] {
    let bounded = EncoderConfig::preset(Mode::Bounded { max_error_um: 20_000 });
    [exact(), bounded, with_back_end(backend::LZMA)].map(|config| EncoderConfig {
        gop: 2,
        threads: 2,
        ..config
    })
}

/// Each folder is a drive; files below `beside` are not scans.
fn inputs(files: &[Scan]) -> Vec<FrameInput> {
    let folder = |name: &str| name.rsplit_once('/').map(|(folder, _)| folder.to_owned());
    let mut folders: Vec<_> = files.iter().map(|(name, _)| folder(name)).collect();
    folders.dedup();
    let input = |(name, bytes): &Scan| {
        let drive = folders.iter().position(|known| *known == folder(name)).unwrap();
        let kind = if name.starts_with("beside/") { FrameKind::Beside } else { FrameKind::File };
        let stamp = Stamp { kind, ..Stamp::default() };
        FrameInput::memory(name.clone(), bytes.clone()).stamped(stamp).of_drive(drive)
    };
    files.iter().map(input).collect()
}

/// A partial stream and its journal.
struct Partial(TempDir);

impl Partial {
    fn with(stream: &[u8], journal: &[u8]) -> Self {
        let partial = Partial(TempDir::new().unwrap());
        fs::write(partial.0.path().join("stream"), stream).unwrap();
        fs::write(partial.0.path().join("journal"), journal).unwrap();
        partial
    }

    /// The files of an encode that was interrupted at the very end.
    fn complete(files: &[Scan], config: &EncoderConfig) -> Self {
        let partial = Partial::with(b"", b"");
        let encoded = partial.encode(files, config).unwrap();
        assert_eq!(encoded.resumed_frames, 0);
        partial
    }

    fn encode(&self, files: &[Scan], config: &EncoderConfig) -> Result<EncodeStatistics> {
        let [stream, journal] = ["stream", "journal"].map(|name| self.0.path().join(name));
        let stream = File::options().read(true).write(true).open(stream).unwrap();
        let partial = PartialFiles { path: "out.partial".into(), stream, journal };
        let frames = AtomicUsize::new(0);
        let count = || _ = frames.fetch_add(1, Ordering::Relaxed);
        let encoded = encode_resuming(&inputs(files), config, partial, &count)?;
        assert_eq!(frames.into_inner(), files.len(), "frames heard of");
        Ok(encoded)
    }

    fn contents(&self) -> (Vec<u8>, Vec<u8>) {
        let read = |name| fs::read(self.0.path().join(name)).unwrap();
        (read("stream"), read("journal"))
    }

    /// Continues, which must end in `whole`; returns the number of frames that were kept.
    #[track_caller]
    fn becomes(&self, whole: &[u8], files: &[Scan], config: &EncoderConfig) -> u64 {
        let encoded = self.encode(files, config).unwrap();
        let (stream, journal) = self.contents();
        assert!(stream == whole, "another stream");
        assert_eq!(encoded.stream_bytes, whole.len() as u64);
        assert_eq!(encoded.file_bytes(), files.iter().map(|(_, bytes)| bytes.len() as u64).sum::<u64>());
        assert_eq!(ends(&journal).len(), files.len().div_ceil(config.gop), "the journal is not complete");
        encoded.resumed_frames
    }

    /// Continues, which must fail and leave everything unchanged; returns the error's line.
    #[track_caller]
    fn refuses(&self, files: &[Scan], config: &EncoderConfig) -> String {
        let before = self.contents();
        let error = self.encode(files, config).map(|_| ()).unwrap_err().to_string();
        assert!(self.contents() == before, "something was changed");
        assert!(error.contains("delete") && error.contains("without resuming"), "{error}");
        assert!(!error.contains('\n'), "{error}");
        error
    }
}

/// The ends of the groups in the stream, according to a journal.
fn ends(journal: &[u8]) -> Vec<usize> {
    let lines = journal.split_inclusive(|byte| *byte == b'\n').skip(1);
    let end = |line| serde_json::from_slice::<Value>(line).unwrap()["stream_end"].as_u64().unwrap() as usize;
    lines.map(end).collect()
}

#[test]
fn wherever_it_was_cut_the_stream_is_the_same() {
    for config in modes() {
        let whole = encode_files(&FILES, &config);
        let partial = Partial::complete(&FILES, &config);
        let (stream, journal) = partial.contents();
        assert!(stream == whole);
        assert_eq!(partial.becomes(&whole, &FILES, &config), FILES.len() as u64);

        let ends = ends(&journal);
        let around = ends.iter().flat_map(|end| [end - 1, *end, end + 1]);
        for cut in (0..whole.len()).step_by(whole.len() / 12).chain([1, 11, 12, 13]).chain(around) {
            let kept = ends.iter().filter(|end| **end <= cut).count() * config.gop;
            let taken = Partial::with(&stream[..cut], &journal).becomes(&whole, &FILES, &config);
            assert_eq!(taken, kept.min(FILES.len()) as u64, "of a stream cut at byte {cut}");
        }
    }
}

#[test]
fn drives_of_a_tree_and_files_beside_them_go_on_too() {
    let mut files: Vec<Scan> = Vec::new();
    for (drive, seed) in [("a", 3), ("b", 8)] {
        let scans = scans(&small(seed, 3));
        files.extend((0..).zip(&scans).map(|(n, scan)| (format!("{drive}/{n}.bin"), kitti(scan))));
    }
    files.extend((0..3).map(|n| (format!("beside/{n}.txt"), vec![b'0' + n; 50])));
    let mut whole = Vec::new();
    encode(&inputs(&files), &exact(), &mut whole, &|| ()).unwrap();
    let partial = Partial::with(b"", b"");
    partial.encode(&files, &exact()).unwrap();
    let (stream, journal) = partial.contents();
    assert!(stream == whole);
    let ends = ends(&journal);
    // Two groups of each drive.
    assert_eq!(ends.len(), 6);
    for (groups, end) in (1..).zip(&ends) {
        let resumed = Partial::with(&stream[..*end], &journal);
        let encoded = resumed.encode(&files, &exact()).unwrap();
        assert!(resumed.contents().0 == whole, "another stream, after {groups} groups");
        assert_eq!(encoded.resumed_frames, [2, 3, 5, 6, 8, 9][groups - 1]);
    }
}

#[test]
fn scans_of_two_scanners_in_turn_go_on_too() {
    let drives = [3, 8].map(|seed| scans(&small(seed, 3)));
    let name = |frame: usize, scanner: usize| format!("{frame}-{scanner}.bin");
    let files: Vec<Scan> = (0..6).map(|n| (name(n / 2, n % 2), kitti(&drives[n % 2][n / 2]))).collect();
    let whole = encode_files(&files, &exact());
    let tracks = take_apart(&whole).1.iter().map(|group| group.scanners.len()).max();
    assert_eq!(tracks, Some(2));
    let (stream, journal) = Partial::complete(&files, &exact()).contents();
    for (groups, end) in (1..).zip(ends(&journal)) {
        let taken = Partial::with(&stream[..end], &journal).becomes(&whole, &files, &exact());
        assert_eq!(taken, 2 * groups);
    }
}

#[test]
fn wherever_the_journal_was_cut_the_stream_is_the_same() {
    let whole = encode_files(&FILES, &exact());
    let (stream, journal) = Partial::complete(&FILES, &exact()).contents();
    let head = journal.iter().position(|byte| *byte == b'\n').unwrap() + 1;
    for cut in (head..journal.len()).step_by(47).chain([journal.len() - 1]) {
        let lines = journal[head..cut].iter().filter(|byte| **byte == b'\n').count();
        let taken = Partial::with(&stream, &journal[..cut]).becomes(&whole, &FILES, &exact());
        assert_eq!(taken, (lines * exact().gop) as u64, "of a journal cut at byte {cut}");
    }
    for cut in [0, 1, head - 1] {
        Partial::with(&stream, &journal[..cut]).refuses(&FILES, &exact());
        assert_eq!(Partial::with(b"", &journal[..cut]).becomes(&whole, &FILES, &exact()), 0);
    }
}

#[test]
fn what_was_interrupted_often_goes_on_too() {
    let whole = encode_files(&FILES, &exact());
    let mut partial = Partial::complete(&FILES, &exact());
    for kept in [3, 1, 2] {
        let (stream, journal) = partial.contents();
        partial = Partial::with(&stream[..ends(&journal)[kept - 1] + 5], &journal);
        assert_eq!(partial.becomes(&whole, &FILES, &exact()), (kept * exact().gop) as u64);
    }
}

#[test]
fn damage_costs_groups_and_never_changes_the_stream() {
    let whole = encode_files(&FILES, &exact());
    let (stream, journal) = Partial::complete(&FILES, &exact()).contents();
    let ends = ends(&journal);
    for place in (0..stream.len()).step_by(stream.len() / 20) {
        let mut damaged = stream.clone();
        damaged[place] ^= 0x10;
        let kept = ends.iter().filter(|end| **end <= place).count() * exact().gop;
        let taken = Partial::with(&damaged, &journal).becomes(&whole, &FILES, &exact());
        assert_eq!(taken, kept.min(FILES.len()) as u64, "damaged at byte {place}");
    }
    let mut went_on = 0;
    for place in (0..journal.len()).step_by(31) {
        let mut damaged = journal.clone();
        damaged[place] ^= 0x10;
        let partial = Partial::with(&stream, &damaged);
        match partial.encode(&FILES, &exact()) {
            Ok(_) => assert!(partial.contents().0 == whole, "damaged at byte {place}"),
            Err(_) => {
                assert!(partial.contents() == (stream.clone(), damaged));
                continue;
            }
        }
        went_on += 1;
    }
    assert!(went_on > 0);
}

#[test]
fn other_settings_are_refused() {
    let partial = Partial::complete(&FILES, &exact());
    for (config, what) in [
        (EncoderConfig { gop: 3, ..exact() }, "gop: 2, now 3"),
        (modes()[1].clone(), "largest error: none, now "),
        (
            EncoderConfig { order: lidarpc::internals::frame::settings::FrameOrder::Time, ..exact() },
            "order: Ratio, now Time",
        ),
    ] {
        let error = partial.refuses(&FILES, &config);
        assert!(error.starts_with("out.partial was begun with other settings"), "{error}");
        assert!(error.contains(what), "{error}");
    }
    // If nothing is kept, there is no difference.
    let gop_3 = EncoderConfig { gop: 3, ..exact() };
    let (stream, journal) = partial.contents();
    let begun = Partial::with(&stream[..100], &journal);
    assert_eq!(begun.becomes(&encode_files(&FILES, &gop_3), &FILES, &gop_3), 0);

    let one_thread = EncoderConfig { threads: 1, ..exact() };
    assert_eq!(partial.becomes(&encode_files(&FILES, &exact()), &FILES, &one_thread), 7);

    let (stream, journal) = Partial::complete(&FILES, &exact()).contents();
    let journal = String::from_utf8(journal).unwrap().replacen(env!("CARGO_PKG_VERSION"), "0.0.9", 1);
    let error = Partial::with(&stream, journal.as_bytes()).refuses(&FILES, &exact());
    assert!(error.contains("lidarpc: 0.0.9, now"), "{error}");
    // A journal that claims fewer frames.
    let journal = journal.replacen("0.0.9", env!("CARGO_PKG_VERSION"), 1).replacen("\"7\"", "\"4\"", 1);
    let error = Partial::with(&stream, journal.as_bytes()).refuses(&FILES[..4], &exact());
    assert!(error.contains("more frames"), "{error}");
}

#[test]
fn other_frames_are_refused() {
    for config in modes() {
        let (stream, journal) = Partial::complete(&FILES, &config).contents();
        let ends = ends(&journal);
        // The first four frames.
        let partial = Partial::with(&stream[..ends[1] + 9], &journal);
        let changed = |change: &dyn Fn(&mut Vec<Scan>)| {
            let mut files = FILES.clone();
            change(&mut files);
            partial.refuses(&files, &config)
        };
        let was_changed = "2.bin was changed after out.partial was begun with it";
        let error = changed(&|files| files[2].1[1000] ^= 1);
        assert!(error.starts_with(was_changed), "{error}");
        let error = changed(&|files| files[2].1.truncate(1600));
        assert!(error.starts_with(was_changed), "{error}");
        let error = changed(&|files| files[3].0 = "3b.bin".to_owned());
        assert!(error.contains("other frames (\"3.bin\", now \"3b.bin\")"), "{error}");
        let error = changed(&|files| files.swap(0, 1));
        assert!(error.contains("other frames"), "{error}");
        let error = changed(&|files| drop(files.pop()));
        assert!(error.contains("frames: 7, now 6"), "{error}");
        let error = changed(&|files| files.push(("8.bin".to_owned(), b"more".to_vec())));
        assert!(error.contains("frames: 7, now 8"), "{error}");
        let error = changed(&|files| {
            let other = scans(&small(4, 7));
            files.iter_mut().zip(&other).for_each(|(file, other)| file.1 = kitti(other));
        });
        assert!(error.starts_with("0.bin was changed"), "{error}");
    }
}

#[test]
fn a_sample_that_was_changed_is_refused() {
    let (stream, journal) = Partial::complete(&FILES, &exact()).contents();
    let partial = Partial::with(&stream[..ends(&journal)[0]], &journal);
    let mut files = FILES.clone();
    let other = scans(&small(4, 7));
    files.iter_mut().zip(&other).skip(2).for_each(|(file, other)| file.1 = kitti(other));
    assert!(partial.refuses(&files, &exact()).contains("another scanner model"));
}

#[test]
fn what_is_not_encoded_yet_may_change() {
    let mut files: Vec<Scan> = (0..5).map(|n| (format!("{n}.bin"), kitti(&random_points(200, n)))).collect();
    let (stream, journal) = Partial::complete(&files, &exact()).contents();
    let partial = Partial::with(&stream[..ends(&journal)[1]], &journal);
    files[4].1 = kitti(&random_points(300, 9));
    assert_eq!(partial.becomes(&encode_files(&files, &exact()), &files, &exact()), 4);
}

#[test]
fn files_that_are_no_partial_stream_stay() {
    let (stream, journal) = Partial::complete(&FILES, &exact()).contents();
    for (garbage, journal) in [
        (&b"somebody's"[..], &b""[..]),
        (&stream, b""),
        (&stream, b"{}\n"),
        (b"somebody's", b"\x89LPC and so on\n\n"),
    ] {
        let error = Partial::with(garbage, journal).refuses(&FILES, &exact());
        assert!(error.starts_with("out.partial has no journal"), "{error}");
    }
    // A valid journal with another stream, even one of the same names and settings.
    let whole = encode_files(&FILES, &exact());
    let mut others = FILES.clone();
    others[0].1 = kitti(&random_points(200, 1));
    let other = encode_files(&others, &exact());
    // A complete one that differs in a byte of its first frame.
    let (models, mut groups) = take_apart(&whole);
    groups[0].frames[0].sections[0].payload[3] ^= 1;
    let forged = put_together(&models, &groups);
    assert_eq!(forged.len(), whole.len());
    // One with other names than its journal.
    let renamed: Vec<Scan> = FILES.iter().map(|(name, bytes)| (format!("a{name}"), bytes.clone())).collect();
    let (stream_of_renamed, journal_of_renamed) = Partial::complete(&renamed, &exact()).contents();
    let misnamed = String::from_utf8(journal_of_renamed).unwrap().replace("\"a", "\"");
    for (stream, journal) in [
        (&b"garbage"[..], &journal[..]),
        (&[0; 10_000], &journal),
        (&other, &journal),
        (&forged, &journal),
        (&stream_of_renamed, misnamed.as_bytes()),
    ] {
        assert_eq!(Partial::with(stream, journal).becomes(&whole, &FILES, &exact()), 0);
    }
    // Bytes after the end are not part of the stream.
    let longer = [&whole[..], &[7; 1000]].concat();
    assert_eq!(Partial::with(&longer, &journal).becomes(&whole, &FILES, &exact()), 7);
}

//! Streams cut and joined: any range of frames, groups of any length, every kind of frame.

use std::io::Cursor;
use std::sync::LazyLock;

use crate::common::formats::{kitti, nuscenes, pcd_extra, pcd_text, ply};
use crate::common::scans::{moved, random_points, scans, shuffled, small};
use crate::common::{File, cases, decode_files, encode_files, put_together, take_apart};
use lidarpc::internals::article::image_coding::{ImageCodec, ImageConfig, Rate};
use lidarpc::internals::backend;
use lidarpc::internals::container::{CodedFrame, Group, SectionKind, StreamReader};
use lidarpc::internals::edit::{Cut, Joined, Named, cat, cut, cut_indexed};
use lidarpc::internals::frame::settings::{Coder, EncoderConfig, Mode, PredictionChoice, ProjectionKind};
use lidarpc::internals::frame::{FrameParameters, IntensityFidelity, Prediction};
use lidarpc::internals::ground::error::{Error, Limits, Result};
use lidarpc::internals::stream::FrameRange;
use lidarpc::internals::study::synth::SynthConfig;
use proptest::prelude::*;

const LENGTHS: [usize; 4] = [1, 2, 3, 7];

/// Streams of seven frames each, by the length of their groups: exact, in paper mode, exact by a back-end, by
/// context in paper mode, by image coders.
static STREAMS: LazyLock<Vec<Vec<Vec<u8>>>> = LazyLock::new(|| {
    let paper = EncoderConfig {
        projection: ProjectionKind::Ideal { columns: 400, range_step_um: 5000 },
        ..EncoderConfig::preset(Mode::Paper)
    };
    let smallest = EncoderConfig {
        coder: Coder::Backend(backend::LZMA),
        prediction: PredictionChoice::Smallest,
        ..EncoderConfig::default()
    };
    let context = EncoderConfig {
        coder: Coder::Context,
        prediction: PredictionChoice::Always(Prediction::None),
        ..paper.clone()
    };
    let of = |config: &EncoderConfig| {
        let config = |gop| EncoderConfig { gop, threads: 2, ..config.clone() };
        LENGTHS.map(|gop| encode_files(&odd_drive(), &config(gop))).to_vec()
    };
    let images = ImageCodec::ALL.map(|codec| EncoderConfig {
        coder: Coder::Image(codec),
        image: ImageConfig { passes: 2, rate: Rate::Bits(8.0) },
        intensity: IntensityFidelity::Exact,
        ..paper.clone()
    });
    [&[EncoderConfig::default(), paper, smallest, context], &images[..]].concat().iter().map(of).collect()
});

/// Scans of one scanner, in order and not, in several formats, and a file that is not a scan.
fn odd_drive() -> Vec<File> {
    let scans = scans(&small(1, 3));
    let files = [
        kitti(&scans[0]),
        pcd_extra(&shuffled(&scans[1], 5)),
        b"no scan at all".to_vec(),
        nuscenes(&scans[1]),
        [kitti(&scans[2]), kitti(&random_points(90, 3)), vec![1, 2, 3]].concat(),
        pcd_text(&scans[2][..200]),
        ply(&moved(&scans[0])),
    ];
    (0..).zip(files).map(|(n, bytes)| (format!("{n}.bin"), bytes)).collect()
}

fn named<T>(stream: T) -> Named<T> {
    Named { path: "in.lpc".into(), stream }
}

fn frames(start: usize, end: usize) -> FrameRange {
    FrameRange { start: start as u64, end: Some(end as u64) }
}

/// Cuts from a pipe and by the index, which must be the same.
fn cut_both_ways(stream: &[u8], range: FrameRange) -> (Vec<u8>, Cut) {
    let (mut piped, mut indexed) = (Vec::new(), Vec::new());
    let done = cut(named(stream), range, &Limits::default(), &mut piped).unwrap();
    let again = cut_indexed(named(Cursor::new(stream)), range, &Limits::default(), &mut indexed).unwrap();
    assert!(piped == indexed && done == again);
    assert_eq!(done.stream_bytes, piped.len() as u64);
    (piped, done)
}

fn join(streams: &[&[u8]]) -> Result<(Vec<u8>, Joined)> {
    let open = |stream| StreamReader::open(stream, Limits::default()).map(named);
    let mut out = Vec::new();
    let joined = cat(streams.iter().map(|stream| open(*stream)), &mut out)?;
    assert_eq!(joined.stream_bytes, out.len() as u64);
    Ok((out, joined))
}

fn groups(stream: &[u8]) -> Vec<Group> {
    take_apart(stream).1
}

proptest! {
    #![proptest_config(cases(48))]

    #[test]
    fn any_range_decodes_as_in_the_whole(
        kind in 0..6usize, length in 0..LENGTHS.len(), start in 0..7usize, count in 1..8usize,
    ) {
        let (stream, gop, end) = (&STREAMS[kind][length], LENGTHS[length], (start + count).min(7));
        let (part, done) = cut_both_ways(stream, frames(start, end));
        prop_assert!(decode_files(&part).unwrap() == decode_files(stream).unwrap()[start..end]);

        let inside = start.next_multiple_of(gop).min(end) - start;
        let expected = Cut { recoded: inside as u64, copied: (end - start - inside) as u64, ..done };
        prop_assert_eq!(done, expected);
        let (old, new) = (groups(stream), groups(&part));
        let headers = |groups: &[Group]| -> Vec<_> {
            groups.iter().flat_map(|group| &group.frames).map(|frame| frame.header.clone()).collect()
        };
        prop_assert_eq!(headers(&new), &headers(&old)[start..end]);
        let skipped = usize::from(inside > 0);
        for (group, copied) in old[start.div_ceil(gop)..].iter().zip(&new[skipped.min(new.len())..]) {
            prop_assert_eq!(&group.frames[..copied.frames.len()], &copied.frames[..]);
        }
    }

    #[test]
    fn parts_that_are_joined_are_the_whole(
        kind in 0..6usize, length in 0..LENGTHS.len(), middle in 1..7usize,
    ) {
        let (stream, gop) = (&STREAMS[kind][length], LENGTHS[length]);
        let (start, _) = cut_both_ways(stream, frames(0, middle));
        let (end, _) = cut_both_ways(stream, frames(middle, 7));
        let (whole, joined) = join(&[&start, &end]).unwrap();
        prop_assert_eq!((joined.streams, joined.frames), (2, 7));
        prop_assert!(decode_files(&whole).unwrap() == decode_files(stream).unwrap());
        if middle % gop == 0 {
            prop_assert!(whole == *stream, "groups are copied whole");
        }
        prop_assert!(take_apart(&whole).0.len() == take_apart(stream).0.len(), "a scanner model is there twice");
    }
}

/// A recoded first frame of a group equals the encoder's.
#[test]
fn frames_are_coded_again_as_they_were() {
    // With the context coder: back-ends predict the first frame of a group from regions, which a P frame does
    // not have.
    let is_whole = |(_, groups): &(_, Vec<Group>)| {
        groups[0].frames[0].sections.iter().any(|section| section.kind == SectionKind::Bytes)
    };
    let mut compared = 0;
    for kind in [0, 3] {
        for number in 1..7 {
            let [copied, .., recoded] = &STREAMS[kind][..] else { panic!("no streams") };
            let [copied, recoded] =
                [copied, recoded].map(|stream| cut_both_ways(stream, frames(number, number + 1)));
            assert_eq!((copied.1.copied, recoded.1.recoded), (1, 1));
            let parts = [&copied.0, &recoded.0].map(|stream| take_apart(stream));
            // Files that no model fits are coded as a whole or not, as those before them in their group were.
            if is_whole(&parts[0]) == is_whole(&parts[1]) {
                assert!(parts[0] == parts[1], "kind {kind}, frame {number}");
                compared += 1;
            }
        }
    }
    assert!(compared > 8, "{compared} frames compared");
}

/// A frame whose reference is kept after a cut keeps its coded image, byte for byte; one that has lost its
/// reference is recoded by the context coder. Neither loses anything further.
#[test]
fn images_are_written_again_as_they_are() {
    // The scanner stands still, so that there are P frames.
    let scan = kitti(&scans(&small(1, 1))[0]);
    let files: Vec<File> = (0..4).map(|n| (format!("{n}.bin"), scan.clone())).collect();
    for codec in ImageCodec::ALL {
        let config = EncoderConfig {
            projection: ProjectionKind::CALIBRATED,
            coder: Coder::Image(codec),
            image: ImageConfig { passes: 2, rate: Rate::Bits(8.0) },
            ..EncoderConfig::preset(Mode::Paper)
        };
        let stream = encode_files(&files, &config);
        let whole = decode_files(&stream).unwrap();
        let coded = |stream: &[u8]| groups(stream).swap_remove(0).frames;
        let payload = |frame: &CodedFrame| {
            let residual = frame.sections.iter().find(|section| section.kind == SectionKind::Residual);
            residual.map(|section| section.payload.clone())
        };
        let mut left_alone = 0;
        for start in 1..4 {
            let (part, _) = cut_both_ways(&stream, frames(start, 4));
            assert!(decode_files(&part).unwrap() == whole[start..]);
            for (number, (before, after)) in coded(&stream)[start..].iter().zip(&coded(&part)).enumerate() {
                let is_predicted = FrameParameters::of(before).unwrap().prediction == Prediction::Inter;
                assert!(payload(before).is_some());
                let expected = payload(before).filter(|_| number > 0 || !is_predicted);
                left_alone += usize::from(expected.is_none());
                assert!(payload(after) == expected, "{codec:?}, cut at {start}, frame {number} after it");
            }
        }
        assert!(left_alone > 0, "no cut was before a P frame");
    }
}

#[test]
fn every_stream_keeps_its_own_scanner() {
    let drive = |config: SynthConfig, prefix: &str| {
        let scans = scans(&config);
        let files = (0..).zip(&scans).map(|(n, points)| (format!("{prefix}{n}.bin"), kitti(points)));
        let config = EncoderConfig { gop: 2, threads: 1, ..EncoderConfig::default() };
        encode_files(&files.collect::<Vec<_>>(), &config)
    };
    let one = drive(small(1, 3), "a");
    let other = drive(SynthConfig { beams: 16, thinning: 20, ..small(7, 3) }, "b");
    let again = drive(small(1, 3), "c");
    let (all, joined) = join(&[&one, &other, &again]).unwrap();
    assert_eq!((joined.streams, joined.frames), (3, 9));
    let (models, joined_groups) = take_apart(&all);
    assert_eq!(models, [take_apart(&one).0, take_apart(&other).0].concat());
    assert_eq!(
        joined_groups.iter().map(|group| group.scanners.clone()).collect::<Vec<_>>(),
        [0, 0, 1, 1, 0, 0].map(|place: usize| vec![Some(models[place].id())])
    );
    let expected = [&one, &other, &again].map(|stream| decode_files(stream).unwrap()).concat();
    assert!(decode_files(&all).unwrap() == expected);

    let (part, _) = cut_both_ways(&all, frames(4, 8));
    assert!(decode_files(&part).unwrap() == expected[4..8]);
    let (models, groups) = take_apart(&part);
    assert_eq!(models, [take_apart(&other).0, take_apart(&one).0].concat());
    assert_eq!(
        groups.iter().map(|group| group.scanners.clone()).collect::<Vec<_>>(),
        [0, 0, 1].map(|place: usize| vec![Some(models[place].id())])
    );
    assert!(
        take_apart(&cut_both_ways(&all, frames(3, 6)).0).0 == take_apart(&other).0,
        "a model nobody needs"
    );
}

#[test]
fn only_the_groups_asked_for_are_read_through_the_index() {
    let mut stream = STREAMS[0][1].clone();
    let mut reader = StreamReader::open(&stream[..], Limits::default()).unwrap();
    while reader.next_record().unwrap().is_some() {}
    let damaged = reader.index().groups[0].clone();
    stream[(damaged.offset + damaged.length / 2) as usize] ^= 1;
    let indexed = |start| {
        let input = named(Cursor::new(&stream));
        cut_indexed(input, frames(start, 7), &Limits::default(), std::io::sink()).map_err(|e| e.to_string())
    };
    assert_eq!(indexed(3).unwrap().recoded, 1);
    assert!(indexed(1).unwrap_err().starts_with("in.lpc: damaged stream: group 0: "));
    let piped = cut(named(&stream[..]), frames(3, 7), &Limits::default(), std::io::sink());
    assert!(piped.unwrap_err().to_string().starts_with("in.lpc: damaged stream: group 0"));
}

#[test]
fn a_frame_that_decodes_to_something_else_is_not_coded_again() {
    let (models, mut groups) = take_apart(&STREAMS[0][2]);
    groups[0].frames[1].header.file_crc ^= 1;
    let stream = put_together(&models, &groups);
    let error = cut(named(&stream[..]), frames(1, 7), &Limits::default(), std::io::sink()).unwrap_err();
    assert_eq!(
        error.to_string(),
        "in.lpc: damaged stream: frame 1 (\"1.bin\"): the decoded file's checksum does not match"
    );
    assert!(cut(named(&stream[..]), frames(2, 7), &Limits::default(), std::io::sink()).is_ok());
}

#[test]
fn limits_are_kept() {
    for limits in
        [Limits { points: 300, ..Limits::default() }, Limits { record_bytes: 99, ..Limits::default() }]
    {
        let error = cut(named(&STREAMS[0][3][..]), frames(1, 7), &limits, std::io::sink()).unwrap_err();
        let Error::At { source, .. } = error else { panic!("{error}") };
        assert!(matches!(*source, Error::LimitExceeded { .. }), "{source}");
    }
}

#[test]
fn two_frames_of_one_name_are_refused() {
    let stream = &STREAMS[0][1][..];
    let (part, _) = cut_both_ways(stream, frames(2, 3));
    let error = join(&[stream, &part]).unwrap_err().to_string();
    assert!(
        error.starts_with("in.lpc: frame 0 (\"2.bin\") has the same name as frame 2 of in.lpc; "),
        "{error}"
    );
}

#[test]
fn a_file_and_a_folder_of_one_name_are_refused() {
    let stream = |name: &str| encode_files(&[(name.to_owned(), vec![1; 16])], &EncoderConfig::default());
    for (first, second) in [("a", "a/1.bin"), ("a/b/1.bin", "a/b")] {
        let error = join(&[&stream(first), &stream("b.bin"), &stream(second)]).unwrap_err().to_string();
        let expected = format!("in.lpc: frame 0 ({second:?}) needs a file and a folder of one name; ");
        assert!(error.starts_with(&expected), "{error}");
    }
}

#[test]
fn streams_without_frames_are_cut_and_joined() {
    let empty = put_together(&[], &[]);
    assert!(cut_both_ways(&empty, FrameRange::default()).0 == empty);
    assert!(join(&[]).unwrap().0 == empty);
    assert!(join(&[&empty, &STREAMS[0][1], &empty]).unwrap().0 == STREAMS[0][1]);
    assert!(cut(named(&empty[..]), frames(0, 1), &Limits::default(), std::io::sink()).is_err());
}

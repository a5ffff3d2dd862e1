//! Recordings: after packing and unpacking, every message, channel and attachment is unchanged.

use std::collections::BTreeMap;
use std::io::{self, Cursor, Read};

use crate::common::messages::cloud;
use crate::common::scans::{Points, scans};
use lidarpc::internals::study::synth::{SynthConfig, SynthScanner};
use lidarpc::recordings::internals::{Encoding, points as points_of, scan};
use lidarpc::recordings::{Clouds, CopySummary, TopicFilter, examine, pack, same_messages, unpack};
use lidarpc::{Encoder, Error, Limits, Scans, Settings};
use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, Compression, WriteOptions};
use predicates::prelude::PredicateBooleanExt;

/// A message with its channel's number, topic, schema and metadata, its sequence number, both its times and
/// its bytes.
type OneMessage = (u16, String, String, BTreeMap<String, String>, u32, u64, u64, Vec<u8>);
/// Everything that a reader of recordings can see: messages, attachments with their names, metadata.
type Contents = (Vec<OneMessage>, Vec<(String, Vec<u8>)>, Vec<Metadata>);

fn contents(recording: &[u8]) -> Contents {
    let messages = mcap::MessageStream::new(recording).unwrap().map(|message| {
        let message = message.unwrap();
        let channel = &message.channel;
        let schema = channel.schema.as_ref().map_or(String::new(), |schema| schema.name.clone());
        let metadata = channel.metadata.clone();
        let times = (message.log_time, message.publish_time);
        (
            channel.id,
            channel.topic.clone(),
            schema,
            metadata,
            message.sequence,
            times.0,
            times.1,
            message.data.to_vec(),
        )
    });
    let messages = messages.collect();
    let summary = mcap::Summary::read(recording).unwrap().expect("a summary");
    let attachments = summary.attachment_indexes.iter().map(|index| {
        let attachment = mcap::read::attachment(recording, index).unwrap();
        (attachment.name, attachment.data.to_vec())
    });
    let metadata =
        summary.metadata_indexes.iter().map(|index| mcap::read::metadata(recording, index).unwrap());
    (messages, attachments.collect(), metadata.collect())
}

/// Turns of a VLP-16.
fn turns(frames: usize) -> Vec<Points> {
    let synth = SynthConfig { scanner: SynthScanner::Vlp16, frames, thinning: 4, ..SynthConfig::default() };
    scans(&synth)
}

/// A recording with two topics of clouds, one of them with a damaged message, and one of text.
fn recording(compression: Option<Compression>, is_cdr: bool) -> Vec<u8> {
    let options = WriteOptions::new().compression(compression).profile("ros2").chunk_size(Some(100_000));
    let mut out = options.create(Cursor::new(Vec::new())).unwrap();
    let of = |kind| if is_cdr { format!("sensor_msgs/msg/{kind}") } else { format!("sensor_msgs/{kind}") };
    let (encoding, message_encoding) = if is_cdr { ("ros2msg", "cdr") } else { ("ros1msg", "ros1") };
    let clouds = out.add_schema_with_id(3, &of("PointCloud2"), encoding, b"the fields of a cloud").unwrap();
    let text = out.add_schema_with_id(5, "std_msgs/msg/String", encoding, b"string data").unwrap();
    let metadata = BTreeMap::from([("offered_qos_profiles".to_owned(), "- history: 3".to_owned())]);
    let front = out.add_channel_with_id(1, clouds, "/front/points", message_encoding, &metadata).unwrap();
    let rear =
        out.add_channel_with_id(2, clouds, "/rear/points", message_encoding, &BTreeMap::new()).unwrap();
    let words = out.add_channel_with_id(9, text, "/words", message_encoding, &BTreeMap::new()).unwrap();
    let mut sequence = 0;
    let mut write = |channel_id, data: &[u8]| {
        sequence += 1;
        let (log_time, publish_time) = (u64::from(sequence) * 1000, u64::from(sequence) * 1000 - 7);
        let header = MessageHeader { channel_id, sequence, log_time, publish_time };
        out.write_to_known_channel(&header, data).unwrap();
    };
    for (number, points) in turns(4).iter().enumerate() {
        let whole = cloud(points, is_cdr, false);
        write(front, &whole);
        write(words, b"hello");
        write(rear, &cloud(points, is_cdr, is_cdr));
        if number == 1 {
            write(front, &whole[..whole.len() / 2]);
            write(front, b"");
            write(rear, &cloud(&Points::new(), is_cdr, false));
        }
    }
    let (name, media_type) = ("calibration.yaml".to_owned(), "text/yaml".to_owned());
    let data = b"roll: 0".as_slice().into();
    out.attach(&Attachment { log_time: 5, create_time: 6, name, media_type, data }).unwrap();
    let facts = BTreeMap::from([("operator".to_owned(), "me".to_owned())]);
    out.write_metadata(&Metadata { name: "drive".to_owned(), metadata: facts }).unwrap();
    out.finish().unwrap();
    out.into_inner().into_inner()
}

fn packed(recording: &[u8], settings: &Settings, filter: &TopicFilter) -> (Vec<u8>, CopySummary) {
    let mut out = Cursor::new(Vec::new());
    let copied = pack(Cursor::new(recording), &mut out, settings, filter, &|| ()).unwrap();
    (out.into_inner(), copied)
}

fn unpacked(recording: &[u8]) -> (Vec<u8>, CopySummary) {
    let mut out = Cursor::new(Vec::new());
    let copied = unpack(recording, &mut out, 2, Limits::default(), &|| ()).unwrap();
    (out.into_inner(), copied)
}

#[test]
fn recordings_come_back_message_by_message() {
    for (compression, is_cdr) in
        [(None, true), (Some(Compression::Lz4), true), (Some(Compression::Zstd), false)]
    {
        let original = recording(compression, is_cdr);
        let (small, copied) = packed(&original, &Settings::default(), &TopicFilter::default());
        assert_eq!((copied.messages, copied.clouds, copied.kept), (15, 9, 2));
        assert_eq!((copied.attachments, copied.damage), (2, None));
        let (before, after) = (copied.cloud_bytes_before, copied.cloud_bytes_after);
        assert!(after * 8 < before, "{before} bytes of clouds to {after}");
        // Any reader sees the same topics, times and sequence numbers.
        let (messages, of_packed) = (contents(&original).0, contents(&small).0);
        assert_eq!(messages.len(), of_packed.len());
        for (message, packed) in messages.iter().zip(&of_packed) {
            assert_eq!(
                (&message.1, message.4, message.5, message.6),
                (&packed.1, packed.4, packed.5, packed.6)
            );
        }
        let (restored, back) = unpacked(&small);
        assert_eq!((back.messages, back.clouds), (15, 9));
        assert_eq!(contents(&restored), contents(&original));
    }
}

#[test]
fn topics_that_are_not_asked_for_are_copied() {
    let original = recording(None, true);
    let filter = TopicFilter { topics: vec!["/rear/points".to_owned()] };
    let (small, copied) = packed(&original, &Settings::default(), &filter);
    assert_eq!((copied.clouds, copied.kept), (5, 0));
    assert_eq!(contents(&unpacked(&small).0), contents(&original));
    let mut out = Cursor::new(Vec::new());
    let again = pack(Cursor::new(&small), &mut out, &Settings::default(), &TopicFilter::default(), &|| ());
    assert!(again.unwrap_err().to_string().contains("packed already"));
}

/// Two topics of clouds with the highest channel numbers; the second channel and its schema come after
/// messages of the first.
fn numbered_from_the_top(repeats: bool) -> Vec<u8> {
    let options = WriteOptions::new().chunk_size(Some(1000)).repeat_channels(repeats).repeat_schemas(repeats);
    let mut out = options.create(Cursor::new(Vec::new())).unwrap();
    let points = &turns(1)[0];
    for (sequence, (schema, channel)) in [(7, 3), (65535, 65534), (65533, 65535)].into_iter().enumerate() {
        let text = format!("the fields of a cloud, {sequence}");
        let topic = format!("/lidar_{sequence}");
        out.add_schema_with_id(schema, "sensor_msgs/msg/PointCloud2", "ros2msg", text.as_bytes()).unwrap();
        out.add_channel_with_id(channel, schema, &topic, "cdr", &BTreeMap::new()).unwrap();
        for data in [&cloud(points, true, false)[..], b"no cloud"] {
            let sequence = sequence as u32;
            let header = MessageHeader { channel_id: channel, sequence, log_time: 5, publish_time: 4 };
            out.write_to_known_channel(&header, data).unwrap();
        }
    }
    out.finish().unwrap();
    out.into_inner().into_inner()
}

#[test]
fn what_packing_adds_has_numbers_that_the_recording_uses_nowhere() {
    for repeats in [true, false] {
        let original = numbered_from_the_top(repeats);
        let (small, copied) = packed(&original, &Settings::default(), &TopicFilter::default());
        assert_eq!((copied.messages, copied.clouds, copied.kept), (6, 3, 3));
        assert_eq!(contents(&unpacked(&small).0), contents(&original));
    }
}

#[test]
fn a_recording_that_is_cut_short_is_taken_as_far_as_it_is_whole() {
    let original = recording(None, true);
    let (messages, ..) = contents(&original);
    let cut = &original[..original.len() / 2];
    let (small, copied) = packed(cut, &Settings::default(), &TopicFilter::default());
    assert!(copied.damage.is_some() && copied.messages > 2, "{copied:?}");
    let (restored, ..) = contents(&unpacked(&small).0);
    assert_eq!(restored, messages[..restored.len()]);
    assert_eq!(restored.len() as u64, copied.messages);
    let mut out = Cursor::new(Vec::new());
    let none = Cursor::new(b"no recording at all");
    assert!(pack(none, &mut out, &Settings::default(), &TopicFilter::default(), &|| ()).is_err());
}

#[test]
fn records_that_claim_to_be_longer_than_they_are_are_not_read() {
    let start = [mcap::MAGIC, &record(1, &[0; 8])].concat();
    let endless = [0xff; 4];
    // A header, a schema, a channel and its metadata, a chunk, metadata: with one text of 4 GiB each. An
    // attachment without its checksum.
    let claims = [
        (3, vec![1, 0]),
        (4, vec![1, 0, 1, 0]),
        (4, [&[1, 0, 1, 0][..], &[0; 8], &[4, 0, 0, 0]].concat()),
        (6, vec![0; 28]),
        (12, Vec::new()),
        (9, vec![0; 32]),
    ];
    for (opcode, fields) in claims {
        let contents = if opcode == 9 { fields } else { [&fields[..], &endless].concat() };
        let damaged = [&start[..], &record(opcode, &contents)].concat();
        let copied = packed(&damaged, &Settings::default(), &TopicFilter::default()).1;
        let fault = copied.damage.expect("a fault");
        assert!(fault.contains(&format!("kind {opcode}")), "{fault}");
    }
    let header = [mcap::MAGIC, &record(1, &endless)].concat();
    let error = pack(
        Cursor::new(header),
        Cursor::new(Vec::new()),
        &Settings::default(),
        &TopicFilter::default(),
        &|| (),
    );
    assert!(error.unwrap_err().to_string().contains("kind 1"));
    // A summary is not needed, so that one with a channel of 4 GiB is ignored.
    let original = recording(None, true);
    let (messages, ..) = contents(&original);
    let data = &original[..original.len() - 37];
    let summary = record(4, &[&[1, 0, 1, 0][..], &endless].concat());
    let footer = record(2, &[&(data.len() as u64).to_le_bytes()[..], &[0; 12]].concat());
    let damaged = [data, &summary, &footer, mcap::MAGIC].concat();
    let (small, copied) = packed(&damaged, &Settings::default(), &TopicFilter::default());
    assert_eq!(copied.damage, None);
    assert_eq!(contents(&unpacked(&small).0).0, messages);
}

/// A record with its kind and length.
fn record(opcode: u8, contents: &[u8]) -> Vec<u8> {
    [&[opcode], &(contents.len() as u64).to_le_bytes()[..], contents].concat()
}

#[test]
fn what_is_damaged_is_left_out_and_said_and_the_rest_is_taken() {
    let whole = recording(None, true);
    let (messages, ..) = contents(&whole);
    let at = |part: &[u8]| whole.windows(part.len()).position(|bytes| bytes == part).unwrap();
    let flipped = |at: usize| {
        let mut bytes = whole.clone();
        bytes[at] ^= 1;
        bytes
    };
    let with = |parts: &[&[u8]]| parts.concat();
    let (before, after) = whole.split_at(mcap::MAGIC.len() + 9 + whole[9] as usize);
    let data_end = whole.windows(9).rposition(|bytes| bytes == [15, 4, 0, 0, 0, 0, 0, 0, 0]).unwrap();
    let message = record(5, &[&[99, 0][..], &[0; 20]].concat());
    let schema = record(3, &[0; 14]);
    let other_schema = record(3, &[&[3, 0][..], &[0; 12]].concat());
    let channel = record(4, &[&[98, 0, 97, 0][..], &[0; 12]].concat());
    // The damage, the recording, and how many of its messages are not as they were.
    let cases = [
        ("CRC", flipped(at(b"hello")), 1),
        ("checksum of its data", flipped(at(b"operator")), 0),
        ("checksum of its summary", flipped(whole.len() - 38), 0),
        ("bytes after its end", with(&[&whole, &whole]), 0),
        ("bytes after its end", with(&[&whole, b"x"]), 0),
        ("in the middle of a record", whole[..whole.len() - 1].to_vec(), 0),
        ("in the middle of a record", whole[..data_end + 13].to_vec(), 0),
        ("records after the end of its data", with(&[&whole[..data_end + 13], &message, &whole]), 0),
        (
            "records after the end of its data",
            with(&[&whole[..data_end + 13], &record(200, b"x"), &whole]),
            0,
        ),
        ("channel 99, which does not exist", with(&[before, &message, after]), 0),
        ("a record is of kind 16", with(&[before, &record(16, b"new"), after]), 0),
        ("a schema has the number 0", with(&[before, &schema, after]), 0),
        ("channel 98 has schema 97", with(&[before, &channel, after]), 0),
        ("two schemas of number 3", with(&[&whole[..data_end], &other_schema, &whole[data_end..]]), 0),
    ];
    for (expected, damaged, changed) in cases {
        let (small, copied) = packed(&damaged, &Settings::default(), &TopicFilter::default());
        let damage = copied.damage.expect(expected);
        assert!(damage.contains(expected), "{expected}: {damage}");
        let (restored, ..) = contents(&unpacked(&small).0);
        let differ = restored.iter().zip(&messages).filter(|(a, b)| a != b).count();
        assert_eq!((restored.len(), differ), (messages.len(), changed), "{expected}");
        let found = examine(&damaged[..], Some(Limits::default()), 1, &|| ()).unwrap();
        assert_eq!(found.damage, Some(damage));
    }
}

#[test]
fn a_message_that_is_missing_is_told_by_the_statistics() {
    // Without chunks and checksums, nothing else does.
    let options = WriteOptions::new().use_chunks(false).calculate_data_section_crc(false);
    let mut out = options.create(Cursor::new(Vec::new())).unwrap();
    let words = out.add_channel(0, "/words", "", &BTreeMap::new()).unwrap();
    for text in [&b"first"[..], b"second"] {
        let header = MessageHeader { channel_id: words, sequence: 0, log_time: 0, publish_time: 0 };
        out.write_to_known_channel(&header, text).unwrap();
    }
    out.finish().unwrap();
    let mut recording = out.into_inner().into_inner();
    assert_eq!(examine(&recording[..], Some(Limits::default()), 1, &|| ()).unwrap().damage, None);
    let text = recording.windows(6).position(|bytes| bytes == b"second").unwrap();
    // A record of an application's own, which may be left out.
    recording[text - 22 - 9] = 200;
    let damage = examine(&recording[..], Some(Limits::default()), 1, &|| ())
        .unwrap()
        .damage
        .expect("a message is missing");
    assert_eq!(damage, "of 2 messages that its statistics count, 1 are there");
}

/// An input that fails after the first bytes.
struct Failing<'b>(&'b [u8]);

impl Read for Failing<'_> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        if self.0.is_empty() { Err(io::Error::other("unplugged")) } else { self.0.read(out) }
    }
}

#[test]
fn an_input_that_fails_is_an_error_and_no_damage() {
    let original = recording(None, true);
    let small = packed(&original, &Settings::default(), &TopicFilter::default()).0;
    for place in [small.len() / 3, small.len() - 4] {
        let failing = || Failing(&small[..place]);
        let failed = |error: Error| assert_eq!(error.to_string(), "unplugged", "at byte {place}");
        failed(examine(failing(), Some(Limits::default()), 1, &|| ()).unwrap_err());
        failed(unpack(failing(), Cursor::new(Vec::new()), 1, Limits::default(), &|| ()).unwrap_err());
        failed(same_messages(failing(), &small[..]).unwrap_err());
        let filter = TopicFilter::default();
        let clouds = Clouds::open(failing(), &filter, Limits::default()).unwrap();
        failed(clouds.map(|cloud| cloud.map(drop)).find_map(Result::err).unwrap());
    }
}

#[test]
fn a_damaged_cloud_is_left_out_and_those_after_it_are_taken() {
    let original = recording(None, true);
    let (small, copied) = packed(&original, &Settings::default(), &TopicFilter::default());
    // A program that rewrites a recording drops schemas to which no channel refers.
    let mut out = WriteOptions::new().create(Cursor::new(Vec::new())).unwrap();
    let mut is_first = true;
    for message in mcap::MessageStream::new(&small).unwrap() {
        let mut message = message.unwrap();
        let payload = message.data.windows(4).position(|bytes| bytes == b"\x89LPC");
        if let Some(place) = payload.filter(|_| std::mem::take(&mut is_first)) {
            message.data.to_mut()[place + 100] ^= 0xff;
        }
        out.write(&message).unwrap();
    }
    out.finish().unwrap();
    let damaged = out.into_inner().into_inner();
    let (restored, restored_clouds) = unpacked(&damaged);
    assert!(restored_clouds.damage.unwrap().contains("is left out"));
    assert_eq!(restored_clouds.clouds + 1, copied.clouds);
    assert_eq!(contents(&restored).0.len() + 1, contents(&original).0.len());
    let filter = TopicFilter::default();
    let mut clouds = Clouds::open(&damaged[..], &filter, Limits::default()).unwrap();
    assert_eq!(clouds.by_ref().map(Result::unwrap).count() as u64 + 1, copied.clouds);
    assert!(clouds.damage().unwrap().contains("is left out"));
}

#[test]
fn clouds_become_a_stream_with_their_times() {
    let original = recording(None, true);
    let small = packed(&original, &Settings::default(), &TopicFilter::default()).0;
    // The clouds of the other topic are the same but big-endian, and one more without points.
    let of_rear = TopicFilter { topics: vec!["/rear/points".to_owned()] };
    let rear: Vec<_> =
        Clouds::open(&original[..], &of_rear, Limits::default()).unwrap().map(Result::unwrap).collect();
    assert_eq!(rear.iter().map(|scan| scan.len()).filter(|length| *length > 0).count(), 4);
    assert_eq!(rear[0].positions()[7], [0, 1, 2].map(|axis| turns(4)[0][7][axis]));
    for recording in [&original, &small] {
        let filter = TopicFilter { topics: vec!["/front/points".to_owned()] };
        let mut stream = Vec::new();
        let mut encoder = Encoder::new(&mut stream, Settings::default()).unwrap();
        let clouds = Clouds::open(&recording[..], &filter, Limits::default()).unwrap();
        clouds.for_each(|cloud| encoder.push(cloud.unwrap()).unwrap());
        encoder.finish().unwrap();
        let scans = Scans::from_reader(&stream[..]).unwrap().map(Result::unwrap);
        let found: Vec<_> = scans.map(|scan| (scan.len(), scan.time())).collect();
        let turns = turns(4);
        let expected = turns.iter().map(|points| (points.len(), Some(1_700_000_000_123_456_789)));
        assert_eq!(found, expected.collect::<Vec<_>>());
    }
}

#[test]
fn the_program_packs_and_unpacks() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let lidarpc = |args: &[&str]| assert_cmd::Command::cargo_bin("lidarpc").unwrap().args(args).assert();
    let original = recording(Some(Compression::Zstd), true);
    std::fs::write(path("drive.mcap"), &original).unwrap();
    lidarpc(&["encode", &path("drive.mcap"), "-o", &path("small.mcap"), "--verify"]).success();
    lidarpc(&["decode", &path("small.mcap"), "-o", &path("back.mcap"), "--quiet"]).success();
    assert_eq!(contents(&std::fs::read(path("back.mcap")).unwrap()), contents(&original));
    // Their contents, packed and not.
    let json = |args: &[&str]| -> serde_json::Value {
        let run = lidarpc(&[args, &["--json"]].concat()).success();
        serde_json::from_slice(&run.get_output().stdout).unwrap()
    };
    let clouds = |report: &serde_json::Value, what: &str| -> u64 {
        report["topics"].as_array().unwrap().iter().filter_map(|topic| topic[what].as_u64()).sum()
    };
    let (before, after) = (json(&["info", &path("drive.mcap")]), json(&["info", &path("small.mcap")]));
    assert_eq!(clouds(&before, "messages"), clouds(&after, "messages"));
    assert_eq!(
        (clouds(&before, "compressed"), before["attachments"].clone()),
        (0, after["attachments"].clone())
    );
    assert!(clouds(&after, "compressed") >= 4);
    let stats = json(&["stats", &path("small.mcap")]);
    assert!(clouds(&stats, "points") > 0 && clouds(&stats, "cloud_bytes") > 0);
    let verified = json(&["verify", &path("small.mcap")]);
    assert_eq!(
        (&verified["whole"], &verified["frames"]),
        (&true.into(), &clouds(&after, "compressed").into())
    );
    lidarpc(&["verify", &path("small.mcap"), "--against", &path(".")]).code(2);
    // Clouds over the limits are left out, which is said.
    for output in ["few.mcap", "few"] {
        let run = lidarpc(&["decode", &path("small.mcap"), "--max-points", "1", "-o", &path(output)]);
        run.code(3).stderr(predicates::str::contains("over the limit of 1"));
    }
    lidarpc(&["verify", &path("small.mcap"), "--max-points", "1"]).failure();
    // What has no meaning for recordings is refused.
    for odd in [&["--topic", "/front/points"][..], &["--format", "pcd"], &["--messages"]] {
        lidarpc(&[&["decode", &path("small.mcap"), "-o", &path("odd.mcap")], odd].concat()).code(2);
    }
    lidarpc(&["encode", &path("drive.mcap"), "-o", &path("odd.mcap"), "--jobs", "2"]).code(2);
    // Only a recording becomes one.
    lidarpc(&["encode", &path("a"), "-o", &path("new.mcap")]).code(2);
    // An input that does not exist is named, not the output.
    for command in ["encode", "decode"] {
        let missing = lidarpc(&[command, &path("missing.mcap"), "-o", &path("new.mcap")]).code(1);
        missing.stderr(predicates::str::contains("missing.mcap: does not exist"));
    }
    // The clouds alone: as a stream, and as files.
    lidarpc(&["encode", &path("small.mcap"), "-o", &path("front.lpc"), "--topic", "/front/points"]).success();
    lidarpc(&["decode", &path("front.lpc"), "-o", &path("a")]).success();
    lidarpc(&["decode", &path("drive.mcap"), "-o", &path("b"), "--topic", "/front/points"]).success();
    let files = |folder: &str| -> BTreeMap<String, Vec<u8>> {
        let read = std::fs::read_dir(path(folder)).unwrap().map(|entry| entry.unwrap().path());
        read.map(|path| (path.file_name().unwrap().display().to_string(), std::fs::read(path).unwrap()))
            .collect()
    };
    let front = files("a/front/points");
    assert!(front.keys().eq(&["000000.pcd", "000001.pcd", "000002.pcd", "000003.pcd"]), "{:?}", front.keys());
    assert_eq!(front, files("b/front/points"));
    // Those of several topics, in folders of their own.
    lidarpc(&["encode", &path("drive.mcap"), "-o", &path("both.lpc")]).success();
    lidarpc(&["decode", &path("both.lpc"), "-o", &path("c")]).success();
    lidarpc(&["decode", &path("drive.mcap"), "-o", &path("d")]).success();
    for topic in ["front/points", "rear/points"] {
        assert_eq!(files(&format!("c/{topic}")), files(&format!("d/{topic}")));
    }
    assert!(files("c/front/points").into_values().eq(front.into_values()));
    // Two recordings have the same topics.
    lidarpc(&["cat", &path("both.lpc"), &path("front.lpc"), "-o", &path("all.lpc")]).success();
    lidarpc(&["verify", &path("all.lpc")]).success();
    lidarpc(&["decode", &path("all.lpc"), "-o", &path("e"), "--keep-going"]).success();
    assert_eq!(files("e/front/points").len(), 8);
    // The remaining part of a recording is processed, and this is reported.
    std::fs::write(path("cut.mcap"), &original[..original.len() * 2 / 3]).unwrap();
    let cut = lidarpc(&["encode", &path("cut.mcap"), "-o", &path("rest.mcap")]).code(3);
    cut.stderr(predicates::str::contains("is cut short or damaged"));
    assert!(std::path::Path::new(&path("rest.mcap")).is_file());
    for command in ["verify", "stats", "info"] {
        lidarpc(&[command, &path("cut.mcap")]).code(3);
    }
    let no_topic = ["encode", &path("drive.mcap"), "--topic", "/nope", "-o", &path("nope.mcap")];
    lidarpc(&no_topic).code(1).stderr(predicates::str::contains("no clouds on the topic \"/nope\""));
    assert!(!std::path::Path::new(&path("nope.mcap")).exists());
    // What is wrong with the input names the input.
    std::fs::write(path("bad.mcap"), b"\x89MCAP0\r\n\x01garbage").unwrap();
    for command in ["encode", "decode"] {
        let bad = lidarpc(&[command, &path("bad.mcap"), "-o", &path("none.mcap")]).code(1);
        bad.stderr(predicates::str::contains("bad.mcap: ").and(predicates::str::contains("none.mcap").not()));
    }
    std::fs::write(path("old.bag"), b"#ROSBAG V2.0").unwrap();
    let bag = lidarpc(&["encode", &path("old.bag"), "-o", &path("old.lpc")]).failure();
    bag.stderr(predicates::str::contains("rosbags-convert"));
    lidarpc(&["encode", &path("drive.mcap"), "-o", &path("drive.mcap"), "--force"]).failure();
    // Points may be off by no more than a bound, but none is dropped; options without an effect are refused.
    let lossy = ["encode", &path("drive.mcap"), "-o", &path("lossy.mcap")];
    for (options, complaint) in [
        (&["--mode", "paper"][..], "drops points"),
        (&["--max-error", "1cm", "--verify"], "byte for byte"),
        (&["--gop", "3"], "compressed alone"),
        (&["--layout", "xyz"], "name their fields"),
    ] {
        lidarpc(&[&lossy[..], options].concat()).code(2).stderr(predicates::str::contains(complaint));
    }
    let rounded = json(&[&lossy[..], &["--max-error", "1cm"]].concat());
    assert_eq!((&rounded["mode"], &rounded["max_error_m"]), (&"bounded".into(), &0.01.into()));
    // Which it says afterwards too, however many clouds are exact because the bound saves nothing there.
    for (name, words) in [("lossy.mcap", "within 10 mm"), ("small.mcap", "exact")] {
        let stats = json(&["stats", &path(name)]);
        let fidelity = |topic: &serde_json::Value| topic["fidelity"].as_object().unwrap().clone();
        let all: Vec<_> = stats["topics"].as_array().unwrap().iter().flat_map(fidelity).collect();
        let number = |which: &dyn Fn(&str) -> bool| -> u64 {
            all.iter().filter(|(known, _)| which(known)).map(|(_, clouds)| clouds.as_u64().unwrap()).sum()
        };
        assert!(number(&|known| known == words) > 0, "{name}: {all:?}");
        assert_eq!(number(&|_| true), clouds(&stats, "compressed"), "{name}: {all:?}");
        let text = lidarpc(&["stats", &path(name)]).success();
        text.stdout(predicates::str::contains(format!(": {words}\n")));
    }
    for [command, complaint] in [
        ["estimate", "`encode` a recording"],
        ["repair", "no stream"],
        ["view", "no stream"],
        ["cut", "no stream"],
        ["cat", "no stream"],
    ] {
        let output = path("out.png");
        let output: &[&str] = match command {
            "estimate" => &[],
            "cut" => &["--frames", "0", "-o", &output],
            _ => &["-o", &output],
        };
        let drive = path("drive.mcap");
        lidarpc(&[&[command, &drive], output].concat()).code(2).stderr(predicates::str::contains(complaint));
    }
    lidarpc(&["encode", &path("drive.mcap")]).code(2).stderr(predicates::str::contains("FILE.mcap"));
}

#[test]
fn a_bound_is_kept_in_recordings_too() {
    let original = recording(None, true);
    let (messages, attachments, metadata) = contents(&original);
    let exact = packed(&original, &Settings::default(), &TopicFilter::default()).1.cloud_bytes_after;
    let (small, copied) = packed(&original, &Settings::bounded(0.02), &TopicFilter::default());
    assert!(copied.cloud_bytes_after < exact * 9 / 10, "{} bytes, exact {exact}", copied.cloud_bytes_after);
    let (restored, restored_attachments, restored_metadata) = contents(&unpacked(&small).0);
    assert_eq!((&attachments, &metadata), (&restored_attachments, &restored_metadata));
    assert_eq!(messages.len(), restored.len());
    let mut largest = 0.0f64;
    for (before, after) in messages.iter().zip(&restored) {
        let about = |message: &OneMessage| {
            let (id, topic, schema, metadata, sequence, sent, received, bytes) = message.clone();
            (id, topic, schema, metadata, sequence, sent, received, bytes.len())
        };
        assert_eq!(about(before), about(after));
        let is_cloud = before.7 != after.7;
        let points = |bytes: &[u8]| scan(bytes, Encoding::Cdr).unwrap().0.cloud.positions;
        for (a, b) in
            is_cloud.then(|| points(&before.7).into_iter().zip(points(&after.7))).into_iter().flatten()
        {
            let apart = |axis: usize| f64::from(a[axis]) - f64::from(b[axis]);
            largest = largest.max((0..3).map(|axis| apart(axis).powi(2)).sum::<f64>().sqrt());
        }
    }
    assert!(largest > 0.005 && largest <= 0.02, "{largest} m");
    let paper = pack(
        Cursor::new(&original),
        Cursor::new(Vec::new()),
        &Settings::paper(),
        &TopicFilter::default(),
        &|| (),
    );
    assert!(paper.unwrap_err().to_string().contains("drops points"));
}

#[test]
fn clouds_that_claim_more_points_than_there_are_numbers_are_none() {
    for (encoding, is_cdr) in [(Encoding::Cdr, true), (Encoding::Ros1, false)] {
        let points = &turns(1)[0][..100];
        let message = cloud(&points.to_vec(), is_cdr, false);
        assert!(scan(&message, encoding).is_some());
        // Height and width.
        let place = message.windows(8).position(|bytes| *bytes == [1, 0, 0, 0, 100, 0, 0, 0]).unwrap();
        let claims = [&message[..place], &[0xff; 8], &message[place + 8..]].concat();
        assert!(scan(&claims, encoding).is_none());
    }
}

#[test]
fn clouds_without_a_position_are_no_scans_alone() {
    let message = cloud(&turns(1)[0][..100].to_vec(), true, false);
    let is_scan =
        |message: &[u8]| scan(message, Encoding::Cdr).and_then(|(scan, _)| points_of(scan)).is_some();
    assert!(is_scan(&message));
    let place = message.windows(6).position(|bytes| bytes == b"\x02\0\0\0y\0").unwrap();
    let without_y = [&message[..place + 4], b"q", &message[place + 5..]].concat();
    assert!(!is_scan(&without_y));
}

//! The program from outside: its output, messages and exit codes.

#![cfg_attr(not(target_os = "linux"), allow(dead_code, unused_imports))] // Some tests take what Linux has.

use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::{Command as Process, Stdio};
use std::time::{Duration, Instant};

use crate::common::scans::{scans, small};
use crate::common::{put_together, skip, take_apart};
use crate::program::{Bench, Files, failure, noise, odd_files, scan};
use assert_cmd::cargo::cargo_bin;
use lidarpc::internals::study::synth::{SynthConfig, drive};
use serde_json::Value;

#[test]
fn a_folder_comes_back_byte_for_byte() {
    let bench = Bench::encoded();
    bench.ok("decode out.lpc -o deep/er/back");
    assert_eq!(bench.files("deep/er/back"), odd_files());
    assert_eq!(bench.names("."), ["deep", "out.lpc", "seq"]);
}

#[test]
fn files_can_be_given_one_by_one() {
    let bench = Bench::encoded();
    bench.ok("encode seq/2.bin seq/empty.bin -o two.lpc --verify");
    bench.ok("decode two.lpc -o back");
    assert_eq!(bench.names("back"), ["2.bin", "empty.bin"]);
}

#[test]
fn frames_are_in_the_order_of_their_numbers() {
    let bench = Bench::encoded();
    let info = bench.json("info out.lpc --json");
    let frames = info["frames"].as_array().unwrap();
    let names: Vec<_> = frames.iter().map(|frame| frame["name"].as_str().unwrap()).collect();
    assert_eq!(names[..3], ["1.bin", "2.bin", "10.bin"]);
    assert_eq!(names.len(), odd_files().len());
    for (number, frame) in frames.iter().enumerate() {
        assert_eq!(frame["number"], number);
        assert_eq!(frame["file_bytes"], odd_files()[names[number]].len());
    }
    assert_eq!(info["groups"].as_array().unwrap().len(), 5);
    let text = String::from_utf8(bench.ok("info out.lpc")).unwrap();
    assert!(text.contains("10 frames in 5 groups"), "{text}");
    assert!(text.lines().last().unwrap().ends_with("seventeen.bin"), "{text}");
}

#[test]
fn stats_add_up_to_the_file() {
    let bench = Bench::encoded();
    let stats = bench.json("stats out.lpc --json");
    let size = fs::metadata(bench.path("out.lpc")).unwrap().len();
    let sections = stats["sections"].as_array().unwrap();
    let sum: u64 = sections.iter().map(|part| part["bytes"].as_u64().unwrap()).sum();
    assert_eq!(sum, size);
    assert_eq!(stats["stream_bytes"], size);
    let container = sections.iter().find(|part| part["name"] == "container").unwrap();
    assert!(container["bytes"].as_u64().unwrap() > 0 && container["bytes"].as_u64().unwrap() < size);

    let original: usize = odd_files().values().map(Vec::len).sum();
    assert_eq!(stats["file_bytes"], original);
    let close = |value: &Value, expected: f64| (value.as_f64().unwrap() - expected).abs() < 1e-9;
    assert!(close(&stats["ratio"], size as f64 / original as f64));
    let points = stats["points"].as_u64().unwrap();
    assert!(points >= 84, "{points}");
    assert!(close(&stats["bits_per_point"], 8.0 * size as f64 / points as f64));
    assert!(stats.get("against").is_none());

    let text = String::from_utf8(bench.ok("stats out.lpc")).unwrap();
    let total = text.lines().last().unwrap();
    assert!(total.starts_with("total") && total.contains(&size.to_string()), "{text}");
}

#[test]
fn stats_say_how_well_the_scanner_explains_its_points() {
    let bench = Bench::new();
    let drive = Path::new(env!("CARGO_MANIFEST_DIR")).join("testdata/drive");
    let files: Files = ["0000000000.bin", "0000000001.bin"]
        .map(|name| (name.to_owned(), fs::read(drive.join(name)).unwrap()))
        .into();
    let shares = |files: &Files, folder: &str| -> [f64; 2] {
        bench.write_files(folder, files);
        bench.ok(&format!("encode {folder} -o {folder}.lpc"));
        let stats = bench.json(&format!("stats {folder}.lpc --json"));
        let [scanner] = &stats["scanners"].as_array().unwrap()[..] else { panic!("one scanner") };
        assert!(scanner["description"].as_str().unwrap().contains("64 lasers"), "{scanner}");
        ["share_in_image", "share_exact"].map(|name| scanner[name].as_f64().unwrap())
    };
    let [in_image, exact] = shares(&files, "drive");
    assert!(in_image > 0.999 && exact > 0.98 && exact <= in_image, "{in_image}, {exact}");

    // One point of ten is a millimetre off, one of a thousand where no laser points.
    let mut moved = files;
    for (number, point) in
        moved.get_mut("0000000000.bin").unwrap().as_chunks_mut::<16>().0.iter_mut().enumerate()
    {
        let lift = if number % 50 == 0 {
            7.0
        } else if number % 10 == 1 {
            0.001
        } else {
            continue;
        };
        let z = f32::from_le_bytes(*point[8..12].first_chunk().unwrap()) + lift;
        point[8..12].copy_from_slice(&((z * 1000.0).round() / 1000.0).to_le_bytes());
    }
    let [less_in_image, less_exact] = shares(&moved, "moved");
    assert!(less_in_image < in_image - 0.0005, "{less_in_image}, {in_image}");
    // At least those; the constants, fitted to points of which a tenth is wrong, miss a few more.
    assert!((0.5..0.91 * exact).contains(&less_exact), "{less_exact} of {exact}");

    let text = String::from_utf8(bench.ok("stats moved.lpc")).unwrap();
    assert!(text.contains("of its first scan 9") && text.contains("to the last bit"), "{text}");
}

#[test]
fn stats_measure_the_error() {
    let bench = Bench::encoded();
    let against = bench.json("stats out.lpc --against seq --json")["against"].clone();
    assert_eq!(against["identical_files"], odd_files().len());
    assert_eq!((&against["rmse_m"], &against["max_error_m"]), (&Value::from(0.0), &Value::from(0.0)));

    // An original whose first point is 3 m farther away, and that has one more point.
    let mut moved = scan(40, 1);
    let x = f32::from_le_bytes(moved[..4].try_into().unwrap()) + 3.0;
    moved[..4].copy_from_slice(&x.to_le_bytes());
    moved.extend(scan(1, 9));
    fs::write(bench.path("seq/1.bin"), moved).unwrap();
    let against = bench.json("stats out.lpc --against seq --json")["against"].clone();
    assert_eq!((&against["differing_files"], &against["lost_points"]), (&1.into(), &1.into()));
    assert!((against["max_error_m"].as_f64().unwrap() - 3.0).abs() < 1e-5, "{against}");

    fs::remove_file(bench.path("seq/2.bin")).unwrap();
    let error = bench.fails("stats out.lpc --against seq", "seq");
    assert!(error.contains("2.bin"), "{error}");
}

#[test]
fn stats_measure_the_error_of_files_with_few_digits() {
    let bench = Bench::new();
    let points = &scans(&small(1, 1))[0];
    let lines = points.iter().map(|[x, y, z, _]| format!("{x:.1},{y:.1},{z:.1}\n"));
    let text = ["x,y,z\n".to_owned()].into_iter().chain(lines).collect::<String>();
    bench.write_files("seq", &Files::from([("1.csv".to_owned(), text.into_bytes())]));
    bench.ok("encode seq -o out.lpc --max-error 300mm");
    bench.ok("decode out.lpc -o back");
    let numbers = |folder: &str| -> Vec<f64> {
        let text = String::from_utf8(bench.files(folder)["1.csv"].clone()).unwrap();
        text.lines().skip(1).flat_map(|line| line.split(',')).map(|number| number.parse().unwrap()).collect()
    };
    let (before, after) = (numbers("seq"), numbers("back"));
    let distance =
        |(a, b): (&[f64], &[f64])| a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
    let largest = before.chunks(3).zip(after.chunks(3)).map(distance).fold(0.0, f64::max);
    let measured = bench.json("stats out.lpc --against seq --json")["against"]["max_error_m"].clone();
    assert!(
        largest > 0.05 && (measured.as_f64().unwrap() - largest).abs() < 1e-5,
        "{measured}, not {largest}"
    );
}

#[test]
fn verify_finds_what_differs() {
    let bench = Bench::encoded();
    let said = bench.command("verify out.lpc --against seq").output().unwrap();
    assert!(String::from_utf8(said.stdout).unwrap().starts_with("out.lpc: whole; 10 frames"));

    fs::write(bench.path("seq/extra.bin"), b"more").unwrap();
    bench.fails("verify out.lpc --against seq", "seq/extra.bin");
    bench.fails("verify out.lpc out.lpc --against seq", "seq/extra.bin");
    fs::write(bench.path("seq/other.bin"), b"more").unwrap();
    let error = bench.fails("verify out.lpc --against seq", "seq/extra.bin");
    assert!(error.contains("not in out.lpc; 2 scans are missing in all"), "{error}");
    fs::remove_file(bench.path("seq/extra.bin")).unwrap();
    fs::remove_file(bench.path("seq/other.bin")).unwrap();
    bench.ok("verify out.lpc out.lpc --against seq");

    let mut changed = scan(41, 3);
    changed[5] ^= 1;
    fs::write(bench.path("seq/10.bin"), changed).unwrap();
    let error = bench.fails("verify out.lpc --against seq", "out.lpc");
    assert!(error.contains("frame 2") && error.contains("10.bin"), "{error}");
    bench.ok("verify out.lpc");
}

#[test]
fn the_stream_does_not_depend_on_threads() {
    let bench = Bench::encoded();
    let expected = fs::read(bench.path("out.lpc")).unwrap();
    for threads in [1, 4] {
        bench.ok(&format!("encode seq -o {threads}.lpc --gop 2 --threads {threads}"));
        assert_eq!(fs::read(bench.path(&format!("{threads}.lpc"))).unwrap(), expected, "{threads} threads");
    }
}

#[test]
fn a_range_of_frames_is_the_same_as_in_the_whole() {
    let bench = Bench::encoded();
    let stream = fs::read(bench.path("out.lpc")).unwrap();
    for (range, expected) in [
        ("1", &["2.bin"][..]),
        ("1..3", &["10.bin", "2.bin"]),
        ("..=1", &["1.bin", "2.bin"]),
        ("9..", &["seventeen.bin"]),
    ] {
        bench.ok(&format!("decode out.lpc -o {range} --frames {range}"));
        bench
            .command(&format!("decode - -o piped{range} --frames {range}"))
            .write_stdin(stream.clone())
            .assert()
            .success();
        let all = odd_files();
        let expected: Files = expected.iter().map(|name| (name.to_string(), all[*name].clone())).collect();
        assert_eq!(bench.files(range), expected);
        assert_eq!(bench.files(&format!("piped{range}")), expected);
    }
    bench.fails("decode out.lpc -o none --frames 10", "out.lpc");
    bench.fails("decode out.lpc -o none --frames 5..11", "out.lpc");
    assert!(!bench.path("none").exists());
}

#[test]
fn streams_go_through_pipes() {
    let bench = Bench::encoded();
    let stream = bench.ok("encode seq -o - --gop 2");
    assert_eq!(stream, fs::read(bench.path("out.lpc")).unwrap());
    let through = |args: &str| {
        let run = bench.command(args).write_stdin(stream.clone()).assert().success();
        run.get_output().stdout.clone()
    };
    through("decode - -o back");
    assert_eq!(bench.files("back"), odd_files());
    assert_eq!(through("stats - --json --against seq"), bench.ok("stats out.lpc --json --against seq"));
    let mut info = bench.json("info out.lpc --json");
    info["file"] = "stdin".into();
    assert_eq!(serde_json::from_slice::<Value>(&through("info - --json")).unwrap(), info);
    assert!(through("verify - --against seq").starts_with(b"stdin: whole"));
    assert_eq!(through("decode - -o - --frames 2"), odd_files()["10.bin"]);
    let error = bench.fails("decode out.lpc -o -", "out.lpc");
    assert!(error.contains("--frames"), "{error}");
}

#[test]
fn a_closed_pipe_is_no_failure() {
    let bench = Bench::encoded();
    for args in ["info out.lpc --json", "stats out.lpc", "encode seq -o - -q", "verify out.lpc"] {
        let mut child = Process::new(cargo_bin!("lidarpc"))
            .args(args.split(' '))
            .current_dir(bench.0.path())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        drop(child.stdout.take());
        let output = child.wait_with_output().unwrap();
        assert_eq!((output.status.code(), &output.stderr[..]), (Some(0), &b""[..]), "{args}");
    }
}

#[test]
fn nothing_is_overwritten_without_force() {
    let bench = Bench::encoded();
    let before = fs::read(bench.path("out.lpc")).unwrap();
    let error = bench.fails("encode seq/1.bin -o out.lpc", "out.lpc");
    assert!(error.contains("--force"), "{error}");
    assert_eq!(fs::read(bench.path("out.lpc")).unwrap(), before);
    bench.ok("encode seq/1.bin -o out.lpc --force");
    assert_ne!(fs::read(bench.path("out.lpc")).unwrap(), before);

    bench.write_files(
        "back",
        &Files::from([("1.bin".into(), b"old".to_vec()), ("b".into(), b"mine".to_vec())]),
    );
    let error = bench.fails("decode out.lpc -o back", "back/1.bin");
    assert!(error.contains("--force"), "{error}");
    assert_eq!(bench.files("back")["1.bin"], b"old");
    bench.ok("decode out.lpc -o back --force");
    assert_eq!(bench.files("back")["1.bin"], odd_files()["1.bin"]);
    assert_eq!(bench.names("back"), ["1.bin", "b"]);
}

#[test]
fn an_input_that_cannot_be_read_is_named() {
    let bench = Bench::encoded();
    fs::create_dir(bench.path("void")).unwrap();
    for (args, path) in [
        ("encode nowhere -o new.lpc", "nowhere"),
        ("encode seq nowhere.bin -o new.lpc", "nowhere.bin"),
        ("encode void -o new.lpc", "void"),
        ("encode seq -o nowhere/new.lpc", "nowhere"),
        ("decode nowhere.lpc -o back", "nowhere.lpc"),
        ("decode seq -o back", "seq"),
        ("decode seq/1.bin -o back", "seq/1.bin"),
        ("decode seq/empty.bin -o back", "seq/empty.bin"),
        ("decode out.lpc -o seq/1.bin", "seq/1.bin"),
        ("decode out.lpc -o seq/1.bin/below", "seq/1.bin"),
        ("stats nowhere.lpc", "nowhere.lpc"),
        ("info seq/1.bin", "seq/1.bin"),
        ("verify out.lpc --against void", "void"),
        ("synth -o seq/1.bin", "seq/1.bin"),
    ] {
        let error = bench.fails(args, path);
        assert!(error.contains(';') || path == "seq/empty.bin", "what to do is missing: {error}");
    }
    assert_eq!(bench.names("."), ["out.lpc", "seq", "void"], "something was left behind");
    assert_eq!(bench.files("seq"), odd_files());
}

#[test]
fn a_file_that_cannot_be_opened_is_named() {
    // Root ignores permissions, so a folder takes the place of a file.
    let bench = Bench::encoded();
    fs::create_dir(bench.path("folder.bin")).unwrap();
    bench.fails("encode folder.bin -o new.lpc", "folder.bin");
    bench.fails("decode folder.bin -o new", "folder.bin");
    fs::create_dir(bench.path("back")).unwrap();
    fs::create_dir(bench.path("back/10.bin")).unwrap();
    bench.fails("decode out.lpc -o back --force", "back/10.bin");
    assert_eq!(bench.names("back"), ["10.bin"]);

    let secret = bench.path("seq/2.bin");
    let readable = fs::metadata(&secret).unwrap().permissions();
    let mut unreadable = readable.clone();
    #[cfg(unix)]
    std::os::unix::fs::PermissionsExt::set_mode(&mut unreadable, 0);
    #[cfg(not(unix))]
    unreadable.set_readonly(true);
    fs::set_permissions(&secret, unreadable).unwrap();
    if fs::read(&secret).is_ok() {
        skip("permissions do not stop this user");
    } else {
        let error = bench.fails("encode seq -o new.lpc", "seq/2.bin");
        assert!(error.contains("denied"), "{error}");
        assert!(!bench.path("new.lpc").exists());
    }
    fs::set_permissions(&secret, readable).unwrap();
}

#[test]
fn a_damaged_stream_leaves_nothing_behind() {
    let bench = Bench::encoded();
    let whole = fs::read(bench.path("out.lpc")).unwrap();
    fs::create_dir(bench.path("back")).unwrap();
    let mut damaged = whole.clone();
    damaged[whole.len() / 2] ^= 4;
    let cuts = [0, 3, 11, 12, whole.len() / 2, whole.len() - 1].map(|length| whole[..length].to_vec());
    for bytes in cuts.into_iter().chain([damaged, [&whole[..], b"x"].concat()]) {
        fs::write(bench.path("bad.lpc"), &bytes).unwrap();
        for args in ["decode bad.lpc -o back", "decode bad.lpc -o new", "info bad.lpc"] {
            let error = bench.fails(args, "bad.lpc");
            assert!(error.contains("damaged stream"), "{error}");
        }
        // Lists what is lost first.
        let run = bench.command("verify bad.lpc").assert().code(1);
        let error = String::from_utf8_lossy(&run.get_output().stderr).into_owned();
        assert!(error.lines().all(|line| line.starts_with("lidarpc: bad.lpc: ")), "{error}");
        assert!(error.lines().last().is_some_and(|line| line.contains("damaged stream")), "{error}");
        bench.fails("stats bad.lpc --against seq", "bad.lpc");
        assert_eq!(bench.names("back"), [""; 0]);
        assert_eq!(bench.names("."), ["back", "bad.lpc", "out.lpc", "seq"]);
    }
}

#[test]
fn a_newer_stream_is_named_as_such() {
    let bench = Bench::encoded();
    let mut newer = fs::read(bench.path("out.lpc")).unwrap();
    newer[4] = 9;
    let crc = crc32c::crc32c(&newer[..8]);
    newer[8..12].copy_from_slice(&crc.to_le_bytes());
    fs::write(bench.path("newer.lpc"), newer).unwrap();
    let error = bench.fails("decode newer.lpc -o back", "newer.lpc");
    assert!(error.contains("version 9") && error.contains("newer lidarpc"), "{error}");
}

/// The decoder trusts no name, be it of a scan or of a file beside the scans.
#[test]
fn names_in_a_stream_cannot_leave_the_folder() {
    use FrameKind::{Beside, File};
    use lidarpc::internals::container::{FrameKind, Group};
    let bench = Bench::encoded();
    // Three points, which are the same under any name.
    bench.ok("encode seq/2.bin -o three.lpc");
    let (_, groups) = take_apart(&bench.read("three.lpc"));
    let group = |&(name, kind): &(&str, FrameKind)| {
        let mut frame = groups[0].frames[0].clone();
        frame.header.name = name.to_owned();
        frame.header.stamp.kind = kind;
        // One group each, so that no frame depends on another.
        Group { scanners: vec![None], frames: vec![frame] }
    };
    let write = |frames: &[(&str, FrameKind)]| {
        let groups: Vec<_> = frames.iter().map(group).collect();
        fs::write(bench.path("evil.lpc"), put_together(&[], &groups)).unwrap();
    };
    fs::create_dir_all(bench.path("in/back")).unwrap();
    let names = [
        "../evil.bin",
        "/tmp/evil.bin",
        "..",
        "",
        "a/../b.bin",
        "a/../../b.bin",
        "a//b.bin",
        "./a.bin",
        "a\\b.bin",
        "a\\..\\b.bin",
        "a/",
        "NUL/a.bin",
    ];
    // With a slash at its end, the name of what is beside the scans is that of an empty folder.
    let kinds = |name| if name == "a/" { &[File][..] } else { &[File, Beside] };
    for (name, kind) in names.into_iter().flat_map(|name| kinds(name).iter().map(move |kind| (name, *kind))) {
        write(&[("fine.bin", File), (name, kind)]);
        let error = bench.fails("decode evil.lpc -o in/back --force", "in/back");
        assert!(name.is_empty() || error.contains("safely"), "{name:?}: {error}");
        assert_eq!(
            (bench.names("in/back"), bench.names("in")),
            (vec![], vec!["back".to_owned()]),
            "{name:?}"
        );
        if !name.is_empty() {
            let error = bench.fails("verify evil.lpc", "evil.lpc");
            assert!(error.contains("frame 1 has the name"), "{error}");
            bench.command("decode evil.lpc -o in/kept --keep-going").assert().code(3);
            assert_eq!(bench.names("in/kept"), ["fine.bin"]);
            fs::remove_dir_all(bench.path("in/kept")).unwrap();
        }
    }
    write(&[("twice.bin", File), ("twice.bin", File)]);
    bench.fails("decode evil.lpc -o in/back --force", "in/back");
    bench.fails("verify evil.lpc", "evil.lpc");
    write(&[("fine.bin", File), ("also fine.bin", File)]);
    bench.ok("decode evil.lpc -o in/back");
    assert_eq!(bench.names("in/back"), ["also fine.bin", "fine.bin"]);
}

#[test]
fn two_frames_of_one_name_are_refused() {
    let bench = Bench::encoded();
    bench.write_files("other", &Files::from([("1.bin".into(), b"another".to_vec())]));
    bench.command("encode seq other -o new.lpc").assert().code(1);
    assert!(!bench.path("new.lpc").exists());
}

#[test]
#[cfg(target_os = "linux")]
fn a_full_disk_leaves_nothing_behind() {
    let bench = Bench::encoded();
    let full = fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let run = Process::new(cargo_bin!("lidarpc"))
        .args(["encode", "seq", "-o", "-"])
        .current_dir(bench.0.path())
        .stdout(full)
        .output()
        .unwrap();
    assert_eq!(run.status.code(), Some(1));
    let error = String::from_utf8(run.stderr).unwrap();
    assert!(error.starts_with("lidarpc: stdout: no space left"), "{error}");

    bench.write_files("big", &Files::from([("noise.bin".into(), noise(200_000, 1))]));
    bench.ok("encode big -o big.lpc");
    for (args, path) in
        [("encode big -o new.lpc --quiet", "new.lpc"), ("decode big.lpc -o back", "back/noise.bin")]
    {
        failure(&mut bench.on_full_disk(args), path);
        assert_eq!(bench.names("."), ["big", "big.lpc", "out.lpc", "seq"]);
    }
}

/// A folder with ten scans in `seq/`, and `whole.lpc` encoded from them with two frames a group. As on a full
/// disk, there are also `out.lpc.partial` and its journal.
#[cfg(target_os = "linux")]
fn interrupted() -> Bench {
    let bench = Bench::new();
    bench.write_files("seq", &(0..10).map(|n| (format!("{n}.bin"), noise(10_000, n + 1))).collect());
    bench.ok("encode seq -o whole.lpc --gop 2");
    failure(&mut bench.on_full_disk("encode seq -o out.lpc --gop 2 --resume --quiet"), "out.lpc");
    bench
}

#[test]
#[cfg(target_os = "linux")]
fn an_encode_goes_on_when_the_disk_has_room_again() {
    let bench = interrupted();
    let left = ["out.lpc.partial", "out.lpc.partial.journal", "seq", "whole.lpc"];
    assert_eq!(bench.names("."), left);
    let error = bench.fails("encode seq -o out.lpc --gop 3 --resume --quiet", "out.lpc.partial");
    assert!(error.contains("gop: 2, now 3") && error.contains("delete it"), "{error}");

    let says = bench.says("encode seq -o out.lpc --gop 2 --resume --verify");
    let taken = says
        .lines()
        .last()
        .unwrap()
        .strip_prefix("10 frames, ")
        .and_then(|says| says.split_once(" of them from the inter"));
    let taken: u32 = taken.unwrap_or_else(|| panic!("{says}")).0.parse().unwrap();
    assert!((2..10).contains(&taken), "{says}");
    assert_eq!(bench.names("."), ["out.lpc", "seq", "whole.lpc"]);
    assert!(bench.read("out.lpc") == bench.read("whole.lpc"));

    let says = bench.says("encode seq -o out.lpc --gop 2 --resume --force");
    assert!(says.contains("\n10 frames: "), "{says}");
    assert!(bench.read("out.lpc") == bench.read("whole.lpc"));
}

#[test]
fn what_is_complete_is_not_encoded_again() {
    let bench = Bench::encoded();
    let whole = bench.read("out.lpc");
    let again = "encode seq -o out.lpc --gop 2 --resume";
    let line = "out.lpc: already complete, from these 10 frames with these settings";
    assert_eq!(bench.says(again).lines().last(), Some(line));
    assert_eq!(
        bench.says(&format!("{again} --verify")).lines().last(),
        Some(&format!("{line}, verified")[..])
    );
    assert_eq!(bench.ok(again), b"");
    let report = bench.json(&format!("{again} --json"));
    assert_eq!((&report["was_complete"], &report["frames"]), (&true.into(), &10.into()));
    assert_eq!(report["stream_bytes"], whole.len());
    assert_eq!(bench.json("encode seq -o new.lpc --gop 2 --resume --json")["was_complete"], false);

    // What differs is said.
    let refuses = |args: &str, output: &str, what: &str| {
        let before = bench.read(output);
        let error = bench.fails(&format!("encode {args} -o {output} --resume --quiet"), output);
        assert!(error.contains(&format!("exists, but {what}")), "{args}: {error}");
        assert!(error.contains("--force"), "{args}: {error}");
        assert!(bench.read(output) == before, "{args}");
    };
    refuses("seq --gop 3", "out.lpc", "has 2 frames in a group, not 3");
    fs::write(bench.path("notes.lpc"), b"somebody's").unwrap();
    refuses("seq --gop 2", "notes.lpc", "is no whole stream");
    fs::write(bench.path("cut.lpc"), &whole[..whole.len() - 9]).unwrap();
    refuses("seq --gop 2", "cut.lpc", "is no whole stream");
    for (name, bytes, what) in [
        ("10.bin", Some(vec![7; 41 * 16]), "holds another \"10.bin\" than there is now"),
        ("seventeen.bin", None, "holds 10 frames, not 9"),
    ] {
        let mut files = odd_files();
        files.remove(name);
        files.extend(bytes.map(|bytes| (name.to_owned(), bytes)));
        bench.write_files(name, &files);
        refuses(&format!("{name} --gop 2"), "out.lpc", what);
    }
    let mut files = odd_files();
    let moved = files.remove("1.bin").unwrap();
    files.insert("0.bin".to_owned(), moved);
    bench.write_files("renamed", &files);
    refuses("renamed --gop 2", "out.lpc", "holds other frames (\"1.bin\", not \"0.bin\")");

    // Nothing is deleted that the stream does not hold, whatever its headers say.
    let (models, mut groups) = take_apart(&whole);
    let sections = groups[1].frames.iter_mut().flat_map(|frame| &mut frame.sections);
    sections.filter_map(|section| section.payload.last_mut()).for_each(|byte| *byte ^= 0x55);
    fs::write(bench.path("forged.lpc"), put_together(&models, &groups)).unwrap();
    bench.fails("encode seq -o forged.lpc --gop 2 --resume --rm --quiet", "forged.lpc");
    assert_eq!(bench.files("seq"), odd_files());
    bench.ok("encode seq -o out.lpc --gop 2 --resume --rm");
    assert!(!bench.path("seq").exists());
    assert!(bench.read("out.lpc") == whole);
    bench.ok("decode out.lpc -o seq");
    assert_eq!(bench.files("seq"), odd_files());
}

#[test]
fn a_complete_file_with_a_largest_error_is_known_too() {
    let bench = Bench::new();
    bench.ok("synth -o drive --frames 2");
    bench.ok("encode drive -o b.lpc --max-error 2cm -1 --gop 1");
    let again = |args: &str| format!("encode drive -o b.lpc -1 --gop 1 --resume {args}");
    assert_eq!(bench.ok(&again("--max-error 2cm")), b"");
    for (args, what) in [
        ("--max-error 1cm", "was made with other settings"),
        ("--max-error 2cm --intensity-step 0.1", "was made with other settings"),
        ("", "does not hold the files exactly"),
    ] {
        let error = bench.fails(&again(&format!("{args} --quiet")), "b.lpc");
        assert!(error.contains(what), "{args}: {error}");
    }
    // An intensity of the last frame, in a file of the same size.
    let name = format!("drive/{}", bench.names("drive").last().unwrap());
    let mut bytes = bench.read(&name);
    let intensity = &mut bytes[16 * 1000 + 12..][..4];
    let other = if intensity == 0.5f32.to_le_bytes() { 0.25f32 } else { 0.5 };
    intensity.copy_from_slice(&other.to_le_bytes());
    fs::write(bench.path(&name), bytes).unwrap();
    let error = bench.fails(&again("--max-error 2cm --quiet"), "b.lpc");
    assert!(error.contains("was made with other settings, of other files, or"), "{error}");
}

#[test]
#[cfg(target_os = "linux")]
fn a_partial_file_is_left_to_those_who_ask_for_it() {
    let bench = interrupted();
    let partial = || (bench.read("out.lpc.partial"), bench.read("out.lpc.partial.journal"));
    let before = partial();
    let says = bench.says("encode seq -o out.lpc --gop 2");
    assert!(says.contains("lidarpc: out.lpc.partial of an interrupted run is left as it is"), "{says}");
    assert!(bench.read("out.lpc") == bench.read("whole.lpc") && partial() == before);

    // While the output exists.
    bench.ok("encode seq -o out.lpc --gop 2 --resume");
    bench.fails("encode seq -o out.lpc --gop 3 --resume --quiet", "out.lpc");
    assert!(partial() == before);

    // A file that is not a partial stream.
    fs::write(bench.path("mine.lpc.partial"), b"somebody's").unwrap();
    bench.fails("encode seq -o mine.lpc --gop 2 --resume --quiet", "mine.lpc.partial");
    assert_eq!(bench.read("mine.lpc.partial"), b"somebody's");
    assert!(!bench.path("mine.lpc.partial.journal").exists());
    fs::create_dir(bench.path("folder.lpc.partial")).unwrap();
    bench.fails("encode seq -o folder.lpc --gop 2 --resume --quiet", "folder.lpc.partial");

    // A device, which can only be written.
    bench.fails("encode seq -o /dev/null --resume --quiet", "/dev/null");

    // While another run is using it.
    let locked = fs::File::open(bench.path("out.lpc.partial")).unwrap();
    locked.lock().unwrap();
    let error = bench.fails("encode seq -o out.lpc --gop 2 --resume --force --quiet", "out.lpc.partial");
    assert!(error.contains("another run"), "{error}");
    assert!(partial() == before);
}

#[test]
#[cfg(unix)]
fn a_signal_leaves_nothing_behind() {
    let bench = Bench::encoded();
    fs::create_dir(bench.path("back")).unwrap();
    let stream = fs::read(bench.path("out.lpc")).unwrap();
    for signal in ["-INT", "-TERM"] {
        let mut child = Process::new(cargo_bin!("lidarpc"))
            .args(["decode", "-", "-o", "back"])
            .current_dir(bench.0.path())
            .stdin(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut stdin = child.stdin.take().unwrap();
        stdin.write_all(&stream[..stream.len() / 2]).unwrap();
        wait_until(|| !bench.names("back").is_empty());
        let killed = Process::new("kill").args([signal, &child.id().to_string()]).status().unwrap();
        assert!(killed.success());
        assert!(!child.wait().unwrap().success());
        assert_eq!(bench.names("back"), [""; 0], "after {signal}");
    }
}

#[cfg(unix)]
fn wait_until(condition: impl Fn() -> bool) {
    let start = Instant::now();
    while !condition() {
        assert!(start.elapsed() < Duration::from_secs(30), "it never happened");
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
#[cfg(unix)]
fn links_and_devices_are_written_through() {
    let bench = Bench::encoded();
    std::os::unix::fs::symlink("out.lpc", bench.path("link.lpc")).unwrap();
    bench.fails("encode seq/1.bin -o link.lpc", "link.lpc");
    let before = fs::read(bench.path("out.lpc")).unwrap();
    bench.ok("encode seq/1.bin -o link.lpc --force");
    assert!(fs::symlink_metadata(bench.path("link.lpc")).unwrap().is_symlink());
    assert_ne!(fs::read(bench.path("out.lpc")).unwrap(), before);

    bench.ok("encode seq -o /dev/null --force");
    assert!(!fs::metadata("/dev/null").unwrap().is_file());

    let usual = bench.path("usual");
    fs::write(&usual, b"").unwrap();
    let rights = |path: &Path| fs::metadata(path).unwrap().permissions();
    assert_eq!(rights(&bench.path("out.lpc")), rights(&usual), "not the rights that new files get");
}

#[test]
fn wrong_usage_is_exit_code_2() {
    let bench = Bench::encoded();
    for args in [
        "",
        "frobnicate",
        "encode -",
        "encode seq out.lpc",
        "encode - -o new.lpc --all",
        "encode - -o new.lpc --rm",
        "encode seq -o - --rm",
        "encode seq -o new.lpc --rm --max-error 1cm",
        "encode seq -o new.lpc --jobs 2",
        "encode seq -o new.lpc --topic /points",
        "encode -o new.lpc",
        "encode seq -o new.lpc --gop 0",
        "encode seq -o new.lpc --mode wild",
        "encode seq -o new.lpc --mode bounded",
        "encode seq -o new.lpc --max-error 10",
        "encode seq -o new.lpc --mode exact --max-error 10mm",
        "encode seq -o new.lpc --mode paper --max-error 10mm",
        "encode seq -o new.lpc --max-error 11m",
        "encode seq -o new.lpc --max-error 10mm --backend lzma",
        "encode seq -o new.lpc --max-error 10mm --intensity none",
        "encode seq -o new.lpc --max-error 10mm --intensity-step 0",
        "encode seq -o new.lpc --intensity-step 0.1",
        "encode seq -o new.lpc --threads many",
        "encode seq -o - --verify",
        "encode seq -o - --resume",
        "encode - -o new.lpc --resume",
        "decode -",
        "decode out.lpc out.lpc",
        "decode out.lpc -o back --time 5",
        "decode out.lpc -o back --time 2s..1s",
        "decode out.lpc -o back --time 1..2 --frames 1",
        "decode out.lpc out.lpc -o back --time 1..2",
        "cut out.lpc --frames 1 --time 1..2 -o part.lpc",
        "completions",
        "completions tcsh",
        "estimate",
        "decode out.lpc -o back --frames 5..5",
        "decode out.lpc -o back --frames five",
        "encode seq -o new.lpc --mode paper --backend gzip",
        "encode seq -o new.lpc --mode paper --level 10",
        "encode seq -o new.lpc --level 0",
        "encode seq -o new.lpc --level best",
        "encode seq -o - --json",
        "decode out.lpc seq/1.bin -o back --frames 1",
        "decode out.lpc out.lpc -o -",
        "verify - -",
        "cut out.lpc --frames 2 -o - --json",
        "encode seq -o new.lpc --level 2 --predict inter",
        "encode seq -o new.lpc --packing planes",
        "encode seq -o new.lpc --rate 2",
        "encode seq -o new.lpc --mode paper --passes 2",
        "encode seq -o new.lpc --backend jpeg2000",
        "encode seq -o new.lpc --backend jpeg2000 --rate 0",
        "encode seq -o new.lpc --mode paper --backend jpeg --rate lossless",
        "encode seq -o new.lpc --mode paper --backend jpeg --passes 9",
        "encode seq -o new.lpc --mode paper --backend jpeg2000 --level 5",
        "encode seq -o new.lpc --mode paper --backend jpeg2000 --step float",
        "encode seq -o new.lpc --step 1cm",
        "encode seq -o new.lpc --intensity none",
        "encode seq -o new.lpc --predict intra",
        "encode seq -o new.lpc --mode paper --step 1",
        "encode seq -o new.lpc --mode paper --columns 0",
        "encode seq -o new.lpc --mode paper --cluster-angle 91",
        "encode seq -o new.lpc --mode paper --lambda nan",
        "encode seq -o new.lpc --mode paper --step float --backend context",
        "encode seq -o new.lpc --mode paper --step float --regions fitted",
        "stats out.lpc --steps --against seq",
        "cut out.lpc -o part.lpc",
        "cut out.lpc --frames 2",
        "cut out.lpc --frames 3..1 -o part.lpc",
        "cut out.lpc out.lpc --frames 2 -o part.lpc",
        "cat -o all.lpc",
        "cat out.lpc",
        "cat - out.lpc - -o all.lpc",
        "view out.lpc",
        "view out.lpc -o out.png --kind x-ray",
        "view out.lpc -o out.png --scale 0",
    ] {
        bench.command(args).assert().code(2);
    }
    assert_eq!(bench.names("."), ["out.lpc", "seq"]);
    for command in ["", "encode", "decode", "stats", "info", "verify", "cut", "cat", "view", "bench", "synth"]
    {
        bench.command(&format!("{command} --help")).assert().success();
    }
}

#[test]
fn options_do_what_they_say() {
    let bench = Bench::encoded();
    bench.ok("encode seq -o all.lpc --gop 100 --verify --mode exact");
    assert_eq!(bench.json("info all.lpc --json")["groups"].as_array().unwrap().len(), 1);
    bench.ok("decode all.lpc -o back --threads 1");
    assert_eq!(bench.files("back"), odd_files());

    let told = bench.command("encode seq -o told.lpc").output().unwrap();
    let told = String::from_utf8(told.stderr).unwrap();
    assert!(told.starts_with("10 frames: ") && told.lines().count() == 1, "{told}");

    fs::write(bench.path("seq/notes.txt"), b"cloudy").unwrap();
    let told = bench.command("encode seq -o noted.lpc").output().unwrap();
    let told = String::from_utf8(told.stderr).unwrap();
    assert!(told.contains("seq: left out 1 file not known as a scan (6 bytes, seq/notes.txt)"), "{told}");
}

#[test]
fn a_synthetic_drive_is_repeatable() {
    let bench = Bench::new();
    bench.ok("synth -o a --frames 2 --seed 7");
    bench.ok("synth -o b --frames 2 --seed 7");
    bench.ok("synth -o c --frames 2 --seed 8");
    assert_eq!(bench.files("a").len(), 2);
    assert_eq!(bench.files("a"), bench.files("b"));
    assert_ne!(bench.files("a"), bench.files("c"));
    bench.ok("encode a -o a.lpc --verify");
    bench.ok("verify a.lpc --against a");
    bench.command("synth -o a --frames 2").assert().code(1);
}

// ---- cut and cat ----

impl Bench {
    /// Compares the decoded frames of one stream with a range of those of another.
    #[track_caller]
    fn decodes_to_range(&self, part: &str, whole: &str, range: &str) {
        self.ok(&format!("decode {whole} -o expected --frames {range}"));
        self.ok(&format!("decode {part} -o got"));
        assert_eq!(self.files("got"), self.files("expected"), "frames {range} of {whole}");
        self.ok(&format!("verify {part} --against expected"));
        ["got", "expected"].iter().for_each(|folder| fs::remove_dir_all(self.path(folder)).unwrap());
    }
}

#[test]
fn a_cut_decodes_to_the_same_as_the_range() {
    let bench = Bench::encoded();
    bench.ok("encode seq -o one.lpc --gop 100");
    let stream = bench.read("out.lpc");
    for (range, told) in [
        ("2..6", "4 frames: 4 copied, 0 coded again"),
        ("1..6", "5 frames: 4 copied, 1 coded again"),
        ("3..=4", "2 frames: 1 copied, 1 coded again"),
        ("9", "1 frame: 0 copied, 1 coded again"),
        ("..3", "3 frames: 3 copied, 0 coded again"),
        ("..", "10 frames: 10 copied, 0 coded again"),
    ] {
        let said = bench.says(&format!("cut out.lpc --frames {range} -o part.lpc --force"));
        assert!(said.starts_with(told), "{range}: {said}");
        bench.decodes_to_range("part.lpc", "out.lpc", range);
        let piped = bench.command(&format!("cut - --frames {range} -o -")).write_stdin(&stream[..]).unwrap();
        assert!(piped.stdout == bench.read("part.lpc"), "{range}: a pipe gives another stream");
        bench.ok(&format!("cut one.lpc --frames {range} -o part.lpc --force"));
        bench.decodes_to_range("part.lpc", "one.lpc", range);
    }
    bench.ok("cut out.lpc --frames .. -o all.lpc");
    assert!(bench.read("all.lpc") == stream);
}

#[test]
fn parts_that_are_joined_are_the_whole() {
    let bench = Bench::encoded();
    let whole = bench.read("out.lpc");
    for middle in [4, 5] {
        bench.ok(&format!("cut out.lpc --frames ..{middle} -o a.lpc --force"));
        bench.ok(&format!("cut out.lpc --frames {middle}.. -o b.lpc --force"));
        let said = bench.says("cat a.lpc b.lpc -o ab.lpc --force");
        assert!(said.starts_with("2 streams: 10 frames, "), "{said}");
        bench.decodes_to_range("ab.lpc", "out.lpc", "..");
        assert_eq!(bench.read("ab.lpc") == whole, middle == 4, "groups are copied whole");
    }
    let info = bench.json("info ab.lpc --json");
    assert_eq!(info["frames"], {
        let mut frames = bench.json("info out.lpc --json")["frames"].clone();
        let sizes = info["frames"].as_array().unwrap().iter().map(|frame| frame["coded_bytes"].clone());
        frames.as_array_mut().unwrap().iter_mut().zip(sizes).for_each(|(f, size)| f["coded_bytes"] = size);
        frames
    });
    let (a, b) = (bench.read("a.lpc"), bench.read("b.lpc"));
    for (args, stdin) in [("cat - b.lpc -o -", a), ("cat a.lpc - -o -", b)] {
        let piped = bench.command(args).write_stdin(stdin).unwrap();
        assert!(piped.stdout == bench.read("ab.lpc"), "{args}");
    }
    bench.ok("cat out.lpc -o same.lpc");
    assert!(bench.read("same.lpc") == whole);
}

#[test]
fn streams_of_all_modes_and_scanners_are_cut_and_joined() {
    let bench = Bench::encoded();
    bench.ok("synth -o drive --frames 3 --seed 3");
    bench.ok("encode drive -o p.lpc --mode paper --columns 300 --gop 3");
    let scans: Files =
        bench.files("drive").into_iter().map(|(name, scan)| (format!("e{name}"), scan)).collect();
    bench.write_files("renamed", &scans);
    bench.ok("encode renamed -o e.lpc");
    bench.ok("cat out.lpc p.lpc e.lpc -o all.lpc");
    let info = bench.json("info all.lpc --json");
    assert_eq!((&info["version"], info["scanners"].as_array().unwrap().len()), (&1.into(), 2));
    for (range, stream) in [("..10", "out.lpc"), ("10..13", "p.lpc"), ("13..", "e.lpc")] {
        bench.ok(&format!("cut all.lpc --frames {range} -o part.lpc --force"));
        bench.decodes_to_range("part.lpc", stream, "..");
    }
    // From the middle of a lossy group into that of an exact one, and on to the same scanners.
    assert!(
        bench.says("cut all.lpc --frames 11..14 -o a.lpc").starts_with("3 frames: 1 copied, 2 coded again")
    );
    bench.decodes_to_range("a.lpc", "all.lpc", "11..14");
    bench.ok("cut all.lpc --frames 14.. -o b.lpc");
    bench.ok("cat a.lpc b.lpc -o ab.lpc");
    bench.decodes_to_range("ab.lpc", "all.lpc", "11..");
    assert_eq!(bench.json("info ab.lpc --json")["scanners"].as_array().unwrap().len(), 2);
    let stats = |stream: &str| bench.json(&format!("stats {stream} --json"));
    bench.ok("cut p.lpc --frames .. -o same.lpc");
    assert_eq!(stats("same.lpc")["points_lost"], stats("p.lpc")["points_lost"]);
    assert!(bench.read("same.lpc") == bench.read("p.lpc"));
}

#[test]
fn what_cannot_be_cut_or_joined_is_named() {
    let bench = Bench::encoded();
    bench.write_files("other", &Files::from([("10.bin".into(), b"another".to_vec())]));
    bench.ok("encode other -o other.lpc");
    let mut damaged = bench.read("out.lpc");
    let middle = damaged.len() / 2;
    damaged[middle] ^= 4;
    fs::write(bench.path("bad.lpc"), damaged).unwrap();
    let names = bench.names(".");
    for (args, path, complaint) in [
        ("cut out.lpc --frames 5..11 -o new.lpc", "out.lpc", "only frames 0 to 9, not 5..11"),
        ("cut nowhere.lpc --frames 5 -o new.lpc", "nowhere.lpc", "does not exist"),
        ("cut seq/1.bin --frames 5 -o new.lpc", "seq/1.bin", "not a lidarpc stream"),
        ("cut bad.lpc --frames .. -o new.lpc", "bad.lpc", "damaged stream"),
        ("cut out.lpc --frames 5 -o other.lpc", "other.lpc", "--force"),
        ("cut out.lpc --frames 5 -o seq", "seq", "is a folder"),
        ("cat out.lpc nowhere.lpc -o new.lpc", "nowhere.lpc", "does not exist"),
        ("cat out.lpc seq/1.bin -o new.lpc", "seq/1.bin", "not a lidarpc stream"),
        ("cat bad.lpc out.lpc -o new.lpc", "bad.lpc", "damaged stream"),
        ("cat out.lpc other.lpc -o bad.lpc", "bad.lpc", "--force"),
        ("cat out.lpc other.lpc -o new.lpc", "other.lpc", "as frame 2 of out.lpc; leave one out"),
        ("cat out.lpc out.lpc -o new.lpc", "out.lpc", "frame 0 (\"1.bin\") has the same name"),
    ] {
        let error = bench.fails(args, path);
        assert!(error.contains(complaint) && (error.contains(';') || path == "out.lpc"), "{error}");
    }
    assert_eq!(bench.names("."), names, "something was left behind");

    bench.ok("cut out.lpc --frames 2..4 -o other.lpc --force");
    for args in [
        "cut other.lpc --frames 1 -o other.lpc",
        "cat out.lpc other.lpc -o other.lpc",
        "repair other.lpc -o other.lpc",
    ] {
        assert!(bench.fails(&format!("{args} --force"), "other.lpc").contains("is an input as well"));
    }
    bench.decodes_to_range("other.lpc", "out.lpc", "2..4");
    bench.ok("cat other.lpc -o bad.lpc --force");
    assert_eq!(bench.read("bad.lpc"), bench.read("other.lpc"));
}

#[test]
#[cfg(target_os = "linux")]
fn a_full_disk_is_the_output_s_fault() {
    let bench = Bench::encoded();
    for args in ["cut out.lpc --frames 1.. -o -", "cat out.lpc -o -"] {
        let full = fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let run = Process::new(cargo_bin!("lidarpc"))
            .args(args.split(' '))
            .current_dir(bench.0.path())
            .stdout(full)
            .output()
            .unwrap();
        assert_eq!(run.status.code(), Some(1));
        let error = String::from_utf8(run.stderr).unwrap();
        assert!(error.starts_with("lidarpc: stdout: no space left"), "{error}");
    }
}

// ---- formats ----

#[test]
fn scans_are_converted_as_asked() {
    let bench = Bench::new();
    let files = [("1.bin", scan(40, 1)), ("2.bin", scan(5, 2)), ("3.bin", [scan(2, 3), vec![7; 9]].concat())];
    let files: Files = files.map(|(name, bytes)| (name.to_owned(), bytes)).into();
    bench.write_files("seq", &files);
    bench.ok("encode seq -o out.lpc");
    for format in ["pcd", "ply", "npy"] {
        bench.ok(&format!("decode out.lpc -o {format} --format {format}"));
        let converted = bench.files(format);
        let names = ["1", "2", "3"].map(|stem| format!("{stem}.{format}"));
        assert_eq!(bench.names(format), names);
        assert!(converted[&names[0]].ends_with(&files["1.bin"]));
        assert_eq!(
            bench.ok(&format!("decode out.lpc -o - --frames 0 --format {format}")),
            converted[&names[0]]
        );
        // And converted back, by way of another stream.
        bench.ok(&format!("encode {format} -o {format}.lpc"));
        bench.ok(&format!("decode {format}.lpc -o from-{format} --format bin"));
        let back = bench.files(&format!("from-{format}"));
        assert_eq!((&back["1.bin"], &back["2.bin"]), (&files["1.bin"], &files["2.bin"]));
        assert_eq!(back["3.bin"], scan(2, 3), "without what was behind the points");
    }
}

#[test]
fn doubles_are_converted_as_doubles() {
    let bench = Bench::new();
    let header =
        "VERSION 0.7\nFIELDS x y z\nSIZE 8 8 8\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1\nHEIGHT 1\nPOINTS 1\n";
    let point = [0.1, -0.2, 1.0 / 3.0].map(f64::to_le_bytes);
    let file = [header.as_bytes(), b"DATA binary\n", point.as_flattened()].concat();
    bench.write_files("seq", &[("1.pcd".to_owned(), file)].into());
    bench.ok("encode seq -o out.lpc");
    bench.ok("decode out.lpc -o csv --format csv");
    assert_eq!(bench.files("csv")["1.csv"], b"x,y,z\n0.1,-0.2,0.3333333333333333\n");
    let error = bench.fails("decode out.lpc -o bin --format bin", "1.pcd");
    assert!(error.contains("not float32"), "{error}");
}

/// What can be read only once: `<(command)` of a shell, for example.
#[cfg(unix)]
#[test]
fn streams_come_through_named_pipes() {
    let bench = Bench::encoded();
    let (stream, pipe) = (bench.path("out.lpc"), bench.path("pipe"));
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let from_pipe = |command: &str| {
        let (stream, pipe) = (stream.clone(), pipe.clone());
        let writer = std::thread::spawn(move || fs::copy(stream, pipe));
        let answer = bench.ok(command);
        writer.join().unwrap().unwrap();
        answer
    };
    from_pipe("decode pipe -o back");
    assert_eq!(bench.files("back"), bench.files("seq"));
    from_pipe("verify pipe");
    from_pipe("cut pipe -o cut.lpc --frames 0..1");
    from_pipe("cat pipe -o cat.lpc");
    assert_eq!(fs::read(bench.path("cat.lpc")).unwrap(), fs::read(bench.path("out.lpc")).unwrap());
    for command in ["info", "stats"] {
        let named = String::from_utf8(bench.ok(&format!("{command} out.lpc --json"))).unwrap();
        let piped = String::from_utf8(from_pipe(&format!("{command} pipe --json"))).unwrap();
        assert_eq!(piped.replace("\"pipe\"", "\"out.lpc\""), named);
    }
}

#[test]
fn what_cannot_be_converted_is_named() {
    let bench = Bench::encoded();
    // A file without points is written as it was.
    let said = bench.says("decode out.lpc -o converted --format ply");
    assert!(said.contains("2 files without points, such as damaged.pcd: not converted"), "{said}");
    assert!(said.contains("converted: 10 frames: "), "{said}");
    assert_eq!(bench.files("converted")["damaged.pcd"], bench.files("seq")["damaged.pcd"]);
    let same: Files = [("a.bin", scan(4, 1)), ("a.pcd.bin", scan(5, 1))]
        .map(|(name, bytes)| (name.to_owned(), bytes))
        .into();
    bench.write_files("same", &same);
    bench.ok("encode same -o same.lpc");
    let error = bench.fails("decode same.lpc -o back --format ply", "a.pcd.bin");
    assert!(error.contains("a.ply") && error.contains("a.bin"), "{error}");
    assert!(!bench.path("back").exists());
}

#[test]
fn named_fields_keep_their_names_and_types() {
    let bench = Bench::new();
    let record = |n: u32| {
        let point = [n as f32, 7.0, -1.0].map(f32::to_le_bytes).concat();
        [&point[..], &[n as u8], &(n as u16 % 16).to_le_bytes(), &f64::from(n).to_le_bytes(), &[9; 4]]
            .concat()
    };
    let bytes: Vec<u8> = (0..200).flat_map(record).collect();
    bench.write_files("seq", &Files::from([("1.bin".to_owned(), bytes.clone())]));
    bench.ok("encode seq -o out.lpc --layout x,y,z,intensity:u8,ring:u16,time:f64,_:u8*4 --verify");
    bench.ok("verify out.lpc --against seq");
    bench.ok("decode out.lpc -o pcd --format pcd");
    let pcd = &bench.files("pcd")["1.pcd"];
    let header = "FIELDS x y z intensity ring time\nSIZE 4 4 4 1 2 8\nTYPE F F F U U F\n";
    assert!(String::from_utf8_lossy(pcd).contains(header));
    let body: Vec<u8> = bytes.chunks(27).flat_map(|record| record[..23].to_vec()).collect();
    assert!(pcd.ends_with(&body));
    bench.ok("decode out.lpc -o ply --format ply");
    let ply = String::from_utf8_lossy(&bench.files("ply")["1.ply"]).into_owned();
    let properties = "property uchar intensity\nproperty ushort ring\nproperty double time\nend_header\n";
    assert!(ply.contains(properties), "{ply}");
}

#[test]
fn files_that_are_named_must_hold_scans() {
    let bench = Bench::new();
    let files = ["a.npy", "a.mcap", "a.png", "a.lpc", "bad.pcd", "bad.ply"];
    let bytes: Vec<u8> = (0..2000u32).flat_map(|n| (n % 1000).to_le_bytes()).collect();
    bench.write_files("odd", &files.iter().map(|name| (name.to_string(), bytes.clone())).collect());
    for name in files {
        let error = bench.fails(&format!("encode odd/{name} -o out.lpc"), &format!("odd/{name}"));
        assert!(error.contains("--force-bytes"), "{error}");
        assert!(!bench.path("out.lpc").exists());
        bench.ok(&format!("encode odd/{name} -o {name}.lpc --force-bytes --verify"));
        bench.ok(&format!("decode {name}.lpc -o back"));
        assert_eq!(bench.files("back")[name], bytes);
    }
    // Those in a folder are recognised by their names alone.
    bench.ok("encode odd -o folder.lpc");
    assert_eq!(bench.json("info folder.lpc --json")["frames"].as_array().map(Vec::len), Some(2));
}

#[test]
fn records_are_what_the_layout_says() {
    let bench = Bench::new();
    let record = |n: u32| [n as f32, 7.0, -1.0, 0.5 * n as f32, 3.25, n as f32 + 0.125].map(f32::to_le_bytes);
    let bytes: Vec<u8> = (0..50).flat_map(|n| record(n).concat()).collect();
    let cut = bytes[..bytes.len() - 5].to_vec();
    bench.write_files("seq", &Files::from([("1.bin".to_owned(), bytes.clone()), ("2.bin".to_owned(), cut)]));
    bench.ok("encode seq -o out.lpc --layout t_zxyi --verify");
    assert_eq!(bench.json("info out.lpc --json")["points"], 50 + 49);
    bench.ok("verify out.lpc --against seq");
    bench.ok("decode out.lpc -o back --format bin");
    let expected = (0..50).flat_map(|n| {
        let [_, _, z, x, y, i] = record(n);
        [x, y, z, i].concat()
    });
    assert_eq!(bench.files("back")["1.bin"], expected.collect::<Vec<u8>>());

    // The originals are read with the layout with which they were coded: this x would be an intensity in
    // KITTI's layout.
    let mut moved = bytes;
    moved[12..16].copy_from_slice(&2f32.to_le_bytes());
    fs::write(bench.path("seq/1.bin"), moved).unwrap();
    let against = bench.json("stats out.lpc --against seq --json")["against"].clone();
    assert_eq!((&against["max_error_m"], &against["lost_points"]), (&2.0.into(), &0.into()));
    bench.command("encode seq -o no.lpc --layout xyq").assert().code(2);
}

// ---- synthetic drives ----

/// A drive of two scans, in `drive`.
fn driven() -> Bench {
    let bench = Bench::new();
    bench.ok("synth -o drive --frames 2");
    bench
}

#[test]
fn limits_can_be_set() {
    let bench = driven();
    bench.ok("encode drive -o d.lpc");
    for limit in ["--max-points 1000", "--max-file-bytes 5000", "--max-group-bytes 100"] {
        for command in ["verify d.lpc", "decode d.lpc -o out", "cut d.lpc --frames 1.. -o cut.lpc"] {
            let error = bench.fails(&format!("{command} {limit}"), "d.lpc");
            assert!(error.contains("over the limit") && error.contains("--max-points"), "{error}");
        }
        // What the limits leave out is not damaged.
        let kept = bench.command(&format!("decode d.lpc -o kept --keep-going {limit}")).output().unwrap();
        let said = String::from_utf8(kept.stderr).unwrap();
        assert!(said.contains("over the limit") && !said.contains("checksums"), "{said}");
    }
    bench.fails("info d.lpc --max-group-bytes 100", "d.lpc");
    bench.ok("verify d.lpc --max-points 10000000 --max-file-bytes 10000000");
}

#[test]
fn a_largest_error_is_kept_and_told() {
    let bench = Bench::new();
    bench.ok("synth -o drive --frames 3");
    bench.ok("encode drive -o b.lpc --max-error 2cm --intensity-step 0.1 --verify");
    let stats = bench.json("stats b.lpc --against drive --json");
    let largest = stats["against"]["max_error_m"].as_f64().unwrap();
    assert!((0.01..=0.02).contains(&largest), "{largest}");
    let intensity = stats["against"]["max_intensity_error"].as_f64().unwrap();
    assert!((0.02..0.050001).contains(&intensity), "{intensity}");
    assert_eq!((&stats["against"]["lost_points"], &stats["against"]["added_points"]), (&0.into(), &0.into()));
    let coding = bench.json("info b.lpc --json")["frames"][0]["coding"].clone();
    assert_eq!(coding, "within 20 mm, intensities in steps of 0.1, context (light)");
    assert_eq!(stats["fidelity"], serde_json::json!({ "within 20 mm, intensities in steps of 0.1": 3 }));
    let text = String::from_utf8(bench.ok("stats b.lpc")).unwrap();
    assert!(text.contains("\n3 frames: within 20 mm, intensities in steps of 0.1\n"), "{text}");
}

#[test]
fn paper_mode_says_what_it_lost() {
    let bench = driven();
    bench.ok("encode drive -o p.lpc --mode paper --step 1cm --columns 500 --backend zstd --level 2 --verify");
    let info = bench.json("info p.lpc --json");
    assert_eq!(info["frames"][0]["coding"], "range image, intra, snake, zstd, varint");
    let stats = bench.json("stats p.lpc --against drive --json");
    let counts = ["points", "outliers_dropped", "points_lost"].map(|name| stats[name].as_u64().unwrap());
    assert!(counts[1] > 0 && counts[2] > 0, "{stats}");
    assert_eq!(counts[0] - counts[1] - counts[2], info["points"].as_u64().unwrap());
    let rmse = stats["against"]["decoded_to_original_rmse_m"].as_f64().unwrap();
    assert!((0.001..0.5).contains(&rmse), "{stats}");
    assert!(stats["against"].get("psnr").is_none());

    let psnr = bench.json("stats p.lpc --against drive --psnr --json")["against"]["psnr"].clone();
    let [d1, d2] = ["d1_db", "d2_db"].map(|name| psnr[name].as_f64().unwrap());
    // 3 p^2 / d^2 is 40 dB for errors of 1 m, 100 dB for 1 mm; point-to-plane measures ignore errors along
    // planes.
    assert!(40.0 < d1 && d1 < d2 && d2 < 100.0, "{psnr}");
    assert_eq!((&psnr["peak_m"], &psnr["lossless"]), (&59.7.into(), &false.into()));
    let text = String::from_utf8(bench.ok("stats p.lpc --against drive --psnr")).unwrap();
    assert!(text.contains("D2 PSNR") && text.contains("peak 59.70 m"), "{text}");
    bench.ok("encode drive -o e.lpc");
    let psnr = bench.json("stats e.lpc --against drive --psnr --json")["against"]["psnr"].clone();
    assert_eq!((&psnr["lossless"], &psnr["d1_db"]), (&true.into(), &Value::Null));

    bench.ok("encode drive -o n.lpc --mode paper --predict none --no-snake --keep-outliers --packing varint");
    let frame = bench.json("info n.lpc --json")["frames"][0].clone();
    assert_eq!(frame["coding"], "range image, lzma, varint");
    assert_eq!(bench.json("stats n.lpc --json")["outliers_dropped"], 0);
}

#[test]
fn image_coders_spend_what_they_are_given() {
    let bench = driven();
    let coded = |options: &str| {
        let coding = "--mode paper --step 1cm --columns 500 --predict none --verify --force";
        bench.ok(&format!("encode drive -o p.lpc {coding} {options}"));
        let stats = bench.json("stats p.lpc --against drive --json");
        let rmse = stats["against"]["decoded_to_original_rmse_m"].as_f64().unwrap();
        (bench.json("info p.lpc --json")["frames"][0]["coding"].clone(), rmse)
    };
    let (coding, coarse) = coded("--backend jpeg --rate 2 --passes 1");
    assert_eq!(coding, "range image, jpeg");
    let (coding, finer) = coded("--backend jpeg2000 --rate 6");
    assert_eq!(coding, "range image, jpeg2000");
    let exact = coded("--backend jpeg2000 --rate lossless").1;
    assert!(exact < finer && finer < coarse, "{coarse} {finer} {exact}");
    bench.ok("encode drive -o e.lpc --backend jpeg2000 --rate lossless --verify");
    assert_eq!(bench.json("info e.lpc --json")["frames"][0]["coding"], "exact, jpeg2000");
}

#[test]
fn the_smaller_prediction_is_taken() {
    let bench = driven();
    let size = |predict: &str| {
        bench
            .ok(&format!("encode drive -o {predict}.lpc --mode paper --backend deflate --predict {predict}"));
        fs::metadata(bench.path(&format!("{predict}.lpc"))).unwrap().len()
    };
    assert!(size("auto") <= size("none").min(size("intra")));
}

#[test]
fn steps_add_up_to_the_sections() {
    let bench = driven();
    bench.ok("encode drive -o p.lpc --mode paper --columns 500");
    let of_scans = bench.json("stats drive --steps --mode paper --columns 500 --json");
    let of_stream = bench.json("stats p.lpc --steps --json");
    assert_eq!(of_scans["bytes"], of_stream["bytes"]);
    assert!(of_stream.get("encoding_seconds").is_none());
    let bytes = |name: &str| of_stream["bytes"][name].as_f64().unwrap();
    let parts: f64 = ["contour_map", "side_data", "ranges", "rest"].map(bytes).iter().sum();
    assert!((parts - bytes("after_coding")).abs() < 1e-6);
    assert_eq!(bytes("after_conversion"), 4.0 * 64.0 * 500.0);
    assert!(bytes("contour_map") > 0.0 && bytes("after_coding") < bytes("after_prediction"));
    let of_scans = String::from_utf8(bench.ok("stats drive --steps --mode paper --columns 300")).unwrap();
    assert!(of_scans.starts_with("mean of 2 frames, ranges in steps of 1 mm (--step)\n"), "{of_scans}");
    let text = String::from_utf8(bench.ok("stats p.lpc --steps")).unwrap();
    assert!(text.contains("contour map") && text.contains("clustering"), "{text}");
}

/// As [`driven`], with every eighth firing only.
fn thinly_driven() -> Bench {
    let bench = Bench::new();
    let frames = drive(&SynthConfig { frames: 2, thinning: 8, ..SynthConfig::default() });
    bench.write_files("drive", &frames.map(|frame| (frame.name.clone(), frame.to_bin())).collect());
    bench
}

/// The section of a report of `bench --json` with this number.
fn section<'a>(report: &'a Value, number: &str) -> &'a Value {
    let sections = report["sections"].as_array().unwrap();
    sections.iter().find(|section| section["number"] == number).expect(number)
}

/// A value of a table.
fn cell(table: &Value, row: &str, column: usize) -> f64 {
    let rows = table["rows"].as_array().unwrap();
    let row = rows.iter().find(|found| found["name"].as_str().unwrap().trim() == row).expect(row);
    row["cells"][column].as_f64().unwrap()
}

#[test]
fn bench_gives_the_tables_and_figures() {
    let bench = thinly_driven();
    let report = bench.json("bench drive --quick --json --columns 300 --step 2cm --html page.html");
    let numbers: Vec<_> =
        report["sections"].as_array().unwrap().iter().map(|s| s["number"].as_str().unwrap()).collect();
    let tables = ["Table I", "Table I, octree", "Table II", "Table III", "Table IV", "Table V", "Table VI"];
    assert_eq!(numbers[..7], tables);
    let figures =
        ["Figure 13, table", "Figure 13, floats", "Figure 13, integers", "Figure 15", "Figure 15, beyond"];
    assert_eq!(numbers[7..], figures);

    let rates = section(&report, "Table I");
    assert_eq!(cell(rates, "intra coding, LZMA", 1), 3.35, "published");
    let measured = ["intra coding, LZMA", "inter coding, LZMA", "context coder, same image"];
    assert!(measured.iter().all(|row| (0.1..20.0).contains(&cell(rates, row, 0))), "{rates}");
    let octree =
        ["octree, 1 mm\u{b3}", "octree, 5 mm\u{b3}", "octree, 1 cm\u{b3}"].map(|row| cell(rates, row, 0));
    assert!(octree[0] > octree[1] && octree[1] > octree[2] && octree[2] > 0.1, "{octree:?}");
    let octrees = section(&report, "Table I, octree");
    for (row, millimetres) in [("5 mm", 5.0), ("1 cm", 10.0)] {
        // Errors are uniformly distributed over voxels.
        assert!((cell(octrees, row, 2) / (0.5 * millimetres) - 1.0).abs() < 0.1, "{octrees}");
        assert!(cell(octrees, row, 3) <= 1.001 * 0.75f64.sqrt() * millimetres, "{octrees}");
    }
    let times = section(&report, "Table VI");
    for (row, published) in [("octree", 0.024), ("Tu-MPEG", 0.5), ("Tu-SLAM", 0.1)] {
        assert!(cell(times, row, 0) > 0.0 && cell(times, row, 1) > 0.0, "{times}");
        assert_eq!(cell(times, row, 2), published);
    }
    for number in ["Table II", "Table III"] {
        let volumes = section(&report, number);
        let parts = ["ranges", "contour map", "parameters, models of regions", "which cells hold a return"];
        let sum: f64 = parts.iter().map(|part| cell(volumes, part, 0)).sum();
        assert!((sum - cell(volumes, "after coding, LZMA", 0)).abs() < 1e-6, "{volumes}");
        assert!((cell(volumes, "after conversion", 0) - 4.0 * 64.0 * 300.0 / 1e3).abs() < 1e-6);
    }
    for number in ["Table IV", "Table V"] {
        let times = section(&report, number);
        let steps = times["rows"].as_array().unwrap().iter().map(|row| row["cells"][0].as_f64().unwrap());
        let sum: f64 = steps.clone().take(steps.len() - 1).sum();
        assert!(cell(times, "total", 0) >= 0.999 * sum && sum > 0.0, "{times}");
    }

    let table = section(&report, "Figure 13, table");
    let rows = table["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 10);
    for row in rows {
        let sizes = row["cells"].as_array().unwrap();
        assert!(sizes.len() == 9 && sizes.iter().all(|size| size.as_f64().unwrap() > 1.0), "{row}");
    }
    let curves = section(&report, "Figure 15")["series"].as_array().unwrap();
    let points = |curve: &Value| curve["points"].as_array().unwrap().len();
    assert_eq!(curves.iter().map(points).collect::<Vec<_>>(), [2, 2, 2, 2, 2, 2, 1, 1, 2, 2, 3]);
    for curve in &curves[..6] {
        let [few, many] = [&curve["points"][0], &curve["points"][1]];
        assert!(few["x"].as_f64() < many["x"].as_f64() && few["y"].as_f64() > many["y"].as_f64(), "{curve}");
    }
    for curve in &curves[8..10] {
        let [fine, coarse] = [&curve["points"][0], &curve["points"][1]];
        assert!(
            fine["x"].as_f64() > coarse["x"].as_f64() && fine["y"].as_f64() < coarse["y"].as_f64(),
            "{curve}"
        );
    }
    let summary = report["summary"].as_str().unwrap();
    assert!(
        summary.starts_with("Fewest bits at an RMSE of ") && summary.ends_with(" % of the files."),
        "{summary}"
    );
    for other in ["lidarpc (", "the article's coders (", "Tu-MPEG", "Tu-SLAM", "the octree"] {
        assert!(summary.contains(other), "{summary}");
    }
    let curves = section(&report, "Figure 15, beyond")["series"].as_array().unwrap();
    assert_eq!(curves.iter().map(points).collect::<Vec<_>>(), [3, 3, 3, 3, 3, 1]);
    let inter = &curves[1]["points"];
    assert!(
        inter[0]["x"].as_f64() > inter[2]["x"].as_f64() && inter[0]["y"].as_f64() < inter[2]["y"].as_f64()
    );
    assert_eq!(curves[5]["points"][0]["y"], 0.0, "exact mode");

    let page = fs::read_to_string(bench.path("page.html")).unwrap();
    assert!(page.starts_with("<!DOCTYPE html>") && page.ends_with("</html>\n"));
    assert!(page.contains("<p class=\"summary\">Fewest bits at"));
    assert_eq!(page.matches("<svg ").count(), 4);
    for loads in ["http://", "https://", "<script", "src=", "url("] {
        assert!(!page.contains(loads), "{loads}");
    }
    assert!(page.contains("lidarpc bench drive --quick") && page.contains("published, other scenes"));
    assert!(bench.fails("bench drive --quick --html page.html", "page.html").contains("--force"));
}

#[test]
fn bench_takes_a_single_scan_and_no_folder_without_points() {
    let bench = thinly_driven();
    let name = bench.names("drive").remove(0);
    let csv = bench.ok(&format!("bench drive/{name} --quick --csv --columns 200 --step 5cm"));
    let csv = String::from_utf8(csv).unwrap();
    assert!(csv.starts_with("section,series,x,x_unit,y,y_unit,origin\r\n"), "{csv}");
    assert!(csv.contains("Table I,\"intra coding, LZMA\",this drive,,"), "{csv}");
    assert!(!csv.contains("Table I,\"inter coding, LZMA\",this drive"), "nothing to predict from");
    assert!(csv.contains("Table I,\"inter coding, LZMA\",city,,3.27,%,published"), "{csv}");
    assert!(csv.lines().any(|line| line.starts_with("\"Figure 15, beyond\",\"context, ideal image\",")));

    bench.write_files("none", &[("0.bin".to_owned(), Vec::new())].into());
    assert!(bench.fails("bench none", "none").contains("no points"));
    assert!(bench.fails("bench drive --step float", "drive").contains("steps"));
    bench.ok("encode drive -o drive.lpc");
    assert!(bench.fails("bench drive.lpc", "drive.lpc").contains("decode it first"));
    bench.fails("bench missing --html page.html", "missing");
    assert!(!bench.path("page.html").exists());
}

#[test]
fn frames_are_drawn() {
    let bench = driven();
    bench.ok("encode drive -o p.lpc --mode paper --columns 300");
    let png = b"\x89PNG\r\n\x1a\n";
    let draw = |what: &str| {
        bench.ok(&format!("view {what} -o out.png --force"));
        let picture = fs::read(bench.path("out.png")).unwrap();
        assert!(picture.starts_with(png), "{what}");
        picture
    };
    let kinds = [
        "range",
        "occupancy",
        "labels",
        "regions",
        "prediction",
        "residual",
        "birds-eye",
        "perspective",
        "overview",
        "error",
    ];
    let all = kinds.map(|kind| draw(&format!("p.lpc --kind {kind} --frame 1 --against drive")));
    for (place, picture) in all.iter().enumerate() {
        assert!(!all[..place].contains(picture), "two kinds look alike");
    }
    let together = draw("p.lpc --frame 1 --against drive");
    assert_eq!(draw("drive --mode paper --columns 300 --frame 1"), together);
    assert_eq!(draw("drive --mode paper --columns 300 --frame 1 --kind error"), all[9]);
    assert_ne!(draw("p.lpc --frame 1"), together, "the errors are not known");
    assert_ne!(draw("p.lpc --frame 1 --against drive --scale 2"), together);
    assert!(bench.fails("view p.lpc --kind error -o new.png", "0000000000.bin").contains("--against"));
    assert!(bench.ok("view p.lpc --kind range -o -").starts_with(png));
    assert!(bench.fails("view p.lpc --frame 2 -o new.png", "p.lpc").contains("only frames 0 to 1"));
    assert!(bench.fails("view drive --frame 2 -o new.png", "drive").contains("only frames 0 to 1"));
    assert!(bench.fails("view p.lpc -o out.png", "out.png").contains("--force"));

    fs::write(bench.path("few.bin"), scan(2, 1)).unwrap();
    bench.ok("view few.bin --kind birds-eye -o few.png");
    bench.ok("view few.bin -o instead.png");
    assert_eq!(bench.read("instead.png"), bench.read("few.png"), "what there is to see");
    assert!(bench.fails("view few.bin --kind range -o none.png", "few.bin").contains("no range image"));
    fs::write(bench.path("none.bin"), b"").unwrap();
    for kind in ["all", "birds-eye"] {
        let error = bench.fails(&format!("view none.bin --kind {kind} -o none.png"), "none.bin");
        assert!(error.contains("no points to draw"), "{error}");
    }
    bench.command("view p.lpc -o picture.jpg").assert().code(2);
    assert!(["new.png", "none.png", "picture.jpg"].iter().all(|name| !bench.path(name).exists()));
}

#[test]
fn a_page_holds_a_drive() {
    let bench = driven();
    bench.ok("encode drive -o p.lpc");
    let drive_of = |page: &str| -> serde_json::Value {
        assert!(page.starts_with("<!doctype html>") && page.trim_end().ends_with("</html>"));
        let (_, rest) = page.split_once("<script type=\"application/json\" id=\"drive\">").unwrap();
        serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap()
    };
    let frames = |page: &str| page.matches("<script type=\"text/plain\" class=\"frame\">").count();
    bench.ok("view p.lpc --html p.html");
    let page = String::from_utf8(bench.read("p.html")).unwrap();
    let drive = drive_of(&page);
    assert_eq!(frames(&page), 2);
    assert_eq!(drive["name"], "p.lpc");
    assert_eq!(drive["bytes"], bench.read("p.lpc").len());
    for (number, frame) in drive["frames"].as_array().unwrap().iter().enumerate() {
        let name = format!("{number:010}.bin");
        let bytes = bench.read(&format!("drive/{name}")).len();
        assert_eq!((&frame["name"], &frame["bytes"]), (&name.into(), &bytes.into()));
        assert_eq!((&frame["points"], &frame["rows"]), (&(bytes / 16).into(), &64.into()));
        assert_eq!(frame["fields"][0]["name"], "intensity");
    }
    assert!(page.contains(include_str!("../web/view.js")), "the page has its script");

    bench.ok("view drive --html drive.html");
    let folder = String::from_utf8(bench.read("drive.html")).unwrap();
    assert_eq!(drive_of(&folder)["frames"], drive["frames"]);
    let one = String::from_utf8(bench.ok("view p.lpc --frames 1 --html -")).unwrap();
    assert_eq!(frames(&one), 1);
    assert_eq!(drive_of(&one)["frames"][0], drive["frames"][1]);

    assert!(bench.fails("view p.lpc --frames 1..3 --html new.html", "p.lpc").contains("only frames 0 to 1"));
    assert!(bench.fails("view p.lpc --html p.html", "p.html").contains("--force"));
    let mut damaged = bench.read("p.lpc");
    let middle = damaged.len() / 2;
    damaged[middle] ^= 1;
    fs::write(bench.path("damaged.lpc"), damaged).unwrap();
    bench.fails("view damaged.lpc --html new.html", "damaged.lpc");
    for wrong in ["-o new.png --html new.html", "--frame 1 --html new.html", "--frames 1 -o new.png"] {
        bench.command(&format!("view p.lpc {wrong}")).assert().code(2);
    }
    assert!(["new.png", "new.html"].iter().all(|name| !bench.path(name).exists()));
}

#[test]
fn what_is_intact_of_a_damaged_file_is_saved() {
    let bench = Bench::encoded();
    let mut bytes = fs::read(bench.path("out.lpc")).unwrap();
    let info = bench.json("info out.lpc --json");
    let group = &info["groups"][1];
    bytes[group["offset"].as_u64().unwrap() as usize + 9] ^= 1;
    fs::write(bench.path("bad.lpc"), &bytes).unwrap();
    let error = bench.fails("decode bad.lpc -o back", "bad.lpc");
    assert!(error.contains("--keep-going"), "{error}");
    let lost: Vec<&str> = info["frames"].as_array().unwrap()[2..4]
        .iter()
        .map(|frame| frame["name"].as_str().unwrap())
        .collect();
    let mut left = odd_files();
    left.retain(|name, _| !lost.contains(&&name[..]));
    for args in ["decode bad.lpc -o back --keep-going --quiet", "repair bad.lpc -o good.lpc --quiet"] {
        let run = bench.command(args).assert().code(3);
        let said = String::from_utf8_lossy(&run.get_output().stderr).into_owned();
        assert!(
            said.contains("with frames 2 to 3") && said.contains("8 frames saved, 2 frames lost"),
            "{said}"
        );
    }
    assert_eq!(bench.files("back"), left);
    bench.ok("decode good.lpc -o again");
    assert_eq!(bench.files("again"), left);
    bench.ok("decode out.lpc -o whole --keep-going");
    fs::write(bench.path("empty.lpc"), b"").unwrap();
    let error = bench.fails("decode empty.lpc -o none --keep-going", "empty.lpc");
    assert!(error.contains("nothing of it can be saved") && !error.contains("--keep-going"), "{error}");
    assert_eq!(bench.files("whole"), odd_files());
    // Frames can also be recovered from a pipe.
    let run = bench.command("decode - -o piped --keep-going").write_stdin(bytes).assert().code(3);
    drop(run);
    assert_eq!(bench.files("piped"), left);
}

#[test]
fn a_range_of_a_damaged_file_counts_what_it_leaves_out_and_what_it_lost() {
    let bench = Bench::new();
    bench.write_files("seq", &odd_files());
    fs::write(bench.path("seq/notes.txt"), b"of the drive").unwrap();
    fs::write(bench.path("seq/calib.txt"), b"1 0 0").unwrap();
    bench.ok("encode seq -o out.lpc --gop 2 --all");
    let mut bytes = bench.read("out.lpc");
    let info = bench.json("info out.lpc --json");
    let offset = |group: usize| info["groups"][group]["offset"].as_u64().unwrap() as usize;
    bytes[offset(1) + 9] ^= 1;
    fs::write(bench.path("bad.lpc"), &bytes).unwrap();
    let beside = "left out 2 files beside the scans, which only a whole stream gives";
    for (args, code, expected) in [
        ("decode out.lpc -o a --frames 0..2", 0, &[beside, "a: 2 frames"][..]),
        ("decode out.lpc -o b --frames 0..2 --keep-going", 0, &[beside, "b: 2 frames"]),
        ("decode bad.lpc -o c --frames 0..2 --keep-going", 0, &[beside, "c: 2 frames"]),
        ("decode bad.lpc -o d --frames 3..5 --keep-going", 3, &[beside, "1 frame saved, 1 frame lost"]),
        ("decode bad.lpc -o e --frames 20..30 --keep-going", 1, &["holds only frames 0 to 9, not 20..30"]),
        ("decode bad.lpc -o f --keep-going", 3, &["10 frames saved, 2 frames lost"]),
    ] {
        let output = bench.command(args).output().unwrap();
        let says = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{args}: {says}");
        assert!(expected.iter().all(|line| says.contains(line)), "{args}: {says}");
    }
    assert!(!bench.path("e").exists());
    // Lost files beside the scans are not among those left out, nor of a range.
    bytes[offset(5) + 9] ^= 1;
    fs::write(bench.path("worse.lpc"), &bytes).unwrap();
    let says = bench.says("decode worse.lpc -o g --frames 8.. --keep-going");
    assert!(says.starts_with("g: 2 frames: "), "{says}");
}

//! Nothing is lost silently: which inputs the program accepts, leaves out and rejects, and its messages about
//! them.

#![cfg_attr(not(target_os = "linux"), allow(dead_code, unused_imports))] // Some tests take what Linux has.

use std::fs;
use std::process::{Command as Process, Stdio};

use crate::common::{in_package, put_together, take_apart};
use crate::program::{Bench, Files, odd_files, scan};
use assert_cmd::cargo::cargo_bin;
use lidarpc::internals::files::{parse, with_point_count};
use lidarpc::internals::scan::{LzfDialect, Wrapping};
use serde_json::Value;

/// Records of `values` float32 values, as from a rotating scanner.
fn turning(values: usize) -> Vec<u8> {
    let record = |n: u32| {
        let angle = n as f32 * 0.003;
        let range = 10.0 + (n.wrapping_mul(2_654_435_761) >> 24) as f32 * 0.004;
        let rest = [(n % 97) as f32 / 100.0, (n % 16) as f32, n as f32 * 1e-6];
        let record = [range * angle.cos(), range * angle.sin(), range * 0.1].into_iter().chain(rest);
        record.take(values).flat_map(f32::to_le_bytes).collect::<Vec<_>>()
    };
    (0..4000).flat_map(record).collect()
}

/// A folder with `drive/` in KITTI's form: two scans, and the files beside them.
fn kitti_drive() -> Bench {
    let bench = Bench::new();
    let scans = [("0.bin", turning(4)), ("1.bin", turning(4))];
    bench
        .write_files("drive/velodyne_points/data", &scans.map(|(name, scan)| (name.to_owned(), scan)).into());
    bench.write_files("drive/velodyne_points", &[("timestamps.txt".to_owned(), b"now".to_vec())].into());
    bench.write_files("drive/oxts/data", &[("0.txt".to_owned(), b"here".to_vec())].into());
    bench.write_files("drive/image_00", &[("0.png".to_owned(), b"this".to_vec())].into());
    bench
}

#[test]
fn what_is_left_out_is_counted_and_can_be_refused() {
    let bench = kitti_drive();
    let left_out = "3 files not known as scans (11 bytes, such as drive/image_00/0.png)";
    let said = bench.says("encode drive -o out.lpc --verify");
    assert_eq!(said.lines().next().unwrap(), format!("lidarpc: drive: left out {left_out}"));
    assert!(said.contains("times and permissions of files are not stored"), "{said}");
    let error = bench.fails("encode drive -o strict.lpc --strict", "drive");
    assert!(error.contains(left_out) && error.contains("without --strict"), "{error}");
    assert!(!bench.path("strict.lpc").exists());
    bench.ok("encode drive/velodyne_points/data -o strict.lpc --strict");

    let verbose = bench.says("encode drive -o out.lpc --force --verbose");
    for line in ["left out file not known as a scan drive/oxts/data/0.txt\n", "\n1.bin: 64.00 kB -> "] {
        assert!(verbose.contains(line), "{verbose}");
    }
    let report = bench.json("encode drive -o out.lpc --force --json");
    let left_out = &report["left_out"][0];
    assert_eq!(
        (&left_out["what"], &left_out["first"]),
        (&"file not known as a scan".into(), &"drive/image_00/0.png".into())
    );
    assert_eq!(
        (&left_out["count"], &left_out["bytes"], &report["mode"]),
        (&3.into(), &11.into(), &"exact".into())
    );
}

#[test]
fn text_is_a_scan_of_a_folder_where_it_looks_like_points() {
    let bench = Bench::new();
    let point = |n: f64| format!("{:.3},{:.3},{:.3}", 9.0 * (n / 9.0).cos(), 9.0 * (n / 9.0).sin(), n / 99.0);
    let lines =
        |line: &dyn Fn(f64) -> String| (0..200).map(|n| line(f64::from(n)) + "\n").collect::<String>();
    let text = |name: &str, text: String| (name.to_owned(), text.into_bytes());
    let files: Files = [
        text("1.csv", lines(&point)),
        text("2.txt", "X, Y, Z\n1.5, 2.5, 3.5".to_owned()),
        text("imu.csv", lines(&|n| format!("{n}.25,{}", point(n)))),
        text("times.txt", lines(&|n| format!("{n}"))),
    ]
    .into();
    bench.write_files("seq", &files);
    let said = bench.says("encode seq -o out.lpc --verify");
    assert!(said.contains("2 frames: ") && said.contains("left out 2 files not known as scans"), "{said}");
    assert!(!said.contains("plain bytes"), "{said}");
    bench.ok("decode out.lpc -o back");
    let scans = |files: Files| files.into_iter().filter(|(name, _)| name.starts_with(['1', '2']));
    assert!(scans(files).eq(bench.files("back")));
    bench.ok("encode seq -o all.lpc --all --strict");
    bench.ok("decode all.lpc -o all");
    assert_eq!(bench.files("all"), bench.files("seq"));
    // Named explicitly, any table is accepted, but nothing else.
    bench.ok("encode seq/imu.csv -o imu.lpc");
    assert!(bench.fails("encode seq/times.txt -o times.lpc", "seq/times.txt").contains("--force-bytes"));
    // From text to text, by way of an array.
    bench.ok("decode out.lpc -o arrays --format npy");
    bench.ok("encode arrays -o arrays.lpc");
    bench.ok("decode arrays.lpc -o texts --format csv");
    assert_eq!(bench.files("texts")["2.csv"], b"x,y,z\n1.5,2.5,3.5\n");
}

#[test]
#[cfg(unix)]
fn links_pipes_and_hidden_scans_are_counted() {
    use std::os::unix::fs::symlink;

    let bench = Bench::new();
    let names = ["1.bin", ".2.bin", "old.lpc"];
    bench.write_files("seq", &names.map(|name| (name.to_owned(), scan(40, 1))).into());
    symlink("1.bin", bench.path("seq/3.bin")).unwrap();
    symlink("nowhere", bench.path("seq/link")).unwrap();
    for name in ["pipe", "pipe.bin"] {
        assert!(Process::new("mkfifo").arg(bench.path("seq").join(name)).status().unwrap().success());
    }
    let said = bench.says("encode seq -o out.lpc");
    for what in [
        "1 lidarpc stream (640 bytes, seq/old.lpc)",
        "1 hidden file or folder (640 bytes, seq/.2.bin)",
        "1 symbolic link (seq/link)",
        "1 symbolic link, stored as the scan it leads to (seq/3.bin)",
        "2 named pipes, sockets or devices (such as seq/pipe",
    ] {
        assert!(said.contains(what), "{what} is missing in: {said}");
    }
    assert_eq!(said.lines().count(), 2, "{said}");
    bench.fails("encode seq -o strict.lpc --strict", "seq");
}

#[test]
fn an_output_among_the_scans_is_known_the_next_time() {
    let bench = Bench::new();
    bench.write_files("seq", &[("1.bin".to_owned(), turning(4))].into());
    bench.ok("encode seq -o seq/drive.lpc");
    let said = bench.says("encode seq -o seq/drive.lpc --force --strict");
    assert!(said.starts_with("1 frame: "), "{said}");
    assert!(bench.says("encode seq -o other.lpc").contains("left out 1 lidarpc stream ("));
    assert!(
        bench
            .fails("encode seq/drive.lpc -o twice.lpc", "seq/drive.lpc")
            .contains("is a lidarpc stream already")
    );
}

#[test]
fn no_input_is_overwritten() {
    let bench = Bench::encoded();
    let original = bench.read("seq/1.bin");
    for output in ["seq/1.bin", "seq/../seq/1.bin"] {
        for args in ["encode seq/1.bin", "encode seq", "encode seq --resume"] {
            let error = bench.fails(&format!("{args} -o {output} --force"), output);
            assert!(error.contains("is an input as well"), "{error}");
        }
    }
    fs::copy(bench.path("out.lpc"), bench.path("stream")).unwrap();
    bench.fails("view stream -o stream --force", "stream");
    bench.fails("stats out.lpc --poses out.lpc --force", "out.lpc");
    assert_eq!(bench.files("seq"), odd_files());
    assert_eq!(bench.read("seq/1.bin"), original);

    // A frame with the same name as its stream.
    bench.ok("encode seq/1.bin -o 1.lpc");
    fs::rename(bench.path("1.lpc"), bench.path("1.bin")).unwrap();
    let stream = bench.read("1.bin");
    bench.fails("decode 1.bin -o . --force", "./1.bin");
    assert_eq!(bench.read("1.bin"), stream);
    bench.ok("decode 1.bin -o elsewhere");
}

#[test]
fn an_empty_stdin_is_said() {
    let bench = Bench::new();
    let run = bench.command("encode - -o out.lpc").write_stdin("").assert().success();
    let said = String::from_utf8_lossy(&run.get_output().stderr).into_owned();
    assert!(said.contains("stdin: held no frame, and so does out.lpc"), "{said}");
    bench.command("encode - -o strict.lpc --strict").write_stdin("").assert().code(1);
    assert!(!bench.path("strict.lpc").exists());
}

#[test]
fn names_that_cannot_be_taken_say_why() {
    let bench = Bench::new();
    for (name, why) in [("aux.bin", "that of a device on Windows"), ("c:1.bin", "a drive of Windows")] {
        bench.write_files("odd", &[(name.to_owned(), scan(4, 1))].into());
        let error = bench.fails("encode odd -o out.lpc", &format!("odd/{name}"));
        assert!(error.contains(why) && error.contains("rename"), "{error}");
        fs::remove_file(bench.path("odd").join(name)).unwrap();
    }
    bench.write_files("seq", &[("1.bin".to_owned(), scan(4, 1))].into());
    for args in ["encode seq/1.bin seq/1.bin -o out.lpc", "encode seq seq/../seq -o out.lpc"] {
        let run = bench.command(args).assert().code(1);
        assert!(String::from_utf8_lossy(&run.get_output().stderr).contains("is given twice"), "{args}");
    }
}

#[test]
fn lengths_of_records_are_found_or_doubted() {
    let bench = Bench::new();
    let sequence = |folder: &str, values| {
        let names = ["0.bin", "1.bin", "2.bin"];
        bench.write_files(folder, &names.map(|name| (name.to_owned(), turning(values))).into());
    };
    sequence("kitti", 4);
    sequence("six", 6);
    let said = bench.says("encode kitti -o kitti.lpc");
    assert_eq!(said.lines().count(), 1, "nothing to doubt: {said}");
    let said = bench.says("encode six -o six.lpc --verify");
    assert!(
        said.starts_with("lidarpc: six: .bin files look like records of 24 bytes, taken as --layout xyzi__"),
        "{said}"
    );
    assert_eq!(bench.json("info six.lpc --json")["points"], 3 * 4000);
    bench.ok("encode six -o wrong.lpc --layout xyzi");
    assert!(2 * bench.read("six.lpc").len() < bench.read("wrong.lpc").len());
    let said = bench.says("encode kitti -o wrong.lpc --force --layout xyzirt");
    assert!(said.contains("records of 16 bytes, not as --layout xyzirt has it"), "{said}");

    let noise = (0..40_000u32).map(|n| n.wrapping_mul(2_654_435_761).to_be_bytes()[1]).collect();
    bench.write_files("noise", &[("0.bin".to_owned(), noise)].into());
    let said = bench.says("encode noise -o noise.lpc --verify");
    assert!(said.contains("do not look like float32 x, y, z, intensity"), "{said}");
}

#[test]
fn what_was_lost_is_said_with_what_was_saved() {
    let bench = Bench::new();
    bench.ok("synth -o drive --frames 1");
    for (options, says) in [
        ("", ", lossless in "),
        ("--max-error 1cm", ", within 10 mm in "),
        ("--max-error 1um", ", within 0.001 mm (all exact: the bound saves nothing here) in "),
        ("--max-error 1cm --intensity-step 0.1", ", within 10 mm, intensities in steps of 0.1 in "),
        ("--mode paper", " points dropped ("),
    ] {
        let said = bench.says(&format!("encode drive -o out.lpc --force {options}"));
        assert!(said.contains(says) && said.lines().count() == 1, "{options}: {said}");
    }
    let report = bench.json("encode drive -o out.lpc --force --mode paper --json");
    let stats = bench.json("stats out.lpc --json");
    for name in ["points", "outliers_dropped", "points_lost", "stream_bytes"] {
        assert_eq!(report[name], stats[name], "{name}");
    }
    let lost = report["points_lost"].as_u64().unwrap() + report["outliers_dropped"].as_u64().unwrap();
    let said = bench.says("encode drive -o out.lpc --force --mode paper");
    let grouped = format!("paper mode: {},{:03} points dropped", lost / 1000, lost % 1000);
    assert!(said.contains(&grouped) && said.contains("intensities dropped"), "{said}");
}

#[test]
fn paper_mode_warns_of_other_scanners() {
    let bench = Bench::new();
    bench.ok("synth -o vlp16 --scanner vlp16 --frames 2");
    // Its lasers are found and become the rows of the image, unless the scanner is mounted with a tilt.
    assert!(bench.says("encode vlp16 -o out.lpc --mode paper").starts_with("2 frames: "));
    for entry in fs::read_dir(bench.path("vlp16")).unwrap() {
        let path = entry.unwrap().path();
        let bytes = fs::read(&path).unwrap();
        let turned = bytes.chunks(16).map(|record| {
            let [y, z] = [4, 8].map(|at| f32::from_le_bytes(record[at..at + 4].try_into().unwrap()));
            let turned = [0.8 * y - 0.6 * z, 0.6 * y + 0.8 * z].map(f32::to_le_bytes);
            [&record[..4], &turned[0], &turned[1], &record[12..]].concat()
        });
        fs::write(&path, turned.collect::<Vec<_>>().concat()).unwrap();
    }
    let said = bench.says("encode vlp16 -o out.lpc --force --mode paper");
    assert!(
        said.starts_with(
            "lidarpc: vlp16: paper mode does not suit this scanner: of the first frame it drops "
        ),
        "{said}"
    );
    assert!(bench.says("encode vlp16 -o exact.lpc").starts_with("2 frames: "));
}

#[test]
fn what_is_stored_as_bytes_is_called_so() {
    let bench = Bench::encoded();
    let said = bench.says("encode seq -o new.lpc");
    assert!(said.contains(" files as plain bytes (such as damaged.pcd)"), "{said}");
    let plain = bench.json("encode seq -o new.lpc --force --json")["plain_bytes"].clone();
    assert!(plain.as_array().unwrap().contains(&"other.ply".into()), "{plain}");
}

#[test]
#[cfg(target_os = "linux")]
fn a_terminal_gets_no_binary() {
    let bench = Bench::encoded();
    for args in ["encode seq -o -", "cut out.lpc --frames 1 -o -", "cat out.lpc -o -", "repair out.lpc -o -"]
    {
        let terminal = fs::File::options().read(true).write(true).open("/dev/ptmx").unwrap();
        let mut run = Process::new(cargo_bin!("lidarpc"));
        run.args(args.split(' ')).current_dir(bench.0.path()).stdout(terminal).stderr(Stdio::piped());
        let output = run.spawn().unwrap().wait_with_output().unwrap();
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(1), "{args}: {error}");
        assert!(error.starts_with("lidarpc: stdout: is a terminal"), "{args}: {error}");
    }
}

#[test]
#[cfg(target_os = "linux")]
fn a_folder_that_takes_no_files_is_not_called_missing() {
    let bench = Bench::encoded();
    for args in [
        "encode seq -o /proc/out.lpc",
        "encode seq -o /proc/out.lpc --resume",
        "encode seq -o /proc/out/",
        "decode out.lpc -o /proc/back",
        "decode out.lpc -o /proc/new/back",
        "synth -o /proc/drive --frames 1",
        "man -o /proc/pages",
    ] {
        let output = bench.command(args).output().unwrap();
        let says = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{args}: {says}");
        let error =
            says.lines().find(|line| line.starts_with("lidarpc: /proc: takes no new files or folders ("));
        let error = error.unwrap_or_else(|| panic!("{args}: {says}"));
        assert!(error.contains("os error") && error.ends_with("; choose another folder"), "{error}");
        assert!(!says.contains("does not exist"), "{says}");
    }
    let error = bench.fails("decode out.lpc -o out.lpc/back", "out.lpc");
    assert!(error.contains("is no folder"), "{error}");
}

// ---- several files ----

#[test]
fn several_files_are_listed_checked_and_decoded() {
    let bench = Bench::encoded();
    bench.ok("cut out.lpc --frames ..4 -o a.lpc");
    bench.ok("cut out.lpc --frames 4.. -o b.lpc");
    let text = String::from_utf8(bench.ok("info a.lpc b.lpc")).unwrap();
    assert!(text.starts_with("a.lpc:\nformat version 1") && text.contains("\n\nb.lpc:\n"), "{text}");
    let infos = bench.json("info a.lpc b.lpc --json");
    assert_eq!(infos[1]["frames"].as_array().unwrap().len(), 6);
    assert_eq!(bench.json("--list a.lpc --json"), infos[0]);

    let said = String::from_utf8(bench.command("verify a.lpc b.lpc --against seq").output().unwrap().stdout)
        .unwrap();
    assert!(
        said.starts_with("a.lpc: whole; 4 frames") && said.contains("\nb.lpc: whole; 6 frames"),
        "{said}"
    );
    bench.ok("decode a.lpc b.lpc -o back");
    assert_eq!(bench.files("back"), odd_files());
    bench.fails("decode a.lpc out.lpc -o clash", "clash");
    assert!(!bench.path("clash").exists());
}

/// Writes `bad.lpc`, which is `out.lpc` with a bit of its second group changed.
fn damage_second_group(bench: &Bench) {
    let mut bad = bench.read("out.lpc");
    let second = bench.json("info out.lpc --json")["groups"][1]["offset"].as_u64().unwrap() as usize;
    bad[second + 9] ^= 1;
    fs::write(bench.path("bad.lpc"), bad).unwrap();
}

#[test]
fn a_damaged_file_does_not_hide_the_others() {
    let bench = Bench::encoded();
    damage_second_group(&bench);
    let run = bench.command("verify bad.lpc out.lpc").assert().code(1);
    let output = run.get_output();
    let (said, errors) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(said.starts_with("out.lpc: whole; 10 frames"), "{said}");
    let lines: Vec<_> = errors.lines().collect();
    assert!(
        lines[0].starts_with("lidarpc: bad.lpc: bytes ") && lines[0].contains("frames 2 to 3"),
        "{errors}"
    );
    assert!(lines[1].starts_with("lidarpc: bad.lpc: damaged stream"), "{errors}");
    assert_eq!(lines[2..], ["lidarpc: 1 of 2 files failed"]);
    let run = bench.command("verify bad.lpc out.lpc --json").assert().code(1);
    let reports: Value = serde_json::from_slice(&run.get_output().stdout).unwrap();
    assert_eq!((&reports[0]["whole"], &reports[1]["whole"]), (&false.into(), &true.into()));
    assert!(reports[0]["error"].as_str().unwrap().contains("damaged stream"), "{reports}");
    assert_eq!((&reports[0]["lost"]["places"], &reports[0]["lost"]["frames"]), (&1.into(), &2.into()));

    // The contents before the damage are listed.
    let run = bench.command("info bad.lpc").assert().code(1);
    let said = String::from_utf8_lossy(&run.get_output().stdout).into_owned();
    assert!(said.contains("damaged behind byte ") && said.contains("2 frames in 1 group"), "{said}");
    let run = bench.command("info bad.lpc --json").assert().code(1);
    let info: Value = serde_json::from_slice(&run.get_output().stdout).unwrap();
    assert_eq!(info["frames"].as_array().unwrap().len(), 2);
    assert!(info["damage"].as_str().unwrap().contains("damaged stream"), "{info}");
}

#[test]
fn every_command_reports_to_machines() {
    let bench = Bench::encoded();
    let original: usize = odd_files().values().map(Vec::len).sum();
    let encoded = bench.json("encode seq -o new.lpc --verify --json");
    assert_eq!((&encoded["frames"], &encoded["file_bytes"]), (&10.into(), &original.into()));
    assert_eq!(
        (&encoded["verified"], &encoded["stream_bytes"]),
        (&true.into(), &bench.read("new.lpc").len().into())
    );
    let decoded = bench.json("decode out.lpc -o back --json");
    assert_eq!((&decoded["frames"], &decoded["file_bytes"]), (&10.into(), &original.into()));
    let verified = bench.json("verify out.lpc --json");
    assert_eq!((&verified["whole"], &verified["frames"]), (&true.into(), &10.into()));
    let cut = bench.json("cut out.lpc --frames 1..6 -o cut.lpc --json");
    assert_eq!((&cut["copied"], &cut["recoded"]), (&4.into(), &1.into()));
    let joined = bench.json("cat out.lpc -o joined.lpc --json");
    assert_eq!((&joined["streams"], &joined["frames"]), (&1.into(), &10.into()));
    let repaired = bench.json("repair out.lpc -o repaired.lpc --json");
    assert_eq!(repaired["frames"], 10);
}

#[test]
fn only_what_was_lost_is_reported_as_lost() {
    let bench = Bench::encoded();
    damage_second_group(&bench);
    bench.ok("cut out.lpc --frames 2 -o one.lpc");
    let expected = serde_json::json!([{ "file": "bad.lpc", "places": 1, "frames": 2, "maybe_more": false }]);
    for (args, lost) in [
        ("decode one.lpc -o a --keep-going --json --force", serde_json::json!([])),
        ("decode one.lpc bad.lpc -o b --keep-going --json --force", expected.clone()),
        ("repair out.lpc -o c.lpc --json", serde_json::json!([])),
        ("repair bad.lpc -o d.lpc --json", expected.clone()),
    ] {
        let output = bench.command(args).output().unwrap();
        let report: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(report["lost"], lost, "{args}");
        let is_whole = lost.as_array().unwrap().is_empty();
        assert_eq!(output.status.code(), Some(if is_whole { 0 } else { 3 }), "{args}");
    }
}

// ---- help and usage ----

#[test]
fn the_short_help_of_encode_is_short() {
    let bench = Bench::new();
    let help = |args: &str| String::from_utf8(bench.command(args).output().unwrap().stdout).unwrap();
    let short = help("encode -h");
    assert!(short.lines().count() <= 30, "{} lines:\n{short}", short.lines().count());
    for option in
        ["--max-error", "--level", "--threads", "--verify", "--resume", "--force", "--strict", "--json"]
    {
        assert!(short.contains(option), "{option} is missing");
    }
    assert!(!short.contains("--plane-seed") && !short.contains("--packing"), "{short}");

    // The description of each option with a value says what holds without it.
    let long = help("encode --help");
    assert!(
        long.contains("A Novel Coding Scheme for Large-Scale Point Cloud Sequences"),
        "what the article is"
    );
    let required = ["-o, --output"];
    // Not the possible values.
    let is_option = |line: &str| line.trim_start().starts_with('-') && !line.trim_start().starts_with("- ");
    let options = long.split("\n  ").filter(|text| text.trim_start().starts_with('-') && text.contains('<'));
    let mut names = options.map(|text| text.trim().split(" <").next().unwrap().to_owned());
    let lines: Vec<&str> = long.lines().collect();
    for name in names.by_ref().filter(|name| !required.contains(&&name[..])) {
        let start = lines.iter().position(|line| line.trim().starts_with(&name)).unwrap();
        let rest = &lines[start + 1..];
        let end = rest.iter().position(|line| is_option(line)).unwrap_or(rest.len());
        let has_default = rest[..end].iter().any(|line| line.to_lowercase().contains("default"));
        assert!(has_default, "{name} shows no default");
    }
}

#[test]
fn what_other_compressors_call_things_is_understood() {
    let bench = Bench::encoded();
    bench.ok("encode seq -o nine.lpc -9");
    bench.ok("encode seq -o level.lpc --level 9");
    assert_eq!(bench.read("nine.lpc"), bench.read("level.lpc"));
    assert_eq!(bench.ok("-l out.lpc"), bench.ok("info out.lpc"));
    bench.ok("--test out.lpc");
    bench.ok("-d out.lpc -o back");
    assert_eq!(bench.files("back"), odd_files());
}

#[test]
fn wrong_usage_is_explained() {
    let bench = Bench::encoded();
    let said = |args: &str| {
        let output = bench.command(args).output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{args}");
        String::from_utf8(output.stderr).unwrap()
    };
    assert!(said("encode seq -o new.lpc --level best").contains("a number from 1 (fast) to 9 (small)"));
    assert!(said("encode seq -o new.lpc --max-error 10").contains("is not a length; give one as 2mm"));
    // The usage of the current command, not of the program.
    for args in ["encode seq -o new.lpc --mode bounded", "cat - - -o new.lpc", "encode seq -o - --verify"] {
        let said = said(args);
        let command = args.split(' ').next().unwrap();
        assert!(said.contains(&format!("Usage: lidarpc {command} [OPTIONS]")), "{said}");
    }
}

#[test]
#[cfg(unix)]
fn an_interrupted_run_says_what_is_kept() {
    use std::io::{BufRead, BufReader};

    let bench = Bench::new();
    bench.ok("synth -o drive --frames 6");
    let mut child = Process::new(cargo_bin!("lidarpc"))
        .args(["encode", "drive", "-o", "out.lpc", "--resume", "-9", "--threads", "1"])
        .current_dir(bench.0.path())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    while !bench.path("out.lpc.partial").exists() {
        assert!(child.try_wait().unwrap().is_none(), "it ended before it began");
        std::thread::yield_now();
    }
    assert!(Process::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let said: Vec<String> =
        BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap).collect();
    assert!(!child.wait().unwrap().success());
    let kept =
        "lidarpc: interrupted; what is done is kept in out.lpc.partial, and the same command goes on with it";
    assert_eq!(said, [kept]);
}

#[test]
fn many_small_files_come_back() {
    let bench = Bench::new();
    // More than are flushed to disk at a time, and not a multiple of that.
    let files: Files = (0..67).map(|n| (format!("{n}.bin"), scan(2, n))).collect();
    bench.write_files("seq", &files);
    bench.ok("encode seq -o out.lpc");
    bench.ok("decode out.lpc -o back");
    assert_eq!(bench.files("back"), files);
}

#[test]
fn a_deep_check_comes_to_the_same() {
    let bench = Bench::new();
    bench.ok("synth -o seq --frames 1");
    for level in ["1", "6", "8"] {
        bench.ok(&format!("encode seq -o {level}.lpc --level {level}"));
    }
    bench.ok("encode seq -o bounded.lpc --max-error 1cm");
    let report = bench.json("verify --deep 1.lpc 6.lpc 8.lpc --against seq --json");
    for file in report.as_array().unwrap() {
        assert_eq!((&file["whole"], &file["deep"], &file["frames"]), (&true.into(), &true.into(), &1.into()));
    }
    let said =
        String::from_utf8(bench.command("verify --deep bounded.lpc").output().unwrap().stdout).unwrap();
    assert!(
        said.starts_with("bounded.lpc: whole; 1 frame,") && said.contains("without vector units"),
        "{said}"
    );
}

// ---- scans made to cost most ----

/// A count that no file can hold.
const CLAIM: u64 = 1 << 60;

/// Scans with false claims in headers and bodies, and those that cost most for their size.
fn bombs() -> Files {
    let pcd = |data: &str, points: u64, body: &[u8]| {
        let header = format!(
            "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\nWIDTH {points}\n\
             HEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {points}\nDATA {data}\n"
        );
        [header.as_bytes(), body].concat()
    };
    let ply = |format: &str, element: &str, count: u64, body: &[u8]| {
        let header = format!(
            "ply\nformat {format} 1.0\nelement vertex {count}\nproperty float x\nproperty float y\nproperty float z\n\
             {element}end_header\n"
        );
        [header.as_bytes(), body].concat()
    };
    let points = scan(40, 1);
    let compressed = |packed: &[u8], size: u32| {
        let sizes = [packed.len() as u32, size].map(u32::to_le_bytes).concat();
        [&sizes, packed].concat()
    };
    // Zeros as a program would compress them, to a ninetieth: restored as points, not as bytes.
    let zeros = 330_000;
    let mut unfolds = parse("0.pcd", pcd("binary", zeros, &vec![0; 16 * zeros as usize]));
    unfolds.layout.wrapping = Wrapping::PcdCompressed { lzf: LzfDialect::ALL[0] };
    unfolds.prefix = pcd("binary_compressed", zeros, b"");
    let unfolds = unfolds.to_bytes().unwrap();
    assert!(unfolds.len() < 100_000);
    // Nearly as bad, as LZ4 would.
    let vector = fs::read(in_package("testdata/vectors/pyarrow.lz4.feather")).unwrap();
    let mut feather = parse("0.feather", vector);
    feather.records = 1_500_000;
    feather.prefix = with_point_count(&feather.prefix, feather.records);
    feather.cloud.positions = vec![[0.0; 3]; feather.records];
    feather.cloud.intensity = vec![0.0; feather.records];
    for channel in &mut feather.cloud.channels {
        channel.bytes = vec![0; feather.records * channel.field.width()];
    }
    let feather = feather.to_bytes().unwrap();
    assert!(feather.len() < 100_000);
    let fields = String::from_utf8(pcd("ascii", 2, b"1 2 3 4\n5 6 7 8\n")).unwrap();
    let fields = fields.replace("COUNT 1 1 1 1", "COUNT 1 1 1 400000000").into_bytes();
    let line = b"1.25 ".repeat(800_000);
    let list = "element face 1152921504606846976\nproperty list uint int vertex_indices\n";
    let files = [
        ("claim-binary.pcd", pcd("binary", CLAIM, &points)),
        ("claim-ascii.pcd", pcd("ascii", CLAIM, b"1 2 3 4\n5 6 7 8\n")),
        ("claim-fields.pcd", fields),
        ("claim-largest.pcd", pcd("binary", u64::MAX, &points)),
        ("claim-packed.pcd", pcd("binary_compressed", CLAIM, &compressed(&[0, 0, 0xe0, 0xff, 0], u32::MAX))),
        ("claim.ply", ply("binary_little_endian", "", CLAIM, &points)),
        ("claim-ascii.ply", ply("ascii", "", CLAIM, b"1 2 3\n")),
        ("claim-list.ply", ply("binary_big_endian", list, 1, &[255; 64])),
        ("unfolds.pcd", unfolds),
        ("unfolds.feather", feather),
        ("line.pcd", pcd("ascii", 200_000, &line)),
        ("line.ply", ply("ascii", "", 200_000, &line)),
        ("header.pcd", line.clone()),
        ("header.ply", [&b"ply\nformat ascii 1.0\ncomment "[..], &line].concat()),
    ];
    files.into_iter().map(|(name, bytes)| (name.to_owned(), bytes)).collect()
}

/// All scans of a group are bombs: they are restored, in memory proportional to their bytes.
#[test]
#[cfg(target_os = "linux")]
fn scans_that_claim_or_unfold_to_much_come_back_in_bounded_memory() {
    let bench = Bench::new();
    let mut bombs = bombs();
    for n in 0..10 {
        bombs.insert(format!("unfolds-{n}.pcd"), bombs["unfolds.pcd"].clone());
    }
    bench.write_files("seq", &bombs);
    bench.within_memory(MEBIBYTES, "encode seq -o out.lpc --gop 60 --threads 2").success();
    bench.within_memory(MEBIBYTES, "decode out.lpc -o back --threads 2").success();
    assert!(bench.files("back") == bombs);
}

/// Address space in MiB, part of which threads and the allocator reserve without using it.
#[cfg(target_os = "linux")]
const MEBIBYTES: u64 = 1200;

/// The scans are together much larger than the step in which memory is tried, and than what all threads need
/// at a time, so a program that keeps them needs more.
#[test]
#[cfg(target_os = "linux")]
fn to_verify_takes_no_more_memory_than_to_decode() {
    const SCANS: usize = 150;
    const STEP: u64 = 16;
    let bench = Bench::new();
    bench.ok("synth -o seq --scanner vlp16 --frames 1");
    bench.ok("encode seq -o one.lpc --level 1");
    let (scanners, groups) = take_apart(&bench.read("one.lpc"));
    let named = |number: usize| {
        let mut group = groups[0].clone();
        group.frames[0].header.name = format!("{number}.bin");
        group
    };
    let stream = put_together(&scanners, &(0..SCANS).map(named).collect::<Vec<_>>());
    fs::write(bench.path("out.lpc"), stream).unwrap();
    let mebibytes = groups[0].frames[0].header.file_size * SCANS as u64 >> 20;
    assert!(mebibytes >= 3 * STEP, "{mebibytes} MiB of scans");

    for threads in [1, 16] {
        let suffice = |steps: u64, command: &str| {
            let command = format!("{command} --quiet --threads {threads}");
            bench.within_memory(steps * STEP, &command).get_output().status.success()
        };
        let (mut too_few, mut enough) = (0, MEBIBYTES / STEP);
        while enough - too_few > 1 {
            let half = (too_few + enough) / 2;
            match suffice(half, "decode out.lpc -o back --force") {
                true => enough = half,
                false => too_few = half,
            }
        }
        // Whether threads need their memory at the same moment is chance, of which one step is left to it.
        let is_enough = (0..5).any(|_| suffice(enough + 1, "verify out.lpc"));
        assert!(is_enough, "{threads} threads, {} MiB to decode", enough * STEP);
    }
}

#[test]
#[cfg(target_os = "linux")]
fn an_archive_of_empty_files_is_read_in_bounded_memory() {
    let mut archive = tar::Builder::new(Vec::new());
    for n in 0..20_000 {
        let mut header = tar::Header::new_ustar();
        header.set_size(0);
        archive.append_data(&mut header, format!("drive/{n}.bin"), &[][..]).unwrap();
    }
    let bench = Bench::new();
    fs::write(bench.path("archive.tar"), archive.into_inner().unwrap()).unwrap();
    let shell = |args: &str| bench.within_memory(MEBIBYTES, args);
    shell("encode - -o out.lpc <archive.tar").success();
    shell("verify out.lpc").success();
    assert_eq!(bench.json("info out.lpc --json")["frames"].as_array().unwrap().len(), 20_000);
}

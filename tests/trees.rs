//! Trees of drives, the files beside the scans, and times: how typical folders are restored.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use crate::program::{Bench, noise, scan};

/// Everything below a folder: files with their bytes, folders with none.
fn tree(folder: &Path) -> BTreeMap<String, Option<Vec<u8>>> {
    let (mut found, mut open) = (BTreeMap::new(), vec![folder.to_path_buf()]);
    while let Some(next) = open.pop() {
        for entry in fs::read_dir(next).unwrap().map(Result::unwrap) {
            let path = entry.path();
            let name = path.strip_prefix(folder).unwrap().to_str().unwrap().to_owned();
            if path.is_dir() {
                found.insert(name, None);
                open.push(path);
            } else {
                found.insert(name, Some(fs::read(path).unwrap()));
            }
        }
    }
    found
}

/// Two drives in KITTI's form, with equal names, and the files beside their scans.
fn drives() -> Bench {
    let bench = Bench::new();
    for (drive, seed) in [("a/drive_1", 1), ("b/drive_2", 2)] {
        let file = |name: &str, bytes: Vec<u8>| (name.to_owned(), bytes);
        let scans = (0..12).map(|n| file(&format!("{n:010}.bin"), scan(300, seed * 100 + n)));
        bench.write_files(&format!("tree/{drive}/velodyne_points/data"), &scans.collect());
        let times =
            (0..12).map(|n| format!("2011-09-26 13:02:{:02}.{:09}\n", 25 + n / 10, n % 10 * 100_000_000));
        let times = times.collect::<String>().into_bytes();
        bench.write_files(&format!("tree/{drive}/velodyne_points"), &[file("timestamps.txt", times)].into());
        bench.write_files(&format!("tree/{drive}/image_02"), &[file("0.png", noise(5000, seed))].into());
        let oxts =
            [file("0.txt", b"49.1 8.4 112.8 ".repeat(40)), file(".hidden", vec![1]), file("empty", vec![])];
        bench.write_files(&format!("tree/{drive}/oxts"), &oxts.into());
        fs::create_dir_all(bench.path(&format!("tree/{drive}/labels/none"))).unwrap();
    }
    bench
}

#[test]
fn a_tree_comes_back_whole() {
    let bench = drives();
    bench.write_files("tree/calib", &[("poses.bin".to_owned(), b"no scan".to_vec())].into());
    fs::remove_file(bench.path("tree/calib/poses.bin")).unwrap();
    bench.write_files("tree/calib", &[("poses.txt".to_owned(), b"1 0 0 0".to_vec())].into());
    for args in ["", " --max-error 10mm", " --mode paper", " --level 1"] {
        bench.ok(&format!("encode tree -o tree.lpc --all --strict --force{args}"));
        bench.ok("decode tree.lpc -o back --force");
        let (before, after) = (tree(&bench.path("tree")), tree(&bench.path("back")));
        let is_scan = |name: &&String| name.ends_with(".bin");
        let others = |tree: &BTreeMap<String, Option<Vec<u8>>>| {
            tree.iter()
                .filter(|(name, _)| !is_scan(name))
                .map(|(a, b)| (a.clone(), b.clone()))
                .collect::<Vec<_>>()
        };
        assert_eq!(others(&before), others(&after), "{args}");
        assert!(before.keys().filter(is_scan).eq(after.keys().filter(is_scan)), "{args}");
        if args.is_empty() {
            assert_eq!(before, after);
            bench.ok("verify tree.lpc --against tree");
            let stats = bench.json("stats tree.lpc --against tree --json");
            assert_eq!((&stats["frames"], &stats["files_beside"]), (&24.into(), &13.into()));
            assert_eq!(stats["against"]["identical_files"], 37);
        }
    }
    // Written with --resume, it is the same; tests/resume.rs interrupts it.
    bench.ok("encode tree -o resumed.lpc --all --resume");
    bench.ok("encode tree -o plain.lpc --all");
    assert_eq!(bench.read("resumed.lpc"), bench.read("plain.lpc"));
    // A file beside the scans is an input too, which no output may replace; an earlier stream is not.
    let error =
        bench.fails("encode tree -o tree/calib/poses.txt --all --force --quiet", "tree/calib/poses.txt");
    assert!(error.contains("is an input as well"), "{error}");
    assert_eq!(bench.read("tree/calib/poses.txt"), b"1 0 0 0");
    bench.ok("encode tree -o tree/own.lpc --all");
    bench.ok("encode tree -o tree/own.lpc --all --force --strict");
    assert_eq!(bench.read("tree/own.lpc"), bench.read("plain.lpc"));
}

#[test]
fn without_all_a_tree_gives_its_scans_under_their_paths() {
    let bench = drives();
    let said = bench.says("encode tree -o tree.lpc");
    assert!(said.contains("tree: left out 8 files not known as scans (11920 bytes, such as tree/"), "{said}");
    assert!(said.contains("2 hidden files or folders (2 bytes, such as tree/"), "{said}");
    assert!(said.contains("24 frames: "), "{said}");
    bench.ok("decode tree.lpc -o back");
    let scans =
        |folder: &str| tree(&bench.path(folder)).into_iter().filter(|(name, _)| name.ends_with(".bin"));
    assert!(scans("tree").eq(scans("back")));
    // A single drive: its scans keep their own names, as always.
    bench.ok("encode tree/a/drive_1 -o one.lpc");
    bench.ok("decode one.lpc -o one");
    assert_eq!(bench.files("one"), bench.files("tree/a/drive_1/velodyne_points/data"));
}

#[test]
fn groups_and_scanners_are_of_one_drive() {
    let bench = drives();
    bench.ok("encode tree -o tree.lpc --all --gop 5");
    let info = bench.json("info tree.lpc --json");
    let groups: Vec<_> =
        info["groups"].as_array().unwrap().iter().map(|group| group["frames"].as_u64().unwrap()).collect();
    assert_eq!(groups, [5, 5, 2, 5, 5, 2, 5, 5, 2]);
    let frames = info["frames"].as_array().unwrap();
    assert!(frames[..24].iter().all(|frame| frame["kind"] == "file"));
    assert!(frames[24..].iter().all(|frame| frame["kind"] == "file beside the scans"));
    // A range of frames has no files beside them.
    for command in ["cut tree.lpc --frames 3..9 -o part.lpc", "decode tree.lpc --frames 3..9 -o part"] {
        let said = bench.says(command);
        assert!(said.contains("tree.lpc: left out 12 files beside the scans, which"), "{said}");
    }
    assert_eq!(bench.json("cut tree.lpc --frames 3..9 -o part.lpc --force --json")["files_left_out"], 12);
    // Compressed files are stored.
    let picture = frames.iter().find(|frame| frame["name"] == "a/drive_1/image_02/0.png").unwrap();
    let coded = picture["coded_bytes"].as_u64().unwrap();
    assert!((5000..5100).contains(&coded), "{coded}");
}

#[test]
fn a_tree_into_a_folder_gives_a_file_for_each_drive() {
    let bench = drives();
    for jobs in ["", " --jobs 2", " --jobs 1 --threads 1"] {
        bench.ok(&format!("encode tree -o out/ --all --strict --force{jobs}"));
        let files = tree(&bench.path("out"));
        assert!(files.keys().eq(["a", "a/drive_1.lpc", "b", "b/drive_2.lpc"]), "{:?}", files.keys());
    }
    bench.ok("decode out -o back");
    assert_eq!(tree(&bench.path("tree")), tree(&bench.path("back")));
    for command in ["verify out --json", "info out --json"] {
        let reports = bench.json(command);
        let files = reports.as_array().unwrap().iter().map(|report| report["file"].as_str().unwrap());
        assert!(files.eq(["out/a/drive_1.lpc", "out/b/drive_2.lpc"]), "{command}: {reports}");
    }
    bench.command("verify out --against tree").assert().code(2);
    bench.fails("verify tree --quiet", "tree");
    // Existing drives are left as they are.
    fs::remove_file(bench.path("out/a/drive_1.lpc")).unwrap();
    let said = bench.says("encode tree -o out --all --resume");
    assert!(said.contains("1 drive, 12 frames: ") && said.contains("1 drive there already"), "{said}");
    // Files of drives that are not what this would write, or no streams at all.
    let good = fs::read(bench.path("out/a/drive_1.lpc")).unwrap();
    for bad in [&[][..], b"no stream", &[&b"X"[..], &good[1..]].concat(), &good[..good.len() - 9]] {
        fs::write(bench.path("out/a/drive_1.lpc"), bad).unwrap();
        for command in ["encode tree -o out --all --resume", "decode out -o lost --force", "verify out"] {
            let said = bench.command(command).output().unwrap();
            let error = String::from_utf8(said.stderr).unwrap();
            assert_eq!(said.status.code(), Some(1), "{command}: {error}");
            assert!(error.contains("drive_1.lpc: ") && error.contains("1 of 2 "), "{command}: {error}");
        }
    }
    fs::write(bench.path("out/a/drive_1.lpc"), &good).unwrap();
    let said = bench.says("encode tree -o out --all --resume");
    assert!(said.ends_with("2 drives: already complete, from these files with these settings\n"), "{said}");
    let report = bench.json("encode tree -o out --all --resume --json");
    let complete = report["drives"].as_array().unwrap().iter().map(|drive| &drive["was_complete"]);
    assert!(complete.eq([true, true]), "{report}");
    let said = bench.command("encode tree -o out --all --resume --level 1").output().unwrap();
    assert_eq!(said.status.code(), Some(1), "other settings");
    let said = bench.command("encode tree -o out --all").output().unwrap();
    assert_eq!(said.status.code(), Some(1));
    let said = String::from_utf8(said.stderr).unwrap();
    assert!(
        said.contains("drive_1.lpc: exists") && said.ends_with("lidarpc: 2 of 2 drives failed\n"),
        "{said}"
    );
    // Several inputs with the same names in each; and files, by their folder.
    bench.ok("encode tree/a tree/b/drive_2 tree/b/drive_2/velodyne_points/data/0000000001.bin -o several/");
    let files = tree(&bench.path("several"));
    assert!(files.keys().eq(["a.lpc", "data.lpc", "drive_2.lpc"]), "{:?}", files.keys());
    let error = bench.fails("encode tree/a tree/a -o twice/ --quiet", "tree/a");
    assert!(error.contains("another input becomes too"), "{error}");
    // Earlier output is not part of the drive.
    bench.ok("encode tree -o tree/streams/ --all");
    bench.ok("encode tree -o tree/streams/ --all --force");
    bench.ok("decode tree/streams -o again");
    bench.command("decode tree/streams -o -").assert().code(2);
    let reports = bench.json("decode tree/streams -o with_report --json");
    assert!(reports.as_array().unwrap().len() > 1 && reports[0]["frames"].as_u64() > Some(0), "{reports}");
    fs::remove_dir_all(bench.path("tree/streams")).unwrap();
    assert_eq!(tree(&bench.path("tree")), tree(&bench.path("again")));
    // Files that belong to no drive are reported.
    bench.write_files("tree", &[("readme.txt".to_owned(), b"read".to_vec())].into());
    let said = bench.says("encode tree -o more/ --all");
    assert!(said.contains("1 file outside the drives (4 bytes, tree/readme.txt)"), "{said}");
    bench.fails("encode tree -o strict/ --all --strict", "tree");
    let report = bench.json("encode tree -o json/ --all --json");
    let drives = report["drives"].as_array().unwrap();
    assert_eq!((drives.len(), &drives[1]["files_beside"]), (2, &6.into()));
    let left_out = &report["left_out"][0];
    assert_eq!((&left_out["what"], &left_out["count"]), (&"file outside the drives".into(), &1.into()));
    assert_eq!(left_out["first"], "tree/readme.txt");
    // Several inputs are counted together.
    let report = bench.json("encode tree/a tree/b -o apart/ --json");
    let report = report["left_out"].as_array().unwrap();
    let files = report.iter().find(|one| one["what"] == "file not known as a scan").unwrap();
    let alone =
        |tree: &str| bench.json(&format!("encode {tree} -o {tree}_alone/ --json"))["left_out"].clone();
    let counts = ["tree/a", "tree/b"].map(alone).map(|left_out| {
        let left_out = left_out.as_array().unwrap().clone();
        let files = left_out.iter().find(|one| one["what"] == "file not known as a scan");
        files.map_or(0, |files| files["count"].as_u64().unwrap())
    });
    assert_eq!(files["count"], counts[0] + counts[1]);
}

#[test]
fn frames_are_numbered_without_the_files_beside() {
    let bench = drives();
    bench.ok("encode tree/a/drive_1 -o one.lpc --all");
    bench.ok("decode one.lpc -o some --frames 10..");
    let names: Vec<_> = tree(&bench.path("some")).into_keys().filter(|name| name.ends_with(".bin")).collect();
    assert_eq!(names, ["velodyne_points/data/0000000010.bin", "velodyne_points/data/0000000011.bin"]);
    assert_eq!(tree(&bench.path("some")).len(), 4, "the folders above them");
    let report = bench.json("decode one.lpc -o counted --frames 10.. --json");
    assert_eq!((&report["frames"], &report["files_beside"]), (&2.into(), &0.into()));
    bench.ok("decode one.lpc -o kept --frames 10.. --keep-going");
    assert_eq!(tree(&bench.path("kept")), tree(&bench.path("some")));
    bench.fails("decode one.lpc -o none --frames 12", "one.lpc");
    bench.ok("cut one.lpc --frames 3.. -o rest.lpc");
    assert_eq!(bench.json("info rest.lpc --json")["frames"].as_array().unwrap().len(), 9);
    bench.ok("encode tree/b/drive_2 -o two.lpc");
    bench.ok("decode two.lpc -o two");
    bench.ok("cat two.lpc one.lpc -o both.lpc");
    bench.ok("verify both.lpc");
    let error = bench.fails("cat one.lpc two.lpc -o wrong.lpc", "wrong.lpc");
    assert!(error.contains("give it last"), "{error}");
}

#[test]
fn streams_appended_to_one_another_are_saved_whole() {
    let bench = drives();
    bench.ok("encode tree/a/drive_1 -o one.lpc --all");
    bench.ok("encode tree/b/drive_2 -o two.lpc");
    bench.ok("cat two.lpc one.lpc -o both.lpc");
    bench.ok("decode both.lpc -o all");
    let (one, two) = (bench.read("one.lpc"), bench.read("two.lpc"));
    // A file beside the scans before other scans, and groups that occur twice.
    let appended =
        [[&one[..], &two].concat(), [&one[..], &two, &one].concat(), [&two[..], &two, &one].concat()];
    for (n, bytes) in appended.into_iter().enumerate() {
        let saved = |command: &str| {
            let output = bench.command(command).output().unwrap();
            assert_eq!(output.status.code(), Some(3), "{}", String::from_utf8_lossy(&output.stderr));
        };
        bench.write_files(".", &[("appended.lpc".to_owned(), bytes)].into());
        saved(&format!("decode appended.lpc -o kept-{n} --keep-going"));
        assert_eq!(tree(&bench.path(&format!("kept-{n}"))), tree(&bench.path("all")));
        saved(&format!("repair appended.lpc -o repaired-{n}.lpc"));
        bench.ok(&format!("decode repaired-{n}.lpc -o repaired-{n}"));
        assert_eq!(tree(&bench.path(&format!("repaired-{n}"))), tree(&bench.path("all")));
    }
}

#[test]
fn times_come_from_lists_and_names() {
    let bench = drives();
    bench.ok("encode tree/a/drive_1 -o out.lpc");
    let frame = |n: usize| bench.json("info out.lpc --json")["frames"][n].clone();
    assert_eq!(frame(11)["time"], 1_317_042_146_100_000_000_i64);
    assert_eq!(frame(11)["time_source"], "list");
    bench.ok("decode out.lpc -o part --time 0.2s..500ms");
    assert_eq!(bench.names("part"), ["0000000002.bin", "0000000003.bin", "0000000004.bin"]);
    bench.ok("cut out.lpc --time 1s.. -o end.lpc");
    assert_eq!(bench.json("stats end.lpc --json")["frames"], 2);
    let error = bench.fails("decode out.lpc -o none --time 5s..6s", "out.lpc");
    assert!(error.contains("from 0 to 1.100 s"), "{error}");
    // A list that does not match the scans is ignored, and if no other one does, that is said.
    let scans = [("7.bin", 1), ("8.bin", 2)].map(|(name, seed)| (name.to_owned(), scan(50, seed)));
    bench.write_files("lists/velodyne", &scans.into());
    let lists = [("timestamps.txt", "2011-09-26 13:02:25\n"), ("times.txt", "0\n0.5\n")];
    bench.write_files("lists", &lists.map(|(name, lines)| (name.to_owned(), lines.into())).into());
    bench.ok("encode lists -o lists.lpc");
    assert_eq!(bench.json("info lists.lpc --json")["frames"][1]["time"], 500_000_000);
    fs::remove_file(bench.path("lists/times.txt")).unwrap();
    let said = bench.says("encode lists -o untimed.lpc");
    assert!(said.contains("lists/timestamps.txt: has no time for each scan"), "{said}");
    let named =
        ["1566246592875153456.bin", "1566246592975153456.bin"].map(|name| (name.to_owned(), scan(50, 1)));
    bench.write_files("named", &named.into());
    bench.ok("encode named -o named.lpc");
    let info = bench.json("info named.lpc --json");
    assert_eq!(info["frames"][1]["time"], 1_566_246_592_975_153_456_i64);
    assert_eq!(info["frames"][1]["time_source"], "file name");
    bench.write_files("plain", &[("1.bin".to_owned(), scan(50, 1))].into());
    bench.ok("encode plain -o plain.lpc");
    let error = bench.fails("decode plain.lpc -o none --time 0..1", "plain.lpc");
    assert!(error.contains("no times"), "{error}");
}

#[test]
fn outputs_get_names_of_their_own() {
    let bench = drives();
    bench.ok("encode tree/a/drive_1/");
    assert!(bench.path("tree/a/drive_1.lpc").is_file());
    bench.ok("decode tree/a/drive_1.lpc --force");
    assert!(bench.path("tree/a/drive_1/0000000011.bin").is_file());
    for args in ["encode -", "encode tree/a tree/b", "decode -", "encode .."] {
        bench.command(args).assert().code(2);
    }
}

#[test]
fn originals_are_deleted_only_when_they_are_safe() {
    let bench = drives();
    let before = tree(&bench.path("tree"));
    let said = bench.says("encode tree/a/drive_1 -o one.lpc --rm");
    assert!(said.contains(", verified") && said.ends_with("deleted 12 files\n"), "{said}");
    assert!(!bench.path("tree/a/drive_1/velodyne_points/data").exists());
    assert!(bench.path("tree/a/drive_1/velodyne_points/timestamps.txt").exists(), "it was left out");
    bench.ok("decode one.lpc -o tree/a/drive_1/velodyne_points/data");
    assert_eq!(tree(&bench.path("tree")), before);
    bench.ok("encode tree -o all.lpc --all --rm");
    assert!(!bench.path("tree").exists());
    bench.ok("decode all.lpc -o tree");
    assert_eq!(tree(&bench.path("tree")), before);
    for lossy in ["--max-error 1cm", "--mode paper", "--rm -o -"] {
        bench
            .command(
                &format!("encode tree -o lossy.lpc --rm {lossy}").replace("-o lossy.lpc --rm --rm", "--rm"),
            )
            .assert()
            .code(2);
    }
    assert_eq!(tree(&bench.path("tree")), before);
    // Write-protected files are kept, and only these.
    let name = "tree/a/drive_1/velodyne_points/data/0000000003.bin";
    let protected = bench.path(name);
    let mut permissions = fs::metadata(&protected).unwrap().permissions();
    permissions.set_readonly(true);
    fs::set_permissions(&protected, permissions).unwrap();
    let error = bench.fails("encode tree/a/drive_1 -o again.lpc --rm --quiet", name);
    assert!(error.contains("write-protected"), "{error}");
    assert_eq!(bench.names("tree/a/drive_1/velodyne_points/data"), ["0000000003.bin"]);
}

#[test]
fn a_range_of_times_holds_no_frames_of_other_times() {
    let bench = Bench::new();
    // Two scanners at the same times, one after the other.
    for side in ["left", "right"] {
        let scans =
            (0..4).map(|n| (format!("{}.bin", 1_700_000_000_000_000_000 + n * 100_000_000u64), scan(60, 1)));
        bench.write_files(&format!("rec/{side}"), &scans.collect());
    }
    bench.ok("encode rec -o rec.lpc");
    bench.ok("decode rec.lpc -o some --time 0.1..0.25");
    for side in ["left", "right"] {
        let names = bench.names(&format!("some/{side}"));
        assert_eq!(names, ["1700000000100000000.bin", "1700000000200000000.bin"], "{side}");
    }
    let error = bench.fails("cut rec.lpc -o cut.lpc --time 0.1..0.25", "rec.lpc");
    assert!(error.contains("frames of other times"), "{error}");
    bench.ok("cut rec.lpc -o cut.lpc --time 0..");
}

#[test]
#[cfg(target_os = "linux")]
fn remarks_that_nobody_can_read_are_no_error() {
    let bench = Bench::new();
    bench.write_files("seq", &[("1.bin".to_owned(), scan(60, 1))].into());
    let full = fs::File::options().write(true).open("/dev/full").unwrap();
    let program = assert_cmd::cargo::cargo_bin!("lidarpc");
    let mut run = std::process::Command::new(program);
    run.args(["encode", "seq", "-o", "out.lpc"]).current_dir(bench.path(".")).stderr(full);
    assert!(run.status().unwrap().success());
    bench.ok("verify out.lpc --against seq");
}

#[test]
fn an_estimate_is_near_what_comes_of_it() {
    let bench = drives();
    let estimate = bench.json("estimate tree --json");
    let report = bench.json("encode tree -o tree.lpc --json");
    assert_eq!(estimate["frames"], report["frames"]);
    assert_eq!(estimate["file_bytes"], report["file_bytes"]);
    let bytes = |value: &serde_json::Value| value["stream_bytes"].as_f64().unwrap();
    assert!((bytes(&estimate) / bytes(&report) - 1.0).abs() < 0.1, "{estimate} {report}");
    assert!(bench.files(".").contains_key("tree.lpc"));
}

#[test]
fn completions_and_manual_pages_name_every_command() {
    let bench = Bench::new();
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let script = String::from_utf8(bench.ok(&format!("completions {shell}"))).unwrap();
        assert!(script.contains("encode") && script.contains("estimate"), "{shell}");
    }
    bench.ok("man -o man");
    let pages = bench.names("man");
    for command in
        ["encode", "decode", "stats", "info", "verify", "cut", "cat", "repair", "view", "bench", "synth"]
    {
        assert!(pages.contains(&format!("lidarpc-{command}.1")), "{pages:?}");
    }
}

#[test]
#[cfg(target_os = "linux")]
fn a_file_that_no_decoder_takes_is_left_out_and_said() {
    let bench = drives();
    // A sparse file, which takes no space.
    fs::File::create(bench.path("tree/a/drive_1/video.mp4")).unwrap().set_len((1 << 30) + 1).unwrap();
    let said = bench.says("encode tree/a/drive_1 -o one.lpc --all");
    assert!(
        said.contains("1 file of more than 1 GiB (1073741825 bytes, tree/a/drive_1/video.mp4)"),
        "{said}"
    );
    bench.fails("encode tree/a/drive_1 -o strict.lpc --all --strict", "tree/a/drive_1");
}

#[test]
fn a_folder_that_cannot_take_all_files_gets_none() {
    let bench = drives();
    bench.ok("encode tree -o tree.lpc");
    for force in ["", " --force"] {
        // A file in the place of the second drive's folder, and a folder in the place of its last scan.
        for (place, is_folder) in [("b", false), ("b/drive_2/velodyne_points/data/0000000011.bin", true)] {
            let taken = bench.path("out").join(place);
            fs::create_dir_all(if is_folder { &taken } else { taken.parent().unwrap() }).unwrap();
            if !is_folder {
                fs::write(&taken, b"mine").unwrap();
            }
            let before = tree(&bench.path("out"));
            bench.fails(&format!("decode tree.lpc -o out --threads 1{force}"), &format!("out/{place}"));
            assert_eq!(tree(&bench.path("out")), before, "{place}{force}");
            fs::remove_dir_all(bench.path("out")).unwrap();
        }
    }
}

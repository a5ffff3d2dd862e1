//! Frames from a pipe: coded and written as they arrive, from any tar archive or after lines with name and
//! size.

use std::fs;
use std::io::{Read, Write};
use std::process::{Child, Command, Stdio};

use crate::common::formats::kitti;
use crate::common::scans::{scans, small};
use crate::common::{File, decode_files, encode_files, skip};
use assert_cmd::cargo::cargo_bin;
use lidarpc::internals::container::{Record, StreamReader};
use lidarpc::internals::files::ArrivingFrames;
use lidarpc::internals::frame::settings::EncoderConfig;
use lidarpc::internals::ground::error::Limits;
use tempfile::TempDir;

/// Scans of one scanner, so that it can be fitted.
fn files(count: usize) -> Vec<File> {
    let frames = scans(&small(3, count));
    (0..).zip(&frames).map(|(n, frame)| (format!("{n}.bin"), kitti(frame))).collect()
}

fn framed((name, bytes): &File) -> Vec<u8> {
    [format!("{name} {}\n", bytes.len()).as_bytes(), bytes].concat()
}

fn program(args: &[&str]) -> Child {
    let mut command = Command::new(cargo_bin!("lidarpc"));
    command.args(args).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

#[test]
fn a_group_is_written_before_the_next_frame_arrives() {
    let files = files(5);
    let mut child = program(&["encode", "-", "-o", "-", "--gop", "2", "--quiet"]);
    let mut stdin = child.stdin.take().unwrap();
    let (mut reader, mut scanner) = (None, None);
    // The pipe stays open: if a group were held back, this would wait forever.
    for pair in files.chunks_exact(2) {
        pair.iter().for_each(|file| stdin.write_all(&framed(file)).unwrap());
        stdin.flush().unwrap();
        let reader = reader.get_or_insert_with(|| {
            StreamReader::open(child.stdout.take().unwrap(), Limits::default()).unwrap()
        });
        let group = loop {
            match reader.next_record().unwrap() {
                Some(Record::Group(group)) => break group,
                Some(Record::Scanner(found)) => scanner = Some(found.id()),
                None => panic!("the stream ended"),
            }
        };
        let names: Vec<_> = group.frames.iter().map(|frame| &frame.header.name).collect();
        assert_eq!(names, pair.iter().map(|(name, _)| name).collect::<Vec<_>>());
        assert_eq!(group.scanners, [scanner], "no model was fitted to the first group");
    }
    stdin.write_all(&framed(&files[4])).unwrap();
    drop(stdin);
    let mut reader = reader.unwrap();
    assert!(matches!(reader.next_record().unwrap(), Some(Record::Group(_))));
    assert!(reader.next_record().unwrap().is_none());
    assert!(child.wait().unwrap().success());
}

/// The next message of a program, according to its line.
fn message(from: &mut impl Read) -> File {
    let mut line = Vec::new();
    while line.last() != Some(&b'\n') {
        assert_eq!(from.by_ref().take(1).read_to_end(&mut line).unwrap(), 1, "it ended at {line:?}");
    }
    let line = String::from_utf8(line).unwrap();
    let (name, size) = line.trim_end().rsplit_once(' ').unwrap();
    let mut bytes = vec![0; size.parse().unwrap()];
    from.read_exact(&mut bytes).unwrap();
    (name.to_owned(), bytes)
}

#[test]
fn messages_come_and_go_one_by_one() {
    let files = [&files(4)[..], &[("odd name.txt".to_owned(), b"no points".to_vec())]].concat();
    let mut coders = ["encode", "decode"].map(|command| {
        let mut child = program(&[command, "-", "-o", "-", "--messages", "--quiet"]);
        let (stdin, stdout) = (child.stdin.take().unwrap(), child.stdout.take().unwrap());
        (child, stdin, stdout)
    });
    // The pipes stay open: if a message were held back, this would wait forever.
    let mut payloads = Vec::new();
    for file in &files {
        let mut sent = file.clone();
        for (_, stdin, stdout) in &mut coders {
            stdin.write_all(&framed(&sent)).unwrap();
            stdin.flush().unwrap();
            sent = message(stdout);
            payloads.push(sent.clone());
        }
        assert_eq!(sent, *file);
    }
    for (mut child, stdin, _) in coders {
        drop(stdin);
        assert!(child.wait().unwrap().success());
    }
    // Each can be decoded separately, with the scanner that was fitted to the first.
    for (payload, file) in payloads.iter().step_by(2).zip(&files) {
        assert_eq!(decode_files(&payload.1).unwrap(), std::slice::from_ref(file));
        let mut reader = StreamReader::open(&payload.1[..], Limits::default()).unwrap();
        assert!(matches!(reader.next_record().unwrap(), Some(Record::Scanner(_))));
    }
    // From a file into a folder.
    let folder = TempDir::new().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    fs::write(path("messages"), payloads.iter().step_by(2).map(framed).collect::<Vec<_>>().concat()).unwrap();
    let child = program(&["decode", &path("messages"), "-o", &path("out"), "--messages"]);
    let output = child.wait_with_output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success() && said.starts_with("5 messages: "), "{said}");
    for (name, bytes) in &files {
        assert_eq!(&fs::read(folder.path().join("out").join(name)).unwrap(), bytes);
    }
    // A damaged message is an error that names it.
    let mut damaged = payloads[2].clone();
    damaged.1[30] ^= 1;
    fs::write(path("messages"), framed(&damaged)).unwrap();
    let child = program(&["decode", &path("messages"), "-o", &path("more"), "--messages"]);
    let output = child.wait_with_output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success() && said.contains("1.bin"), "{said}");
    // Names may be repeated, but must fit into a line.
    let twice = [&payloads[0], &payloads[0]].map(framed).concat();
    fs::write(path("messages"), twice).unwrap();
    let child = program(&["decode", &path("messages"), "-o", "-", "--messages", "--format", "ply"]);
    let output = child.wait_with_output().unwrap();
    let mut rest = &output.stdout[..];
    let (first, second) = (message(&mut rest), message(&mut rest));
    assert!(output.status.success() && rest.is_empty() && first == second && first.0 == "0.ply");
    let long = ["n".repeat(200), "n".repeat(100)].join("/");
    let stream = encode_files(&[(long, b"abc".to_vec())], &EncoderConfig::default());
    fs::write(path("messages"), framed(&("a".to_owned(), stream))).unwrap();
    let child = program(&["decode", &path("messages"), "-o", "-", "--messages"]);
    let output = child.wait_with_output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success() && output.stdout.is_empty() && said.contains("into a folder"), "{said}");
    for wrong in [["encode", "--verify"], ["decode", "--keep-going"]] {
        let child = program(&[wrong[0], "-", "-o", "-", "--messages", wrong[1]]);
        assert_eq!(child.wait_with_output().unwrap().status.code(), Some(2), "{wrong:?}");
    }
}

/// The frames that arrive from these bytes, which are read one at a time.
fn arrive(bytes: &[u8]) -> Result<Vec<File>, String> {
    struct Slow<'a>(&'a [u8]);
    impl Read for Slow<'_> {
        fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
            let length = out.len().min(1);
            self.0.read(&mut out[..length])
        }
    }
    let frames = ArrivingFrames::new(Slow(bytes));
    frames.map(|file| file.map(|file| (file.name, file.bytes)).map_err(|error| error.to_string())).collect()
}

#[test]
fn lines_and_sizes_are_checked() {
    assert_eq!(arrive(b"").unwrap(), []);
    let two = b"a b.bin 3\nxyz1.bin 0\n";
    assert_eq!(arrive(two).unwrap(), [("a b.bin".to_owned(), b"xyz".to_vec()), ("1.bin".to_owned(), vec![])]);
    for (bytes, complaint) in [
        (&b"1.bin 4\nxyz"[..], "cut short"),
        (b"1.bin 4", "cut short"),
        (b"1.bin\n", "neither"),
        (b"1.bin -4\n", "neither"),
        (b"1.bin 18446744073709551615\n", "that a stream can hold"),
        (b"1.bin 0\n1.bin 0\n", "second time"),
        (&[b'x'; 2000], "neither"),
        (b"\xff\xfe 1\nx", "neither"),
    ] {
        let error = arrive(bytes).unwrap_err();
        assert!(error.contains(complaint), "{complaint:?} is missing in: {error}");
    }
}

/// An entry of a tar archive according to POSIX.
fn entry(name: &str, kind: u8, bytes: &[u8]) -> Vec<u8> {
    let mut header = [0; 512];
    header[..name.len()].copy_from_slice(name.as_bytes());
    header[100..108].copy_from_slice(b"0000644\0");
    header[124..136].copy_from_slice(format!("{:011o}\0", bytes.len()).as_bytes());
    header[148..156].copy_from_slice(b"        ");
    header[156] = kind;
    header[257..265].copy_from_slice(b"ustar\x0000");
    let sum: u32 = header.iter().map(|byte| u32::from(*byte)).sum();
    header[148..156].copy_from_slice(format!("{sum:06o}\0 ").as_bytes());
    let padding = vec![0; bytes.len().wrapping_neg() % 512];
    [&header[..], bytes, &padding].concat()
}

const END: [u8; 1024] = [0; 1024];

#[test]
fn archives_of_all_dialects_are_read() {
    let long = format!("{}.bin", "n".repeat(200));
    let gnu = format!("folder/{long}\0");
    let record = format!("path=folder/{long}\n");
    let pax = format!("{} {record}", record.len() + 4);
    let archive = [
        entry("drive/", b'5', b""),
        entry("drive/1.bin", b'0', &[7; 513]),
        entry("drive/readme.txt", b'0', b"no scan"),
        entry("drive/points.csv", b'0', b"x,y,z\n1,2,3\n"),
        entry("drive/link.bin", b'2', b""),
        entry("././@LongLink", b'L', gnu.as_bytes()),
        entry("cut", b'0', b"abc"),
        END.to_vec(),
    ];
    let expected = [
        ("1.bin".to_owned(), vec![7; 513]),
        ("points.csv".to_owned(), b"x,y,z\n1,2,3\n".to_vec()),
        (format!("folder/{long}"), b"abc".to_vec()),
    ];
    assert_eq!(arrive(&archive.concat()).unwrap(), expected);
    let archive = [entry("x", b'x', pax.as_bytes()), entry("cut", b'0', b"abc"), END.to_vec()].concat();
    assert_eq!(arrive(&archive).unwrap(), [(long, b"abc".to_vec())]);
}

#[test]
fn drives_in_several_folders_of_an_archive_do_not_collide() {
    let names = ["./tree/a/1.bin", "./tree/b/1.bin", "./tree/a/2.bin", "1.bin"];
    let entries = names.map(|name| entry(name, b'0', &[7; 16])).concat();
    let arrived = arrive(&[&entries[..], &END].concat());
    // The last one is in another folder than the first, but has no folder to be told by.
    assert!(arrived.unwrap_err().contains("a second time"));
    let entries = names[..3].iter().map(|name| entry(name, b'0', &[7; 16])).collect::<Vec<_>>().concat();
    let arrived = arrive(&[&entries[..], &END].concat()).unwrap();
    let names: Vec<_> = arrived.iter().map(|(name, _)| &name[..]).collect();
    assert_eq!(names, ["1.bin", "tree/b/1.bin", "2.bin"]);
    // Without their first folder, these would be a file and a folder of one name.
    for names in [["a/b.bin", "b.bin/0.bin"], ["a/b.bin", "b.bin/c/0.bin"]] {
        let both = names.map(|name| entry(name, b'0', &[7; 16]));
        let arrived = arrive(&[&both.concat()[..], &END].concat());
        assert!(arrived.unwrap_err().contains("a file and a folder"), "{names:?}");
    }
    assert!(arrive(b"x/y/0.bin 1\n7x/y 1\n7").unwrap_err().contains("a file and a folder"));
}

#[test]
fn damaged_archives_are_refused() {
    let archive = [entry("1.bin", b'0', &[7; 700]), entry("2.bin", b'0', b"abc"), END.to_vec()].concat();
    assert_eq!(arrive(&archive).unwrap().len(), 2);
    for length in (20..archive.len() - 1024).step_by(37) {
        assert!(arrive(&archive[..length]).unwrap_err().contains("cut short"), "{length}");
    }
    for place in [3, 110, 130, 150, 300, 1600] {
        let mut damaged = archive.clone();
        damaged[place] ^= 1;
        assert!(arrive(&damaged).unwrap_err().contains("damaged"), "{place}");
    }
    let nothing = [entry("readme.txt", b'0', b"no scan"), END.to_vec()].concat();
    assert!(arrive(&nothing).unwrap_err().contains("no .bin"));
    assert!(arrive(&[0; 10240]).unwrap_err().contains("is empty"));
}

#[test]
fn compressed_archives_are_called_so() {
    for (start, program) in [
        (&b"\x1f\x8b\x08\0\0\0\0\0\0\x03"[..], "gzip"),
        (b"\x1f\x8b\x08\x08\n\xa0Yd\x02\x03drive.tar\0", "gzip"),
        (b"\x28\xb5\x2f\xfd\x04\x58\0", "zstd"),
        (b"\xfd7zXZ\0\0", "xz"),
        (b"BZh91AY&SY\x01\0", "bzip2"),
    ] {
        assert!(arrive(start).unwrap_err().contains(program), "{program}");
    }
}

#[test]
fn links_are_not_dropped_without_a_word() {
    let scan = entry("drive/1.bin", b'0', &[7; 16]);
    let hard = [scan.clone(), entry("drive/2.bin", b'1', b""), END.to_vec()].concat();
    let error = arrive(&hard).unwrap_err();
    assert!(error.contains("drive/2.bin") && error.contains("--hard-dereference"), "{error}");

    let links = [entry("drive/2.bin", b'2', b""), entry("drive/3.bin", b'2', b""), END.to_vec()].concat();
    let error = arrive(&links).unwrap_err();
    assert!(error.contains("drive/2.bin") && error.contains("--dereference"), "{error}");
    let readme = entry("readme.txt", b'0', b"no scan");
    let archive = [scan, readme, links].concat();
    let mut frames = ArrivingFrames::new(&archive[..]);
    assert_eq!(frames.by_ref().map(|file| file.unwrap().name).collect::<Vec<_>>(), ["1.bin"]);
    let expected = "1 file not known as a scan (7 bytes, readme.txt), 2 symbolic links (such as drive/2.bin)";
    assert_eq!(frames.left_out().to_string(), expected);

    let mut child = program(&["encode", "-", "-o", "-"]);
    child.stdin.take().unwrap().write_all(&archive).unwrap();
    let output = child.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        output.status.success() && said.contains("2 symbolic links") && said.contains("1 file "),
        "{said}"
    );
}

#[test]
fn pax_records_that_the_reader_cannot_use_are_refused() {
    for (record, complaint) in [("14 path=a\nb.c\n", "odd"), ("22 GNU.sparse.major=1\n", "sparse")] {
        let archive = [entry("x", b'x', record.as_bytes()), entry("1.bin", b'0', b"abc"), END.to_vec()];
        let error = arrive(&archive.concat()).unwrap_err();
        assert!(error.contains(complaint), "{error}");
    }
    // More than a header may have: reported before all of it is in memory.
    let name = vec![b'n'; 2 << 20];
    let error = arrive(&[entry("././@LongLink", b'L', &name), END.to_vec()].concat()).unwrap_err();
    assert!(error.contains("damaged"), "{error}");
}

#[test]
fn nothing_is_read_before_it_is_needed() {
    // Reading beyond the bytes of the first scan fails.
    struct UpTo<'a>(&'a [u8]);
    impl Read for UpTo<'_> {
        fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
            if self.0.is_empty() {
                return Err(std::io::Error::new(std::io::ErrorKind::WouldBlock, "not sent yet"));
            }
            self.0.read(out)
        }
    }
    let scan = entry("1.bin", b'0', &[7; 700]);
    let mut frames = ArrivingFrames::new(UpTo(&scan[..512 + 700]));
    assert_eq!(frames.next().unwrap().unwrap().bytes, [7; 700]);
    assert!(frames.next().unwrap().unwrap_err().to_string().contains("not sent yet"));
}

/// The output of the system's own tar, through the program.
#[test]
#[cfg(target_os = "linux")]
fn a_tar_pipe_comes_back() {
    let folder = TempDir::new().unwrap();
    let files = files(4);
    let drive = folder.path().join("a".repeat(90)).join("b".repeat(90));
    fs::create_dir_all(&drive).unwrap();
    files.iter().for_each(|(name, bytes)| fs::write(drive.join(name), bytes).unwrap());
    for format in ["ustar", "gnu", "pax"] {
        let archive = Command::new("tar")
            .args(["-c", "--sort=name", &format!("--format={format}"), "."])
            .current_dir(folder.path())
            .output();
        let Ok(archive) = archive else {
            skip("there is no tar");
            return;
        };
        let mut child = program(&["encode", "-", "-o", "-", "--quiet"]);
        let mut stdin = child.stdin.take().unwrap();
        let written = std::thread::spawn(move || stdin.write_all(&archive.stdout));
        let output = child.wait_with_output().unwrap();
        written.join().unwrap().unwrap();
        assert_eq!(String::from_utf8_lossy(&output.stderr), "");
        assert_eq!(decode_files(&output.stdout).unwrap(), files, "{format}");
    }
}

#[test]
#[cfg(unix)]
fn a_signal_ends_a_recording_and_keeps_it() {
    let scans = files(4);
    let many = (0..).map(|n| (format!("{n}.bin"), scans[n % scans.len()].1.clone()));
    // More than a pipe holds, so that the program must have begun to read when all is written.
    let sent: Vec<_> = many.take((1 << 19) / scans[0].1.len()).collect();
    for (signal, strict, kept) in [("-INT", false, true), ("-TERM", false, true), ("-INT", true, false)] {
        let folder = TempDir::new().unwrap();
        let out = folder.path().join("out.lpc");
        let mut args = vec!["encode", "-", "-o", out.to_str().unwrap()];
        args.extend(strict.then_some("--strict"));
        let mut child = program(&args);
        // The pipe stays open, within a scan.
        let mut stdin = child.stdin.take().unwrap();
        sent.iter().for_each(|file| stdin.write_all(&framed(file)).unwrap());
        stdin.write_all(b"last.bin 1000\nbegin").unwrap();
        assert!(Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap().success());
        let output = child.wait_with_output().unwrap();
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(1) && error.contains("stdin: interrupted"), "{signal}: {error}");
        assert_eq!(out.exists(), kept, "{signal}: {error}");
        if kept {
            assert!(error.contains(&format!("ends early, after {} frames", sent.len())), "{error}");
            assert_eq!(decode_files(&fs::read(&out).unwrap()).unwrap(), sent, "{signal}");
        }
        drop(stdin);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), usize::from(kept), "{signal}");
    }
}

#[test]
fn what_arrived_before_the_input_was_cut_is_kept() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("out.lpc");
    let out = out.to_str().unwrap();
    let files = files(4);
    let bytes: Vec<u8> = files.iter().flat_map(framed).collect();
    let run = |args: &[&str]| {
        let mut child = program(&[&["encode", "-", "-o", out], args].concat());
        child.stdin.take().unwrap().write_all(&bytes[..bytes.len() - 5]).unwrap();
        let done = child.wait_with_output().unwrap();
        (done.status.code(), String::from_utf8(done.stderr).unwrap())
    };
    assert_eq!(run(&["--strict"]).0, Some(1));
    assert!(!fs::exists(out).unwrap());
    let (code, said) = run(&["--gop", "2"]);
    assert_eq!(code, Some(1));
    assert!(said.contains("ends early, after 3 frames: 3.bin: is cut short"), "{said}");
    assert_eq!(decode_files(&fs::read(out).unwrap()).unwrap(), files[..3]);
}

#[test]
fn unsafe_names_and_cut_input_leave_nothing() {
    let folder = TempDir::new().unwrap();
    let output = folder.path().join("out.lpc");
    for (bytes, complaint) in [(&b"../x.bin 1\nx"[..], "../x.bin"), (b"1.bin 9\nx", "cut short")] {
        let mut child = program(&["encode", "-", "-o", output.to_str().unwrap()]);
        child.stdin.take().unwrap().write_all(bytes).unwrap();
        let done = child.wait_with_output().unwrap();
        let said = String::from_utf8_lossy(&done.stderr).into_owned();
        assert_eq!(done.status.code(), Some(1));
        assert!(said.contains(complaint) && said.lines().count() == 1, "{said}");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}

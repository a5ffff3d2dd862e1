//! The program, run in a folder of its own.
#![allow(dead_code, missing_docs)] // Each test file takes the part that it needs.
#![cfg_attr(not(target_os = "linux"), allow(unused_imports))]

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;

use assert_cmd::Command;
use assert_cmd::cargo::{cargo_bin, cargo_bin_cmd};
use serde_json::Value;
use tempfile::TempDir;

pub type Files = BTreeMap<String, Vec<u8>>;

/// A folder to work in, with the program run inside it.
pub struct Bench(pub TempDir);

impl Bench {
    pub fn new() -> Self {
        Bench(TempDir::new().unwrap())
    }

    /// A folder that contains `seq/` with [`odd_files`], and `out.lpc` encoded from it with two frames a
    /// group.
    pub fn encoded() -> Self {
        let bench = Bench::new();
        bench.write_files("seq", &odd_files());
        bench.ok("encode seq -o out.lpc --gop 2");
        bench
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn write_files(&self, folder: &str, files: &Files) {
        fs::create_dir_all(self.path(folder)).unwrap();
        for (name, bytes) in files {
            fs::write(self.path(folder).join(name), bytes).unwrap();
        }
    }

    /// All files of a folder, hidden ones included.
    pub fn files(&self, folder: &str) -> Files {
        let entries = fs::read_dir(self.path(folder)).unwrap().map(Result::unwrap);
        let name = |entry: &fs::DirEntry| entry.file_name().into_string().unwrap();
        entries.map(|entry| (name(&entry), fs::read(entry.path()).unwrap_or_default())).collect()
    }

    pub fn names(&self, folder: &str) -> Vec<String> {
        self.files(folder).into_keys().collect()
    }

    pub fn command(&self, args: &str) -> Command {
        let mut command = cargo_bin_cmd!("lidarpc");
        command.current_dir(self.0.path()).args(args.split_whitespace());
        command
    }

    /// Runs the program, which must succeed without messages; returns stdout.
    pub fn ok(&self, args: &str) -> Vec<u8> {
        let run = self.command(args).arg("--quiet").assert().success();
        let output = run.get_output();
        assert_eq!(String::from_utf8_lossy(&output.stderr), "", "of {args}");
        output.stdout.clone()
    }

    pub fn json(&self, args: &str) -> Value {
        serde_json::from_slice(&self.ok(args)).unwrap()
    }

    /// As [`Bench::command`], with a limit on file sizes in place of a full disk.
    #[cfg(target_os = "linux")]
    pub fn on_full_disk(&self, args: &str) -> Command {
        let mut shell = Command::new("sh");
        let script = r#"trap "" XFSZ; ulimit -f 64; exec "$0" "$@""#;
        shell.args(["-c", script]).arg(cargo_bin!("lidarpc")).args(args.split(' '));
        shell.current_dir(self.0.path());
        shell
    }

    /// Runs the program by a shell, with an address space of `mebibytes` MiB. All threads allocate from one
    /// arena, since each arena reserves 64 MiB of addresses, used or not.
    #[cfg(target_os = "linux")]
    pub fn within_memory(&self, mebibytes: u64, args: &str) -> assert_cmd::assert::Assert {
        let script =
            format!("ulimit -v {}; exec '{}' {args}", mebibytes * 1024, cargo_bin!("lidarpc").display());
        let mut shell = Command::new("sh");
        shell.args(["-c", &script]).env("MALLOC_ARENA_MAX", "1").current_dir(self.0.path()).assert()
    }

    /// Runs the program, which must succeed; returns its stderr.
    #[track_caller]
    pub fn says(&self, args: &str) -> String {
        let output = self.command(args).output().unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{stderr}");
        stderr
    }

    pub fn read(&self, name: &str) -> Vec<u8> {
        fs::read(self.path(name)).unwrap()
    }

    /// Runs the program, which must fail with exit code 1 and one line that starts with `lidarpc: PATH: `.
    #[track_caller]
    pub fn fails(&self, args: &str, path: &str) -> String {
        failure(&mut self.command(args), path)
    }
}

#[track_caller]
pub fn failure(command: &mut Command, path: &str) -> String {
    let output = command.output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert_eq!(stderr.lines().count(), 1, "{stderr}");
    assert!(stderr.starts_with(&format!("lidarpc: {path}: ")), "{path} is not named in: {stderr}");
    stderr
}

pub fn scan(points: usize, seed: u32) -> Vec<u8> {
    let value = |n: usize| ((n as u32).wrapping_mul(2_654_435_761).wrapping_add(seed) >> 18) as f32 / 1000.0;
    (0..points * 4).flat_map(|n| value(n).to_le_bytes()).collect()
}

/// Bytes that cannot be compressed.
pub fn noise(bytes: usize, seed: u32) -> Vec<u8> {
    let mut state = seed.wrapping_mul(2_654_435_761) | 1;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        (state >> 24) as u8
    };
    (0..bytes).map(|_| next()).collect()
}

/// Scans, and other files with the names of scans.
pub fn odd_files() -> Files {
    let special = [f32::NAN, f32::INFINITY, -0.0, 1e-40, f32::NEG_INFINITY, f32::from_bits(0x7fa0_0001)];
    let special = special.iter().cycle().take(20).flat_map(|value| value.to_le_bytes());
    let files = [
        ("1.bin", scan(40, 1)),
        ("2.bin", scan(3, 2)),
        ("10.bin", scan(41, 3)),
        ("empty.bin", Vec::new()),
        ("seventeen.bin", (0..17).collect()),
        ("nan.bin", special.collect()),
        ("random.bin", scan(31, 4).iter().map(|byte| byte.wrapping_mul(31) ^ 0x5a).collect()),
        ("same.bin", [scan(1, 5), scan(1, 5), scan(1, 5)].concat()),
        ("damaged.pcd", b"# .PCD v0.7\nFIELDS x y z\nSIZE 4 4".to_vec()),
        ("other.ply", b"ply\nformat ascii 1.0\nend_header\n".to_vec()),
    ];
    files.into_iter().map(|(name, bytes)| (name.to_owned(), bytes)).collect()
}

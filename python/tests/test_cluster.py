"""Many drives at once: every engine gives what one run of the program gives."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import lidarpc

pytest.importorskip("fsspec")
from lidarpc import cluster  # noqa: E402
from s3 import running  # noqa: E402

DRIVES = 20


@pytest.fixture(scope="module")
def folder(tmp_path_factory, scans) -> Path:
    """Twenty small drives: every tenth point of the simulated scans, turned a little from drive to drive."""
    root = tmp_path_factory.mktemp("in")
    clouds = [np.frombuffer(data, np.float32).reshape(-1, 4) for _, data in scans]
    for number in range(DRIVES):
        inside = root / f"2011/drive_{number:02}/velodyne_points/data"
        inside.mkdir(parents=True)
        for place, cloud in enumerate(clouds):
            (inside / f"{place:010}.bin").write_bytes(cloud[number::40].tobytes())
    (root / "notes.txt").write_text("no scan")
    return root


@pytest.fixture(scope="module")
def expected(folder, tmp_path_factory) -> dict[str, bytes]:
    """What the program makes of each drive by itself."""
    out = tmp_path_factory.mktemp("single")
    files = {}
    for drive in cluster.find_drives(str(folder)):
        path = out / f"{drive.name.replace('/', '_')}.lpc"
        lidarpc.encode(folder / drive.name / "velodyne_points/data", path, level=1)
        files[f"{drive.name}.lpc"] = path.read_bytes()
    assert len(files) == DRIVES and len(set(files.values())) == DRIVES
    return files


def test_drives_of_argoverse_have_their_names(tmp_path):
    inside = tmp_path / "train/0a1b/sensors/lidar"
    inside.mkdir(parents=True)
    for name in ("2.feather", "1.feather", "../../annotations.feather", "notes.txt"):
        (inside / name).write_bytes(b"")
    (drive,) = cluster.find_drives(str(tmp_path))
    assert (drive.name, [path.rsplit("/", 1)[1] for path in drive.scans]) == ("train/0a1b", ["1.feather", "2.feather"])


def files_of(folder: Path) -> dict[str, bytes]:
    """All files below, hidden ones, too."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "lidarpc.cluster", "encode", *map(str, arguments), "--level=1"]


def test_each_drive_becomes_a_file(folder, expected, tmp_path):
    subprocess.run(command(folder, tmp_path / "out"), check=True)
    assert files_of(tmp_path / "out") == expected
    again = subprocess.run(command(folder, tmp_path / "out"), check=True, capture_output=True, text=True)
    assert again.stderr.count("is there already") == DRIVES and files_of(tmp_path / "out") == expected


def test_parts_are_joined_as_by_cat(folder, tmp_path):
    subprocess.run(command(folder, tmp_path / "out", "--split=2"), check=True)
    made = files_of(tmp_path / "out")
    scans = sorted((folder / "2011/drive_07/velodyne_points/data").iterdir())
    parts = [tmp_path / "first.lpc", tmp_path / "second.lpc"]
    lidarpc.encode(scans[:2], parts[0], level=1)
    lidarpc.encode(scans[2:], parts[1], level=1)
    whole = tmp_path / "whole.lpc"
    subprocess.run([sys.executable, "-m", "lidarpc", "cat", *parts, "-o", whole], check=True)
    assert made["2011/drive_07.lpc"] == whole.read_bytes() and len(made) == DRIVES


def test_scans_are_in_natural_order(folder, tmp_path):
    inside = tmp_path / "in/drive/data"
    inside.mkdir(parents=True)
    scan = next((folder / "2011/drive_00").rglob("*.bin")).read_bytes()
    for number in range(12):
        (inside / f"{number}.BIN").write_bytes(scan)
    subprocess.run(command(tmp_path / "in", tmp_path / "out", "--split=5"), check=True)
    with lidarpc.open(tmp_path / "out/drive.lpc") as drive:
        assert [frame.name for frame in drive] == [f"{number}.BIN" for number in range(12)]


def test_a_drive_that_fails_is_told_and_not_half_written(folder, tmp_path):
    names = ["good", "bad"]
    for name in names:
        inside = tmp_path / "in" / name
        inside.mkdir(parents=True)
        scan = next((folder / "2011/drive_00").rglob("*.bin"))
        (inside / "0.bin").write_bytes(scan.read_bytes())
    # No other system could restore such a name.
    (tmp_path / "in/bad/1\n.bin").write_bytes(b"x")
    done = subprocess.run(command(tmp_path / "in", tmp_path / "out"), capture_output=True, text=True)
    assert done.returncode == 1 and "1 failed: bad" in done.stderr, done.stderr
    assert list(files_of(tmp_path / "out")) == ["good.lpc"]
    none = subprocess.run(command(tmp_path / "out", tmp_path / "none"), capture_output=True, text=True)
    assert none.returncode == 1 and "no folder with scans" in none.stderr


def test_object_storage_to_object_storage(folder, expected, monkeypatch):
    import fsspec

    with running() as server:
        monkeypatch.setitem(fsspec.config.conf, "s3", server.options)
        filesystem = server.filesystem()
        filesystem.mkdir("drives-in")
        filesystem.mkdir("drives-out")
        for path in folder.rglob("*.bin"):
            filesystem.put_file(str(path), f"drives-in/{path.relative_to(folder)}")
        lines: list[str] = []
        failed = cluster.encode(
            "s3://drives-in", "s3://drives-out", split=2, options=["--level=1"], report=lines.append
        )
        assert failed == [] and len(lines) == DRIVES, lines
        filesystem.invalidate_cache()
        assert sorted(filesystem.find("drives-out")) == sorted(f"drives-out/{name}" for name in expected)
        some = "2011/drive_03.lpc"
        with lidarpc.open(f"s3://drives-out/{some}") as drive, lidarpc.open(expected[some]) as other:
            assert [frame.data for frame in drive] == [frame.data for frame in other]


def children(process: int) -> list[int]:
    """Processes below this one, by /proc."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                stat = (entry / "stat").read_text(encoding="ascii", errors="replace")
            except OSError:
                continue
            if int(stat.rpartition(")")[2].split()[1]) == process:
                found += [int(entry.name), *children(int(entry.name))]
    return found


def worker_of(process: int) -> int | None:
    """A worker of dask below this process: one that has begun an encoder."""
    for child in children(process):
        for grandchild in children(child):
            try:
                words = Path(f"/proc/{grandchild}/cmdline").read_bytes().split(b"\0")
            except OSError:
                continue
            if b"encode" in words and any(b"import main" in word for word in words):
                stat = Path(f"/proc/{grandchild}/stat").read_text(encoding="ascii", errors="replace")
                return int(stat.rpartition(")")[2].split()[1])
    return None


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="workers are found in /proc")
def test_dask_survives_a_killed_worker(folder, expected, tmp_path):
    pytest.importorskip("distributed")
    out = tmp_path / "out"
    run = subprocess.Popen(command(folder, out, "--engine=dask", "--workers=2"), stderr=subprocess.PIPE, text=True)
    lines: list[str] = []
    reader = threading.Thread(target=lambda: lines.extend(run.stderr))
    reader.start()
    killed = None
    deadline = time.monotonic() + 120
    while killed is None and run.poll() is None and time.monotonic() < deadline:
        # In the middle: some drives are done, and others are not.
        if sum(": done" in line for line in list(lines)) >= 3:
            try:
                killed = worker_of(run.pid)
                if killed is not None:
                    os.kill(killed, signal.SIGKILL)
            except OSError:
                killed = None
        time.sleep(0.01)
    assert run.wait(120) == 0, lines
    reader.join()
    assert killed is not None and sum(": done" in line for line in lines) == DRIVES, lines
    assert files_of(out) == expected

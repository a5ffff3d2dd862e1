"""Encoders, messages and the program."""

from __future__ import annotations

import io
import subprocess
import sys

import numpy as np
import pytest
from conftest import TESTDATA

import lidarpc

TYPES = ["i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"]


def points(count: int = 50) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(count, 3)).astype(np.float32)


def test_all_types_come_back(tmp_path):
    xyz = points()
    xyz[0] = [np.nan, -0.0, np.inf]
    fields = {f"field_{kind}": np.arange(50).astype(kind) for kind in TYPES}
    path = tmp_path / "live.lpc"
    with lidarpc.Encoder(path, group=2) as out:
        for number in range(5):
            out.push(xyz, intensity=xyz[:, 0] * 2, ring=np.arange(50, dtype="u2"), time=number, fields=fields, name="a")
        assert not path.exists(), "not before it is complete"
    with lidarpc.open(path) as drive:
        assert len(drive) == 5
        for number, frame in enumerate(drive):
            assert (frame.time, frame.name, frame.data) == (number, "a", None)
            assert frame.xyz.tobytes() == xyz.tobytes()
            assert frame["intensity"].tobytes() == (xyz[:, 0] * 2).tobytes()
            assert frame["ring"].dtype == np.uint16
            for name, values in fields.items():
                assert frame[name].dtype == values.dtype and np.array_equal(frame[name], values)


def test_what_an_array_looks_like_does_not_matter():
    xyz = points()
    wide = np.zeros((50, 6), np.float32)
    wide[:, ::2] = xyz
    variants = [wide[:, ::2], np.asfortranarray(xyz), xyz.astype(">f4"), xyz.astype(np.float64), xyz.tolist()]
    ring = np.arange(100, dtype=">u2")[::2]
    for variant in variants:
        frame = lidarpc.decode_frame(lidarpc.encode_frame(variant, ring=ring))
        assert np.array_equal(frame.xyz, xyz) and np.array_equal(frame["ring"], ring)


def test_what_does_not_fit_is_refused():
    xyz = points()
    wrong = [
        dict(xyz=xyz[:, :2]),
        dict(xyz=xyz.ravel()),
        dict(xyz=xyz.astype(np.float64) + 1e-12),
        dict(xyz=xyz, intensity=np.zeros(49, np.float32)),
        dict(xyz=xyz, ring=np.zeros((50, 2), np.uint8)),
        dict(xyz=xyz, fields={"x": np.zeros(50)}),
        dict(xyz=xyz, level=10),
        dict(xyz=xyz, max_error=-1.0),
    ]
    for arguments in wrong:
        with pytest.raises(lidarpc.Error):
            lidarpc.encode_frame(**arguments)
    with pytest.raises(TypeError, match="complex128"):
        lidarpc.encode_frame(xyz, fields={"a": np.zeros(50, complex)})


def test_messages(scans):
    cloud = np.frombuffer(scans[0][1], np.float32).reshape(-1, 4)
    payload = lidarpc.encode_frame(cloud[:, :3], intensity=cloud[:, 3], time=np.datetime64(123, "ns"))
    assert isinstance(payload, bytes) and len(payload) < 0.3 * cloud.nbytes
    frame = lidarpc.decode_frame(payload)
    assert np.array_equal(frame.xyz, cloud[:, :3]) and np.array_equal(frame["intensity"], cloud[:, 3])
    assert frame.time == 123
    with pytest.raises(lidarpc.Error):
        lidarpc.decode_frame(payload[:-1])
    rough = lidarpc.encode_frame(cloud[:, :3], intensity=cloud[:, 3], max_error=0.01)
    assert len(rough) < len(payload)
    error = np.linalg.norm(lidarpc.decode_frame(rough).xyz.astype(float) - cloud[:, :3], axis=1).max()
    assert 0 < error <= 0.01


def test_messages_of_one_scanner(scans):
    encoder = lidarpc.FrameEncoder(level=6)
    for number, (_, data) in enumerate(scans):
        cloud = np.frombuffer(data, np.float32).reshape(-1, 4)
        payload = encoder.encode(cloud[:, :3], intensity=cloud[:, 3], time=number)
        frame = lidarpc.decode_frame(payload)
        assert np.array_equal(frame.xyz, cloud[:, :3]) and frame.time == number
        assert len(payload) < 0.3 * cloud.nbytes
    with pytest.raises(lidarpc.Error, match="level"):
        lidarpc.FrameEncoder(level=0)


def test_an_encoder_leaves_nothing_half_written(tmp_path):
    path = tmp_path / "live.lpc"
    with pytest.raises(RuntimeError), lidarpc.Encoder(path) as out:
        out.push(points())
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(lidarpc.Error, match="level"):
        lidarpc.Encoder(path, level=0)
    with pytest.raises(FileNotFoundError):
        lidarpc.Encoder(tmp_path / "no" / "live.lpc")
    assert list(tmp_path.iterdir()) == []
    out = lidarpc.Encoder(path)
    out.close()
    out.close()
    with pytest.raises(ValueError, match="closed"):
        out.push(points())
    assert len(lidarpc.open(path)) == 0


class Slow(io.RawIOBase):
    """An output that takes a few bytes at a time."""

    def __init__(self):
        self.taken = bytearray()

    def writable(self):
        return True

    def write(self, piece):
        self.taken += piece[:1000]
        return min(len(piece), 1000)


def test_file_objects_are_written_to_and_stay_open(scans):
    plain, slow = io.BytesIO(), Slow()
    for target in (plain, slow):
        with lidarpc.Encoder(target, level=1) as out:
            for name, data in scans:
                out.push_file(name, data)
        assert not target.closed
    assert plain.getvalue() == bytes(slow.taken)
    assert [frame.data for frame in lidarpc.open(plain)] == [data for _, data in scans]


def test_a_write_that_fails_is_told(scans):
    class Full(io.RawIOBase):
        def writable(self):
            return True

        def write(self, piece):
            raise OSError(28, "No space left on device")

    with pytest.raises(lidarpc.InputError, match="No space left"), lidarpc.Encoder(Full(), group=1, threads=1) as out:
        for name, data in scans:
            out.push_file(name, data)


def test_folders_there_and_back(tmp_path, scans):
    stream, folder = tmp_path / "drive.lpc", tmp_path / "drive"
    lidarpc.encode(TESTDATA / "drive", stream, level=1)
    with pytest.raises(lidarpc.Error, match="exists"):
        lidarpc.encode(TESTDATA / "drive", stream)
    lidarpc.encode([TESTDATA / "drive" / name for name, _ in scans], stream, level=1, max_error=0.02, force=True)
    lidarpc.encode(TESTDATA / "drive", stream, level=1, force=True)
    lidarpc.decode(stream, folder)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == dict(scans)
    with pytest.raises(lidarpc.Error, match="missing"):
        lidarpc.decode(tmp_path / "missing.lpc", tmp_path / "out")
    with pytest.raises(lidarpc.Error, match="level"):
        lidarpc.encode(TESTDATA / "drive", stream, level=11, force=True)


def run(*arguments: str) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, "-m", "lidarpc", *arguments], capture_output=True, text=True)


def test_the_program(drive_file, tmp_path):
    assert run("--version").stdout.startswith("lidarpc ")
    assert run("verify", str(drive_file)).returncode == 0
    failed = run("info", str(tmp_path / "missing.lpc"))
    assert failed.returncode == 1 and "missing.lpc: does not exist" in failed.stderr
    assert run("encode").returncode == 2

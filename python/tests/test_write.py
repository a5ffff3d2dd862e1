"""Encoders, messages and the program."""

from __future__ import annotations

import datetime
import io
import os
import signal
import subprocess
import sys
import threading
import time
import warnings

import numpy as np
import pytest
from conftest import TESTDATA, in_fork

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


def noise(number: int = 0, count: int = 2000) -> np.ndarray:
    return np.random.default_rng(number).normal(size=(count, 3)).astype(np.float32)


def test_a_refused_scan_leaves_the_encoder_usable(tmp_path):
    path = tmp_path / "live.lpc"
    with lidarpc.Encoder(path, group=2) as out:
        out.push(points())
        for arguments in (dict(name="aux"), dict(name="a\nb"), dict(track=255), dict(track=-1), dict(time=2**63)):
            with pytest.raises(lidarpc.Error):
                out.push(points(), **arguments)
        out.push(points(), name="b", track=254, time=2**63 - 1)
        out.push(points())
    with lidarpc.open(path) as drive:
        assert [frame.name for frame in drive] == ["", "b", ""] and drive[1].time == 2**63 - 1


@pytest.mark.parametrize("place", ["path", "file", "memory"])
def test_an_error_leaves_what_was_there(tmp_path, place):
    fsspec = pytest.importorskip("fsspec")
    path = {"path": f"{tmp_path}/a.lpc", "file": f"file://{tmp_path}/a.lpc", "memory": "memory://errors/a.lpc"}[place]
    filesystem, name = fsspec.core.url_to_fs(path)
    filesystem.pipe_file(name, b"precious")
    for arguments in (dict(level=0), dict(max_error=-1.0), dict(group=0), dict(threads=1025)):
        with pytest.raises(lidarpc.Error):
            lidarpc.Encoder(path, **arguments)
    with pytest.raises(RuntimeError, match="mine"), lidarpc.Encoder(path, group=1, threads=1) as out:
        out.push(noise())
        raise RuntimeError("mine")
    folder = os.path.dirname(name)
    assert filesystem.cat_file(name) == b"precious" and len(filesystem.ls(folder)) == 1
    with lidarpc.Encoder(path) as out:
        out.push(noise())
    assert len(lidarpc.open(path)) == 1 and len(filesystem.ls(folder)) == 1


def test_cleanup_does_not_hide_the_error():
    fsspec = pytest.importorskip("fsspec")
    with pytest.raises(RuntimeError, match="mine"), lidarpc.Encoder("memory://gone/a.lpc") as out:
        fsspec.filesystem("memory").rm("/gone", recursive=True)
        raise RuntimeError("mine") from None
    assert out._output is None


def test_a_stopped_recording_is_kept(tmp_path):
    path = tmp_path / "live.lpc"
    with pytest.raises(KeyboardInterrupt) as raised, lidarpc.Encoder(path, group=1, threads=1) as out:
        for number in range(5):
            out.push(noise(number))
        raise KeyboardInterrupt
    partial = tmp_path / "live.lpc.partial"
    assert list(tmp_path.iterdir()) == [partial]
    if sys.version_info >= (3, 11):
        assert f"lidarpc repair {partial} -o {path}" in raised.value.__notes__[0]
    assert run("repair", str(partial), "-o", str(path)).returncode in (0, 3)
    assert len(lidarpc.open(path)) == 5
    # Nothing was written yet.
    with pytest.raises(SystemExit), lidarpc.Encoder(tmp_path / "short.lpc") as out:
        out.push(noise())
        sys.exit()
    assert {file.name for file in tmp_path.iterdir()} == {"live.lpc", "live.lpc.partial"}


def test_encoders_of_one_target_do_not_harm_each_other(tmp_path):
    path = tmp_path / "live.lpc"
    (tmp_path / "live.lpc.partial").write_bytes(b"of a resumable run")
    first, second = lidarpc.Encoder(path, group=1, threads=1), lidarpc.Encoder(path, group=1, threads=1)
    for number in range(3):
        first.push(noise(number))
        second.push(noise(number))
    first.close()
    assert len(lidarpc.open(path)) == 3
    second.push(noise())
    second.close()
    assert len(lidarpc.open(path)) == 4
    assert (tmp_path / "live.lpc.partial").read_bytes() == b"of a resumable run" and len(list(tmp_path.iterdir())) == 2


def test_a_forked_process_leaves_the_encoder_alone(tmp_path):
    path = tmp_path / "live.lpc"
    with lidarpc.Encoder(path, group=1) as out:
        out.push(noise())
        assert "the encoder was opened before this process was forked" in in_fork(lambda: out.push(noise()))
        assert in_fork(lambda: out.__exit__(None, RuntimeError(), None)) is None
        out.push(noise())
    assert len(lidarpc.open(path)) == 2


@pytest.mark.parametrize("stop", [KeyboardInterrupt, SystemExit])
def test_what_stops_the_program_while_writing_goes_through(stop):
    class Stopped(io.RawIOBase):
        def write(self, piece):
            raise stop

    with pytest.raises(stop), lidarpc.Encoder(Stopped(), group=1, threads=1) as out:
        for number in range(5):
            out.push(noise(number))


@pytest.mark.parametrize("count", [0, -1, 10**9, "many", None])
def test_counts_of_writes_are_checked(count):
    class Odd(io.RawIOBase):
        def write(self, piece):
            return count

    with pytest.raises(lidarpc.InputError, match="write\\(\\) took") as raised:
        with lidarpc.Encoder(Odd()) as out:
            out.push(points())
    assert isinstance(raised.value.__cause__, OSError)


def test_settings_out_of_range_say_the_range():
    for level in (-1, 0, 4, 5, 10, 300):
        with pytest.raises(lidarpc.Error, match=f"level {level} .* 1, 2, 3, 6, 7, 8 and 9"):
            lidarpc.FrameEncoder(level=level)
    for name, value in (("threads", -1), ("threads", 1025), ("group", -1), ("group", 0)):
        with pytest.raises(lidarpc.Error, match=f"{name} {value} is not from"):
            lidarpc.Encoder(io.BytesIO(), **{name: value})
    for wrong in (5, None):
        with pytest.raises(TypeError, match="is not a path, a URL, or a binary file object"):
            lidarpc.Encoder(wrong)
    with pytest.raises(TypeError, match="text mode"):
        lidarpc.Encoder(io.StringIO())


def time_of(time: object) -> int | None:
    return lidarpc.decode_frame(lidarpc.encode_frame(points(), time=time)).time


def test_times_of_all_kinds():
    second = 1_000_000_000
    assert time_of(np.datetime64(10, "s")) == 10 * second and time_of(np.datetime64(2500, "ps")) == 2
    assert time_of(np.datetime64("NaT")) is None
    assert time_of(datetime.datetime(1970, 1, 1, 0, 0, 1, 5)) == second + 5000
    zone = datetime.timezone(datetime.timedelta(hours=1))
    assert time_of(datetime.datetime(1970, 1, 1, 1, 0, 1, tzinfo=zone)) == second
    for wrong in (np.datetime64("3000-01-01"), np.datetime64("0001-01-01"), datetime.datetime(9000, 1, 1), 2**63):
        with pytest.raises(lidarpc.Error, match="time"):
            time_of(wrong)
    with pytest.raises(TypeError):
        time_of(1.5)


def test_unaligned_arrays():
    xyz = points()
    unaligned = np.frombuffer(b"\0" + xyz.tobytes(), np.float32, offset=1).reshape(-1, 3)
    assert not unaligned.flags.aligned
    frame = lidarpc.decode_frame(lidarpc.encode_frame(unaligned, intensity=unaligned.reshape(3, -1)[0]))
    assert np.array_equal(frame.xyz, xyz) and np.array_equal(frame["intensity"], xyz.reshape(3, -1)[0])


def test_masks_complex_numbers_and_large_integers_are_refused():
    for wrong in (np.full((2, 3), 2**60 + 1), np.full((2, 3), 2**64 - 1, np.uint64), np.full((2, 3), 2**31 - 1, np.int32)):
        with pytest.raises(lidarpc.Error, match="float32 does not hold"):
            lidarpc.encode_frame(wrong)
    for exact in (np.full((2, 3), 2**60), np.full((2, 3), -(2**63)), np.full((2, 3), -128, np.int8)):
        assert np.array_equal(lidarpc.decode_frame(lidarpc.encode_frame(exact)).xyz, exact)
    with pytest.raises(TypeError, match="complex"):
        lidarpc.encode_frame(points().astype(complex))
    for arguments in (dict(xyz=np.ma.masked_array(points())), dict(xyz=points(), ring=np.ma.zeros(50, np.uint8))):
        with pytest.raises(lidarpc.Error, match="masked"):
            lidarpc.encode_frame(**arguments)


def test_only_buffers_are_files(scans):
    stream = io.BytesIO()
    with lidarpc.Encoder(stream, level=1) as out:
        for wrong in (5, None, "text", [1, 2]):
            with pytest.raises(TypeError):
                out.push_file("a.bin", wrong)
        name, data = scans[0]
        for kind in (bytes, bytearray, memoryview, lambda data: np.frombuffer(data, np.float32)):
            out.push_file(name, kind(data))
    assert [frame.data for frame in lidarpc.open(stream)] == [scans[0][1]] * 4


@pytest.fixture
def mixed(tmp_path, scans):
    """A folder of a scan and a note."""
    folder = tmp_path / "drive"
    folder.mkdir()
    (folder / scans[0][0]).write_bytes(scans[0][1])
    (folder / "notes.txt").write_text("not a scan")
    return folder


def test_what_is_left_out_is_warned_of(mixed, tmp_path):
    stream = tmp_path / "drive.lpc"
    with pytest.warns(lidarpc.LidarpcWarning, match="left out 1 file .*notes.txt") as warned:
        lidarpc.encode(mixed, stream, level=1)
    assert [warning.filename for warning in warned] == [__file__]
    with pytest.raises(lidarpc.Error, match="notes.txt"):
        lidarpc.encode(mixed, stream, level=1, strict=True, force=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        lidarpc.encode(mixed, stream, level=1, all_files=True, verify=True, force=True)
        lidarpc.decode(stream, tmp_path / "back")
    assert (tmp_path / "back" / "notes.txt").read_text() == "not a scan"


def test_wrong_usage_is_told_in_one_line(drive_file, tmp_path):
    with pytest.raises(lidarpc.Error) as raised:
        lidarpc.decode(drive_file, tmp_path / "out", format="docx")
    assert "docx" in str(raised.value) and "\n" not in str(raised.value) and "Usage" not in str(raised.value)


def test_what_is_intact_is_decoded(tmp_path):
    damaged = tmp_path / "damaged.lpc"
    with lidarpc.Encoder(damaged, group=2, level=1) as out:
        for number in range(6):
            out.push(noise(number), name=f"{number:02}")
    data = bytearray(damaged.read_bytes())
    # In the second frame of the second of three groups, before which the first comes back.
    data[len(data) * 9 // 16] ^= 1
    damaged.write_bytes(data)
    with pytest.raises(lidarpc.Error, match="damaged"):
        lidarpc.decode(damaged, tmp_path / "none", format="bin")
    with pytest.warns(lidarpc.LidarpcWarning) as warned:
        lidarpc.decode(damaged, tmp_path / "some", format="bin", keep_going=True)
    assert "5 frames saved, 1 frame lost" in str(warned[-1].message)
    assert sorted(path.stem for path in (tmp_path / "some").iterdir()) == ["00", "01", "02", "04", "05"]


def test_the_working_folder_is_not_imported_from(mixed, monkeypatch):
    (mixed / "lidarpc").mkdir()
    (mixed / "lidarpc" / "__init__.py").write_text("raise RuntimeError('imported')")
    monkeypatch.chdir(mixed)
    lidarpc.encode(mixed / "0000000000.bin", mixed / "one.lpc", level=1)


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_an_interrupted_program_cleans_up(tmp_path):
    # Written by the program as it reads: frames that take long.
    folder = tmp_path / "drive"
    folder.mkdir()
    for number in range(40):
        (folder / f"{number:04}.bin").write_bytes(np.random.default_rng(number).normal(size=200_000).astype("f4").tobytes())

    def interrupt() -> None:
        while len(list(tmp_path.iterdir())) == 1:
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGINT)

    # Programs in the background of a shell ignore it.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        thread = threading.Thread(target=interrupt, daemon=True)
        thread.start()
        with pytest.raises(KeyboardInterrupt):
            lidarpc.encode(folder, tmp_path / "drive.lpc", level=9, threads=1)
        thread.join()
    finally:
        signal.signal(signal.SIGINT, before)
    assert list(tmp_path.iterdir()) == [folder]

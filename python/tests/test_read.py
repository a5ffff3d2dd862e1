"""Drives and frames."""

from __future__ import annotations

import gc
import io
import itertools
import pickle
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from conftest import in_fork

import lidarpc


def xyzi(data: bytes) -> np.ndarray:
    return np.frombuffer(data, np.float32).reshape(-1, 4)


def test_a_drive_is_a_sequence_of_the_files(drive_file, scans):
    with lidarpc.open(drive_file) as drive:
        assert len(drive) == 3 and drive.names == [name for name, _ in scans]
        for frame, (name, data) in zip(drive, scans, strict=True):
            expected = xyzi(data)
            assert (frame.name, len(frame), frame.data) == (name, len(expected), data)
            assert frame.xyz.dtype == np.float32 and np.array_equal(frame.xyz, expected[:, :3])
            assert np.array_equal(frame["intensity"], expected[:, 3])
            assert np.array_equal(frame["z"], expected[:, 2])
            assert frame.fields == ["x", "y", "z", "intensity"] and "intensity" in frame and "ring" not in frame
        assert [frame.number for frame in drive] == [0, 1, 2]


@pytest.mark.parametrize("source", ["str", "bytes", "bytearray", "file", "buffered"])
def test_it_is_read_from_anything(drive_file, scans, source):
    data = drive_file.read_bytes()
    sources = {
        "str": str(drive_file),
        "bytes": data,
        "bytearray": bytearray(data),
        "file": io.BytesIO(data),
        "buffered": drive_file.open("rb"),
    }
    with lidarpc.open(sources[source]) as drive:
        assert [frame.data for frame in drive[1:]] == [data for _, data in scans[1:]]
        assert drive[0].data == scans[0][1]


def test_indexes_and_slices(long_file):
    with lidarpc.open(long_file) as drive:
        for number in (0, 17, 999, -1, -1000):
            frame = drive[number]
            assert frame.number == number % 1000 == frame.time and len(frame) == 300 + frame.number % 7
        for number in (1000, -1001, 10**30):
            with pytest.raises(IndexError):
                drive[number]
        with pytest.raises(TypeError):
            drive["17"]
        for cut in (slice(95, 115), slice(None, None, 97), slice(30, 5, -3), slice(990, 2000), slice(5, 5)):
            expected = list(range(1000))[cut]
            assert [frame.number for frame in drive[cut]] == expected and len(drive[cut]) == len(expected)
        part = drive[100:200]
        assert part[5].number == 105 and part[-1].number == 199 and [f.number for f in part[10:12]] == [110, 111]
        with pytest.raises(IndexError):
            part[100]
        assert drive.groups == [range(start, start + 10) for start in range(0, 1000, 10)]


def test_times(long_file, drive_file):
    with lidarpc.open(long_file) as drive:
        assert drive.times.dtype == np.dtype("datetime64[ns]")
        assert np.array_equal(drive.times.astype(np.int64), np.arange(1000))
    with lidarpc.open(drive_file) as drive:
        assert np.isnat(drive.times).all() and drive[0].time is None


def test_range_images(drive_file):
    with lidarpc.open(drive_file) as drive:
        frame = drive[1]
        ranges, cells = frame.range_image, frame.cells
        assert ranges.dtype == np.float32 and ranges.shape == cells.shape and ranges.shape[0] == 64
        seen = (ranges > 0) & (cells >= 0)
        assert seen.sum() > 0.99 * len(frame)
        distances = np.linalg.norm(frame.xyz[cells[seen]], axis=1)
        # Lasers stand up to a quarter of a metre beside the origin.
        assert np.abs(distances - ranges[seen]).max() < 0.3
    with lidarpc.open(drive_file, range_images=False) as drive:
        assert drive[1].range_image is None and drive[1].cells is None


def test_structured_arrays(drive_file, scans):
    with lidarpc.open(drive_file) as drive:
        records = drive[2].to_structured()
    assert records.dtype.names == ("x", "y", "z", "intensity")
    assert records.tobytes() == scans[2][1]


def test_arrays_are_the_callers_own(drive_file, scans):
    with lidarpc.open(drive_file) as drive:
        frame = drive[0]
        frame.xyz[:] = 0
        frame["intensity"][:] = 0
        assert frame.data == scans[0][1] and drive[0].data == scans[0][1]
        points = frame.xyz
    assert np.array_equal(points, xyzi(scans[0][1])[:, :3]), "they outlive the drive"


def test_errors_name_file_and_frame(long_file, tmp_path):
    damaged = tmp_path / "damaged.lpc"
    data = bytearray(long_file.read_bytes())
    data[len(data) // 2] ^= 1
    damaged.write_bytes(data)
    with lidarpc.open(damaged) as drive:
        with pytest.raises(lidarpc.Error) as raised:
            list(drive)
        number = raised.value.frame
        assert 400 < number < 600 and raised.value.file == str(damaged)
        with pytest.raises(ValueError, match=f"damaged.lpc: .*frame {number} ?[:(]") as raised:
            drive[number]
        assert raised.value.frame is not None
        assert drive[number - 10].number == number - 10 and drive[number + 10].number == number + 10
        error = pickle.loads(pickle.dumps(raised.value))
        assert (str(error), error.frame) == (str(raised.value), raised.value.frame)


def test_what_is_no_stream(tmp_path):
    with pytest.raises(FileNotFoundError, match="missing"):
        lidarpc.open(tmp_path / "missing.lpc")
    for data in (b"", b"no stream at all", bytes(100_000)):
        with pytest.raises(lidarpc.Error):
            lidarpc.open(data)


class Broken(io.BytesIO):
    """A file whose reads fail after the first."""

    reads = 0

    def read(self, *arguments):
        self.reads += 1
        if self.reads > 1:
            raise ConnectionError("the line is dead")
        return super().read(*arguments)


def test_errors_of_file_objects_are_told(long_file):
    with lidarpc.open(Broken(long_file.read_bytes())) as drive:
        with pytest.raises(lidarpc.InputError, match="the line is dead") as raised:
            drive[5]
    assert isinstance(raised.value, OSError) and isinstance(raised.value.__cause__, ConnectionError)


def test_a_closed_drive_says_so(drive_file):
    drive = lidarpc.open(drive_file)
    frames = iter(drive)
    drive.close()
    with pytest.raises(ValueError, match="closed"):
        drive[0]
    assert len(list(frames)) == 3


def test_threads_share_a_drive(long_file):
    # From a file object, too: its reads need the interpreter, while others wait for the drive.
    for source in (long_file, io.BytesIO(long_file.read_bytes())):
        with lidarpc.open(source, threads=2) as drive:
            found: list[list[int]] = [[] for _ in range(4)]

            def read(place: int, drive=drive, found=found) -> None:
                if place % 2:
                    found[place] = [frame.number for frame in drive[place * 100 : place * 100 + 50]]
                else:
                    found[place] = [drive[number].number for number in range(place * 100, place * 100 + 50)]

            threads = [threading.Thread(target=read, args=(place,)) for place in range(4)]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join(60)
                assert not thread.is_alive()
            assert found == [list(range(place * 100, place * 100 + 50)) for place in range(4)]


def resident_bytes() -> int:
    with open("/proc/self/status", encoding="ascii") as status:
        return next(int(line.split()[1]) * 1024 for line in status if line.startswith("VmRSS"))


def test_random_access_does_not_grow_memory():
    try:
        resident_bytes()
    except OSError:
        pytest.skip("memory is read from /proc")
    random = np.random.default_rng(2)
    stream = io.BytesIO()
    with lidarpc.Encoder(stream, level=1, group=2) as out:
        for _ in range(200):
            out.push(random.normal(size=(100, 3)).astype(np.float32))
    with lidarpc.open(stream.getvalue()) as drive:

        def access(count: int) -> None:
            for number in random.integers(len(drive), size=count):
                frame = drive[int(number)]
                assert len(frame.xyz) == len(frame)

        access(1000)
        gc.collect()
        before = resident_bytes()
        access(10_000)
        gc.collect()
        # A frame takes more than a kilobyte: 12 MB if each were kept.
        assert resident_bytes() - before < 4 << 20


def test_iterating_does_not_hold_all_frames(long_file):
    with lidarpc.open(long_file, threads=2) as drive:
        frames = iter(drive)
        assert [frame.number for frame in itertools.islice(frames, 3)] == [0, 1, 2]
        assert drive[500].number == 500, "in between"
        assert next(frames).number == 3


def sizes(drive: lidarpc.Drive, *numbers: int) -> list[int]:
    return [len(drive[number]) for number in numbers]


@pytest.mark.parametrize("kind", ["path", "file", "bytes"])
def test_a_drive_works_in_a_forked_process(long_file, kind):
    sources = {"path": long_file, "file": long_file.open("rb"), "bytes": io.BytesIO(long_file.read_bytes())}
    with lidarpc.open(sources[kind], threads=2) as drive:
        assert sizes(drive, 5, 6) == [305, 306], "its threads exist now, but not in the forked process"
        frames = iter(drive)
        next(frames)
        assert in_fork(lambda: sizes(drive, 7, 999)) == [300, 300 + 999 % 7]
        assert in_fork(lambda: [frame.number for frame in drive[30:60]]) == list(range(30, 60))
        told = in_fork(lambda: next(frames))
        assert told.startswith("Error: ") and "the iteration was begun before this process was forked" in told
        assert next(frames).number == 1 and sizes(drive, 7) == [300]


def test_what_stops_the_program_goes_through(long_file):
    class Stopped(Broken):
        def read(self, *arguments):
            try:
                return super().read(*arguments)
            except ConnectionError:
                raise KeyboardInterrupt from None

    with lidarpc.open(Stopped(long_file.read_bytes())) as drive, pytest.raises(KeyboardInterrupt):
        drive[5]


class Yielding(io.BytesIO):
    """A file that lets other threads run between seeking and reading."""

    def seek(self, *arguments):
        place = super().seek(*arguments)
        time.sleep(1e-4)
        return place


def test_threads_share_the_position_of_a_file(long_file):
    with lidarpc.open(Yielding(long_file.read_bytes()), threads=1) as drive, ThreadPoolExecutor(4) as pool:

        def read(start: int) -> list[int]:
            return [frame.number for frame in drive[start : start + 100]]

        assert list(pool.map(read, range(0, 400, 100))) == [list(range(s, s + 100)) for s in range(0, 400, 100)]


def test_a_file_on_disk_keeps_its_position(long_file):
    with long_file.open("rb") as file, lidarpc.open(file) as drive:
        file.seek(3)
        assert drive[5].number == 5 and file.tell() == 3


def test_buffers_and_what_is_no_source(drive_file):
    data = drive_file.read_bytes()
    for source in (memoryview(data), np.frombuffer(data, np.uint8)):
        with lidarpc.open(source) as drive:
            assert len(drive) == 3 and len(drive[1]) > 1000
    for wrong in (5, None, [1, 2], np.zeros(5)):
        with pytest.raises(TypeError, match="is not a path, a URL, bytes, or a binary file object"):
            lidarpc.open(wrong)
    with drive_file.open(encoding="latin-1") as text, pytest.raises(TypeError, match="drive.lpc is open in text mode"):
        lidarpc.open(text)
    with pytest.raises(TypeError):
        lidarpc.decode_frame(5)
    with pytest.raises(lidarpc.Error, match="threads -1 is not from 0 to 1024"):
        lidarpc.open(drive_file, threads=-1)


def test_names_of_intact_groups_of_a_damaged_file(long_file):
    data = bytearray(long_file.read_bytes())
    data[len(data) // 2] ^= 1
    with lidarpc.open(data) as drive:
        names = drive.names
    lost = [number for number, name in enumerate(names) if name != f"{number:04}"]
    assert len(names) == 1000 and len(lost) == 10 and {names[number] for number in lost} == {""}


def npy(types: list[tuple], values: float) -> lidarpc.Frame:
    """An array of three records as a file."""
    file, stream = io.BytesIO(), io.BytesIO()
    records = np.zeros(3, types)
    for name in records.dtype.names:
        records[name] = values
    np.save(file, records)
    with lidarpc.Encoder(stream, level=1) as out:
        out.push_file("a.npy", file.getvalue())
    return lidarpc.open(stream)[0]


def test_positions_of_other_types():
    xyz = npy([("x", "f8"), ("y", "i4"), ("z", "f8")], 1 / 3).xyz
    assert xyz.dtype == np.float64 and xyz.tolist() == [[1 / 3, 0, 1 / 3]] * 3
    xyz = npy([("x", "i4"), ("y", "i4"), ("z", "i4")], 5).xyz
    assert xyz.dtype == np.int32 and xyz.tolist() == [[5, 5, 5]] * 3
    with pytest.raises(KeyError, match="no field \"z\""):
        npy([("x", "f4"), ("y", "f4"), ("i", "u1")], 1).xyz


def test_a_field_is_listed_once():
    header = (
        "VERSION 0.7\nFIELDS x y z x\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\nWIDTH 2\nHEIGHT 1\n"
        "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA binary\n"
    )
    stream = io.BytesIO()
    with lidarpc.Encoder(stream) as out:
        out.push_file("a.pcd", header.encode() + np.arange(8, dtype="<f4").tobytes())
    frame = lidarpc.open(stream)[0]
    assert frame.fields == ["x", "y", "z"] and frame.to_structured().dtype.names == ("x", "y", "z")


def test_a_frame_cannot_be_pickled(drive_file):
    with lidarpc.open(drive_file) as drive, pytest.raises(TypeError, match="use frame.to_structured"):
        pickle.dumps(drive[0])

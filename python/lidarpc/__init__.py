"""Lossless compression for sequences of spinning-LiDAR scans.

>>> import lidarpc
>>> lidarpc.encode("drive/", "drive.lpc")
>>> with lidarpc.open("drive.lpc") as drive:
...     for frame in drive[100:200]:
...         points, intensities = frame.xyz, frame["intensity"]

Shapes, types, units and errors are in each docstring.
"""

from __future__ import annotations

import io
import operator
import os
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, BinaryIO, Literal, NoReturn, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidarpc import _native
from lidarpc._errors import Error, InputError
from lidarpc._files import Ranges, is_url, name_of, open_url

__all__ = [
    "Drive",
    "Encoder",
    "Error",
    "Frame",
    "FrameEncoder",
    "Frames",
    "InputError",
    "decode",
    "decode_frame",
    "encode",
    "encode_frame",
    "open",
]

#: A local path.
Path = str | os.PathLike[str]
#: A time: nanoseconds since 1970, or a datetime64.
Time = int | np.datetime64 | None

#: What a frame without a time stamp has in arrays of times.
_NO_TIME = np.iinfo(np.int64).min


class Frame:
    """A decoded scan. Arrays are the caller's own: changing them changes nothing else."""

    __slots__ = ("_scan",)

    def __init__(self, scan: _native.Frame) -> None:
        self._scan = scan

    @property
    def number(self) -> int:
        """Its number in the drive, the first being 0."""
        return self._scan.number

    @property
    def name(self) -> str:
        """The name of its file, without a folder; empty if it was none. Check it before use as a path."""
        return self._scan.name

    @property
    def time(self) -> int | None:
        """When it was taken, in nanoseconds since 1970, if that is known."""
        return self._scan.time

    @property
    def track(self) -> int:
        """Which of several scanners that take turns it is of; the first is 0."""
        return self._scan.track

    @property
    def fields(self) -> list[str]:
        """The names of the fields, the position's first."""
        return self._scan.fields

    @property
    def xyz(self) -> NDArray[Any]:
        """Positions in metres: (points, 3), float32 (what the file has, if that is another type).

        KeyError if the file has none.
        """
        return self._scan.xyz

    @property
    def data(self) -> bytes | None:
        """The bytes of the file as it was; None if the scan was none."""
        return self._scan.data

    @property
    def range_image(self) -> NDArray[np.float32] | None:
        """First returns as (lasers, azimuths), float32, in metres; 0 where there is none.

        None if lidarpc has no model of the scanner, or the drive was opened with ``range_images=False``.
        """
        return self._scan.ranges()

    @property
    def cells(self) -> NDArray[np.int32] | None:
        """Which point each cell of the range image is: (lasers, azimuths), int32; -1 where there is none.

        ``frame["intensity"][frame.cells]`` is an image of the intensities, where ``frame.cells >= 0``.
        """
        return self._scan.cells()

    def to_structured(self) -> NDArray[np.void]:
        """All fields as one structured array, (points,), with a field for each name in ``fields``."""
        columns = {name: self[name] for name in self.fields}
        types = [(name, column.dtype, column.shape[1:]) for name, column in columns.items()]
        records = np.empty(len(self), types)
        for name, column in columns.items():
            records[name] = column
        return records

    def __getitem__(self, name: str) -> NDArray[Any]:
        """The values of a field: (points,), or (points, count) if it has several for each, in the type of the file.

        KeyError if there is no such field.
        """
        return self._scan[name]

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and name in self._scan

    def __len__(self) -> int:
        """Number of points."""
        return len(self._scan)

    def __bool__(self) -> bool:
        # A scan without points is a scan.
        return True

    def __iter__(self) -> NoReturn:
        raise TypeError("a frame is no sequence: use frame.xyz, or frame.fields for the names of its fields")

    def __repr__(self) -> str:
        return repr(self._scan)


class Frames(Sequence[Frame]):
    """Some frames of a drive: what a slice of it gives. Frames are decoded when they are asked for."""

    def __init__(self, drive: Drive, numbers: range) -> None:
        self._drive = drive
        self._numbers = numbers

    def __len__(self) -> int:
        return len(self._numbers)

    @overload
    def __getitem__(self, key: int) -> Frame: ...
    @overload
    def __getitem__(self, key: slice) -> Frames: ...
    def __getitem__(self, key: int | slice) -> Frame | Frames:
        """The frame at this place of the slice, or a slice of it. IndexError if there is none."""
        if isinstance(key, slice):
            return Frames(self._drive, self._numbers[key])
        try:
            number = self._numbers[operator.index(key)]
        except IndexError:
            raise IndexError(f"no frame {key} in a slice of {len(self)}") from None
        return self._drive[number]

    def __iter__(self) -> Iterator[Frame]:
        numbers = self._numbers
        if numbers.step == 1 and numbers:
            # In parallel, and ahead of who asks.
            return map(Frame, self._drive._reader().frames(numbers.start, numbers.stop))
        return (self._drive[number] for number in numbers)

    def __repr__(self) -> str:
        return f"<lidarpc.Frames {self._numbers} of {self._drive!r}>"


class Drive(Sequence[Frame]):
    """An open stream: a sequence of frames. Several threads may use it at once.

    Of frames that are asked for one by one, the group decoded last is kept, as far as it was decoded.
    """

    def __init__(self, source: Path | bytes | BinaryIO, *, threads: int = 0, range_images: bool = True) -> None:
        """See :func:`open`."""
        self._name = name_of(source)
        self._opened: BinaryIO | None = None
        self._native: _native.StreamReader | None = None
        if is_url(source):
            self._opened = source = open_url(source, "rb")
        if isinstance(source, (bytearray, memoryview)):
            source = bytes(source)
        kept = source if isinstance(source, (str, os.PathLike, bytes)) else Ranges(source)
        try:
            self._native = _native.StreamReader(kept, self._name, threads, range_images)
        except BaseException:
            self.close()
            raise

    def _reader(self) -> _native.StreamReader:
        if self._native is None:
            raise ValueError(f"{self._name or 'the drive'} is closed")
        return self._native

    def __len__(self) -> int:
        return len(self._reader())

    @overload
    def __getitem__(self, key: int) -> Frame: ...
    @overload
    def __getitem__(self, key: slice) -> Frames: ...
    def __getitem__(self, key: int | slice) -> Frame | Frames:
        """The frame with this number, negative from the end; of a slice, :class:`Frames`.

        IndexError if there is no such frame; Error if it is damaged. Only the frame's group is read.
        """
        reader = self._reader()
        if isinstance(key, slice):
            return Frames(self, range(*key.indices(len(reader))))
        number = operator.index(key)
        if not -len(reader) <= number < len(reader):
            raise IndexError(f"no frame {number} in a drive of {len(reader)}")
        return Frame(reader.frame(number % len(reader)))

    def __iter__(self) -> Iterator[Frame]:
        """All frames, decoded in parallel and ahead."""
        return iter(self[:])

    @property
    def names(self) -> list[str]:
        """The names of the frames. They stand in the groups: this reads the whole stream, but decodes nothing."""
        return self._reader().names()

    @property
    def times(self) -> NDArray[np.datetime64]:
        """When the frames were taken: (frames,), datetime64[ns], NaT where that is not known."""
        return self._reader().times().view("datetime64[ns]")

    @property
    def groups(self) -> list[range]:
        """The numbers of the frames that are coded together, and come cheap one after the other."""
        starts = self._reader().groups()
        return [range(start, end) for start, end in zip(starts, starts[1:])]

    def close(self) -> None:
        """Closes the drive, and the file if it was opened by its name. Iterators that were begun go on."""
        self._native = None
        opened, self._opened = self._opened, None
        if opened is not None:
            opened.close()

    def __enter__(self) -> Drive:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        state = "closed" if self._native is None else f"{len(self._native)} frames"
        return f"<lidarpc.Drive {self._name!r}: {state}>"


def open(source: Path | bytes | BinaryIO, *, threads: int = 0, range_images: bool = True) -> Drive:
    """Opens a stream for reading. Reads its index, at the end.

    ``source``: a path, a URL that fsspec knows (``s3://bucket/drive.lpc``), bytes, or a binary file object that can be
    sought in. ``threads``: how many decode ahead where frames are iterated over; 0 stands for one a processor, 1 for none
    but the caller's. ``range_images=False`` saves their time and memory.

    OSError if the file cannot be opened; Error if it is no stream, or is damaged at its end.
    """
    return Drive(source, threads=threads, range_images=range_images)


def _positions(xyz: ArrayLike) -> NDArray[np.float32]:
    """Positions as they are stored: (n, 3), float32."""
    xyz = np.asarray(xyz)
    if xyz.ndim != 2 or xyz.shape[1] != 3:
        raise Error(f"xyz is of shape {xyz.shape}, not (points, 3)")
    positions = np.ascontiguousarray(xyz, dtype=np.float32)
    if xyz.dtype != np.float32 and not np.array_equal(positions, xyz, equal_nan=xyz.dtype.kind == "f"):
        raise Error(f"xyz is {xyz.dtype}, and float32 does not hold its values: round it, xyz.astype('float32')")
    return positions


def _fields(
    intensity: ArrayLike | None, ring: ArrayLike | None, fields: Mapping[str, ArrayLike] | None
) -> list[tuple[str, NDArray[Any]]]:
    """Fields as they are stored: in the machine's byte order, without gaps."""
    named = [("intensity", intensity), ("ring", ring), *(fields or {}).items()]
    arrays = []
    for name, values in named:
        if values is None:
            continue
        values = np.asarray(values)
        if values.ndim != 1:
            raise Error(f"{name} is of shape {values.shape}, not (points,)")
        arrays.append((name, np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("="))))
    return arrays


def _nanoseconds(time: Time) -> int | None:
    """A time as it is stored."""
    if time is None:
        return None
    if isinstance(time, np.datetime64):
        nanoseconds = int(time.astype("datetime64[ns]").astype(np.int64))
        return None if nanoseconds == _NO_TIME else nanoseconds
    return operator.index(time)


class Encoder:
    """Writes a stream, frame by frame as they come.

    A file at a path has its name only once the stream is complete: until then, ``.partial`` follows the name. If the
    ``with`` block ends in an exception, nothing is left. Groups are coded by threads of their own.
    """

    def __init__(
        self,
        target: Path | BinaryIO,
        *,
        level: int = 6,
        max_error: float | None = None,
        intensity_step: float | None = None,
        threads: int = 0,
        group: int | None = None,
    ) -> None:
        """To a path, a URL that fsspec knows, or a binary file object, which stays open.

        ``level``: effort, from 1 to 9. ``max_error``: how far a point may be moved, in metres; None: not at all.
        ``intensity_step``: intensities may be rounded to multiples of it (with ``max_error``). ``threads``: how many code
        groups; 0 stands for one a processor. ``group``: frames coded together; default 10, 30 at level 9.

        Error if one is out of range, OSError if the file cannot be written.
        """
        settings = (level, max_error, intensity_step, threads, group)
        self._name = name_of(target)
        #: Until it is complete, and then.
        self._names: tuple[str, str] | None = None
        self._file: BinaryIO | None = None
        self._writer: _native.StreamWriter | None = None
        if is_url(target):
            # What such a file holds is there once it is closed, as a rule.
            self._file = open_url(target, "wb")
            write = self._file.write
        elif isinstance(target, (str, os.PathLike)):
            path = os.fsdecode(target)
            self._names = (f"{path}.partial", path)
            self._file = io.open(self._names[0], "wb")
            write = self._file.write
        else:
            write = target.write

        def write_all(piece: bytes) -> None:
            rest = memoryview(piece)
            while rest:
                # Raw files may take a part; others give the whole length, or nothing.
                count = write(rest)
                rest = rest[len(rest) if count is None else count :]

        try:
            self._writer = _native.StreamWriter(write_all, self._name, *settings)
        except BaseException:
            self._abandon()
            raise

    def push(
        self,
        xyz: ArrayLike,
        *,
        intensity: ArrayLike | None = None,
        ring: ArrayLike | None = None,
        time: Time = None,
        name: str = "",
        track: int = 0,
        fields: Mapping[str, ArrayLike] | None = None,
    ) -> None:
        """Takes the next scan.

        ``xyz``: (points, 3), metres, float32, or what float32 holds exactly. ``intensity``, ``ring``: (points,).
        ``fields``: further fields, name to (points,), such as ``{"time": seconds}``. Types are int8 to int64, uint8 to
        uint64, float32 and float64; each comes back as it is. ``time``: when the scan was taken, in nanoseconds since
        1970, or a datetime64. ``name``: of the frame. ``track``: which of several scanners it is of.

        Error if the arrays do not fit together.
        """
        values = _fields(intensity, ring, fields)
        self._open().push(_positions(xyz), values, name, _nanoseconds(time), track)

    def push_file(self, name: str, data: bytes, *, time: Time = None, track: int = 0) -> None:
        """Takes a file by its name and its bytes, which come back as they are: .bin, .pcd.bin, .pcd, .ply, .las, .csv, .txt,
        .xyz, .npy or .feather."""
        self._open().push_file(name, bytes(data), _nanoseconds(time), track)

    def _open(self) -> _native.StreamWriter:
        if self._writer is None:
            raise ValueError(f"{self._name or 'the encoder'} is closed")
        return self._writer

    def close(self) -> None:
        """Writes what is left, and gives the file its name. Nothing happens the second time."""
        if self._writer is None:
            return
        try:
            self._writer.finish()
            self._writer = None
            if self._file is not None:
                self._file.flush()
                if self._names is not None:
                    os.fsync(self._file.fileno())
                self._file.close()
            if self._names is not None:
                os.replace(*self._names)
        except BaseException:
            self._abandon()
            raise

    def _abandon(self) -> None:
        """Leaves nothing behind."""
        self._writer = None
        file, self._file = self._file, None
        if file is None:
            return
        # A file of fsspec would be stored when it is closed.
        discard = getattr(file, "discard", None)
        if self._names is None and discard is not None:
            discard()
            file.closed = True  # type: ignore[misc]
            return
        file.close()
        if self._names is not None:
            os.unlink(self._names[0])

    def __enter__(self) -> Encoder:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.close()
        else:
            self._abandon()


def encode_frame(
    xyz: ArrayLike,
    *,
    intensity: ArrayLike | None = None,
    ring: ArrayLike | None = None,
    time: Time = None,
    fields: Mapping[str, ArrayLike] | None = None,
    level: int = 6,
    max_error: float | None = None,
    intensity_step: float | None = None,
) -> bytes:
    """One scan as a message that stands by itself: a stream of one frame. Arguments are those of :class:`Encoder`. For more
    than one scan of a scanner, :class:`FrameEncoder` is quicker."""
    encoder = FrameEncoder(level=level, max_error=max_error, intensity_step=intensity_step)
    return encoder.encode(xyz, intensity=intensity, ring=ring, time=time, fields=fields)


class FrameEncoder:
    """Encodes scans to messages that stand by themselves, as a node does that publishes them. The scanner is looked for in the
    first scans, and kept once it is found. Use one for each scanner; it may be shared by threads, which then wait for each
    other. Arguments are those of :class:`Encoder`."""

    def __init__(
        self, *, level: int = 6, max_error: float | None = None, intensity_step: float | None = None
    ) -> None:
        self._native = _native.FrameEncoder(level, max_error, intensity_step)

    def encode(
        self,
        xyz: ArrayLike,
        *,
        intensity: ArrayLike | None = None,
        ring: ArrayLike | None = None,
        time: Time = None,
        fields: Mapping[str, ArrayLike] | None = None,
    ) -> bytes:
        """One scan as a message, for :func:`decode_frame`. Arguments are those of :meth:`Encoder.push`."""
        return self._native.encode(_positions(xyz), _fields(intensity, ring, fields), _nanoseconds(time))


def decode_frame(payload: bytes, *, range_images: bool = False) -> Frame:
    """The scan in such a message. Error if it is damaged, or holds more frames than one."""
    return Frame(_native.decode_frame(bytes(payload), range_images))


def _run(arguments: list[str], file: str) -> None:
    """Runs the program in a process of its own: it may be interrupted, and leaves nothing half done."""
    command = [sys.executable, "-m", "lidarpc", "--quiet", *arguments]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, errors="replace")
    said = done.stderr.strip().removeprefix("lidarpc: ").removeprefix("error: ")
    if done.returncode < 0:
        raise Error(f"{file}: ended by signal {-done.returncode}", file)
    if done.returncode:
        raise Error(said or f"{file}: failed", file)


def encode(
    source: Path | Iterable[Path],
    target: Path,
    *,
    level: int = 6,
    max_error: float | None = None,
    intensity_step: float | None = None,
    threads: int = 0,
    force: bool = False,
) -> None:
    """Encodes a folder of scans, or a list of scans, into a file, as ``lidarpc encode`` does.

    ``level``, ``max_error`` (metres), ``intensity_step`` and ``threads`` are those of :class:`Encoder`. ``force``: an
    existing target is overwritten. The target appears when it is complete. Error says what went wrong.
    """
    sources = [source] if isinstance(source, (str, os.PathLike)) else list(source)
    arguments = [f"--output={os.fspath(target)}", f"--level={level}", f"--threads={threads}"]
    if max_error is not None:
        arguments.append(f"--max-error={max_error * 1000:.9g}mm")
    if intensity_step is not None:
        arguments.append(f"--intensity-step={intensity_step:.9g}")
    if force:
        arguments.append("--force")
    _run(["encode", *arguments, "--", *(os.fspath(path) for path in sources)], os.fspath(target))


def decode(
    source: Path,
    target: Path,
    *,
    threads: int = 0,
    format: Literal["bin", "pcd", "ply", "csv", "npy"] | None = None,
    force: bool = False,
) -> None:
    """Decodes a file into a folder of scans, as ``lidarpc decode`` does: byte for byte as they were.

    ``format``: None, or ``"bin"``, ``"pcd"``, ``"ply"``, ``"csv"`` or ``"npy"`` to convert them. ``force``: existing files are overwritten.
    Error says what went wrong.
    """
    arguments = [f"--output={os.fspath(target)}", f"--threads={threads}"]
    if format is not None:
        arguments.append(f"--format={format}")
    if force:
        arguments.append("--force")
    _run(["decode", *arguments, "--", os.fspath(source)], os.fspath(source))

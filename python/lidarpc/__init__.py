"""Lossless compression for sequences of spinning-LiDAR scans.

>>> import lidarpc
>>> lidarpc.encode("drive/", "drive.lpc")
>>> with lidarpc.open("drive.lpc") as drive:
...     for frame in drive[100:200]:
...         points, intensities = frame.xyz, frame["intensity"]

Shapes, types, units and errors are in each docstring.
"""

from __future__ import annotations

import contextlib
import datetime
import operator
import os
import signal
import subprocess
import sys
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, BinaryIO, Literal, NoReturn, SupportsIndex, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidarpc import _native
from lidarpc._errors import Error, InputError, LidarpcWarning
from lidarpc._files import Output, Ranges, bytes_of, filesystem_of, is_buffer, is_url, name_of, open_output

__all__ = [
    "Drive",
    "Encoder",
    "Error",
    "Frame",
    "FrameEncoder",
    "Frames",
    "InputError",
    "LidarpcWarning",
    "decode",
    "decode_frame",
    "encode",
    "encode_frame",
    "open",
]

#: A local path.
Path = str | os.PathLike[str]
#: The bytes of a stream or a file.
Buffer = bytes | bytearray | memoryview | NDArray[np.uint8]
#: A time: nanoseconds since 1970, a datetime64, or a datetime (UTC if it has no time zone).
Time = SupportsIndex | np.datetime64 | datetime.datetime | None

#: What a frame without a time stamp has in arrays of times.
_NO_TIME = np.iinfo(np.int64).min

#: There are no levels 4 and 5.
_LEVELS = (1, 2, 3, 6, 7, 8, 9)


class Frame:
    """A decoded scan. Arrays are the caller's own: changing them changes nothing else.

    Frames cannot be pickled: give other processes ``to_structured()``, or the number and the drive's name.
    """

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
        """The names of the fields, the position's first; each name once, also if the file has several such fields."""
        return self._scan.fields

    @property
    def xyz(self) -> NDArray[Any]:
        """Positions in metres: (points, 3), float32.

        If float32 does not hold the values of the file, the type of the file, or float64 if x, y and z have different
        types. Positions of .las files are relative to the offset in the file's header, if float32 holds them only so: the
        header is at the beginning of ``data``. KeyError if x, y or z is missing.
        """
        positions = self._scan.positions()
        if positions is not None:
            return positions
        columns = [self._scan[axis] for axis in "xyz"]
        types = {column.dtype for column in columns}
        return np.stack(columns, axis=1, dtype=types.pop() if len(types) == 1 else np.float64)

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
        """The values of a field: (points,), or (points, count) if it has several for each.

        The type is that of the file; but x, y, z, and intensities of floating point, are float32 where that holds their
        values. KeyError if there is no such field.
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

    def __reduce__(self) -> NoReturn:
        raise TypeError("a frame cannot be pickled: use frame.to_structured(), or its number and the drive's name")

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
    def __getitem__(self, key: SupportsIndex) -> Frame: ...
    @overload
    def __getitem__(self, key: slice) -> Frames: ...
    def __getitem__(self, key: SupportsIndex | slice) -> Frame | Frames:
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
    """An open stream: a sequence of frames. Several threads may use it at once, and so may forked processes; but an
    iterator works only in the process that began it, and of file objects, only files on disk or in memory may be read by
    several processes.

    Of frames that are asked for one by one, the group decoded last is kept, as far as it was decoded.
    """

    def __init__(
        self, source: Path | Buffer | BinaryIO, *, threads: SupportsIndex = 0, range_images: bool = True
    ) -> None:
        """See :func:`open`."""
        self._name = name_of(source)
        self._opened: BinaryIO | None = None
        self._native: _native.StreamReader | None = None
        threads = _in_range("threads", threads, 0, 1024)
        kept: Any = source
        if is_url(source):
            filesystem, kept = filesystem_of(source)
            if filesystem is not None:
                self._opened = filesystem.open(kept, "rb")
                kept = Ranges(self._opened)
        elif is_buffer(source):
            kept = bytes_of(source)
        elif not isinstance(source, (str, os.PathLike)):
            kept = Ranges(source)
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
    def __getitem__(self, key: SupportsIndex) -> Frame: ...
    @overload
    def __getitem__(self, key: slice) -> Frames: ...
    def __getitem__(self, key: SupportsIndex | slice) -> Frame | Frames:
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
        """The names of the frames; empty for those without one, and those of damaged groups. They are stored in the groups:
        this reads the whole stream, but decodes nothing."""
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


def open(
    source: Path | Buffer | BinaryIO, *, threads: SupportsIndex = 0, range_images: bool = True
) -> Drive:
    """Opens a stream for reading. Reads its index, at the end.

    ``source``: a path, a URL that fsspec knows (``s3://bucket/drive.lpc``), bytes (also as a bytearray, a memoryview or a
    contiguous array of uint8), or a binary file object that can be sought in. ``threads``: how many decode ahead where
    frames are iterated over, at most 1024; 0 stands for one a processor, 1 for none but the caller's.
    ``range_images=False`` saves their time and memory.

    OSError if the file cannot be opened; Error if it is no stream, or is damaged at its end; TypeError if the source is
    something else.
    """
    return Drive(source, threads=threads, range_images=range_images)


def _in_range(name: str, value: SupportsIndex, least: int, most: int) -> int:
    """The value as an integer. Error if it is out of range."""
    value = operator.index(value)
    if not least <= value <= most:
        raise Error(f"{name} {value} is not from {least} to {most}")
    return value


def _level(level: SupportsIndex) -> int:
    level = operator.index(level)
    if level not in _LEVELS:
        raise Error(f"level {level} does not exist: levels are 1, 2, 3, 6, 7, 8 and 9")
    return level


def _array(values: ArrayLike, name: str) -> NDArray[Any]:
    if isinstance(values, np.ma.MaskedArray):
        raise Error(f"{name} is a masked array, and masks are not stored: use {name}.filled(value)")
    return np.asarray(values)


def _positions(xyz: ArrayLike) -> NDArray[np.float32]:
    """Positions as they are stored: (n, 3), float32."""
    xyz = _array(xyz, "xyz")
    if xyz.ndim != 2 or xyz.shape[1] != 3:
        raise Error(f"xyz is of shape {xyz.shape}, not (points, 3)")
    if xyz.dtype.kind not in "fiub":
        raise TypeError(f"xyz is {xyz.dtype}: positions are real numbers")
    with np.errstate(over="ignore"):
        positions = np.require(xyz, np.float32, ["C", "A"])
    if not _holds(positions, xyz):
        raise Error(f"xyz is {xyz.dtype}, and float32 does not hold its values: round it, xyz.astype('float32')")
    return positions


def _holds(positions: NDArray[np.float32], xyz: NDArray[Any]) -> bool:
    """Whether the positions are exactly these values."""
    if xyz.dtype.kind in "iu":
        # As integers: the larger ones are rounded in float64 as well, with which NumPy would compare them. Integers near
        # the largest may be rounded to one that the type does not have.
        bits = int(np.iinfo(xyz.dtype).max).bit_length()
        return bool((positions < np.float32(2.0**bits)).all()) and np.array_equal(positions.astype(xyz.dtype), xyz)
    return xyz.dtype == np.float32 or np.array_equal(positions, xyz, equal_nan=xyz.dtype.kind == "f")


def _fields(
    intensity: ArrayLike | None, ring: ArrayLike | None, fields: Mapping[str, ArrayLike] | None
) -> list[tuple[str, NDArray[Any]]]:
    """Fields as they are stored: in the machine's byte order, aligned, without gaps."""
    named = [("intensity", intensity), ("ring", ring), *(fields or {}).items()]
    arrays = []
    for name, values in named:
        if values is None:
            continue
        values = _array(values, name)
        if values.ndim != 1:
            raise Error(f"{name} is of shape {values.shape}, not (points,)")
        arrays.append((name, np.require(values, values.dtype.newbyteorder("="), ["C", "A"])))
    return arrays


def _nanoseconds(time: Time) -> int | None:
    """A time as it is stored."""
    # A datetime of pandas, which has nanoseconds.
    exact = getattr(time, "to_datetime64", None)
    if exact is not None:
        time = exact()
    if isinstance(time, np.datetime64):
        nanoseconds = time.astype("datetime64[ns]")
        if np.isnat(time):
            return None
        # What does not fit wraps around. Finer units always fit.
        if np.datetime_data(time.dtype)[0] not in ("ps", "fs", "as") and nanoseconds.astype(time.dtype) != time:
            raise Error(f"time {time} is not from 1677-09-22 to 2262-04-11, which 64 bits of nanoseconds hold")
        return int(nanoseconds.astype(np.int64))
    if isinstance(time, datetime.datetime):
        utc = time.replace(tzinfo=datetime.timezone.utc) if time.tzinfo is None else time
        since = utc - datetime.datetime(1970, 1, 1, tzinfo=datetime.timezone.utc)
        time = since // datetime.timedelta(microseconds=1) * 1000
    return None if time is None else _in_range("time", time, _NO_TIME + 1, -_NO_TIME - 1)


class Encoder:
    """Writes a stream, frame by frame as they come.

    A file at a path has its name only once the stream is complete, and then replaces one of that name; until then,
    ``.partial`` follows the name (or ``.2.partial`` and so on, if there is such a file). If the ``with`` block ends in an
    exception, nothing is left; but after KeyboardInterrupt or SystemExit, as when a recording is stopped, a ``.partial``
    file is kept if anything was written to it. ``lidarpc repair X.partial -o Y`` makes a stream of its complete groups; a
    note of the exception says so.
    Groups are coded by threads of their own. A forked process cannot go on with an encoder.
    """

    def __init__(
        self,
        target: Path | BinaryIO,
        *,
        level: SupportsIndex = 6,
        max_error: float | None = None,
        intensity_step: float | None = None,
        threads: SupportsIndex = 0,
        group: SupportsIndex | None = None,
    ) -> None:
        """To a path, a URL that fsspec knows, or a binary file object, which stays open.

        ``level``: effort, from 1 to 9, without 4 and 5. ``max_error``: how far a point may be moved, in metres; None: not at
        all. ``intensity_step``: intensities may be rounded to multiples of it (with ``max_error``). ``threads``: how many
        code groups, at most 1024; 0 stands for one a processor. ``group``: frames coded together, from 1 to 100,000;
        default 10, 30 at level 9.

        Error if one is out of range, OSError if the file cannot be written, TypeError if the target is something else.
        """
        self._name = name_of(target)
        self._process = os.getpid()
        opened: list[Output] = []
        # Before the target is opened: wrong settings must not harm it.
        writer = _native.StreamWriter(
            lambda piece: opened[0].write(piece),
            self._name,
            _level(level),
            max_error,
            intensity_step,
            _in_range("threads", threads, 0, 1024),
            None if group is None else _in_range("group", group, 1, 100_000),
        )
        self._output: Output | None = open_output(target)
        opened.append(self._output)
        self._writer: _native.StreamWriter | None = writer

    def push(
        self,
        xyz: ArrayLike,
        *,
        intensity: ArrayLike | None = None,
        ring: ArrayLike | None = None,
        time: Time = None,
        name: str = "",
        track: SupportsIndex = 0,
        fields: Mapping[str, ArrayLike] | None = None,
    ) -> None:
        """Takes the next scan.

        ``xyz``: (points, 3), metres, float32, or what float32 holds exactly. ``intensity``, ``ring``: (points,).
        ``fields``: further fields, name to (points,), such as ``{"time": seconds}``. Types are int8 to int64, uint8 to
        uint64, float32 and float64; each comes back as it is. ``time``: when the scan was taken, in nanoseconds since
        1970, a datetime64, or a datetime, which is UTC if it has no time zone. ``name``: of the frame. ``track``: which of
        several scanners it is of, from 0 to 254.

        Error if the arrays do not fit together, or the name cannot be one of a file: the scan is left out then, and the
        encoder takes further ones.
        """
        values = _fields(intensity, ring, fields)
        self._open().push(_positions(xyz), values, name, _nanoseconds(time), _in_range("track", track, 0, 254))

    def push_file(self, name: str, data: Buffer, *, time: Time = None, track: SupportsIndex = 0) -> None:
        """Takes a file by its name and its bytes, which come back as they are: .bin, .pcd.bin, .pcd, .ply, .las, .csv, .txt,
        .xyz, .npy or .feather. ``time``, ``track`` and errors are those of :meth:`push`."""
        self._open().push_file(name, bytes_of(data), _nanoseconds(time), _in_range("track", track, 0, 254))

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
            if self._output is not None:
                self._output.commit()
                self._output = None
        except BaseException as error:
            self._abandon(error)
            raise

    def _abandon(self, error: BaseException) -> None:
        """Leaves nothing behind, unless the program was stopped."""
        self._writer = None
        output, self._output = self._output, None
        if output is None or self._process != os.getpid():
            # The file is that of another process.
            return
        # The error that led here is more important than one of the cleanup.
        with contextlib.suppress(Exception):
            if not isinstance(error, (KeyboardInterrupt, SystemExit)):
                output.discard()
            elif (partial := output.keep()) and hasattr(error, "add_note"):
                error.add_note(f"{partial} holds what was written: lidarpc repair {partial} -o {self._name} saves it")

    def __enter__(self) -> Encoder:
        return self

    def __exit__(self, _kind: object, error: BaseException | None, _traceback: object) -> None:
        if error is None:
            self.close()
        else:
            self._abandon(error)


def encode_frame(
    xyz: ArrayLike,
    *,
    intensity: ArrayLike | None = None,
    ring: ArrayLike | None = None,
    time: Time = None,
    fields: Mapping[str, ArrayLike] | None = None,
    level: SupportsIndex = 6,
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
        self, *, level: SupportsIndex = 6, max_error: float | None = None, intensity_step: float | None = None
    ) -> None:
        self._native = _native.FrameEncoder(_level(level), max_error, intensity_step)

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


def decode_frame(payload: Buffer, *, range_images: bool = False) -> Frame:
    """The scan in such a message. Error if it is damaged, or holds more frames than one."""
    return Frame(_native.decode_frame(bytes_of(payload), range_images))


#: Where this package is.
_HOME = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))

#: The program. Modules are not imported from the working folder, as they would be with ``-m``.
_PROGRAM = (
    f"import sys; sys.path[:] = [*filter(None, sys.path), {_HOME!r}]; "
    "from lidarpc.__main__ import main; sys.exit(main())"
)

#: What the program puts before its remarks and errors.
_SPEAKER = "lidarpc: "

#: How long an interrupted program may take to clean up, in seconds.
_PATIENCE = 10


def _run(arguments: list[str], file: str, lost_frames: int | None = None) -> None:
    """Runs the program in a process of its own: it may be interrupted, and leaves nothing half done. What it remarks
    becomes warnings at the caller of the function that calls this. ``lost_frames``: the exit code that is only remarked."""
    command = [sys.executable, "-c", _PROGRAM, *arguments]
    nothing, pipe = subprocess.DEVNULL, subprocess.PIPE
    with subprocess.Popen(
        command, stdin=nothing, stdout=nothing, stderr=pipe, encoding="utf-8", errors="replace"
    ) as process:
        try:
            _, said = process.communicate()
        except BaseException:
            _stop(process)
            raise
    code = process.returncode
    if code < 0:
        raise Error(f"{file}: ended by signal {-code}", file)
    remarks = [line.removeprefix(_SPEAKER) for line in said.splitlines() if line.startswith(_SPEAKER)]
    error = None
    if code and code != lost_frames:
        if not remarks:
            # Wrong usage, which is followed by a summary of the usage; or a fault of Python.
            remarks = [" ".join(said.split("\n\n")[0].split()).removeprefix("error: ") or f"{file}: failed"]
        error = remarks.pop()
    for remark in remarks:
        warnings.warn(remark, LidarpcWarning, stacklevel=3)
    if error is not None:
        raise Error(error, file)


def _stop(process: subprocess.Popen[str]) -> None:
    """Ends the program as Ctrl-C does, so that it removes what is half done."""
    with contextlib.suppress(ProcessLookupError):
        process.send_signal(signal.SIGINT if os.name == "posix" else signal.SIGTERM)
    try:
        process.wait(_PATIENCE)
    except BaseException:
        process.kill()


def encode(
    source: Path | Iterable[Path],
    target: Path,
    *,
    level: SupportsIndex = 6,
    max_error: float | None = None,
    intensity_step: float | None = None,
    threads: SupportsIndex = 0,
    all_files: bool = False,
    strict: bool = False,
    verify: bool = False,
    force: bool = False,
) -> None:
    """Encodes a folder of scans, or a list of scans, into a file, as ``lidarpc encode`` does.

    ``level``, ``max_error`` (metres), ``intensity_step`` and ``threads`` are those of :class:`Encoder`. ``all_files``: keeps
    all other files of the folder, too (``--all``). ``strict``: Error if anything would be left out; otherwise a
    LidarpcWarning counts it. ``verify``: decodes the file and compares it with the scans. ``force``: an existing target is
    overwritten. The target appears when it is complete. Error says what went wrong.
    """
    sources = [source] if isinstance(source, (str, os.PathLike)) else list(source)
    arguments = [f"--output={os.fspath(target)}", f"--level={_level(level)}"]
    arguments.append(f"--threads={_in_range('threads', threads, 0, 1024)}")
    if max_error is not None:
        arguments.append(f"--max-error={max_error * 1000:.9g}mm")
    if intensity_step is not None:
        arguments.append(f"--intensity-step={intensity_step:.9g}")
    flags = {"--all": all_files, "--strict": strict, "--verify": verify, "--force": force}
    arguments += [flag for flag, given in flags.items() if given]
    _run(["encode", *arguments, "--", *(os.fspath(path) for path in sources)], os.fspath(target))


def decode(
    source: Path,
    target: Path,
    *,
    threads: SupportsIndex = 0,
    format: Literal["bin", "pcd", "ply", "csv", "npy"] | None = None,
    keep_going: bool = False,
    force: bool = False,
) -> None:
    """Decodes a file into a folder of scans, as ``lidarpc decode`` does: byte for byte as they were.

    ``format``: None, or ``"bin"``, ``"pcd"``, ``"ply"``, ``"csv"`` or ``"npy"`` to convert them. ``keep_going``: decodes
    what is intact of a damaged file; a LidarpcWarning says which frames are lost. ``force``: existing files are
    overwritten. Error says what went wrong.
    """
    arguments = [f"--output={os.fspath(target)}", f"--threads={_in_range('threads', threads, 0, 1024)}"]
    if format is not None:
        arguments.append(f"--format={format}")
    flags = {"--keep-going": keep_going, "--force": force}
    arguments += [flag for flag, given in flags.items() if given]
    _run(["decode", *arguments, "--", os.fspath(source)], os.fspath(source), 3 if keep_going else None)

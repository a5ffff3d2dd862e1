"""Streams as data sets of KISS-ICP and PyTorch. Neither package is needed until it is used."""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

import lidarpc
from lidarpc._files import bytes_of, is_buffer

__all__ = ["GroupBatchSampler", "GroupSampler", "KissIcpDataset", "TorchDataset"]

#: Names of the field that tells when each point was measured.
TIME_FIELDS = ("time", "t", "timestamp", "timestamps", "time_stamp", "point_time_offset")


class _Lazy:
    """A stream that each process opens for itself, when it first needs it: file handles and threads are not inherited."""

    def __init__(self, source: Any, **options: Any) -> None:
        if type(source) in (io.BufferedReader, io.FileIO) and isinstance(source.name, str):
            source = os.path.abspath(source.name)
        elif type(source) is io.BytesIO:
            source = source.getvalue()
        elif is_buffer(source):
            source = bytes_of(source)
        self.source = source
        self.options = options
        self._drive: lidarpc.Drive | None = None
        self._process = -1
        self._first_process = os.getpid()

    def _check_shared(self) -> None:
        if not isinstance(self.source, (str, os.PathLike, bytes)):
            kind = type(self.source).__name__
            raise TypeError(f"processes cannot share a source of type {kind}: give the data set a path, a URL or bytes")

    @property
    def drive(self) -> lidarpc.Drive:
        """The stream, open in this process."""
        if self._drive is None or self._process != os.getpid():
            if self._first_process != os.getpid():
                self._check_shared()
            self._drive = lidarpc.open(self.source, **self.options)
            self._process = os.getpid()
        return self._drive

    def __getstate__(self) -> dict[str, Any]:
        self._check_shared()
        return {**self.__dict__, "_drive": None, "_process": -1}


class KissIcpDataset(_Lazy):
    """A stream as KISS-ICP's pipeline takes it: ``OdometryPipeline(KissIcpDataset("drive.lpc"))``.

    A frame is a pair: points (n, 3), float64, in metres; and when each was measured, (n,), float64, from 0 to 1, or empty
    if no field tells (``time_field``: its name, if it is none of the usual ones). Points that are not finite are left out.
    """

    def __init__(self, source: Any, *, time_field: str | None = None) -> None:
        super().__init__(source, threads=1, range_images=False)
        self.time_field = time_field
        self.data_dir = os.fspath(source) if isinstance(source, (str, os.PathLike)) else ""
        self.sequence_id = os.path.splitext(os.path.basename(self.data_dir))[0]

    def __len__(self) -> int:
        return len(self.drive)

    def __getitem__(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        frame = self.drive[number]
        points = frame.xyz.astype(np.float64)
        names = (self.time_field,) if self.time_field is not None else TIME_FIELDS
        name = next((name for name in names if name in frame), None)
        if self.time_field is not None and name is None:
            raise KeyError(f"no field {self.time_field!r}; there are {', '.join(frame.fields)}")
        finite = np.isfinite(points).all(axis=1)
        points = np.ascontiguousarray(points[finite])
        if name is None or not len(points):
            return points, np.empty(0)
        times = frame[name].astype(np.float64)[finite]
        first, last = times.min(), times.max()
        return points, (times - first) / (last - first) if last > first else np.zeros(len(times))

    def get_frames_timestamps(self) -> np.ndarray:
        """Seconds since 1970 of each frame, (n,), float64; the frames' numbers if their times are not known."""
        times = self.drive.times
        if np.isnat(times).any():
            return np.arange(len(times), dtype=np.float64)
        return times.astype(np.int64) * 1e-9


def _points(frame: lidarpc.Frame) -> dict[str, np.ndarray]:
    """What a frame gives unless said otherwise: positions, and all fields beside them."""
    fields = {name: frame[name] for name in frame.fields if name not in ("x", "y", "z")}
    return {"xyz": frame.xyz, **fields}


class TorchDataset(_Lazy):
    """A stream as a map-style data set of PyTorch; works in the workers of a DataLoader, forked or spawned.

    ``transform``: a frame to what the data set gives; as it stands, a dictionary of arrays: ``xyz`` (n, 3), and each other
    field by its name, (n,). Scans differ in their number of points, so a DataLoader needs ``batch_size=None`` or a
    ``collate_fn``. Reading is quickest in order of the frames, or group by group: :class:`GroupBatchSampler`, or
    :class:`GroupSampler` without workers. With workers, ``source`` is a path, a URL or bytes.
    """

    def __init__(
        self, source: Any, *, transform: Callable[[lidarpc.Frame], Any] | None = None, threads: int = 1
    ) -> None:
        super().__init__(source, threads=threads, range_images=transform is not None)
        self.transform = transform

    def __len__(self) -> int:
        return len(self.drive)

    def __getitem__(self, number: int) -> Any:
        # torch's samplers may give tensors.
        frame = self.drive[int(number)]
        return (self.transform or _points)(frame)


class GroupSampler:
    """The numbers of all frames in random order, but those of a group together: each group is decoded once, if one process
    loads them all.

    For the ``sampler`` of a DataLoader with ``num_workers`` of 0 or 1. More workers take turns, and would decode each group
    several times: use :class:`GroupBatchSampler`. The order is another one in each epoch, and depends on ``seed`` alone.
    """

    def __init__(self, dataset: TorchDataset, *, seed: int = 0) -> None:
        self._batches = GroupBatchSampler(dataset, seed=seed)

    def __len__(self) -> int:
        return sum(map(len, self._batches.groups))

    def __iter__(self) -> Iterator[int]:
        for batch in self._batches:
            yield from batch


class GroupBatchSampler:
    """The numbers of the frames of each group as a batch, groups and frames in random order: each group is decoded once,
    by one of the workers.

    For a DataLoader's ``batch_sampler``, with a ``collate_fn`` such as ``list``. The order is another one in each epoch, and
    depends on ``seed`` alone.
    """

    def __init__(self, dataset: TorchDataset, *, seed: int = 0) -> None:
        self.groups = dataset.drive.groups
        self.random = np.random.default_rng(seed)

    def __len__(self) -> int:
        return len(self.groups)

    def __iter__(self) -> Iterator[list[int]]:
        for group in self.random.permutation(len(self.groups)):
            yield [int(number) for number in self.random.permutation(self.groups[group])]

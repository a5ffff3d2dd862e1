"""Where streams are read from and written to."""

from __future__ import annotations

import contextlib
import io
import itertools
import operator
import os
import threading
from typing import Any, TypeGuard

#: What a stream is read from and written to, for errors.
SOURCES = "a path, a URL, bytes, or a binary file object"
TARGETS = "a path, a URL, or a binary file object"


def is_url(path: Any) -> TypeGuard[str]:
    """Whether this names a place that fsspec knows, such as s3://bucket/drive.lpc, rather than a local file."""
    return isinstance(path, str) and "://" in path


def filesystem_of(url: str) -> tuple[Any, str]:
    """The file system of a URL, None for files of this machine; and the path on it."""
    try:
        from fsspec.core import url_to_fs
    except ImportError as error:
        raise ImportError(f"{url}: fsspec is needed for URLs: pip install fsspec") from error
    filesystem, path = url_to_fs(url)
    return (None if "file" in _protocols(filesystem) else filesystem), path


def _protocols(filesystem: Any) -> tuple[str, ...]:
    protocol = filesystem.protocol
    return (protocol,) if isinstance(protocol, str) else tuple(protocol)


def name_of(source: Any) -> str:
    """What errors call it."""
    if isinstance(source, (str, os.PathLike)):
        return os.fsdecode(source)
    name = getattr(source, "name", None) or getattr(source, "path", None)
    return name if isinstance(name, str) else ""


def bytes_of(data: Any) -> bytes:
    """The bytes of a buffer. TypeError for anything else: ``bytes(5)`` would be five zeros."""
    return data if isinstance(data, bytes) else memoryview(data).tobytes()


def is_buffer(source: Any) -> bool:
    """Whether this holds the bytes of a stream itself. A memory map is rather read like a file, piece by piece."""
    if hasattr(source, "read"):
        return False
    try:
        view = memoryview(source)
    except TypeError:
        return False
    return view.itemsize == 1 and view.contiguous


def check_file(file: Any, methods: tuple[str, ...], kinds: str) -> None:
    """TypeError if this is not a binary file object with these methods."""
    if isinstance(file, io.TextIOBase):
        raise TypeError(f"{name_of(file) or 'the file'} is open in text mode: open it in binary mode")
    if not all(callable(getattr(file, method, None)) for method in methods):
        raise TypeError(f"{type(file).__name__} is not {kinds}")


class Ranges:
    """A file object as ``size`` and ``read_at``, for several threads.

    Files of fsspec are asked for just the bytes that are wanted: their own buffers would read several MiB ahead of each
    piece. Files on disk are read without their position, which other processes may share.
    """

    def __init__(self, file: Any) -> None:
        check_file(file, ("read", "seek", "tell"), SOURCES)
        self._file = file
        self._lock = threading.Lock()
        self._process = os.getpid()
        self._fetch = getattr(file, "_fetch_range", None)
        raw = file.raw if type(file) is io.BufferedReader else file
        self._on_disk = raw if type(raw) is io.FileIO and hasattr(os, "pread") else None
        size = getattr(file, "size", None)
        if self._fetch is None or not isinstance(size, int):
            self._fetch = None
            size = file.seek(0, os.SEEK_END)
            # Some files' seek returns nothing.
            size = file.tell() if size is None else size
        self.size = size

    def read_at(self, start: int, length: int) -> bytes:
        """So many bytes from there on, or fewer where the file ends."""
        end = min(start + length, self.size)
        pieces = []
        if self._process != os.getpid():
            # A thread that this forked process lacks may have held the lock.
            self._lock, self._process = threading.Lock(), os.getpid()
        with self._lock if self._on_disk is None else contextlib.nullcontext():
            while start < end:
                piece = self._read(start, end)
                if not piece:
                    break
                pieces.append(piece)
                start += len(piece)
        return b"".join(pieces)

    def _read(self, start: int, end: int) -> bytes:
        if self._on_disk is not None:
            return os.pread(self._on_disk.fileno(), end - start, start)
        if self._fetch is not None:
            return bytes(self._fetch(start, end))
        self._file.seek(start)
        return self._file.read(end - start)


class Output:
    """Where a stream is written to: a file object, which stays open and keeps what was written."""

    def __init__(self, file: Any) -> None:
        check_file(file, ("write",), TARGETS)
        self._file = file

    def write(self, piece: bytes) -> None:
        """Writes all of it."""
        rest = memoryview(piece)
        while rest:
            count = self._file.write(rest)
            if count is None and not isinstance(self._file, io.RawIOBase):
                # Files that take everything may return nothing; a raw file, None if it would block.
                return
            try:
                taken = operator.index(count)
            except TypeError:
                taken = 0
            # Raw files may take a part.
            if not 0 < taken <= len(rest):
                raise OSError(f"write() took {count!r} of {len(rest)} bytes: use a file that blocks, such as open(path, 'wb')")
            rest = rest[taken:]

    def commit(self) -> None:
        """The stream is complete."""

    def discard(self) -> None:
        """The stream will not be completed."""

    def keep(self) -> str | None:
        """As ``discard``, but keeps what a local file holds; returns its name."""
        self.discard()
        return None


class LocalFile(Output):
    """A file that gets its name when it is complete. Until then, ``.partial`` follows the name; if there is such a file,
    ``.2.partial`` and so on: it may be another encoder's, or that of a resumable run."""

    def __init__(self, path: str) -> None:
        self._path = path
        for number in itertools.count(1):
            self._partial = f"{path}.partial" if number == 1 else f"{path}.{number}.partial"
            try:
                # Without a buffer, of which a forked process would write a copy.
                super().__init__(io.open(self._partial, "xb", buffering=0))
                return
            except FileExistsError:
                continue

    def commit(self) -> None:
        os.fsync(self._file.fileno())
        self._file.close()
        os.replace(self._partial, self._path)

    def discard(self) -> None:
        self._file.close()
        os.unlink(self._partial)

    def keep(self) -> str | None:
        if os.path.getsize(self._partial) == 0:
            self.discard()
            return None
        self._file.close()
        return self._partial


class StoredFile(Output):
    """A file of fsspec that appears when it is complete."""

    def __init__(self, filesystem: Any, path: str) -> None:
        self._filesystem, self._path = filesystem, path
        # Files in memory have their name, and are empty, as soon as they are opened.
        self._opened = f"{path}.partial" if "memory" in _protocols(filesystem) else path
        super().__init__(filesystem.open(self._opened, "wb", autocommit=False))
        with contextlib.suppress(AttributeError, ValueError):
            # This file is committed here, not by a later transaction.
            filesystem.transaction.files.remove(self._file)

    def commit(self) -> None:
        self._file.close()
        if getattr(self._file, "autocommit", True) is False:
            self._file.commit()
        if self._opened != self._path:
            self._filesystem.mv(self._opened, self._path)

    def discard(self) -> None:
        if self._opened != self._path:
            self._filesystem.rm_file(self._opened)
            return
        if hasattr(self._file, "discard"):
            self._file.discard()
        # Closing it would store it.
        self._file.closed = True


def open_output(target: Any) -> Output:
    """Opens what a stream is to be written to."""
    if is_url(target):
        filesystem, path = filesystem_of(target)
        return LocalFile(path) if filesystem is None else StoredFile(filesystem, path)
    if isinstance(target, (str, os.PathLike)):
        return LocalFile(os.fsdecode(target))
    return Output(target)

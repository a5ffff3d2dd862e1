"""Where streams are read from and written to."""

from __future__ import annotations

import os
from typing import Any, TypeGuard


def is_url(path: Any) -> TypeGuard[str]:
    """Whether this names a place that fsspec knows, such as s3://bucket/drive.lpc, rather than a local file."""
    return isinstance(path, str) and "://" in path


def open_url(url: str, mode: str) -> Any:
    """The file at a URL. It is open, and to be closed."""
    try:
        import fsspec
    except ImportError as error:
        raise ImportError(f"{url}: fsspec is needed for URLs: pip install fsspec") from error
    return fsspec.open(url, mode).open()


def name_of(source: Any) -> str:
    """What errors call it."""
    if isinstance(source, (str, os.PathLike)):
        return os.fsdecode(source)
    if isinstance(source, (bytes, bytearray, memoryview)):
        return ""
    name = getattr(source, "name", None) or getattr(source, "path", None)
    return name if isinstance(name, str) else ""


class Ranges:
    """A file object as ``size`` and ``read_at``.

    Files of fsspec are asked for just the bytes that are wanted: their own buffers would read several MiB ahead of each
    piece.
    """

    def __init__(self, file: Any) -> None:
        self._file = file
        self._fetch = getattr(file, "_fetch_range", None)
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
        if end <= start:
            return b""
        if self._fetch is not None:
            return bytes(self._fetch(start, end))
        self._file.seek(start)
        pieces = []
        while start < end:
            piece = self._file.read(end - start)
            if not piece:
                break
            pieces.append(piece)
            start += len(piece)
        return b"".join(pieces)

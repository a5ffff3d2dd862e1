"""Streams on object storage: few requests, and no bytes but those that are needed."""

from __future__ import annotations

import pytest
from s3 import running

import lidarpc

#: What is read at the end of a stream: the index, and what else is there.
TAIL = 64 << 10


@pytest.fixture(scope="module")
def server(long_file):
    with running() as server:
        filesystem = server.filesystem()
        filesystem.mkdir("drives")
        filesystem.put_file(str(long_file), "drives/long.lpc")
        server.size = long_file.stat().st_size
        yield server


@pytest.mark.parametrize("frames", [range(125, 135), range(120, 130), range(996, 1000)])
def test_ten_frames_take_three_requests(server, frames):
    filesystem = server.filesystem()
    server.requests.clear()
    with lidarpc.open(filesystem.open("drives/long.lpc")) as drive:
        assert [frame.number for frame in drive[frames.start : frames.stop]] == list(frames)
    methods = [method for method, _ in server.requests]
    assert methods in (["HEAD", "GET", "GET"], ["HEAD", "GET"]), "the size, the index, the groups"
    read = sum(length for method, length in server.requests if method == "GET")
    groups = {number // 10 for number in frames}
    # A thousand frames in groups of one size but for a few points.
    assert read <= TAIL + len(groups) * 1.03 * server.size / 100
    print(f"{server.requests} of {server.size} bytes")


def test_frames_one_by_one_take_a_request_a_group(server):
    filesystem = server.filesystem()
    with lidarpc.open(filesystem.open("drives/long.lpc")) as drive:
        server.requests.clear()
        for number in (125, 128, 120, 129, 133, 130):
            assert drive[number].number == number
        assert [method for method, _ in server.requests] == ["GET", "GET"]
        server.requests.clear()
        assert len(drive.times) == 1000 and len(drive.groups) == 100
        assert server.requests == [], "the index has them"


def test_a_url_is_opened_and_written(server, scans, monkeypatch):
    fsspec = pytest.importorskip("fsspec")
    monkeypatch.setitem(fsspec.config.conf, "s3", server.options)
    with lidarpc.Encoder("s3://drives/written.lpc", level=1) as out:
        for name, data in scans:
            out.push_file(name, data)
    with lidarpc.open("s3://drives/written.lpc") as drive:
        assert [frame.data for frame in drive] == [data for _, data in scans]
    with pytest.raises(RuntimeError), lidarpc.Encoder("s3://drives/half.lpc", level=1) as out:
        out.push_file(*scans[0])
        raise RuntimeError
    assert not server.filesystem().exists("drives/half.lpc")
    with pytest.raises(FileNotFoundError):
        lidarpc.open("s3://drives/missing.lpc")

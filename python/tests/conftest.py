"""What the tests share: scans of testdata, and streams of them."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import lidarpc

TESTDATA = Path(__file__).resolve().parents[2] / "testdata"


@pytest.fixture(scope="session")
def scans() -> list[tuple[str, bytes]]:
    """The files of the simulated drive: names and bytes."""
    return [(path.name, path.read_bytes()) for path in sorted((TESTDATA / "drive").glob("*.bin"))]


@pytest.fixture(scope="session")
def drive_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The drive, encoded by the program."""
    path = tmp_path_factory.mktemp("drive") / "drive.lpc"
    lidarpc.encode(TESTDATA / "drive", path, level=1)
    return path


def noise(random: np.random.Generator, points: int) -> np.ndarray:
    """Points that no model shortens by much."""
    return random.normal(size=(points, 3)).astype(np.float32)


@pytest.fixture(scope="session")
def long_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A thousand frames of noise, ten a group; frame n was taken at n ns and has n % 7 more points than 300."""
    path = tmp_path_factory.mktemp("long") / "long.lpc"
    random = np.random.default_rng(1)
    with lidarpc.Encoder(path, level=1) as out:
        for number in range(1000):
            out.push(noise(random, 300 + number % 7), time=number, name=f"{number:04}")
    return path


def in_fork(action: Callable[[], object]) -> object:
    """What this returns in a forked process, or the text of its error."""
    if "fork" not in multiprocessing.get_all_start_methods():
        pytest.skip("no fork on this system")
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)

    def run() -> None:
        try:
            sender.send(action())
        except Exception as error:
            sender.send(f"{type(error).__name__}: {error}")

    child = context.Process(target=run)
    child.start()
    try:
        assert receiver.poll(30), "the forked process hangs"
        return receiver.recv()
    finally:
        child.kill()
        child.join()

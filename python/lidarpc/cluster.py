"""Encodes many drives, each by a task of its own: ``python -m lidarpc.cluster encode s3://in s3://out --engine dask``.

Each folder with scans below the input is a drive, and becomes a file of that name below the output. Input and output are
paths, or URLs that fsspec knows. What is complete has its name; a task that is done again, because its worker was lost,
comes to the same bytes, or finds them. A drive that fails is reported, and the others are encoded all the same.

Only scans are read, not the files beside them: times are those in the scans' names, not those of a ``timestamps.txt``.
"""

from __future__ import annotations

import argparse
import os
import posixpath
import re
import sys
import tempfile
import uuid
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass

import lidarpc

__all__ = ["Drive", "Task", "encode", "find_drives", "main"]

#: How often a task is begun again that failed or lost its worker.
RETRIES = 2

#: What files of scans are called. What else a folder holds is left out, as by ``lidarpc encode``; so are text and arrays of NumPy, which
#: it would read to tell whether they are scans. Tables of Arrow are scans in ``ARGOVERSE`` only.
SCANS = (".bin", ".pcd", ".ply", ".las", ".xyz")

#: The folder within a drive of Argoverse 2 that holds its scans.
ARGOVERSE = "/sensors/lidar"

#: Folders within a drive that hold its scans, and are not part of its name.
INSIDE = ("/velodyne_points/data", "/velodyne", ARGOVERSE, "/data")


def _natural(path: str) -> list[tuple[int, int, str]]:
    """What sorts names as ``lidarpc encode`` does: ``2.bin`` before ``10.bin``."""
    parts = re.split("([0-9]+)", path)
    return [(0, int(part), part) if part.isdecimal() else (1, 0, part) for part in parts if part]


def _filesystem(url: str):
    """The file system of a URL or path, and the path on it."""
    try:
        from fsspec.core import url_to_fs
    except ImportError as error:
        raise ImportError("fsspec is needed for clusters: pip install lidarpc[cluster]") from error
    filesystem, path = url_to_fs(url)
    # Other tasks, other processes: what was listed may have changed.
    filesystem.invalidate_cache()
    return filesystem, path.rstrip("/")


def _is_local(filesystem) -> bool:
    protocol = filesystem.protocol
    return "file" in ([protocol] if isinstance(protocol, str) else protocol)


@dataclass(frozen=True)
class Drive:
    """A folder of scans."""

    #: Where it is below the input, without the folders in which every drive of KITTI keeps its scans.
    name: str
    #: Paths of the scans on the input's file system, in natural order of their names.
    scans: tuple[str, ...]


def find_drives(source: str) -> list[Drive]:
    """The folders below this one, and itself, that hold scans."""
    filesystem, root = _filesystem(source)
    drives = []
    for folder, _, files in filesystem.walk(root):
        folder = folder.rstrip("/")
        known = (*SCANS, ".feather") if folder.endswith(ARGOVERSE) else SCANS
        names = [name for name in files if name.lower().endswith(known) and not name.startswith(".")]
        scans = [f"{folder}/{name}" for name in sorted(names, key=_natural)]
        if scans:
            name = folder[len(root) :].strip("/")
            inside = next((inside for inside in INSIDE if f"/{name}".endswith(inside)), "")
            name = f"/{name}"[: len(name) + 1 - len(inside)].strip("/")
            drives.append(Drive(name or posixpath.basename(root), tuple(scans)))
    names = [drive.name for drive in drives]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"{source}: several folders of scans for {', '.join(twice)}")
    return sorted(drives, key=lambda drive: drive.name)


@dataclass(frozen=True)
class Task:
    """Files in, one file out: scans that are encoded, or streams that are joined. It may be run again, anywhere."""

    #: What reports call it.
    name: str
    #: ``encode`` or ``cat``.
    command: str
    #: Options of the command.
    options: tuple[str, ...]
    #: Where the inputs are: a URL that tells the file system, and paths on it.
    source: str
    inputs: tuple[str, ...]
    #: The file to write.
    target: str
    #: Marks what this run has not completed.
    run_id: str
    #: Whether a target that is there is written anew.
    force: bool

    def run(self) -> None:
        """Does it, unless the target is there already."""
        outputs, target = _filesystem(self.target)
        if not self.force and outputs.exists(target):
            return
        with tempfile.TemporaryDirectory(prefix="lidarpc-") as scratch:
            inputs = self._local_inputs(os.path.join(scratch, "in"))
            made = os.path.join(scratch, "made.lpc")
            lidarpc._run(["--quiet", self.command, *self.options, f"--output={made}", "--", *inputs], self.name)
            self._publish(made, outputs, target)

    def _local_inputs(self, scratch: str) -> list[str]:
        """The inputs as files on this machine."""
        filesystem, _ = _filesystem(self.source)
        if _is_local(filesystem):
            return list(self.inputs)
        os.mkdir(scratch)
        copies = [os.path.join(scratch, posixpath.basename(path)) for path in self.inputs]
        filesystem.get(list(self.inputs), copies)
        return copies

    def _publish(self, made: str, filesystem, target: str) -> None:
        """Copies to a name that no other try has, then moves: whoever comes last, the file is whole, and the same."""
        folder, name = posixpath.split(target)
        partial = f"{folder}/.{name}.{self.run_id}.{uuid.uuid4().hex}.partial"
        if _is_local(filesystem):
            os.makedirs(folder, exist_ok=True)
        try:
            filesystem.put_file(made, partial)
            if _is_local(filesystem):
                os.replace(partial, target)
            else:
                filesystem.mv(partial, target)
        except BaseException:
            if filesystem.exists(partial):
                filesystem.rm_file(partial)
            raise


def _attempt(task: Task) -> str | None:
    """Runs a task; what went wrong in the end, or None."""
    for tries_left in range(RETRIES, -1, -1):
        try:
            task.run()
            return None
        except Exception as error:
            # What is wrong with the scans will be wrong again.
            if tries_left == 0 or isinstance(error, lidarpc.Error):
                return f"{error}" or repr(error)
    return None


#: Runs tasks somewhere, and tells of each how it ended, in any order.
Engine = Callable[[list[Task]], Iterator["tuple[Task, str | None]"]]


def _local(workers: int, _address: str | None) -> Engine:
    def run(tasks: list[Task]) -> Iterator[tuple[Task, str | None]]:
        # Threads are enough: the coding is done by processes.
        with ThreadPoolExecutor(workers or os.cpu_count()) as pool:
            futures = {pool.submit(_attempt, task): task for task in tasks}
            yield from ((futures[future], future.result()) for future in as_completed(futures))

    return run


def _dask(workers: int, address: str | None) -> Engine:
    from distributed import Client, LocalCluster, as_completed

    def run(tasks: list[Task]) -> Iterator[tuple[Task, str | None]]:
        count = workers or os.cpu_count() or 1
        cluster = None if address else LocalCluster(n_workers=count, threads_per_worker=1, dashboard_address=None)
        with Client(address or cluster) as client:
            try:
                # Workers that are lost are replaced, and their tasks begun again by the scheduler.
                futures = {client.submit(_attempt, task, pure=False): task for task in tasks}
                for future in as_completed(futures):
                    lost = future.exception()
                    yield futures[future], str(lost) if lost else future.result()
            finally:
                if cluster is not None:
                    cluster.close()

    return run


def _ray(workers: int, address: str | None) -> Engine:
    import ray

    def run(tasks: list[Task]) -> Iterator[tuple[Task, str | None]]:
        ray.init(address=address, num_cpus=None if address else workers or os.cpu_count(), include_dashboard=False)
        try:
            attempt = ray.remote(max_retries=RETRIES)(_attempt)
            waiting = {attempt.remote(task): task for task in tasks}
            while waiting:
                [done], _ = ray.wait(list(waiting), num_returns=1)
                task = waiting.pop(done)
                try:
                    yield task, ray.get(done)
                except ray.exceptions.RayError as error:
                    yield task, str(error)
        finally:
            ray.shutdown()

    return run


ENGINES = {"local": _local, "dask": _dask, "ray": _ray}


def encode(
    source: str,
    target: str,
    *,
    engine: str = "local",
    workers: int = 0,
    address: str | None = None,
    split: int | None = None,
    force: bool = False,
    options: Iterable[str] = (),
    report: Callable[[str], None] = lambda line: print(line, file=sys.stderr),
) -> list[str]:
    """Encodes each drive below ``source`` to a file below ``target``; returns the names of those that failed.

    ``engine``: ``local``, ``dask`` or ``ray``. ``workers``: tasks at a time, if no ``address`` of a running cluster is
    given; 0 stands for one a processor. ``split``: drives of more frames are encoded in parts of so many, and joined.
    ``force``: files that are there are written anew; otherwise they are left. ``options``: of ``lidarpc encode``.
    ``report`` gets a line for each drive.

    ValueError if there is no drive, or the folders of two would make the same file.
    """
    drives = find_drives(source)
    if not drives:
        raise ValueError(f"{source}: no folder with scans")
    run_id = uuid.uuid4().hex[:12]
    filesystem, root = _filesystem(target)
    run = ENGINES[engine](workers, address)
    # Tasks share the machine: one thread each, unless said otherwise.
    given = tuple(options)
    options = given if any(option.startswith("--threads") for option in given) else ("--threads=1", *given)

    def file_of(name: str) -> str:
        return f"{target.rstrip('/')}/{name}.lpc"

    def part_of(drive: Drive, number: int) -> str:
        folder, name = posixpath.split(drive.name)
        return posixpath.join(folder, f".{name}.{run_id}.part{number:06}")

    failed: dict[str, str] = {}
    done: set[str] = set()
    encoding: list[Task] = []
    parts: dict[str, list[str]] = {}
    for drive in drives:
        if not force and filesystem.exists(f"{root}/{drive.name}.lpc"):
            report(f"{drive.name}: is there already")
            done.add(drive.name)
            continue
        size = split if split and split < len(drive.scans) else len(drive.scans)
        pieces = [drive.scans[start : start + size] for start in range(0, len(drive.scans), size)]
        names = [drive.name] if len(pieces) == 1 else [part_of(drive, number) for number in range(len(pieces))]
        if len(pieces) > 1:
            parts[drive.name] = names
        for name, scans in zip(names, pieces):
            encoding.append(Task(drive.name, "encode", options, source, scans, file_of(name), run_id, force))

    def finish(tasks: list[Task]) -> None:
        for task, error in run(tasks) if tasks else ():
            if error is not None:
                failed.setdefault(task.name, error)
                report(f"{task.name}: failed: {error}")
            elif task.command == "cat" or task.name not in parts:
                done.add(task.name)
                report(f"{task.name}: done")

    try:
        finish(encoding)
        whole = {name: pieces for name, pieces in parts.items() if name not in failed}
        finish(
            [
                Task(
                    name,
                    "cat",
                    (),
                    target,
                    tuple(f"{root}/{piece}.lpc" for piece in pieces),
                    file_of(name),
                    run_id,
                    force,
                )
                for name, pieces in whole.items()
            ]
        )
    finally:
        _remove_leftovers(target, drives, run_id)
    return [drive.name for drive in drives if drive.name not in done]


def _remove_leftovers(target: str, drives: list[Drive], run_id: str) -> None:
    """Removes the parts of this run, and what tasks left whose workers were killed."""
    filesystem, root = _filesystem(target)
    for folder in {posixpath.dirname(f"{root}/{drive.name}") for drive in drives}:
        if filesystem.exists(folder):
            for path in filesystem.ls(folder, detail=False):
                if f".{run_id}." in posixpath.basename(path):
                    filesystem.rm_file(path)


def main(arguments: list[str] | None = None) -> int:
    """The command line. Returns the exit code: 0 all done, 1 something failed; wrong usage ends the process with 2."""
    parser = argparse.ArgumentParser(prog="python -m lidarpc.cluster", description=__doc__.split("\n\n")[0])
    command = parser.add_subparsers(dest="command", required=True).add_parser(
        "encode", help="encode each folder of scans below IN to a file below OUT"
    )
    command.add_argument("source", metavar="IN", help="folder or URL")
    command.add_argument("target", metavar="OUT", help="folder or URL")
    command.add_argument("--engine", choices=sorted(ENGINES), default="local")
    command.add_argument("--workers", type=int, default=0, help="tasks at a time; 0: one a processor")
    command.add_argument("--address", help="of a running cluster")
    command.add_argument("--split", type=int, metavar="N", help="encode drives of more frames in parts of N, then join")
    command.add_argument("--level", type=int, default=6, help="effort, 1 to 9")
    command.add_argument("--max-error", metavar="LENGTH", help="such as 1cm; default: none")
    command.add_argument("--verify", action="store_true", help="decode each file and compare")
    command.add_argument("--force", action="store_true", help="write files anew that are there")
    given = parser.parse_args(arguments)
    if given.split is not None and given.split < 1:
        parser.error("--split: at least 1")
    options = [f"--level={given.level}"]
    if given.max_error:
        options.append(f"--max-error={given.max_error}")
    if given.verify:
        options.append("--verify")
    try:
        failed = encode(
            given.source,
            given.target,
            engine=given.engine,
            workers=given.workers,
            address=given.address,
            split=given.split,
            force=given.force,
            options=options,
        )
    except (ValueError, OSError, ImportError) as error:
        print(f"lidarpc.cluster: {error}", file=sys.stderr)
        return 1
    if failed:
        print(f"lidarpc.cluster: {len(failed)} failed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    # By the name under which workers can import it.
    from lidarpc.cluster import main as run_main

    sys.exit(run_main())

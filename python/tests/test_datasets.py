"""Data sets, with the packages that they are for where those are installed."""

from __future__ import annotations

import io
import multiprocessing
import pickle

import numpy as np
import pytest
from conftest import TESTDATA, in_fork

import lidarpc
from lidarpc.datasets import GroupBatchSampler, GroupSampler, KissIcpDataset, TorchDataset


def test_kiss_icp_gets_points_and_times(tmp_path, scans):
    path = tmp_path / "timed.lpc"
    xyz = np.array([[1, 2, 3], [np.nan, 0, 0], [4, 5, 6], [7, 8, 9]], np.float32)
    with lidarpc.Encoder(path) as out:
        out.push(xyz, fields={"t": np.array([10, 11, 15, 20], np.uint32)}, time=2_000_000_000)
        out.push(xyz[:1])
    dataset = KissIcpDataset(path)
    points, times = dataset[0]
    assert len(dataset) == 2 and points.dtype == np.float64 and times.dtype == np.float64
    assert points.tolist() == [[1, 2, 3], [4, 5, 6], [7, 8, 9]] and times.tolist() == [0, 0.5, 1]
    points, times = dataset[1]
    assert points.tolist() == [[1, 2, 3]] and times.shape == (0,)
    with pytest.raises(IndexError):
        dataset[2]
    assert dataset.get_frames_timestamps().tolist() == [0, 1] and dataset.sequence_id == "timed"
    with pytest.raises(KeyError, match="no field 'when'"):
        KissIcpDataset(path, time_field="when")[0]


def test_kiss_icp_finds_the_poses_of_the_folder(drive_file):
    pipeline = pytest.importorskip("kiss_icp.pipeline")
    generic = pytest.importorskip("kiss_icp.datasets.generic")
    poses = []
    datasets = (generic.GenericDataset(TESTDATA / "drive"), KissIcpDataset(drive_file))
    for number in range(3):
        assert all(map(np.array_equal, datasets[0][number], datasets[1][number]))
    for dataset in datasets:
        run = pipeline.OdometryPipeline(dataset)
        run._run_pipeline()
        poses.append(run.poses)
    folder, stream = poses
    # Its threads add up in any order: two runs on the folder differ by as much.
    assert np.abs(folder - stream).max() < 1e-12 and np.abs(folder[0] - folder[-1]).max() > 1e-3


def numbers(dataset: TorchDataset) -> list[int]:
    return [len(dataset[number]["xyz"]) for number in range(10)]


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_it_works_in_other_processes(long_file, method):
    if method not in multiprocessing.get_all_start_methods():
        pytest.skip(f"no {method} on this system")
    dataset = TorchDataset(long_file)
    # Open here already: the others must not use what this process has.
    expected = numbers(dataset)
    with multiprocessing.get_context(method).Pool(2) as pool:
        assert pool.map(numbers, [dataset] * 4) == [expected] * 4
    assert pickle.loads(pickle.dumps(dataset))._drive is None


def points_of(frame: lidarpc.Frame) -> int:
    return len(frame)


def test_transforms_and_fields(drive_file):
    assert TorchDataset(drive_file, transform=points_of)[1] > 1000
    assert list(TorchDataset(drive_file)[0]) == ["xyz", "intensity"]


def test_the_sampler_takes_group_by_group(long_file):
    sampler = GroupSampler(TorchDataset(long_file), seed=1)
    first, second = list(sampler), list(sampler)
    assert sorted(first) == list(range(1000)) == sorted(second) and first != second and len(sampler) == 1000
    assert all(len({number // 10 for number in first[start : start + 10]}) == 1 for start in range(0, 1000, 10))


def test_batches_are_groups(long_file):
    sampler = GroupBatchSampler(TorchDataset(long_file), seed=1)
    first, second = list(sampler), list(sampler)
    assert len(sampler) == 100 and first != second
    assert sorted(map(sorted, first)) == [list(range(start, start + 10)) for start in range(0, 1000, 10)]
    # Batches go to the workers as they are, so that each group is decoded by one.
    assert list(GroupSampler(TorchDataset(long_file), seed=1)) == [number for batch in first for number in batch]


def test_file_objects_in_other_processes(long_file):
    with long_file.open("rb") as file:
        dataset = TorchDataset(file)
        expected = numbers(dataset)
        assert in_fork(lambda: numbers(dataset)) == expected == numbers(pickle.loads(pickle.dumps(dataset)))

    class Other(io.BytesIO):
        pass

    other = TorchDataset(Other(long_file.read_bytes()))
    assert numbers(other) == expected
    assert "processes cannot share a source of type Other" in in_fork(lambda: numbers(other))
    with pytest.raises(TypeError, match="give the data set a path"):
        pickle.dumps(other)


def tensors(frames: list[dict]) -> list[dict]:
    import torch

    return [{name: torch.from_numpy(values) for name, values in frame.items()} for frame in frames]


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_torch_loads_it_in_workers(long_file, method):
    torch = pytest.importorskip("torch")
    dataset = TorchDataset(long_file)
    assert len(dataset[3]["xyz"]) == 303
    options = dict(num_workers=2, multiprocessing_context=method)
    loader = torch.utils.data.DataLoader(
        dataset, batch_sampler=GroupBatchSampler(dataset), collate_fn=tensors, **options
    )
    batches = [frame for batch in loader for frame in batch]
    assert len(batches) == 1000 and all(batch["xyz"].dtype == torch.float32 for batch in batches)
    assert sum(batch["xyz"].shape[0] for batch in batches) == sum(300 + number % 7 for number in range(1000))

"""Data-parallel training over processes: filters in a module under DistributedDataParallel, by gloo on one machine."""

from __future__ import annotations

import functools
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
import torch.distributed as dist
import torch.distributed.nn  # before the process group exists, as examples/train_distributed.py says
from torch import Tensor, nn
from torch.distributed.device_mesh import init_device_mesh
from torch.distributed.tensor import Shard, distribute_tensor
from torch.distributed.tensor.experimental import implicit_replication
from torch.nn.parallel import DistributedDataParallel

import kvision as K
from kvision import _backend

# Of float32. The processes import nothing else of the tests, which would take longer than all they do.
assert_close = functools.partial(torch.testing.assert_close, rtol=2e-5, atol=2e-6)

pytestmark = pytest.mark.programs

PROCESSES = 2
STEPS = 3


class Model(nn.Module):
    """A learned blur and a learned kernel between convolutions."""

    def __init__(self) -> None:
        super().__init__()
        torch.manual_seed(0)
        self.first = nn.Conv2d(3, 4, 3, padding=1)
        self.blur = K.filters.GaussianBlur2d(5, nn.Parameter(torch.tensor([[1.0, 1.5]])))
        self.kernel = nn.Parameter(torch.full((1, 3, 3), 1 / 9))
        self.edges = nn.Sequential(K.filters.Sobel(), K.filters.MedianBlur(3), K.filters.BoxBlur(3))
        self.last = nn.Conv2d(4, 1, 1)

    def forward(self, x: Tensor) -> Tensor:
        return self.last(self.edges(K.filters.filter2d(self.blur(self.first(x)), self.kernel)))


def train(model: nn.Module, images: Tensor) -> list[float]:
    optimizer = torch.optim.SGD(model.parameters(), lr=0.1)
    losses = []
    for _ in range(STEPS):
        optimizer.zero_grad()
        loss = (model(images) - 1).square().mean()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    return losses


def images() -> Tensor:
    return torch.rand(4, 3, 12, 14, generator=torch.Generator().manual_seed(1))


def check_sharded_images() -> None:
    """DTensor: the references keep the axis of the shards, and give the results of the whole."""
    mesh = init_device_mesh("cpu", (PROCESSES,))
    functions = [K.filters.sobel, K.color.rgb_to_hsv, lambda x: K.geometry.resize(x, (6, 5))]
    if torch.__version__ >= "2.13":  # 2.11 has no strategy for flip
        functions.append(lambda x: K.filters.gaussian_blur2d(x, 3, (1.0, 1.0)))
    for function in functions:
        with implicit_replication():
            y = function(distribute_tensor(images(), mesh, [Shard(0)]))
        assert y.placements == (Shard(0),)
        assert_close(y.full_tensor(), function(images()))


def work(rank: int, folder: Path) -> None:
    """One of the processes, which trains on its part of the images."""
    torch.set_num_threads(1)
    store = dist.FileStore(str(folder / "store"), PROCESSES)
    dist.init_process_group("gloo", store=store, rank=rank, world_size=PROCESSES)
    model = DistributedDataParallel(Model())
    losses = train(model, images().chunk(PROCESSES)[rank])
    gradients = {name: p.grad for name, p in model.module.named_parameters()}
    torch.save({"losses": losses, "gradients": gradients, "state": model.module.state_dict()}, folder / f"{rank}.pt")
    check_sharded_images()
    del model  # before its process group, as train() of examples/train_distributed.py says
    dist.destroy_process_group()


def test_processes_learn_what_one_process_learns(tmp_path: Path) -> None:
    command = [sys.executable, __file__, str(tmp_path)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "KVISION_BACKEND": _backend.current_backend()}
    workers = [subprocess.Popen([*command, str(rank)], env=environment) for rank in range(PROCESSES)]
    try:
        model = Model()
        losses = train(model, images())
        assert [worker.wait(120) for worker in workers] == [0] * PROCESSES
    finally:
        for worker in workers:
            worker.kill()

    assert losses[-1] < losses[0]
    results = [torch.load(tmp_path / f"{rank}.pt") for rank in range(PROCESSES)]
    assert_close(torch.tensor([r["losses"] for r in results]).mean(0), torch.tensor(losses))
    for result in results:
        for name, parameter in model.named_parameters():
            assert parameter.grad.abs().max() > 0, name
            assert_close(result["gradients"][name], parameter.grad)
            assert_close(result["state"][name], parameter.detach())


if __name__ == "__main__":
    work(int(sys.argv[2]), Path(sys.argv[1]))

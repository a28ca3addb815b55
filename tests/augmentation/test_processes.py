"""Augmentation in several processes: ranks that train together by gloo, and the workers of a data loader."""

from __future__ import annotations

import copy
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
import torch.distributed as dist
import torch.distributed.nn  # before the process group exists, as examples/train_distributed.py says
import torch.nn.functional as F
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel
from torch.utils.data import DataLoader, Dataset

import kvision.augmentation as A
from kvision import _backend

pytestmark = pytest.mark.interface

PROCESSES, STEPS, SAVED = 2, 4, 2
LABELED = ["image", "mask", "keypoints"]


def pipeline() -> Any:
    return A.AugmentationSequential(
        A.RandomResizedCrop((12, 12)),
        A.RandomHorizontalFlip(),
        A.ColorJitter(0.2, 0.2, 0.2, 0.1, p=0.7),
        A.RandomGaussianNoise(0.0, 0.05),
        data_keys=["image"],
    )


def batch() -> Tensor:
    return torch.rand(8, 3, 16, 16, generator=torch.Generator().manual_seed(1))


def train(model: nn.Module, optimizer: Any, steps: range, folder: Path | None = None) -> dict[str, Any]:
    """Losses, and the augmented images of each step; the state is saved after step SAVED."""
    augment, images = pipeline(), batch().chunk(PROCESSES)[dist.get_rank()]
    result: dict[str, Any] = {"losses": [], "images": [], "crops": []}
    for step in steps:
        augmented = augment(images)
        optimizer.zero_grad()
        loss = (model(augmented) - 1).square().mean()
        loss.backward()
        optimizer.step()
        result["losses"].append(loss.item())
        result["images"].append(augmented)
        result["crops"].append(augment._params[0].data["src"])
        if folder is not None and step + 1 == SAVED:
            state = {"model": model.module.state_dict(), "optimizer": optimizer.state_dict()}
            torch.save({**state, "generator": torch.get_rng_state()}, folder / f"state{dist.get_rank()}.pt")
    return result


def network() -> tuple[nn.Module, Any]:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        model = nn.Sequential(nn.Conv2d(3, 4, 3), nn.ReLU(), nn.Conv2d(4, 1, 3))
    optimizer = torch.optim.SGD(model.parameters(), lr=0.1, momentum=0.9)
    return DistributedDataParallel(model), optimizer


def work(folder: Path, rank: int, again: bool) -> None:
    """A process: trains, or continues from its saved state."""
    torch.set_num_threads(1)
    store = dist.FileStore(str(folder / f"store{int(again)}"), PROCESSES)
    dist.init_process_group("gloo", store=store, rank=rank, world_size=PROCESSES)
    model, optimizer = network()
    if again:
        state = torch.load(folder / f"state{rank}.pt")
        model.module.load_state_dict(state["model"])
        optimizer.load_state_dict(state["optimizer"])
        torch.set_rng_state(state["generator"])
        result = train(model, optimizer, range(SAVED, STEPS))
    else:
        torch.manual_seed(17 + rank)
        result = train(model, optimizer, range(STEPS), folder)
    seeds = torch.arange(8).chunk(PROCESSES)[rank]
    result["seeded"] = pipeline()(batch().chunk(PROCESSES)[rank], seed=seeds)
    torch.save(result, folder / f"found{rank}{int(again)}.pt")
    del model  # before its process group, as train() of examples/train_distributed.py says
    dist.destroy_process_group()


def run(folder: Path, again: bool) -> list[dict[str, Any]]:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "KVISION_BACKEND": _backend.current_backend()}
    command = [sys.executable, __file__, str(folder)]
    workers = [subprocess.Popen([*command, str(rank), str(int(again))], env=environment) for rank in range(PROCESSES)]
    try:
        assert [worker.wait(120) for worker in workers] == [0] * PROCESSES
    finally:
        for worker in workers:
            worker.kill()
    return [torch.load(folder / f"found{rank}{int(again)}.pt") for rank in range(PROCESSES)]


@pytest.mark.slow
def test_ranks_draw_other_numbers_and_resume_exactly(tmp_path: Path) -> None:
    first, second = run(tmp_path, again=False)
    for a, b in zip(first["crops"], second["crops"]):
        assert (a != b).any(2).any(1).all()  # no sample has the crop of its counterpart
    for crops in (first["crops"], second["crops"]):
        assert all(not torch.equal(crops[i], crops[j]) for i in range(STEPS) for j in range(i))

    resumed = run(tmp_path, again=True)
    for before, after in zip((first, second), resumed):
        assert after["losses"] == before["losses"][SAVED:]
        assert all(torch.equal(a, b) for a, b in zip(after["images"], before["images"][SAVED:]))

    # Seeds of samples do not depend on how many processes there are.
    whole = pipeline()(batch(), seed=torch.arange(8))
    assert torch.equal(torch.cat([first["seeded"], second["seeded"]]), whole)


class Samples(Dataset[tuple[Tensor, ...]]):
    """Images with a mask and key points, augmented where they are loaded."""

    def __init__(self, seeded: bool) -> None:
        self.seeded = seeded
        self.augment = A.AugmentationSequential(
            A.RandomAffine(30.0, (0.1, 0.1), p=0.8), A.RandomCrop((12, 12)), A.RandomGrayscale(), data_keys=LABELED
        )

    def __len__(self) -> int:
        return 10

    def __getitem__(self, i: int) -> tuple[Tensor, ...]:
        seed = torch.tensor([100 + i]) if self.seeded else None
        return tuple(x[0] for x in self.augment(*sample(i), seed=seed))


def sample(i: int) -> tuple[Tensor, Tensor, Tensor]:
    generator = torch.Generator().manual_seed(i)
    image = torch.rand(1, 3, 16, 16, generator=generator)
    return image, (image[:, :1] > 0.5).long(), 16 * torch.rand(1, 4, 2, generator=generator)


@pytest.mark.slow
def test_workers_that_are_spawned() -> None:
    """A data set whose pipeline has run before travels to new interpreters, which draw what this one draws."""
    samples = Samples(True)
    expected = [samples[i] for i in range(len(samples))]
    loaded = DataLoader(samples, 5, num_workers=1, multiprocessing_context="spawn")
    for result, each in zip(zip(*loaded), zip(*expected)):
        assert torch.equal(torch.cat(result), torch.stack(each))


@pytest.mark.parametrize("workers", [0, 1, 2])
def test_seeds_of_samples_are_invariant_under_workers(workers: int) -> None:
    expected = Samples(True).augment(*(torch.cat(x) for x in zip(*map(sample, range(10)))), seed=torch.arange(100, 110))
    loaded = DataLoader(Samples(True), 3, num_workers=workers)
    for parts, whole in zip(zip(*loaded), expected):
        torch.testing.assert_close(torch.cat(parts), whole, rtol=0, atol=1e-6)


def test_workers_draw_different_numbers() -> None:
    """Without seeds torch gives each worker a stream, which follows from the generator of the loader."""

    def load() -> Tensor:
        loader = DataLoader(Samples(False), 1, num_workers=2, generator=torch.Generator().manual_seed(4))
        return torch.cat([points - sample(i)[2] for i, (_, _, points) in enumerate(loader)])

    motion = load()
    assert F.pdist(motion.flatten(1)).min() > 1e-3
    assert torch.equal(load(), motion)


class OwnGenerators(Dataset[Tensor]):
    """Angles of an augmentation, and of a child of a container, with one generator each or the same one."""

    def __init__(self) -> None:
        generator = torch.Generator().manual_seed(3)
        self.alone = A.RandomRotation(30.0, p=1.0, generator=torch.Generator().manual_seed(3))
        self.chain = A.ImageSequential(
            A.ImageSequential(A.RandomRotation(30.0, p=1.0), generator=generator),
            A.RandomHorizontalFlip(),
            A.RandomRotation(30.0, p=1.0, generator=generator),
        )

    def __len__(self) -> int:
        return 8

    def __getitem__(self, i: int) -> Tensor:
        self.alone(torch.zeros(1, 1, 4, 4))
        self.chain(torch.zeros(1, 1, 4, 4))
        _, _, last = self.chain._params
        (first,) = self.chain._params[0].data
        return torch.cat([self.alone._params["degrees"], first.data["degrees"], last.data["degrees"]])


def angles_of_workers(method: str, epochs: int) -> Tensor:
    options: dict[str, Any] = {"generator": torch.Generator().manual_seed(1), "multiprocessing_context": method}
    loader = DataLoader(OwnGenerators(), None, num_workers=2, **options)
    return torch.stack([angles for _ in range(epochs) for angles in loader])


def test_workers_draw_different_numbers_from_generators_of_augmentations() -> None:
    angles = angles_of_workers("fork", 2)
    assert [len(each.unique()) for each in angles.T] == [16, 16, 16]
    assert torch.equal(angles_of_workers("fork", 2), angles)


@pytest.mark.slow
def test_workers_that_are_spawned_draw_from_generators_as_forked_ones() -> None:
    assert torch.equal(angles_of_workers("spawn", 1), angles_of_workers("fork", 1))


def test_modules_keep_their_generators_in_containers() -> None:
    samples, again = OwnGenerators(), copy.deepcopy(OwnGenerators())
    drawn = torch.stack([samples[i] for i in range(4)])
    twice = torch.Generator().manual_seed(3)
    alone = A.RandomRotation(30.0, p=1.0, generator=twice)
    expected = []
    for _ in range(8):
        alone(torch.zeros(1, 1, 4, 4))
        expected.append(alone._params["degrees"])
    assert torch.equal(drawn[:, 0], torch.cat(expected[:4]))
    assert torch.equal(drawn[:, 1:].flatten(), torch.cat(expected))  # of two modules with one generator
    torch.manual_seed(9)
    assert torch.equal(torch.stack([again[i] for i in range(4)]), drawn)
    # A generator of the call replaces them.
    call = torch.Generator().manual_seed(5)
    samples.chain(torch.zeros(1, 1, 4, 4), generator=call)
    assert torch.equal(twice.get_state(), samples.chain[2].generator.get_state())


if __name__ == "__main__":
    work(Path(sys.argv[1]), int(sys.argv[2]), bool(int(sys.argv[3])))

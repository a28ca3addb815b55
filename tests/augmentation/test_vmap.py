"""Tests of torch.func.vmap over augmentations: element i is the call on element i, with the numbers that `randomness` says."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.func import grad, vmap

import kvision.augmentation as A
from benchmarks.sample_calls.augmentations import IMAGES, VOLUMES, Augmentation
from op_tests import assert_close

pytestmark = pytest.mark.interface

CASES = [*IMAGES, *(case for case in VOLUMES if case.changes_size or case.one_kernel)]
CONTAINERS: dict[str, Callable[[], Any]] = {
    "chain": lambda: A.ImageSequential(
        A.RandomRotation(30.0), A.ColorJitter(0.2, 0.2, 0.2, 0.2), A.RandomGaussianNoise()
    ),
    "once": lambda: A.ImageSequential(
        A.RandomRotation(30.0), A.RandomElasticTransform((9, 9), (3.0, 3.0), (0.5, 0.5)), resample="once"
    ),
    "crop": lambda: A.AugmentationSequential(A.RandomResizedCrop((9, 11), p=1.0), A.RandomErasing()),
    "policy": lambda: A.auto.RandAugment(2, 9),
    "mix": lambda: A.RandomMixUpV2(p=0.7),
}


def in_a_loop(f: Callable[[Tensor], Tensor], x: Tensor, is_same: bool) -> Tensor:
    """`f` of each element: every call draws the same numbers, or the next ones."""
    results = []
    for element in x:
        if is_same:
            torch.manual_seed(3)
        results.append(f(element))
    return torch.stack(results)


def assert_vmap_is_the_loop(f: Callable[[Tensor], Tensor], x: Tensor, randomness: str) -> None:
    torch.manual_seed(3)
    y = vmap(f, randomness=randomness)(x)
    torch.manual_seed(3)
    assert_close(y, in_a_loop(f, x, randomness == "same"), 0.0, 2e-5)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_each_class(case: Augmentation, device: torch.device) -> None:
    size = (6, 7, 8) if case in VOLUMES else (16, 20)
    x = torch.rand(3, 2, 3, *size, generator=torch.Generator().manual_seed(1)).to(device)
    augment = case.make(p=0.7)
    by_seed = vmap(lambda element: augment(element, seed=5))(x)
    assert_close(by_seed, torch.stack([augment(element, seed=5) for element in x]), 0.0, 2e-5)
    assert_vmap_is_the_loop(augment, x, "same")
    if (case.changes_size or case.one_kernel) and case.name != "PadTo":  # which the batch of an element chooses
        with pytest.raises(RuntimeError, match=f"{case.name}: a random choice that changes sizes .* torch.func.vmap"):
            vmap(augment, randomness="different")(x)
    else:
        assert_vmap_is_the_loop(augment, x, "different")


@pytest.mark.parametrize("name", CONTAINERS)
def test_containers_and_policies(name: str, device: torch.device) -> None:
    x, augment = torch.rand(3, 2, 3, 16, 20, device=device), CONTAINERS[name]()
    seeds = torch.tensor([3, 4], device=device)
    for seed in (5, seeds):
        y = vmap(lambda element, seed=seed: augment(element, seed=seed))(x)
        assert_close(y, torch.stack([augment(element, seed=seed) for element in x]), 0.0, 2e-5)
    y = vmap(lambda element, seed: augment(element, seed=seed))(x[:2], seeds)
    assert_close(y, torch.stack([augment(element, seed=seed) for element, seed in zip(x, seeds)]), 0.0, 2e-5)
    for randomness in ("same", "different"):
        assert_vmap_is_the_loop(augment, x, randomness)
    with pytest.raises(RuntimeError, match="random operation while in randomness error mode"):
        vmap(augment)(x)


def test_levels_labels_and_gradients(device: torch.device) -> None:
    x, augment = torch.rand(2, 3, 1, 3, 8, 9, device=device), A.RandomAffine(30.0, p=0.7)
    torch.manual_seed(3)
    y = vmap(vmap(augment, randomness="different"), randomness="different")(x)
    torch.manual_seed(3)
    assert_close(y, in_a_loop(augment, x.flatten(0, 1), False).view_as(x), 0.0, 1e-5)

    for one in (augment, A.RandomSaltAndPepperNoise(0.5, p=1.0)):
        assert_vmap_is_the_loop(grad(lambda element, one=one: one(element).square().sum()), x[0], "different")

    both = A.AugmentationSequential(augment, A.RandomHorizontalFlip(), data_keys=["input", "keypoints"])
    points = 8 * torch.rand(3, 1, 4, 2, device=device)
    torch.manual_seed(3)
    moved = vmap(lambda *labeled: both(*labeled)[1], randomness="different")(x[0], points)
    torch.manual_seed(3)
    assert_close(moved, torch.stack([both(*labeled)[1] for labeled in zip(x[0], points)]), 0.0, 1e-4)


@pytest.mark.tracing
@pytest.mark.parametrize("transform", ["vmap", "grad"])
def test_compiled_transforms_call_eagerly_or_say_why(transform: str) -> None:
    """What a module keeps of its call would leave the transform with the graph."""
    augment, x = A.RandomAffine(10.0, p=1.0), torch.rand(3, 2, 1, 8, 8)

    def f(x: Tensor) -> Tensor:
        if transform == "vmap":
            return vmap(lambda y: augment(y, seed=1))(x)
        return torch.func.grad(lambda y: augment(y, seed=1).square().sum())(x[0])

    torch._dynamo.reset()
    assert_close(torch.compile(f, backend="aot_eager")(x), f(x), 0, 0)
    torch._dynamo.reset()
    with pytest.raises(
        torch._dynamo.exc.Unsupported, match="an augmentation inside of torch.func's transforms has no graph"
    ):
        torch.compile(f, backend="aot_eager", fullgraph=True)(x)

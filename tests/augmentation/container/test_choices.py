"""Tests of the containers that choose the children of each sample."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor, nn

import kvision.augmentation as A
from kvision.augmentation.engine import turns
from kvision.augmentation.engine.turns import plan_turns
from kvision.augmentation.sample_rows import SampleRows

CHOICES: dict[str, Callable[..., Any]] = {
    "OneOf": A.OneOf,
    "SomeOf": lambda *children, **options: A.SomeOf(*children, n=(1, 3), **options),
    "SomeOf, drawn again": lambda *children, **options: A.SomeOf(*children, n=2, replace=True, order=False, **options),
    "RandomOrder": A.RandomOrder,
    "RandomApply": A.RandomApply,
}


def children() -> list[nn.Module]:
    return [
        A.RandomAffine(30.0, p=0.7),
        A.RandomInvert(p=0.7),
        A.ImageSequential(A.RandomElasticTransform((5, 5), (2.0, 2.0)), A.RandomJPEG(p=1.0)),
        A.OneOf(A.RandomVerticalFlip(), A.RandomGaussianBlur((3, 3), (0.5, 1.0))),
        A.RandomMotionBlur((3, 7), 35.0, 0.5, p=0.7),
    ]


def images(device: torch.device, batch: int = 8, dtype: torch.dtype = torch.float32) -> Tensor:
    x = torch.rand(batch, 3, 16, 20, generator=torch.Generator().manual_seed(batch)).to(device)
    return (255 * x).to(dtype) if dtype == torch.uint8 else x.to(dtype)


class Count(nn.Module):
    """Keeps images, and counts those that it gets in each call."""

    def __init__(self) -> None:
        super().__init__()
        self.calls: list[int] = []

    def forward(self, x: Tensor) -> Tensor:
        self.calls.append(len(x))
        return x


BOTH = [(name, torch.uint8 if name == "RandomOrder" else torch.float32) for name in CHOICES if name != "SomeOf"]


@pytest.mark.parametrize(("name", "dtype"), BOTH, ids=str)
def test_samples_depend_on_their_seeds_alone(name: str, dtype: torch.dtype, device: torch.device) -> None:
    """With labels, in any batch and order; replay gives the same, and the inverse brings all of it back."""
    x, seeds = images(device, dtype=dtype), torch.arange(8) + 70
    boxes = torch.tensor([[3.0, 4.0, 11.0, 12.0]], device=device).expand(8, 1, 4)
    inputs = [x, x[:, :1] > 0.5, boxes, 10 * torch.rand(8, 2, 2, device=device), torch.arange(8)]
    keys = ["image", "mask", "bbox_xyxy", "keypoints", "class"]
    augment = A.AugmentationSequential(A.RandomHorizontalFlip(), CHOICES[name](*children()), data_keys=keys)
    outputs = augment(*inputs, seed=seeds)
    matrix, params = augment.transform_matrix, augment._params
    assert all(torch.equal(a, b) for a, b in zip(augment(*inputs, params=params), outputs))
    assert torch.equal(augment.transform_matrix, matrix)
    back = augment.inverse(*outputs)
    assert [value.shape for value in back] == [value.shape for value in inputs]
    assert torch.equal(augment.inverse(outputs[0], params=params, data_keys=["image"]), back[0])
    for order in (torch.tensor([5, 2, 7, 0]), torch.tensor([6])):
        part = augment(*(value[order.to(value.device)] for value in inputs), seed=seeds[order])
        assert all(torch.equal(a, b[order.to(b.device)]) for a, b in zip(part, outputs))
    assert torch.equal(augment(*inputs, seed=3)[0], augment(*inputs, seed=3)[0])


@pytest.mark.parametrize("name", CHOICES)
def test_nothing_changes_at_p_0(name: str, device: torch.device) -> None:
    for dtype in (torch.float32, torch.uint8):
        x, augment = images(device, dtype=dtype), CHOICES[name](*children(), p=0.0)
        assert torch.equal(augment(x), x) and augment._params == [] and torch.equal(augment(x, params=[]), x)
        assert torch.equal(augment.transform_matrix, torch.eye(3, device=device).expand(8, 3, 3))


def test_each_sample_is_what_its_child_gives(device: torch.device) -> None:
    x, seeds = images(device, 40), torch.arange(40)
    augment = A.OneOf(A.RandomAffine(30.0), A.RandomInvert(), A.Normalize(0.5, 0.5), p=0.8)
    y, expected, counts = augment(x, seed=seeds), x.clone(), torch.zeros(40)
    for item in augment._params:
        child = dict(augment.named_children())[item.name]
        assert item.data["batch_prob"].all() and len(item.data["batch_prob"]) == item.samples.sum()
        expected[item.samples] = child(x[item.samples], params=item.data)
        counts += item.samples
    assert torch.equal(y, expected) and counts.max() == 1 and 25 < counts.sum() < 40
    stored = augment(images(device, 40, torch.uint8), seed=seeds)
    torch.testing.assert_close(stored, augment(images(device, 40, torch.uint8) / 255, seed=seeds))


def test_children_run_for_their_samples_alone() -> None:
    x, counts = torch.rand(64, 1, 2, 2), [Count(), Count(), Count()]
    A.OneOf(*counts)(x)
    assert all(len(count.calls) == 1 for count in counts) and sum(count.calls[0] for count in counts) == 64
    counts = [Count(), Count(), Count()]
    A.SomeOf(*counts, n=2)(x)
    assert all(len(count.calls) == 1 for count in counts) and sum(count.calls[0] for count in counts) == 128
    never = Count()
    A.OneOf(A.RandomInvert(p=1.0), A.RandomApply(never, p=0.0))(x)
    assert never.calls == []
    same = Count()
    A.OneOf(same, Count(), same_on_batch=True)(x, seed=1)
    assert same.calls in ([], [64])


def test_colors_are_one_run_and_so_are_warps(monkeypatch: pytest.MonkeyPatch, device: torch.device) -> None:
    """In which each sample is bit for bit what its child gives alone, and no other child changes anything."""
    colors = [
        A.RandomBrightness((0.5, 0.8)),
        A.RandomSaturation((0.5, 0.8)),
        A.ColorJitter(0.2, 0.2, 0.2, 0.1),
        A.RandomInvert(),
    ]
    warps = [A.RandomHorizontalFlip(), A.RandomAffine(30.0, p=0.2), A.RandomPerspective(0.5)]
    runs: list[list[str]] = []

    def counted(x: Tensor, children: Any, *rest: Any) -> Any:
        runs.append([child.name for child in children])
        return execute(x, children, *rest)

    execute = turns.execute
    monkeypatch.setattr(turns, "execute", counted)
    for dtype in (torch.float32, torch.uint8):
        x, seeds = images(device, 40, dtype), torch.arange(40)
        for children, expected_runs in (
            (colors, 1),
            (warps, 1),
            ([*colors, *warps, A.RandomGaussianBlur((3, 3), (1.0, 2.0))], 3),
        ):
            augment = A.OneOf(*children)
            runs.clear()
            y = augment(x, seed=seeds)
            assert len(runs) == expected_runs and max(map(len, runs)) >= 3
            params, matrix, expected = augment._params, augment.transform_matrix, torch.zeros_like(x)
            for item in params:
                child = dict(augment.named_children())[item.name]
                expected[item.samples] = child(x[item.samples], params=item.data)
            assert torch.equal(y, expected) and torch.equal(augment(x, params=params), y)
            torch.testing.assert_close(augment.transform_matrix, matrix)
            assert torch.equal(augment(x[[7, 3]], seed=seeds[[7, 3]]), y[[7, 3]])


def names_of_samples(augment: Any, x: Tensor) -> list[list[str]]:
    """The children of each sample, in their order."""
    augment(x, seed=torch.arange(len(x)))
    names: list[list[str]] = [[] for _ in range(len(x))]
    for item in augment._params:
        for sample in item.samples.nonzero()[:, 0].tolist():
            names[sample].append(item.name[-1])
    return names


BY_LABELS: dict[str, Callable[..., list[nn.Module]]] = {
    "crop in any order": lambda: [A.RandomOrder(A.RandomRotation(20.0), A.CropNonEmptyMaskIfExists(7, 8))],
    "crop in a container": lambda: [
        A.RandomOrder(A.RandomAffine(9.0), A.ImageSequential(A.CropNonEmptyMaskIfExists(7, 8)))
    ],
    "crop of boxes": lambda: [A.RandomOrder(A.RandomVerticalFlip(), A.RandomSizedBBoxSafeCrop(7, 8))],
    "objects of some": lambda: [A.OneOf(A.MaskDropout(), A.RandomInvert())],
    "objects that moved": lambda: [
        A.RandomOrder(A.RandomRotation(20.0), A.MaskDropout()),
        A.CropNonEmptyMaskIfExists(7, 8),
    ],
    "objects in a container": lambda: [A.OneOf(A.ImageSequential(A.MaskDropout(p=1.0)), A.RandomRotation(20.0, p=1.0))],
}


@pytest.mark.parametrize("name", BY_LABELS)
def test_children_read_the_labels_of_their_samples(name: str, device: torch.device) -> None:
    """Others may have another size by then."""
    x, seeds = images(device), torch.arange(8, device=device)
    masks = torch.zeros(8, 1, 16, 20, dtype=torch.uint8, device=device)
    for i in range(8):
        masks[i, :, 2 + i : 6 + i, i : i + 6] = 1
    boxes = torch.tensor([[[3.0, 4.0, 9.0, 9.0]]], device=device).repeat(8, 1, 1)
    augment = A.AugmentationSequential(*BY_LABELS[name](), data_keys=["image", "mask", "bbox_xyxy"])
    results = augment(x, masks, boxes, seed=seeds)
    for i in range(8):
        alone = augment(x[i : i + 1], masks[i : i + 1], boxes[i : i + 1], seed=seeds[i : i + 1])
        for of_batch, own in zip(results, alone):
            torch.testing.assert_close(of_batch[i : i + 1], own)


def test_objects_that_are_chosen_are_dropped_for_certain(device: torch.device) -> None:
    x, masks = images(device), torch.ones(8, 1, 16, 20, dtype=torch.uint8, device=device)
    choice = A.AugmentationSequential(A.OneOf(A.MaskDropout(p=0.1)), data_keys=["image", "mask"])
    dropped, theirs = choice(x, masks)
    assert not dropped.any() and not theirs.any()


def test_boxes_are_not_cut_off_at_the_size_that_other_samples_have(device: torch.device) -> None:
    """Some samples are resized first, others at the end."""
    x, boxes = images(device), torch.tensor([[[3.0, 4.0, 18.0, 14.0]]], device=device).repeat(8, 1, 1)
    order = A.RandomOrder(A.Resize((32, 40)), A.RandomInvert(p=1.0), A.RandomPosterize(p=1.0))
    moved = [
        A.AugmentationSequential(order, data_keys=["image", "bbox_xyxy"], clip_boxes=clips)(
            x, boxes, seed=torch.arange(8, device=device)
        )[1]
        for clips in ("each", False)
    ]
    torch.testing.assert_close(*moved)


OF_ONE_TYPE: dict[str, Callable[..., Any]] = {
    "OneOf": lambda *children: A.OneOf(*children),
    "SomeOf": lambda *children: A.SomeOf(*children, n=(0, 2)),
    "RandomApply": lambda child, _: A.RandomApply(child),
    "random_apply": lambda *children: A.ImageSequential(*children, random_apply=1),
    "cells": lambda *children: A.PatchSequential(*children, grid_size=(2, 2), random_apply=(0, 2)),
    "inside": lambda *children: A.ImageSequential(A.RandomHorizontalFlip(), A.OneOf(*children)),
}


@pytest.mark.parametrize("name", OF_ONE_TYPE)
def test_types_do_not_depend_on_what_is_drawn(name: str, device: torch.device) -> None:
    """Neither of one sample, as a worker of a loader augments, nor of a list, nor with seeds of samples."""
    x = images(device, 1, torch.uint8)
    halves = A.ImageSequential(A.RandomInvert(p=1.0), output_dtype=torch.float16)
    for child, dtype in ((A.Normalize(0.0, 1.0), torch.float32), (halves, torch.float32), (A.RandomInvert(), x.dtype)):
        augment = OF_ONE_TYPE[name](child, A.RandomVerticalFlip(p=1.0))
        for i in range(8):
            for seed in (None, i, torch.tensor([i], device=device)):
                for y in (augment(x, seed=seed), augment(list(x), seed=seed)[0]):
                    assert y.dtype == dtype and (dtype == torch.uint8 or y.max() <= 1)


def test_frequencies() -> None:
    """Weights of OneOf; all subsets, orders and numbers of the others alike."""
    x, n = torch.zeros(3000, 1, 1, 1), 3000

    def shares(augment: Any) -> dict[str, float]:
        names = [
            "".join(sorted(of_sample) if isinstance(augment, A.OneOf) else of_sample)
            for of_sample in names_of_samples(augment, x)
        ]
        return {name: names.count(name) / n for name in sorted(set(names))}

    three = [A.RandomInvert(p=0.2), A.RandomHorizontalFlip(p=0.6), A.ImageSequential(A.RandomInvert(p=1.0))]
    expected: list[tuple[Any, dict[str, float]]] = [
        (A.OneOf(*three, p=0.9), {"": 0.1, "0": 0.1, "1": 0.3, "2": 0.5}),
        (A.SomeOf(*three, n=2), {"01": 1 / 3, "02": 1 / 3, "12": 1 / 3}),
        (A.SomeOf(three, (0, 1)), {"": 0.5, "0": 1 / 6, "1": 1 / 6, "2": 1 / 6}),
        (A.SomeOf(three[:2], 2, True), {"00": 0.25, "01": 0.5, "11": 0.25}),
        (A.SomeOf(three[:2], n=2, replace=True, order=False), dict.fromkeys(("00", "01", "10", "11"), 0.25)),
        (A.RandomOrder(three), dict.fromkeys(("012", "021", "102", "120", "201", "210"), 1 / 6)),
        (A.RandomApply(three[:2], 0.3), {"": 0.7, "01": 0.3}),
    ]
    for augment, wanted in expected:
        drawn = shares(augment)
        assert drawn.keys() == wanted.keys() and all(abs(drawn[name] - wanted[name]) < 0.04 for name in wanted)


def test_some_children_have_their_own_p() -> None:
    x = torch.zeros(1000, 1, 1, 1)
    assert A.OneOf(A.RandomInvert(p=0.1))(x).mean() == 1  # for certain
    assert A.OneOf(A.RandomInvert(p=0.0))(x).mean() == 0
    for augment in (
        A.SomeOf(A.RandomInvert(p=0.3)),
        A.RandomOrder(A.RandomInvert(p=0.3)),
        A.RandomApply(A.RandomInvert(p=0.3), p=1.0),
    ):
        assert 0.2 < augment(x, seed=4).mean() < 0.4


def test_turns_take_each_child_once_where_the_order_allows() -> None:
    planned = [(turn.number, turn.samples) for turn in plan_turns([[0, 2], [1, 2], [], [1]])]
    assert planned == [(1, [1, 3]), (0, [0]), (2, [0, 1])]
    again = plan_turns([[0, 0, 1], [1, 0]])
    assert [(t.number, t.occurrence) for t in again if 0 in t.samples] == [(0, 0), (0, 1), (1, 0)]
    assert [t.number for t in again if 1 in t.samples] == [1, 0]


def test_sizes(device: torch.device) -> None:
    """Children may change the size if all samples have one size in the end; labels follow."""
    x, points = images(device), 8 * torch.rand(8, 2, 2, device=device)
    crops = A.OneOf(A.RandomCrop((9, 9)), A.CenterCrop((9, 9)), A.ImageSequential(A.Resize((9, 9)), A.RandomInvert()))
    augment = A.AugmentationSequential(crops, data_keys=["image", "mask", "keypoints"])
    outputs = augment(x, x, points, seed=2)
    assert outputs[0].shape == outputs[1].shape == (8, 3, 9, 9)
    back = augment.inverse(*outputs)
    assert back[0].shape == back[1].shape == x.shape
    torch.testing.assert_close(back[2], points, atol=1e-4, rtol=0)
    assert all(torch.equal(a, b) for a, b in zip(augment(x, x, points, params=augment._params), outputs))
    order = A.RandomOrder(A.RandomCrop((9, 9)), A.RandomHorizontalFlip(p=1.0))
    assert order(x).shape == (8, 3, 9, 9) and order.inverse(order(x)).shape == x.shape
    with pytest.raises(
        ValueError, match=r"OneOf: .* that give all samples one size, got \(\d+, \d+\) and \(\d+, \d+\)"
    ):
        A.OneOf(A.CenterCrop((9, 9)), A.RandomInvert())(x, seed=1)


def test_gradients_and_layouts(device: torch.device) -> None:
    augment, x = A.OneOf(A.RandomRotation(30.0), A.RandomBrightness((0.5, 0.8)), p=0.9), images(device)
    leaf = x.clone().requires_grad_()
    y = augment(leaf, seed=3)
    assert torch.equal(y, augment(x, seed=3))
    y.square().sum().backward()
    singles = x.clone().requires_grad_()
    torch.cat([augment(singles, params=augment._params)[i : i + 1] for i in range(8)]).square().sum().backward()
    torch.testing.assert_close(leaf.grad, singles.grad)
    last = augment(x.contiguous(memory_format=torch.channels_last), seed=3)
    assert last.is_contiguous(memory_format=torch.channels_last)
    torch.testing.assert_close(last, augment(x, seed=3), atol=1e-6, rtol=0)


def test_vmap(device: torch.device) -> None:
    augment, x = A.OneOf(A.RandomRotation(30.0), A.RandomInvert(), p=0.9), images(device).unflatten(0, (2, 4))
    expected = torch.stack([augment(element, seed=5) for element in x])
    torch.testing.assert_close(torch.func.vmap(lambda element: augment(element, seed=5))(x), expected)
    assert torch.func.vmap(augment, randomness="same")(x).shape == x.shape
    for seed in (None, torch.arange(2, device=device)):
        with pytest.raises(RuntimeError, match="OneOf: a random choice that changes sizes or modules cannot differ"):
            torch.func.vmap(
                lambda element, n: augment(element, seed=n), (0, None if seed is None else 0), randomness="different"
            )(x, seed)


def test_videos(device: torch.device) -> None:
    x = images(device, 3)[:, None].expand(-1, 4, -1, -1, -1)
    seeds = torch.arange(3) + 5
    for same, counts in ((True, {1}), (False, {1, 2})):
        video = A.VideoSequential(A.OneOf(A.RandomHorizontalFlip(), A.RandomInvert()), same_on_frame=same)
        y = video(x, seed=seeds)
        assert torch.equal(video(x[1:2], seed=seeds[1:2]), y[1:2])
        assert max(len(of_video.unique(dim=0)) for of_video in y) in counts


def test_wrong_arguments() -> None:
    invert = A.RandomInvert()
    for make, message in (
        (lambda: A.OneOf(), "OneOf: expected at least one child"),
        (lambda: A.OneOf(invert, p=1.5), "OneOf: expected p within 0 and 1, got 1.5"),
        (lambda: A.SomeOf(invert, n=2), "SomeOf: expected n .*at most 1, the number of children, got 2"),
        (lambda: A.SomeOf(invert, n=(1, 0)), "SomeOf: expected n to be a number or the lowest and the highest"),
        (lambda: A.OneOf(A.RandomMixUpV2()), "OneOf: expected children that keep samples apart, got RandomMixUpV2"),
        (lambda: A.OneOf(invert)(torch.rand(2, 3, 4, 4), seed=torch.arange(3)), "OneOf: expected seeds of 2 samples"),
    ):
        with pytest.raises(ValueError, match=message):
            make()
    for make, message in (
        (lambda: A.OneOf([invert], 0.5, 3), "OneOf: expected at most 1 arguments behind the list of children, got 2"),
        (lambda: A.RandomOrder(invert, 3), "RandomOrder: expected children to be modules, got int"),
    ):
        with pytest.raises(TypeError, match=message):
            make()
    filtered = A.OneOf(A.AugmentationSequential(A.RandomHorizontalFlip(), min_box_area=3.0), invert)
    with pytest.raises(ValueError, match="expected containers that filter no boxes inside of a choice"):
        A.AugmentationSequential(filtered, data_keys=["image", "bbox_xyxy"])(
            torch.rand(9, 3, 8, 8), torch.rand(9, 1, 4)
        )


@pytest.mark.native
@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last], ids=str)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.uint8], ids=str)
def test_rows_of_batches_are_copied_as_one(
    dtype: torch.dtype, layout: torch.memory_format, device: torch.device
) -> None:
    """More rows than a launch takes, of sizes that are no multiples of a vector, and in any order."""
    for side in (1, 5, 16):
        parts = [
            torch.randint(0, 100, (n, 3, side, 7), device=device).to(dtype).contiguous(memory_format=layout)
            for n in (200, 1, 150)
        ]
        rows = torch.randint(0, 351, (400,)).tolist()
        y = torch.ops.kvision.copy_rows(parts, rows)
        assert torch.equal(y, torch.cat(parts)[rows]) and y.is_contiguous(memory_format=layout)
        views = [part[:, 1:2] for part in parts]
        assert torch.equal(torch.ops.kvision.copy_rows(views, rows), torch.cat(views)[rows])
    with pytest.raises(RuntimeError, match="copy_rows: expected rows within 0 and 351, got 351"):
        torch.ops.kvision.copy_rows(parts, [351])
    with pytest.raises(RuntimeError, match="copy_rows: expected parts of one size"):
        torch.ops.kvision.copy_rows([parts[0], parts[1][..., :2]], [0])


@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last], ids=str)
@pytest.mark.parametrize("needs_gradient", [False, True])
@pytest.mark.parametrize("seed", range(6))
def test_samples_are_those_of_a_list(seed, needs_gradient, layout, device):
    rng, count = random.Random(seed), 9
    x = torch.rand(count, 3, 4, 5, device=device).contiguous(memory_format=layout).requires_grad_(needs_gradient)
    rows, samples = SampleRows(x), list(x)
    for _ in range(12):
        chosen = sorted(rng.sample(range(count), rng.choice((1, 3, 5, count))))
        groups = rows.by_size(chosen)
        assert sorted(sample for group in groups for sample in group) == chosen
        for group in groups:
            y = rows.take(group)
            assert torch.equal(y, torch.stack([samples[sample] for sample in group]))
            assert {rows.size_of(sample) for sample in group} == {y.shape[2:]}
            size = (6, 3) if rng.random() < 0.3 else y.shape[2:]
            z = (y + 1 if y.shape[2:] == size else y[..., :1, :1].expand(-1, -1, *size)).contiguous(
                memory_format=layout
            )
            rows.put(group, z)
            for sample, own in zip(group, z):
                samples[sample] = own
    if needs_gradient and len(groups := rows.by_size(range(count))) == 1:
        (grad,) = torch.autograd.grad(rows.take(groups[0]).sum(), x, allow_unused=True)
        assert grad is not None


def test_tensors_of_which_nothing_is_read_are_free():
    rows = SampleRows(torch.zeros(4, 1, 2, 2))
    for turn in range(5):
        for part in ([0, 1], [2, 3]):
            rows.put(part, rows.take(part) + 1)
        assert sum(len(tensor) for tensor in rows._tensors) == 4, turn
    assert torch.equal(rows.take(range(4)), torch.full((4, 1, 2, 2), 5.0))


def test_bytes_beside_floats_are_255ths():
    rows = SampleRows(torch.full((3, 1, 2, 2), 255, dtype=torch.uint8))
    rows.put([1], torch.full((1, 1, 2, 2), 0.5))
    assert rows.take(range(3))[:, 0, 0, 0].tolist() == [1.0, 0.5, 1.0]


def test_an_empty_batch_gets_the_size_of_samples(device) -> None:
    """With its parameters, its labels and its inverse."""
    crops = A.RandomCrop((8, 9)), A.CenterCrop((8, 9))
    for augment in (
        A.OneOf(*crops),
        A.SomeOf(*crops, n=1),
        A.RandomApply(crops[0], p=1.0),
        A.RandomOrder(A.RandomHorizontalFlip(), crops[1]),
        A.ImageSequential(*crops, random_apply=1),
        A.ImageSequential(A.OneOf(*crops), A.RandomInvert()),
        A.ImageSequential(A.OneOf(A.RandomAffine(9.0), A.RandomRotation(9.0), A.ColorJitter(0.2)), crops[0]),
    ):
        for seed in (None, 3, torch.empty(0, dtype=torch.int64, device=device)):
            x = torch.rand(0, 3, 16, 20, device=device)
            y = augment(x, seed=seed)
            assert y.shape == (0, 3, 8, 9) and augment.transform_matrix.shape == (0, 3, 3)
            assert augment(x, params=augment._params).shape == y.shape and augment.inverse(y).shape == x.shape
        labeled = A.AugmentationSequential(augment, data_keys=["input", "bbox_xyxy", "mask"])
        boxes, masks = torch.rand(0, 2, 4, device=device), torch.rand(0, 1, 16, 20, device=device)
        assert [tuple(z.shape) for z in labeled(x, boxes, masks)] == [(0, 3, 8, 9), (0, 2, 4), (0, 1, 8, 9)]

"""Random containers: what they promise together, whatever their children, data keys, layouts and types.

A container is drawn from a seed, which a failure names: `HYPOTHESIS_PROFILE=thorough` draws more of them. The end of a run prints
how many were checked.

Masks may end outside of their boxes by the nature of nearest reading: each one moves an edge by up to half a pixel, which later
children enlarge. In 900 chains of two to six of RandomResizedCrop, CenterCrop, Resize, flips, fisheye and thin-plate maps it was
up to 1.6 pixels with resample="each", and below half a pixel for the same draws with "once". Points of the inverse were at most
0.004 pixels from where they came from.
"""

from __future__ import annotations

import copy
import pickle
import threading
from collections import Counter
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils._pytree import tree_leaves
from torch.utils.data import DataLoader, Dataset

from kvision import _backend
from kvision.core.exceptions import ShapeError
from op_tests import THOROUGH
from random_containers import KINDS, Case, center_of, is_whole, make_case

pytestmark = [pytest.mark.interface]

SHORT = {"images": range(8), "videos": range(2), "volumes": range(3), "mixes": range(4)}
LONG = {kind: range(len(short), 3000 if THOROUGH else 10 * len(short)) for kind, short in SHORT.items()}


def same(a: Any, b: Any) -> bool:
    left, right = tree_leaves(a), tree_leaves(b)
    return len(left) == len(right) and all(
        x.shape == y.shape and x.dtype == y.dtype and torch.equal(x.nan_to_num(), y.nan_to_num())
        if isinstance(x, Tensor)
        else x == y
        for x, y in zip(left, right)
    )


def differing(case: Case, a: list[Any], b: list[Any]) -> str | None:
    """The names of outputs that differ; None if all are the same."""
    return None if same(a, b) else ", ".join(f"{key} differs" for key, x, y in zip(case.keys, a, b) if not same(x, y))


def check_labels(case: Case, seed: int) -> str | None:
    """Boxes, points and masks where the pixels of the blobs are, and points of the inverse where they came from."""
    if case.kind == "mixes":
        return check_masks_of_mixes(case, seed)
    given, called = case.of_images(case.inputs), case.call(case.augment, seed=seed)
    outputs = case.of_images(called)
    visible = case.augment.visible_points[0]
    visible = visible.flatten(0, 1) if case.kind == "videos" else visible
    image, mask, points = (outputs[case.keys.index(key)] for key in ("image", "mask", "keypoints"))
    # Each nearest reading of a mask moves its pixels by half a pixel at most.
    reads = 1 if case.augment.resample == "once" else max(1, len(case.geometric))
    tolerance = 0.75 + 0.5 * reads
    compared = 0
    for i in range(len(image)):
        if not is_whole(mask[i]):
            continue
        compared += 1
        if not visible[i, 0]:
            return f"sample {i}: the point of a whole blob is not visible"
        pixels = mask[i, 0].nonzero().flip(1).float()
        if float((pixels.mean(0) - points[i, 0]).abs().max()) > tolerance:
            return f"sample {i}: mask around {pixels.mean(0).tolist()}, point {points[i, 0].tolist()}"
        if case.kind != "volumes":
            near, far = edges_of_box(case, outputs, i)
            first, last = pixels.amin(0), pixels.amax(0)
            if bool((first < near - tolerance).any() or (last > far + tolerance).any()):
                return (
                    f"sample {i}: mask from {first.tolist()} to {last.tolist()}, box from {near.tolist()} to "
                    f"{far.tolist()}"
                )
        if not case.has_colors:
            center = center_of(image[i, 0])
            if float((center - points[i, 0]).abs().max()) > 1.0:
                return f"sample {i}: blob at {center.tolist()}, point {points[i, 0].tolist()}"
    at = case.keys.index("keypoints")
    back = case.augment.inverse(called[at], data_keys=["keypoints"]).reshape(given[at].shape)
    away = (back - given[at]).abs().amax(-1)
    if bool((away > 0.05)[visible].any()):
        return f"points of the inverse are {float(away[visible].max())} pixels away"
    return None if compared else "skip"


def edges_of_box(case: Case, outputs: list[Any], i: int) -> tuple[Tensor, Tensor]:
    """The first and the last pixel (x, y) of the box of a sample."""
    at = next(n for n, key in enumerate(case.keys) if key.startswith("bbox"))
    box = outputs[at][i][0].double()
    if case.keys[at] == "bbox":
        return box.amin(0), box.amax(0)
    if case.keys[at] == "bbox_xyxy_plus":
        return box[:2], box[2:]
    return box[:2], (box[2:] if case.keys[at] == "bbox_xyxy" else box[:2] + box[2:]) - 1


def check_masks_of_mixes(case: Case, seed: int) -> str | None:
    """Images that are what their masks are stay so, and classes are those of samples of the batch."""
    outputs = case.call(case.augment, seed=seed)
    if "mask" in case.keys and not case.has_colors:
        mask, image = outputs[case.keys.index("mask")].bool(), outputs[0][:, :1].bool()
        if not torch.equal(mask, image):
            return "masks differ from images"
    if "class" in case.keys:
        classes, batch = outputs[case.keys.index("class")], len(case.inputs[0])
        if not bool(((classes[..., :2] >= 0) & (classes[..., :2] < batch)).all()):
            return f"classes {classes.tolist()}"
    return None


def check_replay(case: Case, seed: int) -> str | None:
    outputs = case.call(case.augment, seed=seed)
    return differing(case, outputs, case.call(case.augment, params=case.augment._params))


def check_seeds_of_samples(case: Case, seed: int) -> str | None:
    """Results of samples follow their seeds, in whatever batch they are; what mixes samples depends on the batch by nature."""
    if case.kind == "mixes":
        return "skip"
    batch = len(case.inputs[0])
    seeds = torch.arange(batch) + 1000 * seed
    order = torch.randperm(batch, generator=torch.Generator().manual_seed(seed))
    try:
        outputs = case.call(case.augment, seed=seeds)
        permuted = case.call(case.augment, [taken(x, order) for x in case.inputs], seed=seeds[order])
    except ShapeError:
        if case.augment.random_apply is None:
            raise
        return "skip"  # children that change the size do not run for some samples alone
    if not same([taken(x, order) for x in outputs], permuted):
        return f"permuted: {differing(case, [taken(x, order) for x in outputs], permuted)}"
    one = torch.tensor([batch - 1])
    alone = case.call(case.augment, [taken(x, one) for x in case.inputs], seed=seeds[one])
    differs = differing(case, [taken(x, one) for x in outputs], alone)
    return differs and f"alone: {differs}"


def taken(x: Any, order: Tensor) -> Any:
    return [x[i] for i in order] if isinstance(x, list) else x[order.to(x.device)]


def check_copies(case: Case, seed: int) -> str | None:
    outputs = case.call(case.augment, seed=seed)
    for copied in (copy.deepcopy(case.augment), pickle.loads(pickle.dumps(case.augment))):
        if differs := differing(case, outputs, case.call(copied, seed=seed)):
            return differs
    return None


def check_threads(case: Case, seed: int) -> str | None:
    """Two threads on one container."""
    expected = [case.call(case.augment, seed=seed + i) for i in range(2)]
    results: list[Any] = [None, None]

    def work(i: int) -> None:
        results[i] = case.call(case.augment, seed=seed + i)

    threads = [threading.Thread(target=work, args=(i,)) for i in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return None if same(expected, results) else "results of threads differ"


def check_identity(case: Case, seed: int) -> str | None:
    """With p = 0 everything is returned bit for bit."""
    outputs = case.call(case.augment, seed=seed)
    # The classes of a mix have its partner and its fraction beside them.
    classes = case.keys.index("class") if case.kind == "mixes" and "class" in case.keys else None
    kept = [i for i in range(len(outputs)) if i != classes]
    return None if same([case.inputs[i] for i in kept], [outputs[i] for i in kept]) else "something has changed"


CHECKS: dict[str, Callable[[Case, int], str | None]] = {
    "labels": check_labels,
    "replay": check_replay,
    "seeds of samples": check_seeds_of_samples,
    "copies": check_copies,
    "threads": check_threads,
    "p = 0": check_identity,
}


class Outputs(Dataset[list[Any]]):
    """What containers give for a seed, each made by the process that calls it."""

    def __init__(self, cases: list[tuple[str, int]]) -> None:
        self.cases, self.backend = cases, _backend.current_backend()

    def __len__(self) -> int:
        return len(self.cases)

    def __getitem__(self, i: int) -> list[Any]:
        torch.set_num_threads(1)
        case = make_case(*self.cases[i], torch.device("cpu"))
        with _backend.backend(self.backend):
            return case.call(case.augment, seed=self.cases[i][1])


@pytest.mark.parametrize("seeds", [SHORT, pytest.param(LONG, marks=pytest.mark.slow)], ids=["short", "long"])
@pytest.mark.parametrize("kind", KINDS)
def test_random_containers(
    kind: str, seeds: dict[str, range], device: torch.device, record_property: Callable[[str, object], None]
) -> None:
    counts: Counter[str] = Counter()
    failures = []
    for seed in seeds[kind]:
        for name, check in CHECKS.items():
            case = make_case(kind, seed, device, 0.0 if name == "p = 0" else None)
            verdict = check(case, seed)
            counts[f"{name} skipped" if verdict == "skip" else name] += 1
            if verdict not in (None, "skip"):
                failures.append(f"seed {seed}, {name}: {verdict}\n{case.inputs[0].dtype} {case.augment}")
    record_property("counts", dict(counts))
    assert not failures, f"{len(failures)} of {dict(counts)}\n" + "\n".join(failures[:10])
    assert counts["labels"] > 0.6 * len(seeds[kind])


@pytest.mark.parametrize("method", ["fork", pytest.param("spawn", marks=pytest.mark.slow)])
def test_random_containers_in_workers(method: str, record_property: Callable[[str, object], None]) -> None:
    """Processes that load data give what this one does for a seed."""
    cases = [(kind, seed) for kind in KINDS for seed in range(3 if method == "fork" else 8)]
    outputs = Outputs(cases)
    loader = DataLoader(outputs, None, num_workers=2, multiprocessing_context=method)
    for i, loaded in enumerate(loader):
        assert same(outputs[i], loaded), cases[i]
    record_property("counts", {method: len(cases)})


@pytest.mark.slow
@pytest.mark.parametrize("size", [(256, 320), (1024, 1280), *([(2048, 2048)] if THOROUGH else [])], ids=str)
def test_random_containers_of_large_images(
    size: tuple[int, int], device: torch.device, record_property: Callable[[str, object], None]
) -> None:
    count = (40 if THOROUGH else 4) if size[0] > 1000 else 12
    counts: Counter[str] = Counter()
    failures = []
    for seed in range(count):
        case = make_case("images", seed, device, size=size)
        verdict = check_labels(case, seed)
        counts["skipped" if verdict == "skip" else "labels"] += 1
        if verdict not in (None, "skip"):
            failures.append(f"seed {seed}: {verdict}\n{case.augment}")
    record_property("counts", dict(counts))
    assert not failures, "\n".join(failures)

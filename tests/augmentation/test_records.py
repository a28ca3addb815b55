"""A call keeps its state in its record: calls of threads do not meet, and containers inside mean what they mean alone."""

from __future__ import annotations

import random
import threading
from collections.abc import Callable, Sequence
from itertools import takewhile
from typing import Any

import pytest
import torch
from torch import Tensor, nn

import kvision.augmentation as A
from kvision.augmentation import maps
from kvision.augmentation.engine import AugmentationBase, Contribution, Shape
from kvision.augmentation.samples import where_chosen

pytestmark = [pytest.mark.interface]

BLOB = 9  # the side of what images and masks show


def blobs(number: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Two images with a square of the brightness of a number, with its mask, box and center."""
    image, corners = torch.zeros(2, 3, 40, 48), []
    for i in range(2):
        x, y = 10 + (7 * number + 5 * i) % 20, 8 + (5 * number + 3 * i) % 16
        image[i, :, y : y + BLOB, x : x + BLOB] = 0.2 + 0.7 * (number % 100) / 100
        corners.append([x, y])
    near = torch.tensor(corners, dtype=torch.float32)[:, None]
    boxes = torch.cat([near, near + BLOB], -1)
    return image, (image[:, :1] > 0).long(), boxes, near + (BLOB - 1) / 2


@pytest.mark.parametrize("count", [8, pytest.param(200, marks=pytest.mark.slow)])
def test_threads_on_one_pipeline(count: int) -> None:
    """Eight threads on one pipeline: images and labels are those of calls one after the other, bit for bit."""
    augment = A.AugmentationSequential(
        A.RandomHorizontalFlip(),
        A.ImageSequential(A.RandomAffine(20.0, (0.05, 0.05)), A.RandomBrightness((0.9, 1.1))),
        A.RandomVerticalFlip(),
        data_keys=["input", "mask", "bbox_xyxy", "keypoints"],
        clip_boxes=True,
        return_transform=True,
    )

    def call(number: int) -> list[Any]:
        found: list[Any] = augment(*blobs(number), seed=number)
        return found

    results: dict[int, list[Any]] = {}

    def work(first: int) -> None:
        for number in range(first, first + count):
            results[number] = call(number)

    workers = [threading.Thread(target=work, args=(thread * count,)) for thread in range(8)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    differing = [number for number, found in results.items() if not _same(call(number), found)]
    assert len(results) == 8 * count and not differing, f"{len(differing)} calls differ"


Inner = Callable[..., A.AugmentationSequential]
KEYS = ["input", "mask", "bbox_xyxy", "keypoints", "class"]


def crop(**options: Any) -> A.AugmentationSequential:
    return A.AugmentationSequential(A.CenterCrop((24, 28)), data_keys=KEYS, **options)


def turn(**options: Any) -> A.AugmentationSequential:
    return A.AugmentationSequential(A.RandomRotation((30.0, 30.0), p=1.0), data_keys=KEYS, **options)


SETTINGS: dict[str, tuple[Inner, dict[str, Any]]] = {
    "clip_boxes": (crop, {"clip_boxes": True}),
    "clip_boxes each": (turn, {"clip_boxes": "each"}),
    "min_box_area": (crop, {"min_box_area": 30.0}),
    "min_box_visibility": (crop, {"min_box_visibility": 0.6}),
    "extra_args": (turn, {"extra_args": {"mask": {"resample": "nearest", "fill_value": 9}}}),
    "interpolated masks": (turn, {"extra_args": {}}),
    "output_dtype": (crop, {"output_dtype": torch.float16}),
    "memory_format": (crop, {"memory_format": torch.channels_last}),
    "return_transform": (turn, {"return_transform": True}),
}


@pytest.mark.parametrize("as_lists", [False, True], ids=["tensors", "lists"])
@pytest.mark.parametrize("name", SETTINGS)
def test_settings_of_containers_inside(name: str, as_lists: bool) -> None:
    make, options = SETTINGS[name]
    image = torch.rand(2, 3, 32, 40, generator=torch.Generator().manual_seed(2))
    mask = (image[:, :1] > 0.5).float()
    boxes = torch.tensor(
        [[[0.0, 0, 8, 6], [10, 8, 20, 20], [4, 2, 12, 9]], [[2, 2, 30, 28], [0, 0, 39, 3], [30, 20, 40, 32]]]
    )
    points, classes = torch.tensor([[[12.0, 12.0]], [[3.0, 20.0]]]), torch.arange(6).reshape(2, 3)
    inputs: list[Any] = [image, mask, boxes, points, classes]
    if as_lists:
        inputs[2], inputs[4] = list(boxes), [row.tolist() for row in classes]
    alone = make(**options)(*inputs)
    container = A.AugmentationSequential(make(**options), data_keys=KEYS)
    inside = container(*inputs)
    deeper = A.AugmentationSequential(A.ImageSequential(make(**options), nn.Identity()), data_keys=KEYS)(*inputs)
    default = make()(*inputs)
    assert name == "memory_format" or not _same(alone, default)
    for found in (inside, deeper):
        assert _same(alone, found)
        strides = [(x[0] if isinstance(x, tuple) else x).stride() for x in (alone[0], found[0])]
        assert strides[0] == strides[1]
    if "box" in name:
        kept = make(**options)
        kept(*inputs)
        assert _same(kept.kept_boxes, container.kept_boxes)


def test_what_a_container_inside_removes_stays_removed() -> None:
    """Boxes that a container inside removes do not come back, with whatever follows."""
    boxes = torch.tensor([[[0.0, 0, 8, 6], [10, 8, 20, 20]]])
    inputs = [torch.rand(1, 3, 32, 40), boxes, torch.tensor([[5, 6]])]
    chain = A.AugmentationSequential(
        crop(min_box_area=30.0), A.RandomHorizontalFlip(p=1.0), data_keys=["input", "bbox_xyxy", "class"]
    )
    _, moved, classes = chain(*inputs)
    assert moved[0, 0].tolist() == [0, 0, 0, 0] and moved[0, 1].tolist() == [14, 4, 24, 16]
    assert classes.tolist() == [[-1, 6]]
    assert chain.kept_boxes[0].tolist() == [[False, True]]
    _, moved, classes = chain(inputs[0], list(boxes), [[5, 6]])
    assert moved[0].tolist() == [[14, 4, 24, 16]] and classes == [[6]]
    assert chain.kept_boxes[0][0].tolist() == [False, True]


def test_known_pixels_do_not_depend_on_how_masks_are_read() -> None:
    x = torch.rand(1, 3, 32, 40)
    known = []
    for options in ({}, {"extra_args": {"mask": {"fill_value": 1.0}}}):
        augment = A.AugmentationSequential(turn(**options), data_keys=["input"])
        known.append(augment.known_pixels(augment(x)))
    assert torch.equal(*known) and not known[0].all()


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, Tensor):
        return isinstance(b, Tensor) and a.dtype == b.dtype and a.shape == b.shape and torch.equal(a, b)
    if isinstance(a, (list, tuple)):
        return type(a) is type(b) and len(a) == len(b) and all(_same(x, y) for x, y in zip(a, b))
    return bool(a == b)


def test_replays_take_the_same_passes() -> None:
    """What was joined with neighbors is so in a replay, also where no sample was chosen: bit for bit."""
    chain = A.ImageSequential(
        A.ImageSequential(A.RandomHorizontalFlip(p=0.2), A.ColorJitter(0.1, 0.1, 0.1, 0.1)),
        A.ImageSequential(A.RandomVerticalFlip(p=0.2), A.RandomHue((-0.1, 0.1))),
    )
    for dtype in (torch.float32, torch.uint8):
        for seed in range(8):
            x = torch.rand(1, 3, 64, 80, generator=torch.Generator().manual_seed(seed))
            x = (255 * x).to(dtype) if dtype == torch.uint8 else x
            y = chain(x, seed=seed)
            assert torch.equal(chain(x, params=chain._params), y), seed


# --- the definition of plans ----------------------------------------------------------------------------------------
#
# What a chain of augmentations computes, written plainly: one after the other, each sample by its parameters by name. Plans give
# the same in fewer passes over the images, up to rounding.

Call = tuple[AugmentationBase, dict[str, Any]]  # an augmentation with its parameters


def run_in_turn(
    x: Tensor, augmentations: Sequence[AugmentationBase], params: Sequence[dict[str, Any]], once: bool = False
) -> Tensor:
    """Run augmentations with given parameters, each of which resamples the images that the one before it left.

    Bytes count as 255ths where colors change. They are rounded behind each augmentation, but behind neighbors that change
    colors once: between these there are numbers. With `once`, neighbors that move pixels read the images once. What is blurred
    where images become smaller is left out.
    """
    stored = x.dtype
    pending: list[Call] = list(zip(augmentations, params))
    while pending:
        shape = tuple(x.shape)
        motions = [_contribution(module, shape).motion for module, _ in pending] if once else []
        together = pending[: len(list(takewhile(bool, motions)))]
        if together:
            x, pending = _read_once(x, together), pending[len(together) :]
            continue
        (module, own), pending = pending[0], pending[1:]
        result = module._result_dtype(stored)
        is_color = _contribution(module, tuple(x.shape)).colors is not None
        if is_color and x.dtype == torch.uint8:
            x = x.float() / 255
        x = _run_chosen(x, module, own)
        goes_on = is_color and len(pending) > 0 and _contribution(pending[0][0], tuple(x.shape)).colors is not None
        if result == torch.uint8 and x.dtype != result and not goes_on:
            x = (x * 255).round().clamp(0, 255).to(result)
        stored = result
    return x


def _contribution(module: AugmentationBase, shape: Shape) -> Contribution:
    return module._contribution(shape, module.flags) or Contribution()


def _run_chosen(x: Tensor, module: AugmentationBase, params: dict[str, Any]) -> Tensor:
    """All samples augmented, and those taken that are chosen; a batch whose size changes is augmented as a whole or not at all."""
    chosen = params["batch_prob"] > 0.5
    if module.whole_batch and not bool(chosen.any()):
        return x
    y: Tensor = module(x, params={**params, "batch_prob": torch.ones_like(chosen, dtype=torch.float32)})
    return y if module.whole_batch else where_chosen(chosen.to(x.device), y, x.to(y.dtype))


def _read_once(x: Tensor, calls: Sequence[Call]) -> Tensor:
    """The images where the pixels of the result come from, which go back through the augmentations, the last one first."""
    shape, executions, motions = tuple(x.shape), [], []
    for module, params in calls:
        execution = module._execution_on(x.new_empty(1).expand(shape), params, module.flags)
        motion = module._declared(shape, module.flags).motion
        assert motion is not None
        shape = (*shape[:2], *motion.size) if execution.applied else shape
        executions.append(execution)
        motions.append(motion)
    like = x if x.is_floating_point() else x.new_empty(0, dtype=torch.float32)
    height, width = shape[2:]
    points = maps.pixel_positions(height, width, like).expand(len(x), -1, 2)
    for (module, _), execution in zip(reversed(calls), reversed(executions)):
        points = module.inverse_points(points, execution)
    reading = next((motion for motion in motions if motion.interpolates), motions[-1])
    return maps.read(x, points.unflatten(1, (height, width)), reading.resampling)


class Negative(A.IntensityAugmentationBase2D):
    """Of a user: it runs by itself."""

    def apply_transform(self, input: Any, params: Any, flags: Any, transform: Any = None) -> Tensor:
        return 1 - input if input.is_floating_point() else 255 - input


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float32], ids=str)
def test_plans_give_what_their_definition_gives(dtype: torch.dtype) -> None:
    """Random chains against `run_in_turn`, some with more colors than one program takes. Sums are rounded in another order."""
    makers = [
        lambda: A.ColorJitter(0.2, 0.2, 0.2, 0.05, p=0.7),
        lambda: A.RandomBrightness((0.8, 1.2), p=0.7),
        lambda: A.RandomContrast((0.8, 1.2), p=0.7),
        lambda: A.RandomGamma((0.8, 1.2), p=0.7),
        lambda: A.RandomSaturation((0.8, 1.2), p=0.7),
        lambda: A.RandomInvert(p=0.7),
        lambda: A.RandomHorizontalFlip(p=0.7),
        lambda: A.RandomVerticalFlip(p=0.7),
        lambda: A.RandomGaussianBlur(3, (0.5, 1.0), p=0.7),
        lambda: A.RandomRotation90((0, 2), p=0.7),
        lambda: A.RandomCrop((14, 13), padding=2),
        lambda: A.RandomResizedCrop((15, 14), scale=(0.6, 1.0)),
        lambda: A.RandomAffine(15.0, (0.1, 0.1), p=0.7),
        lambda: A.RandomThinPlateSpline(0.05, p=0.7),
        lambda: Negative(p=0.7),
    ]
    for seed in range(30):
        rng = random.Random(seed)
        chain = A.ImageSequential(*(rng.choice(makers[:6] * 3 + makers)() for _ in range(6)))
        x = torch.rand(3, 3, 16, 16, generator=torch.Generator().manual_seed(seed))
        x = (255 * x).round().to(dtype) if dtype == torch.uint8 else x
        y = chain(x, seed=seed)
        expected = run_in_turn(x, list(chain.children()), [item.data for item in chain._params])
        difference = (y.double() - expected.double()).abs()
        assert y.dtype == dtype
        if dtype == torch.uint8:
            # A value next to a half goes to either level, and steps behind it may double that.
            assert difference.max() <= 2 and (difference > 0).double().mean() < 0.005, (seed, difference.max())
        else:
            assert difference.max() < 2e-5, (seed, difference.max())


def test_plans_that_resample_once_give_what_their_definition_gives() -> None:
    """Positions go back through the augmentations one by one, where a plan multiplies matrices."""
    makers = [
        lambda: A.RandomHorizontalFlip(p=0.7),
        lambda: A.RandomRotation90((0, 2), p=0.7),
        lambda: A.RandomCrop((24, 23), padding=2),
        lambda: A.RandomAffine(15.0, (0.1, 0.1), padding_mode="border", p=0.7),
        lambda: A.RandomPerspective(0.2, p=0.7),
        lambda: A.RandomThinPlateSpline(0.05, p=0.7),
        lambda: A.RandomElasticTransform((9, 9), (3.0, 3.0), (0.1, 0.1), p=0.7),
        lambda: A.RandomBrightness((0.8, 1.2), p=0.7),
        lambda: Negative(p=0.7),
    ]
    for seed in range(20):
        rng = random.Random(seed)
        chain = A.ImageSequential(*(rng.choice(makers)() for _ in range(5)), resample="once")
        x = torch.rand(3, 3, 26, 25, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
        y = chain(x, seed=seed)
        expected = run_in_turn(x, list(chain.children()), [item.data for item in chain._params], once=True)
        assert y.shape == expected.shape and (y - expected).abs().max() < 1e-9, (seed, chain)

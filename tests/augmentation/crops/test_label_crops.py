"""Crops by boxes and masks: windows of the libraries that they are named after, bounds that hold, and labels of the step."""

from __future__ import annotations

import warnings
from typing import Any

import pytest
import torch
from torch import Tensor

import kvision.augmentation as A
from kvision.augmentation.labels import box_edges
from kvision.constants import DataKey

pytestmark = pytest.mark.interface

BOXES = torch.tensor([[10.0, 12, 30, 40], [50, 5, 70, 25]])
HEIGHT, WIDTH = 60, 80


def one_pixel_masks() -> Tensor:
    mask = torch.zeros(1, 1, HEIGHT, WIDTH, dtype=torch.uint8)
    mask[0, 0, (7, 20, 50), (11, 30, 60)] = torch.tensor([1, 2, 1], dtype=torch.uint8)
    return mask


# Class, numbers, boxes or masks, and the window (left, top, right, bottom) of AlbumentationsX 2.5.1 or torchvision 0.29.1 by these
# random numbers.
PEERS = {
    "safe": (A.RandomSizedBBoxSafeCrop(9, 11), [0.31, 0.62, 0.47, 0.85], BOXES, [3, 3, 74, 57]),
    "safe, eroded": (A.RandomSizedBBoxSafeCrop(9, 11, 0.2), [0.31, 0.62, 0.47, 0.85], BOXES, [4, 5, 71, 56]),
    "safe, one box": (A.RandomSizedBBoxSafeCrop(9, 11, 0.2), [0.31, 0.62, 0.47, 0.85], BOXES[:1], [3, 7, 53, 57]),
    "one box": (A.AtLeastOneBBoxRandomCrop(35, 40), [0.6, 0.31, 0.62], BOXES, [33, 3, 73, 38]),
    "one box, eroded": (A.AtLeastOneBBoxRandomCrop(35, 40, 0.5), [0.2, 0.31, 0.62], BOXES, [6, 15, 46, 50]),
    "one large box": (A.AtLeastOneBBoxRandomCrop(9, 11), [0.2, 0.31, 0.62], BOXES, [16, 19, 27, 28]),
    "near a box": (A.RandomCropNearBBox((0.2, 0.3)), [0.5, 0.31, 0.62, 0.9, 0.1], BOXES[:1], [12, 7, 32, 35]),
    # Albumentations chooses a pixel by one number, kvision by two: its row, and its column among those of the row.
    "mask": (A.CropNonEmptyMaskIfExists(20, 24), [0.5, 0.0, 0.31, 0.62], one_pixel_masks(), [23, 8, 47, 28]),
    "mask, ignored": (
        A.CropNonEmptyMaskIfExists(20, 24, ignore_values=[2]), [0.5, 0.0, 0.31, 0.62], one_pixel_masks(), [53, 38, 77, 58],
    ),
    "canvas": (A.RandomZoomOut(), [0.41, 0.27, 0.83], None, [-26, -60, 152, 73]),
}  # fmt: skip


@pytest.mark.parametrize("name", PEERS)
def test_windows_are_those_of_the_peers(name: str, device: torch.device) -> None:
    crop, numbers, labels, expected = PEERS[name]
    if labels is not None:
        labels = [labels.to(device)] if labels.dim() == 4 else labels[None].to(device)
    height, width = (torch.tensor([float(n)], dtype=torch.float64, device=device) for n in (HEIGHT, WIDTH))
    drawn = torch.tensor([numbers], dtype=torch.float64, device=device)
    x, y, w, h = crop._param_generator.windows(drawn, height, width, labels)[0].tolist()
    assert [x, y, x + w, y + h] == expected


def test_a_trial_of_an_overlap_is_torchvisions(device: torch.device) -> None:
    # torchvision 0.29.1 refuses the first two windows: by their aspect, and because no center is inside.
    crop = A.RandomIoUCrop(sampler_options=[0.3], trials=4)
    generator = crop._param_generator
    trials = torch.tensor(
        [[0.41, 0.27, 0.1, 0.1], [0.31, 0.62, 0.5, 0.2], [0.5, 0.5, 0.0, 0.1], [0.1, 0.3, 0.15, 0.35]]
    )
    rounds = (generator.count - 8) // 4
    numbers = torch.zeros(1, 8 + 4 * rounds, dtype=torch.float64)
    numbers[:, 8:].unflatten(1, (4, rounds))[..., :4] = trials.double().T
    height, width = (torch.tensor([float(n)], dtype=torch.float64, device=device) for n in (HEIGHT, WIDTH))
    window = generator.windows(numbers.to(device), height, width, BOXES[None].to(device))
    assert window[0].tolist() == [7, 10, 29, 30]


def windows_of(crop: Any, count: int, device: torch.device, **labels: Any) -> Tensor:
    """The windows (B, 4), left, top, right and bottom, of a call on images of 60 x 80 pixels."""
    crop(torch.zeros(1, 1, 1, 1, device=device).expand(count, 1, HEIGHT, WIDTH), seed=torch.arange(count), **labels)
    src = crop._params["src"]
    return torch.cat([src[:, 0], src[:, 2] + 1], 1)


def overlaps(windows: Tensor, boxes: Tensor) -> Tensor:
    """Intersection over union of a window (B, 4) with boxes (N, 4), of which the center is inside; 0 of others."""
    first, last = torch.maximum(windows[:, None, :2], boxes[:, :2]), torch.minimum(windows[:, None, 2:], boxes[:, 2:])
    common = (last - first).clamp(min=0).prod(-1)
    both = (windows[:, 2:] - windows[:, :2]).prod(-1)[:, None] + (boxes[:, 2:] - boxes[:, :2]).prod(-1) - common
    center = (boxes[:, :2] + boxes[:, 2:]) / 2
    inside = ((windows[:, None, :2] < center) & (center < windows[:, None, 2:])).all(-1)
    return common / both * inside


@pytest.mark.parametrize("least", [0.0, 0.3, 0.7])
def test_an_overlap_has_its_bound(least: float, device: torch.device) -> None:
    boxes = torch.tensor([[10.0, 12, 50, 50], [48, 5, 76, 40]])
    crop = A.RandomIoUCrop(sampler_options=[least])
    windows = windows_of(crop, 64, device, boxes=boxes.expand(64, 2, 4).to(device))
    sides = windows[:, 2:] - windows[:, :2]
    is_whole = (sides == torch.tensor([WIDTH, HEIGHT])).all(1)
    assert is_whole.float().mean() < 0.05 and len(windows.unique(dim=0)) > 50
    overlap = overlaps(windows, boxes).amax(1)[~is_whole]
    assert (overlap >= least).all() and (overlap > 0).all()
    aspect = (sides[:, 0] / sides[:, 1])[~is_whole]
    assert ((aspect >= 0.5) & (aspect <= 2)).all() and (sides[:, 0] >= 24 - 1).all() and (sides[:, 1] >= 18 - 1).all()
    whole = windows_of(A.RandomIoUCrop(), 4, device)  # without boxes, as torchvision ends at last
    assert (whole == torch.tensor([0.0, 0, WIDTH, HEIGHT])).all()


def test_boxes_are_safe(device: torch.device) -> None:
    boxes = torch.rand(64, 3, 4, generator=torch.Generator().manual_seed(1)) * 30
    boxes[..., 2:] += boxes[..., :2] + 1
    windows = windows_of(A.RandomSizedBBoxSafeCrop(8, 8), 64, device, boxes=boxes.to(device))
    assert (windows[:, :2] <= boxes[..., :2].amin(1)).all() and (windows[:, 2:] >= boxes[..., 2:].amax(1)).all()
    assert (windows >= 0).all() and (windows <= torch.tensor([WIDTH, HEIGHT] * 2)).all()
    windows = windows_of(A.AtLeastOneBBoxRandomCrop(45, 40), 64, device, boxes=boxes.to(device))
    contains = (windows[:, None, :2] <= boxes[..., :2]) & (windows[:, None, 2:] >= boxes[..., 2:])
    assert contains.all(-1).any(1).all()
    free = windows_of(A.AtLeastOneBBoxRandomCrop(45, 40), 64, device)
    assert set(free[:, 0].tolist()) > {0.0, 5.0} and free[:, 0].max() <= 40 and free[:, 1].max() <= 15
    masks = torch.zeros(64, HEIGHT, WIDTH, dtype=torch.bool, device=device)
    marked = torch.randint(0, HEIGHT * WIDTH, (64, 3), generator=torch.Generator().manual_seed(1))
    masks.flatten(1).scatter_(1, marked.to(device), True)
    crop = A.CropNonEmptyMaskIfExists(7, 9)
    images = masks[:, None].float()
    assert crop(images, masks=masks).flatten(1).any(1).all()
    assert not crop(images).flatten(1).any(1).all()


def grid(count: int, device: torch.device) -> Tensor:
    """Images (B, 2, 60, 80) of the coordinates of their pixels."""
    y, x = torch.meshgrid(torch.arange(60.0), torch.arange(80.0), indexing="ij")
    return torch.stack([x, y]).expand(count, 2, 60, 80).to(device)


STEPS = {
    "one run": lambda crop, **o: A.AugmentationSequential(A.RandomHorizontalFlip(), crop, A.RandomVerticalFlip(), **o),
    "once": lambda crop, **o: A.AugmentationSequential(A.RandomHorizontalFlip(), crop, resample="once", **o),
    "nested": lambda crop, **o: A.AugmentationSequential(
        A.RandomHorizontalFlip(), A.ImageSequential(A.RandomVerticalFlip(), A.AugmentationSequential(crop)), **o
    ),
    "behind a module": lambda crop, **o: A.AugmentationSequential(
        A.RandomHorizontalFlip(), torch.nn.Identity(), crop, **o
    ),
    "of each sample": lambda crop, **o: A.AugmentationSequential(
        A.RandomHorizontalFlip(), A.RandomOrder(A.RandomVerticalFlip(p=1.0), crop), **o
    ),
    "in turns": lambda crop, **o: A.AugmentationSequential(
        A.RandomHorizontalFlip(p=1.0), A.ImageSequential(A.RandomVerticalFlip(p=1.0), crop, random_apply=2), **o
    ),
}  # fmt: skip


@pytest.mark.parametrize("step", STEPS)
def test_labels_are_those_of_the_step(step: str, device: torch.device) -> None:
    """A single box has all its pixels in the result, wherever flips have put it; one sample alone has the same result."""
    x, count = grid(6, device), 6
    box = torch.tensor([[[8.0, 6, 20, 26]]]).expand(count, 1, 4).to(device)
    crop = A.RandomCropNearBBox((0.0, 0.0), align_corners=False, antialias=False, resample="nearest")
    augment = STEPS[step](crop, data_keys=["image", "bbox_xyxy"])
    seeds = torch.arange(count)
    y, moved = augment(x, box, seed=seeds)
    assert_close = torch.testing.assert_close
    assert_close(moved, torch.tensor([0.0, 0, 80, 60], device=device).expand_as(moved))
    assert y[:, 0].amin() == 8 and y[:, 0].amax() == 19 and y[:, 1].amin() == 6 and y[:, 1].amax() == 25
    params = augment._params
    again = augment(x, box, params=params)
    assert torch.equal(again[0], y) and torch.equal(augment(x, params=params, data_keys=["image"]), y)
    order = torch.tensor([4, 1])
    some = augment(x[order], box[order], seed=seeds[order])
    assert torch.equal(some[0], y[order])


def test_forms_of_labels(device: torch.device) -> None:
    x = grid(2, device)
    boxes = [torch.tensor([[8.0, 6, 20, 26]], device=device), torch.zeros(0, 4, device=device)]
    crop = A.RandomCropNearBBox((0.0, 0.0), size=(10, 12))
    augment = A.AugmentationSequential(crop, data_keys=["image", "bbox_xyxy"])
    _, moved = augment(x, boxes)
    assert moved[0].tolist() == [[0, 0, 12, 10]] and crop._params["src"][1].tolist()[2] == [79, 59]
    # A list of images of different sizes, whose boxes are a list.
    images = [x[0], x[1, :, :40, :50]]
    y, moved = augment(images, [boxes[0], torch.tensor([[30.0, 20, 50, 40]], device=device)])
    assert y.shape == (2, 2, 10, 12)
    torch.testing.assert_close(torch.stack(moved)[:, 0], torch.tensor([[0.0, 0, 12, 10]] * 2, device=device))
    # All formats, and rows of zeros, which are no boxes.
    padded = torch.tensor([[[8.0, 6, 20, 26], [0, 0, 0, 0]]])
    corners = torch.tensor([[8.0, 6], [19, 6], [19, 25], [8, 25]])
    for key, values in (
        ("bbox_xyxy", padded),
        ("bbox_xywh", torch.tensor([[[8.0, 6, 12, 20], [0, 0, 0, 0]]])),
        ("bbox_xyxy_plus", torch.tensor([[[8.0, 6, 19, 25], [0, 0, 0, 0]]])),
        ("bbox", torch.stack([corners, torch.zeros(4, 2)])[None]),
    ):
        flipped = A.AugmentationSequential(A.RandomHorizontalFlip(p=1.0), crop, data_keys=["image", key])
        flipped(x[:1], values.to(device))
        (_, _), (_, params) = flipped._params
        assert params["src"][0, 0].tolist() == [60, 6] and params["src"][0, 2].tolist() == [71, 25]
        edges = box_edges(values, {k.name.lower(): m for k, m in _MODES.items()}[key], 1)
        assert torch.equal(edges, padded)


_MODES = {
    DataKey.BBOX: "vertices",
    DataKey.BBOX_XYXY: "xyxy",
    DataKey.BBOX_XYWH: "xywh",
    DataKey.BBOX_XYXY_PLUS: "xyxy_plus",
}


def test_frames_of_a_video_have_one_window(device: torch.device) -> None:
    """It contains the boxes of all frames; with frames of their own, each has its own."""
    x = grid(6, device).reshape(2, 3, 2, 60, 80)
    boxes = torch.tensor([[8.0, 6, 20, 26], [30, 20, 50, 40], [12, 30, 40, 50]]).expand(2, 3, 4)[:, :, None].to(device)
    for same, expected in ((True, [8, 49, 6, 49]), (False, [8, 19, 6, 25])):
        crop = A.RandomSizedBBoxSafeCrop(30, 40)
        video = A.VideoSequential(crop, same_on_frame=same)
        augment = A.AugmentationSequential(video, data_keys=["image", "bbox_xyxy"])
        augment(x, boxes, seed=1)
        src = crop._params["src"]
        assert src.shape == (6, 4, 2) and (bool((src[:3] == src[:1]).all()) is same)
        left, top, right, bottom = src[0, 0, 0], src[0, 0, 1], src[0, 2, 0], src[0, 2, 1]
        assert left <= expected[0] and right >= expected[1] and top <= expected[2] and bottom >= expected[3]


def test_masks_of_the_step(device: torch.device) -> None:
    mask = torch.zeros(3, 1, 60, 80, dtype=torch.uint8, device=device)
    mask[:, :, 10, 70] = 1
    crop = A.CropNonEmptyMaskIfExists(9, 11)
    augment = A.AugmentationSequential(A.RandomHorizontalFlip(p=1.0), crop, data_keys=["image", "mask"])
    y, moved = augment(grid(3, device), mask)
    assert y.shape == (3, 2, 9, 11) and (moved.flatten(1).sum(1) == 1).all()
    marked = y[:, 0][moved[:, 0] == 1]
    assert (marked == 70).all()
    instances = [mask[0], mask[0].new_zeros(2, 60, 80), mask[0]]  # a list of those of each image
    _, lists = augment(grid(3, device), instances)
    assert [m.shape for m in lists] == [(1, 9, 11), (2, 9, 11), (1, 9, 11)] and lists[0].sum() == lists[2].sum() == 1
    images = [grid(1, device)[0], grid(1, device)[0, :, :40]]
    start = A.AugmentationSequential(crop, data_keys=["image", "mask"])
    _, lists = start(images, [mask[0], mask[0, :, :40]])
    assert all(m.sum() == 1 for m in lists)


def test_key_points_keep_their_visibility(device: torch.device) -> None:
    """As COCO has it; 0 for points that leave, in this step or in one before."""
    points = torch.tensor([[[1.0, 2, 2], [7, 3, 1], [2, 2, 0], [6, 1, 2]]], device=device)
    shift = A.RandomTranslate((-0.5, -0.5), (0.0, 0.0), p=1.0)  # by 4 pixels to the left
    augment = A.AugmentationSequential(shift, A.RandomHorizontalFlip(p=1.0), data_keys=["image", "keypoints"])
    x = torch.zeros(1, 1, 4, 8, device=device)
    _, moved = augment(x, points)
    torch.testing.assert_close(moved, torch.tensor([[[10.0, 2, 0], [4, 3, 1], [9, 2, 0], [5, 1, 2]]], device=device))
    _, lists = augment(x, [points[0]])
    assert torch.equal(lists[0], moved[0]) and torch.equal(augment(x, points[..., :2])[1], moved[..., :2])
    assert augment.visible_points[0].tolist() == [[False, True, False, True]]
    back = augment.inverse(moved, data_keys=["keypoints"])
    torch.testing.assert_close(back[..., :2], points[..., :2])
    maps = A.AugmentationSequential(
        A.RandomFisheye((0.0, 0.0), (0.0, 0.0), (1.0, 1.0), p=1.0), data_keys=["image", "keypoints"]
    )
    assert maps(x, points)[1].shape == points.shape


@pytest.mark.tracing
def test_compiles_with_labels() -> None:
    x, boxes = grid(3, torch.device("cpu")), BOXES.expand(3, 2, 4)
    crop = A.RandomSizedBBoxSafeCrop(30, 40)
    compiled = torch.compile(crop, fullgraph=True, backend="aot_eager")
    torch.testing.assert_close(compiled(x, boxes=boxes, seed=3), crop(x, boxes=boxes, seed=3))
    augment = A.AugmentationSequential(A.RandomHorizontalFlip(), crop, data_keys=["image", "bbox_xyxy"])
    compiled = torch.compile(augment, fullgraph=True, backend="aot_eager")
    for a, b in zip(compiled(x, boxes, seed=3), augment(x, boxes, seed=3)):
        torch.testing.assert_close(a, b)


def test_a_call_without_labels_is_told(device: torch.device) -> None:
    x = torch.zeros(2, 1, 20, 20, device=device)
    calls = {
        "boxes": (
            A.RandomIoUCrop(),
            A.AtLeastOneBBoxRandomCrop(9, 9),
            A.AugmentationSequential(A.RandomCropNearBBox(), data_keys=["image"]),
        ),
        "masks": (A.CropNonEmptyMaskIfExists(9, 9),),
    }
    for name, modules in calls.items():
        for module in modules:
            with pytest.warns(UserWarning, match=f"this call has no {name}, by which windows are chosen"):
                module(x)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        A.RandomIoUCrop()(x, boxes=torch.zeros(2, 0, 4, device=device))
        A.RandomZoomOut()(x)


CENTERS = {
    "alone": lambda crop, **o: A.AugmentationSequential(crop, **o),
    "one warp": lambda crop, **o: A.AugmentationSequential(A.RandomVerticalFlip(p=1.0), crop, A.RandomHorizontalFlip(p=1.0), **o),
    "once": lambda crop, **o: A.AugmentationSequential(crop, A.RandomAffine(20.0, p=1.0), resample="once", **o),
    "composed": lambda crop, **o: A.AugmentationSequential(crop, A.RandomThinPlateSpline(0.1, p=1.0), resample="once", **o),
    "nested": lambda crop, **o: A.AugmentationSequential(A.ImageSequential(A.RandomHorizontalFlip(p=1.0), crop), **o),
    "chosen": lambda crop, **o: A.AugmentationSequential(A.OneOf(crop, A.RandomHorizontalFlip(p=1.0)), **o),
    "filtered": lambda crop, **o: A.AugmentationSequential(crop, min_box_area=1.0, **o),
}  # fmt: skip


@pytest.mark.parametrize("form", CENTERS)
def test_boxes_whose_centers_leave_the_window_are_removed(form: str, device: torch.device) -> None:
    """As torchvision does, with their labels and masks; also where the crop is joined with its neighbors."""
    count, size = 24, torch.tensor([WIDTH, HEIGHT] * 2)
    boxes = torch.tensor([[10.0, 12, 30, 40], [50, 5, 70, 25], [0, 50, 9, 60]]).expand(count, 3, 4).to(device)
    labels, masks = (
        torch.tensor([[1, 2, 3]]).expand(count, 3).to(device),
        torch.ones(count, 3, 60, 80, dtype=torch.uint8),
    )
    crop = A.RandomIoUCrop(sampler_options=[0.2])
    keys = ["image", "bbox_xyxy", "class", "mask"]
    augment = CENTERS[form](crop, data_keys=keys)
    inputs = [grid(count, device), boxes, labels, masks.to(device)]
    _, moved, names, moved_masks = augment(*inputs, seed=torch.arange(count))
    windows, at = [], torch.arange(count)
    items = [item for item in flat_items(augment._params) if "output_size" in item.data]
    assert len(items) == 1
    if getattr(items[0], "samples", None) is not None:
        at = at[items[0].samples > 0.5]
    src = items[0].data["src"]
    windows = torch.cat([src[:, 0], src[:, 2] + 1], 1)
    seen = boxes[at].cpu()
    if form == "one warp":
        seen = torch.stack([seen[..., 0], 60 - seen[..., 3], seen[..., 2], 60 - seen[..., 1]], -1)
    if form == "nested":
        seen = torch.stack([80 - seen[..., 2], seen[..., 1], 80 - seen[..., 0], seen[..., 3]], -1)
    center = (seen[..., :2] + seen[..., 2:]) / 2
    inside = ((windows[:, None, :2] < center) & (center < windows[:, None, 2:])).all(-1)
    is_whole = (windows == torch.tensor([0.0, 0, WIDTH, HEIGHT])).all(1)
    assert not inside.all() and (~is_whole).sum() > len(at) // 2 and size.numel()
    expected = torch.ones(count, 3, dtype=torch.bool)
    expected[at] = inside
    assert torch.equal(names.cpu(), torch.where(expected, labels.cpu(), -1))
    assert torch.equal((moved != 0).any(-1).cpu(), expected)
    gone = torch.where(expected[..., None, None], moved_masks.cpu(), 0)
    assert torch.equal(moved_masks.cpu() * expected[..., None, None], gone)
    lists = augment(inputs[0], list(boxes), list(labels), list(inputs[3]), seed=torch.arange(count))
    assert [part.tolist() for part in lists[2]] == [row[keep].tolist() for row, keep in zip(labels.cpu(), expected)]
    assert [len(part) for part in lists[1]] == [len(part) for part in lists[3]] == expected.sum(1).tolist()


def flat_items(params: Any) -> list[Any]:
    return [item for outer in params for item in (flat_items(outer.data) if isinstance(outer.data, list) else [outer])]


def test_boxes_of_lists_of_images_are_removed_by_centers(device: torch.device) -> None:
    images = [grid(1, device)[0], grid(1, device)[0, :, :40, :50]]
    boxes = [torch.tensor([[10.0, 12, 30, 36], [30, 5, 48, 25]], device=device)] * 2
    augment = A.AugmentationSequential(
        A.RandomIoUCrop(sampler_options=[0.3], size=(20, 24)),
        A.RandomHorizontalFlip(),
        data_keys=["image", "bbox_xyxy"],
    )
    counts = set()
    for seed in range(8):
        _, moved = augment(images, boxes, seed=seed)
        counts.update(len(part) for part in moved)
        for part in moved:
            center = (part[:, :2] + part[:, 2:]) / 2
            assert ((center > 0) & (center < torch.tensor([24.0, 20], device=device))).all()
    assert counts == {1, 2}


BAD = [
    (lambda: A.RandomIoUCrop(0.5, 0.3), ValueError, "RandomIoUCrop: expected min_scale above 0"),
    (lambda: A.RandomIoUCrop(sampler_options=[]), ValueError, "RandomIoUCrop: expected sampler_options"),
    (lambda: A.RandomIoUCrop(trials=0), ValueError, "RandomIoUCrop: expected trials"),
    (lambda: A.RandomSizedBBoxSafeCrop(9, 0), ValueError, "RandomSizedBBoxSafeCrop: expected size"),
    (lambda: A.RandomSizedBBoxSafeCrop(9, 9, 1.5), ValueError, "expected erosion_rate within 0 and 1"),
    (lambda: A.RandomCropNearBBox(0.3), ValueError, "expected max_part_shift to be two fractions"),
    (lambda: A.RandomZoomOut(side_range=(0.5, 2.0)), ValueError, "RandomZoomOut: expected side_range"),
    (lambda: A.AtLeastOneBBoxRandomCrop(9, 9)(torch.zeros(1, 1, 8, 8)), ValueError, "expected images of at least"),
    (lambda: A.RandomIoUCrop(resample="nearest"), ValueError, "expected resample 'bilinear' or 'bicubic' with anti"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        call()

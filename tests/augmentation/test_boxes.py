"""Boxes that are clipped and filtered after they have moved, with their class labels."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import kvision as K
import kvision.augmentation as A

pytestmark = pytest.mark.interface


class Shift(A.GeometricAugmentationBase2D):
    """Three columns to the right and a row up."""

    def compute_transformation(self, input: Tensor, params: Any, flags: Any) -> Tensor:
        return torch.tensor([[1.0, 0, 3], [0, 1, -1], [0, 0, 1]], device=input.device).expand(len(input), 3, 3)


def container(*children: Any, keys: tuple[str, ...] = ("image", "bbox_xyxy", "class"), **options: Any) -> Any:
    return A.AugmentationSequential(*(children or (Shift(p=1.0),)), data_keys=keys, **options)


IMAGE = torch.zeros(1, 3, 8, 10)
# After the shift: whole; a quarter of 4x4 pixels inside; outside; half of 2x8 pixels inside.
BOXES = torch.tensor([[[1.0, 2, 4, 4], [5.0, -1, 9, 3], [8.0, 3, 9, 4], [0.0, -3, 2, 5]]])
MOVED = BOXES + torch.tensor([3.0, -1, 3, -1])
CLASSES = torch.tensor([[5, 6, 7, 8]])


def test_nothing_is_clipped_or_removed_by_default(device: torch.device) -> None:
    augment = container()
    _, boxes, classes = augment(IMAGE.to(device), BOXES.to(device), CLASSES.to(device))
    assert torch.equal(boxes.cpu(), MOVED) and torch.equal(classes.cpu(), CLASSES)
    assert augment.kept_boxes == []


@pytest.mark.parametrize(
    "options, kept",
    [
        ({"clip_boxes": True}, [True, True, False, True]),
        ({"min_box_area": 4.0}, [True, True, False, True]),
        ({"min_box_area": 4.1}, [True, False, False, True]),
        ({"min_box_visibility": 0.25}, [True, True, False, True]),
        ({"min_box_visibility": 0.4}, [True, False, False, True]),
        ({"min_box_visibility": 1.0}, [True, False, False, False]),
        ({"min_box_area": 7.0, "min_box_visibility": 0.1}, [False, False, False, True]),
    ],
)
@pytest.mark.parametrize("format", ["bbox_xyxy", "bbox_xyxy_plus", "bbox_xywh", "bbox"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.int64], ids=str)
def test_boxes_that_stay(options: dict[str, Any], kept: list[bool], format: str, dtype: torch.dtype, device) -> None:
    if format == "bbox" and dtype == torch.int64:
        pytest.skip("vertices are not whole pixels here")
    boxes = as_format(BOXES, format).to(dtype)
    augment = container(keys=("image", format, "class"), **options)
    _, moved, classes = augment(IMAGE.to(device), boxes.to(device), CLASSES.to(device))
    (result,) = augment.kept_boxes
    assert result.tolist() == [kept] and moved.dtype == dtype and moved.shape == boxes.shape
    expected = MOVED.clone()
    if options.get("clip_boxes"):
        expected = torch.stack([*expected.unbind(-1)], -1)
        expected[..., 0::2] = expected[..., 0::2].clamp(0, 10)
        expected[..., 1::2] = expected[..., 1::2].clamp(0, 8)
    expected = as_format(expected, format).to(dtype)
    expected[:, ~torch.tensor(kept)] = 0
    assert torch.equal(moved.cpu(), expected)
    assert classes.tolist() == [[c if k else -1 for c, k in zip((5, 6, 7, 8), kept)]]


def as_format(boxes: Tensor, format: str) -> Tensor:
    x, y, right, bottom = boxes.unbind(-1)
    if format == "bbox_xywh":
        return torch.stack([x, y, right - x, bottom - y], -1)
    if format == "bbox_xyxy_plus":  # the outermost pixels
        return torch.stack([x, y, right - 1, bottom - 1], -1)
    if format == "bbox":  # centers of the outermost pixels
        x, y, right, bottom = x, y, right - 1, bottom - 1
        return torch.stack([x, y, right, y, right, bottom, x, bottom], -1).reshape(*boxes.shape[:-1], 4, 2)
    return boxes


def test_lists_become_shorter_with_their_classes(device: torch.device) -> None:
    images = IMAGE.expand(3, -1, -1, -1).to(device)
    boxes = [BOXES[0].to(device), BOXES[0, 2:3].to(device), BOXES[0, :0].to(device)]
    classes = [CLASSES[0].to(device), CLASSES[0, 2:3].to(device), CLASSES[0, :0].to(device)]
    augment = container(min_box_visibility=0.4)
    _, moved, left = augment(images, boxes, classes)
    assert [len(part) for part in moved] == [2, 0, 0] and torch.equal(moved[0].cpu(), MOVED[0, [0, 3]])
    assert [part.tolist() for part in left] == [[5, 8], [], []]
    assert [part.tolist() for part in augment.kept_boxes[0]] == [[True, False, False, True], [False], []]


def test_empty_boxes(device: torch.device) -> None:
    augment = container(clip_boxes=True, min_box_area=1.0)
    _, boxes, classes = augment(IMAGE.to(device), BOXES[:, :0].to(device), CLASSES[:, :0].to(device))
    assert boxes.shape == (1, 0, 4) and classes.shape == (1, 0)
    none = augment(IMAGE[:0].to(device), BOXES[:0].to(device), CLASSES[:0].to(device))
    assert [x.shape[0] for x in none] == [0, 0, 0]
    _, boxes, _ = augment(IMAGE.to(device), [], [])
    assert boxes == []


def test_boxes_of_one_image_and_boxes_as_objects() -> None:
    augment = container(keys=("image", "bbox_xyxy"), clip_boxes=True)
    _, boxes = augment(IMAGE[0], BOXES[0])
    assert boxes.shape == (4, 4) and augment.kept_boxes[0].tolist() == [True, True, False, True]
    objects = K.geometry.Boxes.from_tensor(BOXES, mode="xyxy")
    augment = container(keys=("image", "bbox"), min_box_visibility=0.4)
    _, moved = augment(IMAGE, objects)
    assert augment.kept_boxes[0].tolist() == [[True, False, False, True]]
    assert torch.equal(moved.to_tensor("xyxy")[0, [0, 3]], MOVED[0, [0, 3]])


def test_classes_belong_to_the_boxes_before_them() -> None:
    keys = ("image", "class", "bbox_xyxy", "bbox_xywh", "class")
    augment = container(keys=keys, min_box_visibility=0.4)
    _, first, _, _, second = augment(IMAGE, CLASSES, BOXES, as_format(BOXES.flip(1), "bbox_xywh"), CLASSES)
    assert first.tolist() == [[5, -1, -1, 8]] and second.tolist() == [[5, -1, -1, 8]][::-1]
    assert len(augment.kept_boxes) == 2
    inputs = {"image": IMAGE, "bbox_xyxy_1": BOXES, "class_1": CLASSES, "class_of_image": torch.tensor([3])}
    outputs = container(keys=None, min_box_visibility=0.4)(inputs)
    assert outputs["class_1"].tolist() == [[5, -1, -1, 8]] and outputs["class_of_image"].tolist() == [3]
    assert torch.equal(inputs["class_1"], CLASSES)
    one_hot = torch.eye(4)[None]
    assert container(min_box_visibility=0.4)(IMAGE, BOXES, one_hot)[2][0, 1].tolist() == [-1] * 4


def test_replay_and_labels_alone_are_filtered_equally(device: torch.device) -> None:
    children = A.RandomResizedCrop((6, 5), scale=(0.2, 0.5)), A.RandomHorizontalFlip(), A.RandomRotation(30.0)
    augment = container(*children, clip_boxes=True, min_box_visibility=0.3)
    images = torch.rand(8, 3, 20, 24, device=device)
    corner = 16 * torch.rand(8, 5, 2)
    boxes = torch.cat([corner, corner + 2 + 6 * torch.rand(8, 5, 2)], -1).to(device)
    classes = torch.arange(40, device=device).reshape(8, 5)
    first = augment(images, boxes, classes)
    params, (kept,) = augment._params, augment.kept_boxes
    assert 0 < kept.sum() < 40
    x, y, right, bottom = first[1][kept].unbind(-1)
    assert (x >= 0).all() and (y >= 0).all() and (right <= 5).all() and (bottom <= 6).all()
    assert (first[1][~kept] == 0).all() and (first[2][~kept] == -1).all()
    assert torch.equal(first[2][kept], classes[kept])
    alone = augment(boxes, classes, data_keys=["bbox_xyxy", "class"])
    other = container(*children, clip_boxes=True, min_box_visibility=0.3)
    replayed = other(boxes, classes, params=params, data_keys=["bbox_xyxy", "class"])
    for moved in (alone, replayed, other(images, boxes, classes, params=params)[1:]):
        torch.testing.assert_close(moved[0], first[1])
        assert torch.equal(moved[1], first[2])


def test_errors() -> None:
    with pytest.raises(ValueError, match="AugmentationSequential: expected min_box_area of 0 or more, got -1"):
        container(min_box_area=-1)
    with pytest.raises(ValueError, match="AugmentationSequential: expected min_box_visibility within 0 and 1, got 2"):
        container(min_box_visibility=2)
    with pytest.raises(TypeError, match="expected class of a signed type, .* got torch.uint8"):
        container(clip_boxes=True)(IMAGE, BOXES, CLASSES.byte())


@pytest.mark.parametrize("key", ["mask", "bbox", "bbox_xyxy", "keypoints"])
@pytest.mark.parametrize("labels", [[[1.0, 2.0], [3.0, 4.0]], [None, None], "labels", None], ids=str)
def test_labels_that_are_no_tensors_are_named(key: str, labels: Any) -> None:
    augment = A.AugmentationSequential(A.RandomHorizontalFlip(p=1.0), data_keys=["input", key])
    got = type(labels[0] if isinstance(labels, list) else labels).__name__
    with pytest.raises(TypeError, match=rf"AugmentationSequential: expected .* to be a Tensor, got {got}"):
        augment(torch.rand(2, 3, 8, 8), labels)


def listed(values: Any) -> Any:
    """Tensors and arrays in a result as lists."""
    if isinstance(values, (list, tuple)):
        return [listed(value) for value in values]
    return values.tolist() if hasattr(values, "tolist") else values


NAMES = [["a", "b", "c", "d"], ["e"]]
NUMBERS = torch.tensor([[5, 6, 7, 8], [9, 0, 0, 0]])
LISTS = [BOXES[0], BOXES[0, 2:3]]  # of which the first and the last stay, and none
ALL = BOXES.expand(2, -1, -1)


@pytest.mark.parametrize(
    "boxes, classes, left",
    [
        (LISTS, NAMES, [["a", "d"], []]),
        (LISTS, tuple(map(tuple, NAMES)), [["a", "d"], []]),
        (LISTS, [[5, 6, 7, 8], [9]], [[5, 8], []]),
        (LISTS, [np.array(row) for row in NAMES], [["a", "d"], []]),
        (LISTS, [np.array([5, 6, 7, 8], np.uint8), np.array([9], np.uint8)], [[5, 8], []]),
        (LISTS, [torch.eye(4), torch.ones(1, 4)], [[[1, 0, 0, 0], [0, 0, 0, 1]], []]),
        (LISTS, NUMBERS, [[5, -1, -1, 8], [-1, 0, 0, 0]]),
        (tuple(LISTS), NUMBERS.numpy(), [[5, -1, -1, 8], [-1, 0, 0, 0]]),
        (ALL, [list("abcd"), list("efgh")], [["a", "d"], ["e", "h"]]),
        (ALL, [torch.arange(4), torch.arange(4)], [[0, 3], [0, 3]]),
        (ALL, np.array([list("abcd"), list("efgh")]), [["a", "", "", "d"], ["e", "", "", "h"]]),
        (ALL, np.arange(8).reshape(2, 4), [[0, -1, -1, 3], [4, -1, -1, 7]]),
        (BOXES[0], list("abcd"), ["a", "d"]),
        (BOXES[0], NUMBERS[0], [5, -1, -1, 8]),
        (BOXES[0], NUMBERS[:1], [[5, -1, -1, 8]]),
        # of the images
        (LISTS, ["x", "y"], ["x", "y"]),
        (LISTS, torch.tensor([3, 4]), [3, 4]),
        (ALL, torch.eye(2), [[1, 0], [0, 1]]),
    ],
)
def test_labels_of_any_kind_are_filtered_with_their_boxes(boxes: Any, classes: Any, left: Any) -> None:
    count = 1 if isinstance(boxes, Tensor) and boxes.dim() == 2 else 2
    augment = container(min_box_visibility=0.4)
    result = augment(IMAGE.expand(count, -1, -1, -1), boxes, classes)[2]
    assert listed(result) == left and type(result) is type(classes)
    assert listed(augment(boxes, classes, data_keys=["bbox_xyxy", "class"])[1]) == left


@pytest.mark.parametrize(
    "boxes, classes, message",
    [
        (LISTS, [["a"], ["e"]], "expected class of 4 labels, as there are boxes, got 1"),
        (LISTS, [["a"] * 4], "expected class of 2 images, as there are boxes, got those of 1"),
        (LISTS, NUMBERS[:, :3], r"expected class of shape \(2, 4\), as there are boxes, got \(2, 3\)"),
        (ALL, NUMBERS[:, :3], r"expected class of shape \(2, 4\), as there are boxes, got \(2, 3\)"),
        (ALL, [["a"] * 4, ["e"]], "expected class of 4 labels, as there are boxes, got 1"),
    ],
)
def test_wrong_numbers_of_labels(boxes: Any, classes: Any, message: str) -> None:
    with pytest.raises(ValueError, match=f"AugmentationSequential: {message}"):
        container(min_box_visibility=0.4)(IMAGE.expand(2, -1, -1, -1), boxes, classes)


def test_masks_of_instances_are_filtered_with_their_boxes() -> None:
    augment = container(keys=("image", "bbox_xyxy", "mask"), min_box_visibility=0.4)
    images = IMAGE.expand(2, -1, -1, -1)
    masks = [torch.arange(1, 5)[:, None, None].expand(4, 8, 10), torch.ones(1, 8, 10, dtype=torch.int64)]
    result = augment(images, LISTS, masks)[2]
    assert [mask.shape for mask in result] == [(2, 8, 10), (0, 8, 10)] and result[0].amax((1, 2)).tolist() == [1, 4]
    of_images = augment(images, LISTS, [mask[:1] for mask in masks])[2]
    assert [mask.shape for mask in of_images] == [(1, 8, 10)] * 2
    with pytest.raises(ValueError, match=r"expected masks of \[4, 1\] instances, as there are boxes, got \[3, 1\]"):
        augment(images, LISTS, [masks[0][:3], masks[1]])

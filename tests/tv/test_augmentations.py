"""kvision.augmentation with torchvision's tv_tensors: the same classes out, boxes and masks recognized by theirs."""

from __future__ import annotations

from typing import Any

import pytest
import torch

import kvision as K

tv_tensors = pytest.importorskip("torchvision.tv_tensors", reason="torchvision is not installed")
SIZE = 8, 10
FLIP = K.augmentation.RandomHorizontalFlip(p=1.0, keepdim=True)


def sample(format: str = "XYXY") -> tuple[Any, dict[str, Any]]:
    from torchvision.transforms.v2.functional import convert_bounding_box_format

    boxes = tv_tensors.BoundingBoxes(torch.tensor([[1.0, 2, 3, 4], [0, 0, 5, 6]]), format="XYXY", canvas_size=SIZE)
    return tv_tensors.Image(torch.rand(3, *SIZE)), {
        "boxes": convert_bounding_box_format(boxes, new_format=format),
        "masks": tv_tensors.Mask(torch.randint(0, 4, (2, *SIZE))),
        "points": tv_tensors.KeyPoints(torch.tensor([[1.0, 2], [3, 4]]), canvas_size=SIZE),
        "labels": torch.tensor([1, 2]),
        "name": "x",
    }


@pytest.mark.parametrize("format", ["XYXY", "XYWH", "CXCYWH"])
@pytest.mark.parametrize("nested", [True, False])
def test_a_flip_gives_what_torchvision_gives(format: str, nested: bool) -> None:
    from torchvision.transforms import v2

    image, target = sample(format)
    arguments: Any = (image, target) if nested else ({"image": image, **target},)
    expected = v2.RandomHorizontalFlip(p=1.0)(*arguments)
    for data_keys in (("input",), None):
        augment = K.augmentation.AugmentationSequential(FLIP, data_keys=data_keys)
        result = augment(*arguments)
        assert_same(result, expected)
        assert_same(augment.inverse(*(result if nested else (result,))), arguments if nested else arguments[0])


def assert_same(result: Any, expected: Any) -> None:
    if isinstance(expected, dict):
        assert list(result) == list(expected)
        for name in expected:
            assert_same(result[name], expected[name])
    elif isinstance(expected, (tuple, list)):
        for r, e in zip(result, expected, strict=True):
            assert_same(r, e)
    elif isinstance(expected, torch.Tensor):
        assert type(result) is type(expected) and result.dtype == expected.dtype
        assert torch.allclose(result.as_subclass(torch.Tensor), expected.as_subclass(torch.Tensor), atol=1e-5)
        for name in ("format", "canvas_size"):
            assert getattr(result, name, None) == getattr(expected, name, None)
    else:
        assert result == expected


def test_classes_of_single_augmentations_and_sizes_of_results() -> None:
    image, target = sample()
    for augment in (FLIP, K.augmentation.ColorJitter(0.1, keepdim=True), K.augmentation.ImageSequential(FLIP)):
        assert type(augment(image)) is tv_tensors.Image and augment(image).shape == image.shape
    resize = K.augmentation.AugmentationSequential(K.augmentation.Resize((16, 30), align_corners=False))
    boxes = tv_tensors.BoundingBoxes([[1, 2, 3, 4]], format="XYXY", canvas_size=SIZE)  # of integers
    result, moved = resize(image[None], boxes)
    assert moved.canvas_size == (16, 30) and moved.tolist() == [[3, 4, 9, 8]] and moved.dtype == torch.int64
    image, moved = K.augmentation.AugmentationSequential(FLIP, data_keys=["input", "bbox_xyxy"])(image, target["boxes"])
    assert type(moved) is tv_tensors.BoundingBoxes and moved[0].tolist() == [7, 2, 9, 4]
    plain_mask = {"image": image, "mask": torch.eye(10)[None, :8], "boxes": target["boxes"]}
    assert torch.equal(K.augmentation.AugmentationSequential(FLIP)(plain_mask)["mask"], plain_mask["mask"].flip(-1))
    videos = tv_tensors.Video(torch.rand(2, 3, 1, *SIZE))
    result = K.augmentation.VideoSequential(FLIP, data_format="BTCHW")(videos)
    assert type(result) is tv_tensors.Video and torch.equal(result, videos.flip(-1))


def test_what_would_be_wrong_is_refused() -> None:
    image, target = sample()
    augment = K.augmentation.AugmentationSequential(FLIP)
    with pytest.raises(TypeError, match=r"expected an image, got tv_tensors\.Mask"):
        FLIP(target["masks"])
    with pytest.raises(TypeError, match="use VideoSequential"):
        FLIP(tv_tensors.Video(torch.rand(2, 3, *SIZE)))
    rotated = tv_tensors.BoundingBoxes(torch.rand(1, 5), format="CXCYWHR", canvas_size=SIZE)
    with pytest.raises(TypeError, match="CXCYWHR; use kvision.tv"):
        augment(image, rotated)
    with pytest.raises(ValueError, match="canvas_size of the image"):
        augment(tv_tensors.Image(torch.rand(3, 4, 4)), target["boxes"])
    with pytest.raises(ValueError, match="format of the data key bbox_xywh"):
        augment(image, target["boxes"], data_keys=["input", "bbox_xywh"])
    with pytest.raises(ValueError, match="expected an image"):
        augment(target["boxes"], target["masks"])


def test_lists_of_images_of_different_sizes() -> None:
    """Each image and its labels are of their classes, and a batch that they become is of that of the first image."""
    images = [tv_tensors.Image(torch.rand(3, 8, 10)), tv_tensors.Image(torch.rand(3, 6, 7))]
    boxes = [
        tv_tensors.BoundingBoxes(torch.rand(n, 4), format="XYXY", canvas_size=tuple(image.shape[1:]))
        for n, image in zip((2, 0), images)
    ]
    masks = [tv_tensors.Mask(torch.randint(0, 4, (n, *image.shape[1:]))) for n, image in zip((1, 3), images)]
    flip = K.augmentation.RandomHorizontalFlip(p=1.0)
    for augment in (flip, K.augmentation.ImageSequential(flip)):
        results = augment(images)
        assert all(type(y) is tv_tensors.Image and torch.equal(y, x.flip(-1)) for x, y in zip(images, results))
    crop = K.augmentation.RandomResizedCrop((4, 5))
    for augment in (crop, K.augmentation.ImageSequential(crop)):
        assert type(augment(images)) is tv_tensors.Image
    keys = ["input", "bbox_xyxy", "mask"]
    augment = K.augmentation.AugmentationSequential(flip, data_keys=keys)
    for y, of_boxes, of_masks, x, before in zip(*augment(images, boxes, masks), images, boxes):
        assert_same(y, tv_tensors.Image(x.flip(-1)))
        assert type(of_masks) is tv_tensors.Mask and type(of_boxes) is tv_tensors.BoundingBoxes
        assert of_boxes.shape == before.shape and of_boxes.canvas_size == tuple(x.shape[1:])
    y, of_boxes, _ = K.augmentation.AugmentationSequential(crop, data_keys=keys)(images, boxes, masks)
    assert type(y) is tv_tensors.Image and [b.canvas_size for b in of_boxes] == [(4, 5)] * 2
    boxes[1] = tv_tensors.BoundingBoxes(torch.rand(1, 4), format="XYXY", canvas_size=(8, 10))
    with pytest.raises(ValueError, match=r"canvas_size of the image, \(6, 7\), got \(8, 10\)"):
        augment(images, boxes, masks)

"""Windows that follow from boxes, of images in lists whose results keep their sizes: those of each image alone."""

from __future__ import annotations

import pytest
import torch

from augmentation.container.test_list_launches import Launches, calls
from augmentation.test_lists import SMALL, assert_as_alone, assert_same, comparison, pictures, seeds_of
from kvision import augmentation as A
from kvision.augmentation.engine.list_chains import ChainParts
from kvision.augmentation.engine.list_runs import ListParts

pytestmark = pytest.mark.filterwarnings("ignore:.*this call has no boxes")

WINDOWS = {
    "overlap": lambda: A.RandomIoUCrop(p=0.7),
    "overlap without antialias": lambda: A.RandomIoUCrop(antialias=False),
    "near": lambda: A.RandomCropNearBBox(p=0.7),
    "zoom out": lambda: A.RandomZoomOut(antialias=False),
}


def labels(device):
    return [torch.rand(n, 4, device=device).cumsum(1) * 5 for n in (2, 0, 1, 3)]


@pytest.mark.parametrize("dtype", [torch.float32, torch.uint8], ids=str)
@pytest.mark.parametrize("name", WINDOWS)
def test_windows_of_a_list(name, dtype, device):
    augment, images = WINDOWS[name](), pictures(device, SMALL, dtype)
    assert_as_alone(augment, images)
    if augment.reads_labels is None:
        return
    boxes, seeds = labels(device), seeds_of(images)
    results, same = augment(images, seed=seeds, boxes=boxes), comparison(augment, images[0].device)
    again = augment(images, params=augment._params)
    for b, x in enumerate(images):
        alone = augment(x[None], seed=seeds[b : b + 1], boxes=[boxes[b]])[0]
        assert same(results[b], alone) and same(again[b], alone)


PIPELINES = {
    "first": lambda crop: (crop, A.RandomHorizontalFlip(), A.SmallestMaxSize(20)),
    "behind colors": lambda crop: (A.ColorJitter(0.2, 0.2), crop, A.RandomAffine(10.0)),
    "before a crop": lambda crop: (crop, A.SmallestMaxSize(20), A.RandomCrop((12, 14)), A.RandomInvert()),
}


@pytest.mark.parametrize("pipeline", PIPELINES)
@pytest.mark.parametrize("name", WINDOWS)
def test_pipelines_of_detectors(name, pipeline, device):
    augment = A.AugmentationSequential(*PIPELINES[pipeline](WINDOWS[name]()), data_keys=["input", "bbox_xyxy", "mask"])
    images, boxes = pictures(device, SMALL), labels(device)
    masks, seeds = [(x[:1] > 0.5).byte() for x in images], seeds_of(images)
    results, moved, of_masks = augment(images, boxes, masks, seed=seeds)
    assert type(augment._record.parts) is ListParts
    same = comparison(augment, images[0].device)
    again = augment(images, boxes, masks, params=augment._params)
    for b, x in enumerate(images):
        y, own, mask = augment(x[None], [boxes[b]], [masks[b]], seed=seeds[b : b + 1])
        assert same(results[b], y[0]) and same(again[0][b], y[0])
        for of_list, replayed, alone in zip((moved, of_masks), again[1:], (own, mask)):
            assert_same(of_list[b], alone[0])
            assert_same(replayed[b], alone[0])


def test_windows_behind_what_moves_boxes(device):
    """Boxes are then those of each image at that step."""
    augment = A.AugmentationSequential(
        A.RandomHorizontalFlip(), A.RandomIoUCrop(), A.RandomCropNearBBox(), data_keys=["input", "bbox_xyxy"]
    )
    images, boxes = pictures(device, SMALL), labels(device)
    seeds = seeds_of(images)
    results, moved = augment(images, boxes, seed=seeds)
    for b, x in enumerate(images):
        y, own = augment(x[None], [boxes[b]], seed=seeds[b : b + 1])
        assert torch.equal(results[b], y[0]) and torch.equal(moved[b], own[0])


CONTAINERS = {
    "inside": lambda: [
        A.ImageSequential(A.RandomVerticalFlip(), A.RandomIoUCrop()),
        A.ImageSequential(A.ImageSequential(A.RandomCropNearBBox((0.1, 0.3)), A.RandomInvert())),
    ],
    "in choices": lambda: [
        A.OneOf(A.RandomIoUCrop(), A.RandomAffine(20.0), A.RandomCropNearBBox((0.1, 0.3))),
        A.RandomApply([A.RandomOrder(A.RandomIoUCrop(), A.Transpose(p=1.0))]),
    ],
    "expanded": lambda: [A.RandomRotation(30.0, p=0.7, expand=True), A.RandomIoUCrop()],
    "behind a module inside": lambda: [
        A.AugmentationSequential(
            A.RandomAffine(20.0, (0.3, 0.3)), torch.nn.AvgPool2d(3, 1, 1), A.RandomIoUCrop(), clip_boxes="each"
        )
    ],
    "behind a module": lambda: [
        A.RandomHorizontalFlip(),
        torch.nn.AvgPool2d(3, 1, 1),
        A.RandomVerticalFlip(),
        A.OneOf(A.RandomIoUCrop(), A.ImageSequential(A.Transpose(), A.CropNonEmptyMaskIfExists(9, 8))),
        A.ImageSequential(A.RandomHorizontalFlip(), A.RandomCropNearBBox((0.1, 0.3)), A.MaskDropout(p=1.0)),
    ],
}


@pytest.mark.parametrize("name", CONTAINERS)
def test_windows_in_containers(name, device):
    """They read the boxes and masks that each image has at their step, also where these move image by image before them."""
    augment = A.AugmentationSequential(*CONTAINERS[name](), data_keys=["input", "bbox_xyxy", "mask"])
    images, boxes = pictures(device, (*SMALL, *SMALL)), [*labels(device), *labels(device)]
    masks, seeds = [(x[:1] > 0.9).byte() for x in images], seeds_of(images)
    outputs, same = augment(images, boxes, masks, seed=seeds), comparison(augment, images[0].device)
    assert type(augment._record.parts) is ChainParts
    matrices, kept, back = augment.transform_matrix, augment.kept_boxes, augment.inverse(*outputs)
    again = augment(images, boxes, masks, params=augment._params)
    for b, x in enumerate(images):
        own = augment(x[None], [boxes[b]], [masks[b]], seed=seeds[b : b + 1])
        own_back = augment.inverse(*own)
        assert same(outputs[0][b], own[0][0]) and same(again[0][b], own[0][0]) and same(back[0][b], own_back[0][0])
        for of_list, alone in ((outputs, own), (again, own), (back, own_back)):
            assert_same(of_list[1][b], alone[1][0])
            assert_same(of_list[2][b], alone[2][0])
        assert_same(matrices[b], augment.transform_matrix[0])
        assert len(kept) == len(augment.kept_boxes) == 1 and torch.equal(kept[0][b], augment.kept_boxes[0][0])


@pytest.mark.parametrize("name", [name for name in CONTAINERS if "module" not in name])
def test_calls_of_windows_in_containers(name, backend):
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    augment, counts = A.AugmentationSequential(*CONTAINERS[name](), data_keys=["input", "bbox_xyxy"]), []
    for number in (40, 40, 120):  # the first call makes constants
        images = pictures("cpu", [(24 + i % 17, 45 - i % 19) for i in range(number)])
        boxes = [torch.rand(i % 3, 4).cumsum(1) * 5 for i in range(number)]
        counts.append(calls(augment, images, boxes, seed=seeds_of(images)))
    assert counts[1] == counts[2]


def test_windows_of_one_size_behind_colors(device):
    images, boxes = pictures(device, SMALL), labels(device)
    seeds = seeds_of(images)
    for crop in (A.RandomSizedBBoxSafeCrop(10, 12), A.AtLeastOneBBoxRandomCrop(10, 12)):
        augment = A.AugmentationSequential(A.RandomInvert(), crop, data_keys=["input", "bbox_xyxy"])
        results, moved = augment(images, boxes, seed=seeds)
        same = comparison(augment, images[0].device)
        for b, x in enumerate(images):
            y, own = augment(x[None], [boxes[b]], seed=seeds[b : b + 1])
            assert same(results[b], y[0]) and torch.equal(moved[b], own[0])
    small = [*images, torch.rand(3, 9, 30, device=device)]
    with pytest.raises(ValueError, match=r"expected images of at least \(10, 12\), got \(9, 30\)"):
        augment(small, [*boxes, boxes[1]])
    with pytest.raises(ValueError, match=r"expected images of at least \(10, 12\), got \(9, 30\)"):
        A.AtLeastOneBBoxRandomCrop(10, 12)(small, boxes=[*boxes, boxes[1]])


@pytest.mark.parametrize("name", ["alone", "one crop", "two chances"])
def test_windows_by_chance_follow_from_the_boxes_of_their_image(name, device):
    """Images for which crops are chosen differently are runs of their own, which read their own boxes."""
    crop = A.AtLeastOneBBoxRandomCrop(10, 12, p=0.5)
    children = {
        "alone": [crop],
        "one crop": [A.RandomInvert(), crop, A.RandomHorizontalFlip()],
        "two chances": [A.RandomIoUCrop(), A.Transpose(p=0.5)],
    }[name]
    augment = A.AugmentationSequential(*children, data_keys=["input", "bbox_xyxy"])
    images, boxes = pictures(device, (*SMALL, *SMALL)), [*labels(device), *labels(device)]
    seeds, same = seeds_of(images), comparison(augment, images[0].device)
    results, moved = augment(images, boxes, seed=seeds)
    assert len({y.shape == x.shape for x, y in zip(images, results)}) == 2
    for b, x in enumerate(images):
        y, own = augment(x[None], [boxes[b]], seed=seeds[b : b + 1])
        assert same(results[b], y[0]) and torch.equal(moved[b], own[0])
        if name == "alone":
            alone = crop(x[None], seed=seeds[b : b + 1], boxes=[boxes[b]])
            assert same(crop(images, seed=seeds, boxes=boxes)[b], alone[0])


@pytest.mark.parametrize("count", [1, 3, 4])
def test_layers_behind_windows_that_follow_from_boxes(count, device):
    """They are as many as the images, whatever the number that a plan is made with."""
    augment = A.ImageSequential(A.RandomSizedBBoxSafeCrop(9, 11, 0.2, p=0.5), A.RandomGaussianIllumination(p=1.0))
    images = pictures(device, SMALL)[:count]
    results, same = augment(images, seed=seeds_of(images)), comparison(augment, images[0].device)
    for b, x in enumerate(images):
        assert same(results[b], augment(x[None], seed=seeds_of(images)[b : b + 1])[0])


def test_gradients_of_antialiased_windows(device):
    for augment in (A.RandomIoUCrop(), A.ImageSequential(A.RandomIoUCrop(), A.ColorJitter(0.2, 0.2, p=1.0))):
        images = [x.requires_grad_() for x in pictures(device, SMALL)]
        seeds, boxes = seeds_of(images), labels(device)
        options = {"boxes": boxes} if isinstance(augment, A.RandomIoUCrop) else {}
        gradients = torch.autograd.grad(sum(y.square().sum() for y in augment(images, seed=seeds, **options)), images)
        for b, x in enumerate(images):
            own = {"boxes": [boxes[b]]} if options else {}
            alone = augment(x[None], seed=seeds[b : b + 1], **own).square().sum()
            assert torch.allclose(gradients[b], torch.autograd.grad(alone, x)[0], atol=1e-4)


@pytest.mark.parametrize("name", WINDOWS)
def test_calls_of_operators(name, backend):
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    images = pictures("cpu", [(24 + i % 17, 45 - i % 19) for i in range(40)])
    augment = A.ImageSequential(A.RandomInvert(), WINDOWS[name](), A.ColorJitter(0.2, 0.2))
    assert calls(augment, images, seed=seeds_of(images)) <= 4


@pytest.mark.parametrize("options", [{}, {"ignore_values": [2], "ignore_channels": [0]}], ids=["all", "some"])
@pytest.mark.parametrize("numbers", [(1,), (2, 0, 1)], ids=str)
def test_windows_by_masks_take_as_many_launches_for_more_images(numbers, options, device, backend):
    crop = A.CropNonEmptyMaskIfExists(12, 14, **options)
    augment = A.AugmentationSequential(A.RandomAffine(20.0), crop, data_keys=["input", "mask", "mask"])
    counts = []
    for number in (3, 3, 9):  # the first call makes constants
        images = pictures(device, [(20 + 3 * (i % 4), 24 + 5 * (i % 3)) for i in range(number)])
        objects = [
            (torch.rand(numbers[i % len(numbers)], *x.shape[1:], device=device) > 0.99).long()
            for i, x in enumerate(images)
        ]
        marks = [2.0 * (torch.rand(1, *x.shape[1:], device=device) > 0.99) for x in images]
        with Launches() as launches:
            results = augment(images, objects, marks, seed=seeds_of(images))
        counts.append(launches.count)
    assert counts[1] == counts[2] or backend == "reference"
    for b, x in enumerate(images):
        alone = augment(x[None], objects[b][None], marks[b][None], seed=seeds_of(images)[b : b + 1])
        assert all(torch.equal(of_list[b], own[0]) for of_list, own in zip(results, alone, strict=True))

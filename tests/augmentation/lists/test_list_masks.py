"""Masks of lists of images: by the launches of a batch they become what those of each image become alone."""

import warnings

import pytest
import torch

from augmentation.container.test_list_launches import SIZES as SIZES_OF_OBJECTS
from augmentation.container.test_list_launches import Launches, calls
from augmentation.test_lists import SIZES, pictures, seeds_of
from kvision import augmentation as A

AUGMENTATIONS = {
    "colors": lambda: [A.ColorJitter(0.2, 0.2, p=1.0)],
    "flip": lambda: [A.RandomHorizontalFlip()],
    "rotation": lambda: [A.RandomRotation(30.0, p=0.7)],
    "affine, border": lambda: [A.RandomAffine(20.0, (0.1, 0.1), padding_mode="border", p=1.0)],
    "perspective": lambda: [A.RandomPerspective(p=1.0)],
    "transpose": lambda: [A.Transpose(p=1.0)],
    "transpose some": lambda: [A.Transpose()],
    "chain": lambda: [A.RandomVerticalFlip(), A.RandomAffine(20.0), A.ColorJitter(0.2, 0.2), A.Transpose(p=1.0)],
    "applied to some": lambda: [A.RandomRotation(30.0, p=1.0, p_batch=0.5), A.RandomHorizontalFlip()],
    "erased": lambda: [A.RandomErasing(p=0.7)],
    "erased, then moved": lambda: [A.RandomErasing(), A.RandomAffine(20.0), A.RandomErasing(p=1.0), A.Transpose(p=1.0)],
    "erased with noise": lambda: [
        A.RandomErasing(value="random", p=0.7),
        A.CoarseDropout(fill="random", fill_mask=1.0),
    ],
    "dropped": lambda: [A.RandomHorizontalFlip(), A.CoarseDropout(fill=[0.1, 0.2, 0.3]), A.Transpose(p=1.0)],
    "dropped, masks kept": lambda: [A.RandomHorizontalFlip(), A.CoarseDropout(fill_mask=None, p=1.0)],
    "grid": lambda: [A.GridDropout(random_offset=True, p=0.7)],
    "lines": lambda: [A.GridMask(rotation_range=(0.0, 0.5), fill_mask=1.0, p=0.7)],
    "objects": lambda: [A.MaskDropout((1, 9), 0.5, p=0.7)],
    "objects, masks kept": lambda: [A.MaskDropout((1, 9), 0.5, fill_mask=None, p=0.7)],
    "objects, noise": lambda: [A.MaskDropout((1, 9), "random", p=0.7)],
    "late crop": lambda: [
        A.RandomHorizontalFlip(),
        A.ColorJitter(0.2, 0.2),
        A.RandomResizedCrop((24, 20)),
        A.RandomErasing(),
    ],
    "late resize": lambda: [A.RandomAffine(20.0), A.Resize((30, 26), antialias=True), A.CoarseDropout(p=1.0)],
    "late padding": lambda: [A.LongestMaxSize(40), A.RandomVerticalFlip(), A.PadTo((48, 44)), A.RandomAffine(20.0)],
    "map": lambda: [A.RandomElasticTransform((5, 5), (2.0, 2.0), p=0.7)],
    "map of a formula": lambda: [A.RandomHorizontalFlip(), A.GridDistortion(p=0.7), A.RandomErasing(p=1.0)],
    "map of a crop": lambda: [A.RandomHorizontalFlip(), A.CenterCrop((24, 20)), A.RandomThinPlateSpline(p=1.0)],
    "objects, another value": lambda: [A.MaskDropout((1, 9), 0.5, fill_mask=-1.0, p=0.7)],
}
TYPES = (torch.uint8, torch.bool, torch.int8, torch.int16, torch.int32, torch.int64, torch.float32, torch.float16)
READINGS = {"default": {}, "fill": {"mask": {"fill_value": 1}}, "mode": {"mask": {"resample": "bilinear"}}}


def masks_of(images, dtype, number=1):
    """Some of the integers have bits that are NaN as floating-point numbers."""
    masks = []
    for i, x in enumerate(images):
        own = (torch.rand(number, *x.shape[1:]) < 0.3) * (1 + i % 3)
        masks.append((own if dtype == torch.uint8 else own * (-1) ** i).to(dtype).to(x.device))
    return masks


@pytest.mark.parametrize("reading", READINGS)
@pytest.mark.parametrize("dtype", TYPES, ids=str)
@pytest.mark.parametrize("name", AUGMENTATIONS)
def test_masks_follow_as_alone(name, dtype, reading, backend, device):
    if dtype == torch.uint8 and "another" in name:
        pytest.skip("bytes have no such value")
    images, augmentations = pictures(device), AUGMENTATIONS[name]()
    augment = A.AugmentationSequential(*augmentations, data_keys=["input", "mask"], extra_args=READINGS[reading])
    masks, seeds = masks_of(images, dtype, 1 + ("objects" not in name)), seeds_of(images)
    given = [m.clone() for m in masks]
    _, moved = augment(images, masks, seed=seeds)
    assert all(map(torch.equal, masks, given))
    for b, (x, mask) in enumerate(zip(images, masks)):
        _, own = augment(x[None], mask[None], seed=seeds[b : b + 1])
        assert moved[b].dtype == dtype
        # The reference blurs and multiplies by torch, whose sums depend on the number of images: ties fall otherwise.
        is_rounded = backend == "reference" and name.startswith("map")
        assert (moved[b] != own[0]).double().mean() <= (0.02 if is_rounded else 0)


@pytest.mark.parametrize("dtype", [torch.uint8, torch.bool, torch.int64, torch.float32], ids=str)
@pytest.mark.parametrize("name", [name for name in AUGMENTATIONS if "some" not in name and "value" not in name])
def test_launches_do_not_depend_on_the_number_of_masks(name, dtype, backend):
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    augment, counts = A.AugmentationSequential(*AUGMENTATIONS[name](), data_keys=["input", "mask"]), []
    images = pictures("cpu", SIZES * 2)
    masks = masks_of(images, dtype)
    for count in (3, 3, len(images)):  # the first one makes constants
        with Launches() as counted:
            augment(images[:count], masks[:count], seed=0)
        counts.append(counted.count)
    assert counts[2] <= counts[1]


@pytest.mark.tracing
@pytest.mark.parametrize("name", ["map", "dropped", "late resize"])
def test_graphs_have_masks(name):
    torch._dynamo.reset()
    augment = A.AugmentationSequential(*AUGMENTATIONS[name](), data_keys=["input", "mask"])
    images = pictures("cpu")[:2]
    masks = masks_of(images, torch.uint8)
    compiled = torch.compile(augment, fullgraph=True, backend="aot_eager")
    for of_graph, eager in zip(compiled(images, masks, seed=3), augment(images, masks, seed=3)):
        for a, b in zip(of_graph, eager, strict=True):
            assert torch.allclose(a.double(), b.double(), atol=1e-4)


def test_masks_without_channels_get_one(device):
    images = pictures(device)
    masks = [m[0] for m in masks_of(images, torch.uint8)]
    augment = A.AugmentationSequential(A.RandomRotation(30.0, p=1.0), data_keys=["input", "mask"])
    _, moved = augment(images, masks, seed=3)
    _, expected = augment(images, [m[None] for m in masks], seed=3)
    assert all(map(torch.equal, moved, expected)) and moved[0].dim() == 3


COUNTS = {"regions": (1, 1, 0, 1, 1, 1), "both": (1, 2, 0, 3, 1, 2), "instances": (2, 3, 4, 2, 5, 2)}


@pytest.mark.parametrize("fill", [0.5, "random"])
@pytest.mark.parametrize("counts", COUNTS)
def test_objects_of_masks_of_several_types_and_numbers(counts, fill, device, backend):
    images, types = pictures(device, SIZES_OF_OBJECTS), TYPES[: len(SIZES_OF_OBJECTS)]
    masks = [
        m.repeat(n, 1, 1).cumsum(-1).to(dtype)
        for m, n, dtype in zip(masks_of(images, torch.uint8), COUNTS[counts], types)
    ]
    drop, seeds = A.MaskDropout((1, 3), fill, p=0.8), seeds_of(images)
    results = drop(images, masks=masks, seed=seeds)
    for b, x in enumerate(images):
        alone = drop(x[None], masks=[masks[b]], seed=seeds[b : b + 1])
        assert torch.equal(results[b], alone[0])
    if backend != "reference":
        assert calls(drop, images, masks=masks, seed=seeds) <= 5 + (counts == "both")


def test_masks_that_do_not_fit_are_named():
    images = pictures("cpu")
    augment = A.AugmentationSequential(A.RandomRotation(30.0), data_keys=["input", "mask"])
    masks = masks_of(images, torch.uint8)
    for given in (masks[:2], masks[::-1]):
        with pytest.raises(ValueError, match="mask"):
            augment(images, given)


@pytest.mark.parametrize("name", [name for name in AUGMENTATIONS if "objects" not in name])
def test_masks_of_several_numbers_follow_as_alone(name, device):
    images = pictures(device)
    augment = A.AugmentationSequential(*AUGMENTATIONS[name](), data_keys=["input", "mask"])
    masks = [m.repeat(i, 1, 1) for i, m in enumerate(masks_of(images, torch.uint8))]
    for seed in range(3):
        seeds = seeds_of(images) + seed
        _, moved = augment(images, masks, seed=seeds)
        for b, (x, mask) in enumerate(zip(images, masks)):
            assert torch.equal(moved[b], augment(x[None], [mask], seed=seeds[b : b + 1])[1][0])


def test_masks_of_several_types_and_numbers_follow_one_by_one(device):
    images, seeds = pictures(device), seeds_of(pictures(device))
    masks = [m.repeat(i, 1, 1) for i, m in enumerate(masks_of(images, torch.uint8))]
    augment = A.AugmentationSequential(A.RandomRotation(30.0, p=1.0), data_keys=["input", "mask"])
    _, moved = augment(images, masks, seed=seeds)
    for b, (x, mask) in enumerate(zip(images, masks)):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            assert torch.equal(moved[b], augment(x[None], [mask], seed=seeds[b : b + 1])[1][0])


@pytest.mark.parametrize("per_channel", [False, True])
def test_dropped_pixels_of_masks_are_those_of_each_image_alone(per_channel, device, backend):
    images = pictures(device, [(20 + i, 34 - i) for i in range(8)])
    masks = [(torch.rand(b % 3, *x.shape[1:], device=device) < 0.5).byte() for b, x in enumerate(images)]
    drop = A.PixelDropout(0.3, per_channel, mask_drop_value=7, p=0.7)
    augment = A.AugmentationSequential(A.RandomHorizontalFlip(), drop, data_keys=["image", "mask"])
    results, moved = augment(images, masks, seed=seeds_of(images))
    params = augment._params
    assert {n for m in moved for n in m.unique().tolist()} == {0, 1, 7}
    for b, x in enumerate(images):
        own, mask = augment(x[None], [masks[b]], seed=seeds_of(images)[b : b + 1])
        assert torch.equal(own[0], results[b]) and torch.equal(mask[0], moved[b])
    again, masks_again = augment(images, masks, params=params)
    assert all(map(torch.equal, again, results)) and all(map(torch.equal, masks_again, moved))
    if backend != "reference":
        assert calls(augment, images[:4], masks[:4], seed=0) == calls(augment, images, masks, seed=0)

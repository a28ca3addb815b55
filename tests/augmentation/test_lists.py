"""Lists of images of different sizes in containers: draws, labels, parameters and the inverse are those of each image."""

from __future__ import annotations

import os
import random

import pytest
import torch
from torch import Tensor

from benchmarks.sample_calls.augmentations import IMAGES
from kvision import augmentation as A
from kvision._backend import current_backend
from op_tests import assert_close

THOROUGH = os.environ.get("HYPOTHESIS_PROFILE") == "thorough"
SOME_IMAGES = IMAGES if THOROUGH else random.Random(2).sample(IMAGES, len(IMAGES) // 10)
SIZES = ((40, 56), (64, 31), (33, 33), (90, 70))


def pictures(device, sizes=SIZES, dtype=torch.float32):
    images = [torch.rand(3, h, w, device=device) for h, w in sizes]
    return [(255 * x).to(dtype) if dtype == torch.uint8 else x.to(dtype) for x in images]


class Halved(A.IntensityAugmentationBase2D):
    """A user's augmentation, which takes a call per size."""

    def apply_transform(self, input, params, flags, transform=None):
        return input / 2


def chain(first=None, **options):
    return A.AugmentationSequential(
        first or A.RandomResizedCrop((24, 20), scale=(0.3, 0.9)),
        A.RandomHorizontalFlip(),
        A.ColorJitter(0.2, 0.2, 0.2, 0.1),
        A.Normalize(0.4, 0.3),
        **options,
    )


STARTS = {
    "crop": lambda: A.RandomResizedCrop((24, 20), scale=(0.3, 0.9)),
    "antialiased crop": lambda: A.RandomResizedCrop((24, 20), antialias=True),
    "window": lambda: A.RandomCrop((24, 20)),
    "padded window": lambda: A.RandomCrop((70, 70), padding=3, pad_if_needed=True),
    "resize": lambda: A.Resize((24, 20)),
    "antialiased resize": lambda: A.Resize((24, 20), antialias=True),
    "center": lambda: A.CenterCrop((24, 20)),
    "pad": lambda: A.PadTo((50, 50)),
}


@pytest.mark.parametrize("start", STARTS)
def test_each_image_is_augmented_as_by_itself(start, device):
    augment, images = chain(STARTS[start]()), pictures(device)
    seeds = torch.arange(len(SIZES), device=device) + 7
    results = augment(images, seed=seeds)
    for b, x in enumerate(images):
        assert_close(results[b : b + 1], augment(x[None], seed=seeds[b : b + 1]), 1e-4, 1e-4)


@pytest.mark.parametrize("dtype", [torch.float32, torch.uint8], ids=str)
def test_equal_sizes_draw_what_a_batch_draws(dtype, device):
    images = pictures(device, [(40, 56)] * 5, dtype)
    augment = A.AugmentationSequential(A.RandomResizedCrop((24, 20)), A.RandomHorizontalFlip(), A.ColorJitter(0.2, 0.2))
    for options in ({"seed": 3}, {}):
        torch.manual_seed(0)
        results = augment(images, **options)
        torch.manual_seed(0)
        assert_close(results, augment(torch.stack(images), **options), 1e-4, 1 if dtype == torch.uint8 else 1e-4)


def test_labels_follow_their_image(device):
    images = pictures(device)
    masks = [torch.randint(0, 9, (n, *x.shape[1:]), device=device) for n, x in zip((1, 2, 0, 3), images)]
    boxes = [torch.rand(n, 4, device=device).cumsum(1) * 9 for n in (2, 0, 1, 3)]
    points = [torch.rand(n, 2, device=device) * 30 for n in (1, 3, 0, 2)]
    augment = chain(data_keys=["input", "mask", "bbox_xyxy", "keypoints"])
    seeds = torch.arange(len(SIZES), device=device)
    results = augment(images, masks, boxes, points, seed=seeds)
    matrices = augment.transform_matrix
    for b, x in enumerate(images):
        alone = augment(x[None], masks[b][None], boxes[b][None], points[b][None], seed=seeds[b : b + 1])
        for of_list, of_image in zip(results[1:], alone[1:]):
            assert_close(of_list[b], of_image[0], 1e-4, 1e-3)
        assert_close(matrices[b : b + 1], augment.transform_matrix, 1e-4, 1e-4)


def test_parameters_repeat_a_call_and_the_inverse_gives_each_size(device):
    augment, images = chain(A.RandomResizedCrop((24, 20))), pictures(device)
    results = augment(images)
    params = augment._params
    assert params[0].data["src"].shape == (len(SIZES), 4, 2)
    assert params[0].data["input_size"].tolist() == [list(size) for size in SIZES]
    back = augment.inverse(results)
    assert [tuple(x.shape) for x in back] == [(3, *size) for size in SIZES]
    known = augment.known_pixels(results)
    assert [tuple(x.shape) for x in known] == [(1, *size) for size in SIZES]
    assert all(torch.equal(a, b) for a, b in zip(known, augment.known_pixels(results, params=params)))
    assert_close(augment(images, params=params), results, 1e-4, 1e-4)


def test_gradients_reach_each_image(device):
    images = [x.requires_grad_() for x in pictures(device)]
    gradients = torch.autograd.grad(chain()(images).square().sum(), images)
    assert all(g.shape == x.shape and g.abs().sum() > 0 for g, x in zip(gradients, images))


def test_plans_do_not_depend_on_the_sizes(device):
    augment = chain()
    counts = set()
    for i in range(40):
        augment(pictures(device, [(40 + i, 50), (60, 70 - i)]))
        counts.add(len(augment._plans._plans))
    assert len(counts) == 1


@pytest.mark.parametrize(
    "augment",
    [
        A.RandomAffine(20.0),
        A.RandomErasing(),
        A.RandomCrop((9, 7)),
        A.OneOf(A.RandomZoomOut(), A.RandomPerspective()),
        chain(),
    ],
    ids=lambda augment: type(augment).__name__,
)
def test_a_list_has_no_vmap_whatever_is_drawn(augment, backend):
    if backend == "reference":
        pytest.skip("plain torch has one")
    with pytest.raises(NotImplementedError, match="lists of images have no vmap"):
        torch.func.vmap(lambda x: augment([x, x[:, :12]], seed=1)[0])(torch.rand(2, 3, 20, 24))


def test_what_has_no_list_is_refused():
    images = pictures("cpu")
    for augment, message in (
        (
            A.AugmentationSequential(A.RandomMixUpV2(), A.Resize((24, 24))),
            "batch for RandomMixUpV2, which mixes samples",
        ),
        (A.RandomMosaic((24, 24)), "list of 4 images"),
        (A.RandomHorizontalFlip3D(), "list of 4 images"),
        (A.VideoSequential(A.Resize((24, 24)), data_format="BTCHW"), "list of 4 images"),
    ):
        with pytest.raises(TypeError, match=message):
            augment(images)
    for augment in (A.RandomHorizontalFlip(), A.ImageSequential(A.RandomHorizontalFlip())):
        with pytest.raises(TypeError, match=r"a list of images \(C, H, W\), .* got a list of 2 images; stack them"):
            augment([torch.rand(2, 3, 4, 5)] * 2)
        with pytest.raises(ValueError, match="one number of channels"):
            augment([torch.rand(3, 4, 5), torch.rand(1, 4, 5)])
        with pytest.raises(ValueError, match="seeds of 4 samples, got 3"):
            augment(images, seed=torch.arange(3))
    with pytest.raises(TypeError, match="or of int16 or uint16 for geometric classes, got torch.int16"):
        A.RandomInvert()([x.short() for x in images])
    labeled = A.AugmentationSequential(A.RandomHorizontalFlip(), data_keys=["input", "bbox_xyxy"])
    with pytest.raises(ValueError, match="expected bbox_xyxy of 4 images, got those of 1"):
        labeled(images, [torch.rand(1, 4)])


# --- image by image -------------------------------------------------------------------------------------------------

SMALL = ((16, 20), (24, 31), (16, 20), (27, 27))  # two of one size, which are a batch


def seeds_of(images):
    return torch.arange(len(images), device=images[0].device) + 5


def close(a, b):
    """Up to rounding."""
    limit = (
        1 if a.dtype == torch.uint8 else 2e-5 if a.dtype.itemsize > 2 else 2e-3 if a.dtype == torch.float16 else 1e-2
    )
    return a.shape == b.shape and bool(((a.float() - b.float()).abs() <= limit).all())


def comparison(augment, device):
    """By bits; up to rounding by the reference, whose sums depend on shapes, and where a kernel of CUDA resizes a list, which sums
    in another order.
    """
    if current_backend() == "reference":
        return close
    modules = list(augment.modules())
    resizes = any(isinstance(m, A.SmallestMaxSize) or getattr(m, "flags", {}).get("antialias") for m in modules)
    return torch.equal if device.type == "cpu" or not resizes else close


def assert_as_alone(augment, images):
    """Each image of a list becomes what it becomes alone with its seed, by its bits, and so do its matrix and its inverse."""
    seeds, same = seeds_of(images), comparison(augment, images[0].device)
    results = augment(images, seed=seeds)
    matrices, params = augment.transform_matrix, augment._params
    back, known = augment.inverse(results), augment.known_pixels(results)
    again = augment(images, params=params)
    back_again = augment.inverse(results, params=params)
    for b, x in enumerate(images):
        alone = augment(x[None], seed=seeds[b : b + 1])
        assert same(results[b], alone[0]) and same(again[b], alone[0])
        assert torch.equal(matrices[b], augment.transform_matrix[0])
        assert same(back[b], augment.inverse(alone)[0]) and same(back_again[b], back[b])
        assert torch.equal(known[b], augment.known_pixels(alone)[0])


@pytest.mark.parametrize("case", SOME_IMAGES, ids=lambda case: case.name)
def test_an_augmentation_of_a_list(case, device):
    """Different sizes give what each image gives alone, equal ones give the batch's bits; the type is the same for both."""
    augment, dtype = case.make(p=0.7), random.Random(case.name).choice([torch.float32, torch.uint8])
    images = pictures(device, SMALL, dtype)
    assert_as_alone(augment, images)
    equal = [x[:, :15, :16] for x in images]
    results = []
    for x in (equal, torch.stack(equal)):
        torch.manual_seed(1)
        results.append(augment(x))
    assert all(torch.equal(a, b) for a, b in zip(*results))
    assert isinstance(results[0], list) == isinstance(augment(images), list)


CONTAINERS = {
    "color": lambda: A.ImageSequential(A.RandomHorizontalFlip(), A.ColorJitter(0.2, 0.2, 0.2, 0.1, p=0.7)),
    "late crop": lambda: A.ImageSequential(
        A.RandomHorizontalFlip(), A.RandomAffine(20.0), A.RandomResizedCrop((12, 14)), A.Normalize(0.4, 0.3)
    ),
    "once": lambda: A.ImageSequential(A.RandomAffine(20.0), A.RandomResizedCrop((12, 14)), resample="once"),
    "sizes": lambda: A.ImageSequential(A.Resize(20), torch.nn.AvgPool2d(2), A.CenterCrop((9, 9))),
    "OneOf": lambda: A.ImageSequential(A.OneOf(A.RandomAffine(20.0), A.RandomCrop((12, 14)), A.RandomGaussianNoise())),
    "OneOf of moves": lambda: A.OneOf(A.RandomVerticalFlip(), A.RandomPerspective(0.5)),
    "OneOf of one size": lambda: A.OneOf(A.RandomResizedCrop((12, 14)), A.Resize((12, 14))),
    "SomeOf": lambda: A.SomeOf(A.RandomAffine(20.0, p=1.0), A.RandomGaussianNoise(p=1.0), A.RandomInvert(), n=(1, 2)),
    "RandomApply": lambda: A.RandomApply(A.RandomRotation(20.0, p=1.0), A.RandomInvert()),
    "random_apply": lambda: A.ImageSequential(A.RandomAffine(20.0), A.RandomInvert(), random_apply=1),
    "RandAugment": lambda: A.auto.RandAugment(2, 9),
    "chance": lambda: A.ImageSequential(A.RandomCrop((12, 14), p=0.5), A.RandomHorizontalFlip()),
    "zoom behind chance": lambda: A.ImageSequential(A.RandomCrop((12, 14), p=0.5), A.RandomZoomOut(p=1.0)),
    "zoom behind a batch": lambda: A.ImageSequential(
        A.RandomHorizontalFlip(), A.RandomResizedCrop((12, 14)), A.RandomInvert(), A.RandomZoomOut(p=1.0)
    ),
}
BATCHES = ("late crop", "once", "sizes", "OneOf of one size", "zoom behind a batch")


@pytest.mark.parametrize("name", CONTAINERS)
def test_a_container_on_a_list(name, device):
    augment, images = CONTAINERS[name](), pictures(device, SMALL)
    assert_as_alone(augment, images)
    equal = [x[:, :15, :16] for x in images]
    for x in (images, equal):
        assert isinstance(augment(x), Tensor) == (name in BATCHES)
    if name != "OneOf":  # which gives samples of a batch no sizes of their own
        assert all(torch.equal(a, b) for a, b in zip(augment(equal, seed=3), augment(torch.stack(equal), seed=3)))


def test_cells_of_each_image(device):
    """PatchSequential, which has no inverse of cells that move."""
    images, seeds = pictures(device, SMALL), torch.arange(4) + 5
    for options in ({}, {"patchwise_apply": False, "random_apply": 1}, {"random_apply": 1}):
        augment = A.PatchSequential(*[A.RandomAffine(20.0), A.RandomInvert()] * 2, grid_size=(2, 2), **options)
        results, params = augment(images, seed=seeds), augment._params
        again = augment(images, params=params)
        for b, x in enumerate(images):
            alone = augment(x[None], seed=seeds[b : b + 1])[0]
            assert torch.equal(results[b], alone) and torch.equal(again[b], alone)


KEYS = ["input", "mask", "bbox_xyxy", "class", "keypoints"]
LABELED = {
    "list": lambda: (A.RandomHorizontalFlip(), A.RandomAffine(30.0, p=0.7), A.ColorJitter(0.1)),
    "late crop": lambda: (A.RandomHorizontalFlip(), A.RandomAffine(20.0), A.RandomResizedCrop((12, 14))),
    "map and chance": lambda: (A.RandomElasticTransform((3, 3), (1.0, 1.0), p=1.0), A.RandomCrop((10, 12), p=0.5)),
    "labels decide": lambda: (A.RandomIoUCrop(), A.CropNonEmptyMaskIfExists(9, 10)),
    "masks of some": lambda: (A.CropNonEmptyMaskIfExists(9, 10, p=0.5), A.RandomHorizontalFlip()),
}


@pytest.mark.parametrize("name", LABELED)
def test_labels_of_each_image(name, device):
    """Masks, boxes that a rule removes with their classes, points and matrices; forward, back, and without the images."""
    is_rounded = "map" in name  # points between the pixels of maps

    def assert_same_labels(a, b):
        if is_rounded and isinstance(a, Tensor) and a.is_floating_point():
            assert_close(a, b, 0, 1e-3)
        else:
            assert_same(a, b)

    images = pictures(device, SMALL)
    counts, seeds = (2, 0, 1, 3), seeds_of(images)
    masks = [torch.randint(0, 9, (n, *x.shape[1:]), device=device) for n, x in zip(counts, images)]
    boxes = [torch.rand(n, 4, device=device).cumsum(1) * 5 for n in counts]
    points = [torch.rand(n, 2, device=device) * 15 for n in (1, 3, 0, 2)]
    inputs = [images, masks, boxes, [list(range(n)) for n in counts], points]
    augment = A.AugmentationSequential(*LABELED[name](), data_keys=KEYS, clip_boxes=True, min_box_area=3.0)
    (y, matrices), *moved = augment(*inputs, seed=seeds, return_transform=True)
    kept, visible, params = augment.kept_boxes[0], augment.visible_points[0], augment._params
    by_params = augment(*inputs, params=params)
    alone = augment(moved[3], data_keys=["keypoints"], params=params)  # moved once more
    back = augment.inverse(y, *moved, params=params)
    for b, x in enumerate(images):
        own = [[value[b]] for value in inputs[1:]]
        (of_image, matrix), *of_labels = augment(x[None], *own, seed=seeds[b : b + 1], return_transform=True)
        assert torch.equal(y[b], of_image[0]) and torch.equal(by_params[0][b], y[b])
        assert_close(matrices[b], matrix[0], 0, 0)
        for of_list, replayed, label in zip(moved, by_params[1:], of_labels):
            assert_same_labels(of_list[b], label[0])
            assert_same_labels(replayed[b], label[0])
        assert_same(kept[b], augment.kept_boxes[0][0])
        assert_same(visible[b], augment.visible_points[0][0])
        assert_same_labels(alone[b], augment([moved[3][b]], data_keys=["keypoints"])[0])
        augment(x[None], *own, seed=seeds[b : b + 1])
        for of_list, label in zip(back, augment.inverse(of_image, *of_labels)):
            assert_same_labels(of_list[b], label[0])


@pytest.mark.parametrize("sizes", [SMALL, SMALL[:1] * 4], ids=["of sizes", "of one size"])
@pytest.mark.parametrize("in_launches", [True, False], ids=["launch", "each"])
def test_masks_of_images_stay_whatever_boxes_an_image_has(in_launches, sizes, device):
    """Masks are of instances if all images have as many of them as boxes, before a filter removes some."""
    images = pictures(device, sizes)
    classes = [torch.ones(1, *size, dtype=torch.uint8, device=device) for size in sizes]
    far = torch.tensor([[900.0, 900.0, 910.0, 910.0]], device=device)
    near = torch.tensor([[2.0, 2.0, 9.0, 9.0]], device=device)
    first = A.RandomHorizontalFlip() if in_launches else Halved()
    inner = A.AugmentationSequential(first, min_box_area=1.0)
    augment = A.AugmentationSequential(inner, A.RandomCrop((9, 9)), data_keys=KEYS[:3], min_box_area=100.0)
    boxes = [torch.cat([near, far]), near, far, near]
    _, kept, filtered = augment(images, classes, boxes)
    assert [len(x) for x in kept] == [1] * 4 and [len(x) for x in filtered] == [0] * 4
    alone = augment(classes, boxes, data_keys=KEYS[1:3], params=augment._params)[0]
    assert [len(x) for x in alone] == [1] * 4
    instances = [torch.ones(len(x), *size, device=device) for x, size in zip(boxes, sizes)]
    assert [len(x) for x in augment(images, instances, boxes)[1]] == [0] * 4
    with pytest.raises(ValueError, match=r"expected masks of \[2, 1, 1, 1\] instances, .* got \[1, 1, 1, 2\]"):
        augment(images, [*classes[:3], classes[3].repeat(2, 1, 1)], boxes)
    with pytest.raises(ValueError, match=r"(of one size|of shape|of images), got|expected mask"):
        augment(images, [instances[0], *[torch.ones(1, 5, 6, device=device)] * 3], boxes)


def test_labels_of_a_list_have_one_type(device):
    images = pictures(device, SMALL)
    flip = A.AugmentationSequential(A.RandomHorizontalFlip(p=1.0), data_keys=["image", "bbox_xyxy"])
    none, whole = torch.zeros(0, 4, device=device), torch.tensor([[2, 2, 9, 9]], device=device)
    moved = flip(images, [none, none, whole, whole])[1]
    assert moved[2].dtype == torch.int64 and moved[2].tolist() == [[11, 2, 18, 9]]
    for key, labels in (
        ("bbox_xyxy", [whole, whole, whole + 0.5, none]),
        ("keypoints", [whole[:, :2], whole[:, :2], whole[:, :2] + 0.5, none[:, :2]]),
        (
            "mask",
            [
                torch.ones(1, *size, dtype=torch.uint8, device=device) * (1 if i < 2 else 1.0)
                for i, size in enumerate(SMALL)
            ],
        ),
    ):
        with pytest.raises(TypeError, match=f"expected {key} of one type, got torch.* and, at 2, torch.float32"):
            flip(images, labels, data_keys=["image", key])
    with pytest.raises(TypeError, match="got a tuple of 4 images; stack them, .* or pass a list"):
        flip(tuple(images), data_keys=["image"])


def assert_same(a, b):
    assert torch.equal(a, b) if isinstance(a, Tensor) else a == b


def test_dicts_types_and_gradients_of_lists(device):
    images = [x.requires_grad_() for x in pictures(device, SMALL)]
    flip = A.AugmentationSequential(A.RandomHorizontalFlip(p=1.0), data_keys=None)
    gray = [x[:1].detach() for x in images]
    flipped = flip({"image": images, "image_gray": gray, "mask": [x[0] > 0.5 for x in gray], "path": "photo.jpg"})
    assert all(torch.equal(y, x.flip(-1)) for y, x in zip(flipped["image"], images)) and flipped["path"] == "photo.jpg"
    assert all(torch.equal(y, x.flip(-1)) for y, x in zip(flipped["image_gray"], gray))
    assert all(torch.equal(y[0], x[0].flip(-1) > 0.5) for y, x in zip(flipped["mask"], gray))
    gradients = torch.autograd.grad(sum(y.square().sum() for y in flipped["image"]), images)
    assert all(torch.equal(g, 2 * x) for g, x in zip(gradients, images))
    single = A.ImageSequential(A.RandomHorizontalFlip(p=1.0))
    arrays = single(gray, output_type="numpy")
    assert [x.shape for x in arrays] == [(*size, 1) for size in SMALL]
    wide = A.ImageSequential(A.RandomHorizontalFlip(), A.CenterCrop(9), memory_format=torch.channels_last)(images)
    assert wide.shape == (4, 3, 9, 9) and wide.is_contiguous(memory_format=torch.channels_last)


def test_draws_of_a_list(device):
    """A generator draws for a list as torch does for its state; images get draws of their own from one seed."""
    images = [torch.full((3, 4, 5 + i), 0.5, device=device) for i in range(6)]
    for augment in (A.RandomBrightness((0.5, 1.5), p=1.0), A.ImageSequential(A.RandomBrightness((0.5, 1.5), p=1.0))):
        calls = [
            [float(y[0, 0, 0]) for y in augment(images, **options)]
            for options in ({"seed": 3}, {"seed": 3}, {"generator": torch.Generator().manual_seed(1)}, {})
        ]
        assert calls[0] == calls[1] and len(set(calls[0])) == 6 and len(set(map(tuple, calls))) == 3
    same = [A.RandomBrightness((0.5, 1.5), p=1.0, same_on_batch=True), A.RandomAffine(9.0, same_on_batch=True)]
    for augment in (same[0], A.ImageSequential(*same), A.auto.RandAugment(1, 9, same_on_batch=True)):
        augment(images)
        params = augment._params if isinstance(augment._params, dict) else augment._params[0].data
        assert all((value == value[0]).all() for name, value in params.items() if name != "forward_input_shape")
    with pytest.raises(ValueError, match="one same_on_batch of all that draws"):
        A.ImageSequential(same[0], Halved())(images)  # which takes a call per size


def test_masks_of_a_list_are_read_as_the_container_says(device):
    images, fill = pictures(device, SMALL), {"mask": {"fill_value": 255}}
    masks = [torch.zeros(1, *size, dtype=torch.uint8, device=device) for size in SMALL]
    turn = A.AugmentationSequential(A.RandomRotation((90.0, 90.0), p=1.0), data_keys=["image", "mask"], extra_args=fill)
    for (height, width), mask in zip(SMALL, turn(images, masks)[1]):
        outside = height * width - min(height, width) ** 2
        assert abs(int((mask == 255).sum()) - outside) <= 2 * max(height, width)  # centers of pixels may be on the edge


@pytest.mark.tracing
def test_a_list_image_by_image_has_no_graph():
    augment = torch.compile(A.ImageSequential(Halved()), fullgraph=True, backend="eager")
    with pytest.raises(Exception, match=r"has no graph; call it outside of"):
        augment(pictures("cpu", SMALL))


WIDE = {
    "affine": lambda: A.RandomAffine(20.0, p=1.0),
    "crop": lambda: A.RandomResizedCrop((9, 12)),
    "resize": lambda: A.SmallestMaxSize(14),
    "elastic": lambda: A.RandomElasticTransform((5, 5), (2.0, 2.0), p=1.0),
    "chain": lambda: A.ImageSequential(A.RandomHorizontalFlip(), A.RandomRotation(20.0, p=1.0)),
    "late crop": lambda: A.ImageSequential(A.RandomHorizontalFlip(), A.RandomCrop((9, 9))),
}


@pytest.mark.parametrize("dtype", [torch.int16, torch.uint16], ids=str)
@pytest.mark.parametrize("name", WIDE)
def test_integers_of_16_bits_become_what_each_image_becomes_alone(name, dtype, device):
    """They are computed in float32 and rounded."""
    augment, images = WIDE[name](), [(60000 * x - 25000 * (dtype == torch.int16)).to(dtype) for x in pictures(device)]
    results = augment(images, seed=seeds_of(images))
    for b, x in enumerate(images):
        alone = augment(x[None], seed=seeds_of(images)[b : b + 1])[0]
        assert results[b].dtype == dtype and torch.equal(results[b], alone)


def test_masks_of_integers_of_16_bits_follow(device):
    images = [(60000 * x).to(torch.uint16) for x in pictures(device)]
    masks = [(x[:1].float() > 30000).byte() for x in images]
    augment = A.AugmentationSequential(A.RandomAffine(20.0, p=1.0), data_keys=["image", "mask"])
    results, moved = augment(images, masks, seed=seeds_of(images))
    for b, x in enumerate(images):
        alone, own = augment(x[None], masks[b][None], seed=seeds_of(images)[b : b + 1])
        assert torch.equal(results[b], alone[0]) and torch.equal(moved[b], own[0])

"""Policies on lists of images of different sizes: each image gets what it gets alone, by the launches of a batch."""

from __future__ import annotations

from functools import partial

import pytest
import torch

from augmentation.auto.test_policy_base import POLICIES_AND_MIXTURES
from augmentation.container.test_list_launches import calls
from augmentation.test_lists import pictures, seeds_of
from benchmarks.timing import launches
from kvision import augmentation as A
from kvision._backend import current_backend
from kvision.augmentation.auto import AugMix, RandAugment, TrivialAugment
from kvision.augmentation.auto import operation_table as table
from kvision.augmentation.auto.operation_table import OPERATIONS
from op_tests import assert_close, pairwise

# Of one pixel, odd, of whole vectors, and larger than what one block measures.
SIZES = ((20, 28), (1, 1), (37, 41), (1, 9), (32, 64), (7, 1), (97, 132))
DTYPES = [torch.uint8, torch.float16, torch.bfloat16, torch.float32, torch.float64]
LAYOUTS = {
    "planar": lambda x: x,
    "interleaved": lambda x: x.permute(1, 2, 0).contiguous().permute(2, 0, 1),
    "sliced": lambda x: torch.cat([x, x], -1)[..., 1 : 1 + x.shape[-1]],
}
policies = pytest.mark.parametrize("name", POLICIES_AND_MIXTURES)


def same_up_to_steps(dtype):
    """By bits; by the reference half types up to a step of `posterize`, as operators on lists round them at other places."""
    if current_backend() != "reference" or dtype not in (torch.float16, torch.bfloat16):
        return torch.equal
    return lambda a, b: a.shape == b.shape and bool(((a.float() - b.float()).abs() <= 1e-2).all())


@pytest.mark.parametrize(
    ("name", "dtype", "layout"), pairwise(list(POLICIES_AND_MIXTURES), DTYPES, list(LAYOUTS)), ids=str
)
def test_each_image_gets_what_it_gets_alone(name, dtype, layout, device):
    same = same_up_to_steps(dtype)
    augment, images = POLICIES_AND_MIXTURES[name](), [LAYOUTS[layout](x) for x in pictures(device, SIZES, dtype)]
    before, seeds = [x.clone() for x in images], seeds_of(images)
    results = augment(images, seed=seeds)
    params, matrices, back = augment._params, augment.transform_matrix, augment.inverse(results)
    for b, x in enumerate(images):
        y = augment(x[None], seed=seeds[b : b + 1])
        assert same(results[b], y[0]) and torch.equal(x, before[b])
        assert results[b].stride() == y[0].stride() or 1 in y.shape
        assert_close(matrices[b].to(device), augment.transform_matrix[0].to(device))
        assert_close(back[b], augment.inverse(y)[0])
        for item, own in zip(params, augment._params):
            assert all(torch.equal(item.data[key][b], own.data[key][0]) for key in ("operation", "magnitude"))
    again = augment(images, params=params)
    assert all(torch.equal(a, b) for a, b in zip(results, again))
    assert_close(augment.transform_matrix, matrices)


def of_channels(channels, device, dtype=torch.float32, sizes=SIZES):
    return [torch.cat([x, x.flip(-1)])[:channels] for x in pictures(device, sizes, dtype)]


@pytest.mark.parametrize("dtype", DTYPES, ids=str)
@pytest.mark.parametrize("channels", [1, 2, 4])
@policies
def test_images_of_other_channels(name, channels, dtype, device, backend):
    augment, images = POLICIES_AND_MIXTURES[name](), of_channels(channels, device, dtype)
    seeds, same = seeds_of(images), same_up_to_steps(dtype)
    results = augment(images, seed=seeds)
    for b, x in enumerate(images):
        assert same(results[b], augment(x[None], seed=seeds[b : b + 1])[0])
    if backend != "reference":
        augment = A.ImageSequential(augment, A.RandomInvert())
        assert calls(augment, images, seed=seeds) == calls(augment, images[:2], seed=seeds[:2])


@pytest.mark.parametrize("channels", [1, 4])
@policies
def test_gradients_of_other_channels(name, channels, device):
    augment, images = POLICIES_AND_MIXTURES[name](), [x.requires_grad_() for x in of_channels(channels, device)]
    seeds = seeds_of(images)
    results = augment(images, seed=seeds)
    weights = [torch.rand_like(y) for y in results]
    of_list = torch.autograd.grad(sum((y * w).sum() for y, w in zip(results, weights)), images)
    for b, x in enumerate(images):
        alone = (augment(x[None], seed=seeds[b : b + 1])[0] * weights[b]).sum()
        assert_close(of_list[b], torch.autograd.grad(alone, x)[0], 1e-4, 1e-4)


@pytest.mark.parametrize("dtype", [torch.float32, torch.uint8], ids=str)
@policies
def test_draws_are_those_of_a_batch(name, dtype, device):
    """Equal sizes give its bits."""
    augment, images = POLICIES_AND_MIXTURES[name](), pictures(device, [(33, 40)] * 9, dtype)
    others = pictures(device, [(10 + b, 12) for b in range(9)], dtype)
    for options in ({"seed": 3}, {}):
        torch.manual_seed(0)
        results = augment(images, **options)
        torch.manual_seed(0)
        batch = augment(torch.stack(images), **options)
        drawn = augment._record.drawn
        assert type(results) is list and all(torch.equal(a, b) for a, b in zip(results, batch))
        torch.manual_seed(0)
        augment(others, **options)
        assert torch.equal(augment._record.parts._drawn.operation, drawn.operation)


@policies
def test_gradients_are_those_of_each_image(name, device):
    augment, images = POLICIES_AND_MIXTURES[name](), [x.requires_grad_() for x in pictures(device, SIZES)]
    seeds = seeds_of(images)
    results = augment(images, seed=seeds)
    alone = [augment(x[None], seed=seeds[b : b + 1])[0] for b, x in enumerate(images)]
    weights = [torch.rand_like(y) for y in results]
    of_list, of_images = (
        torch.autograd.grad(sum((y * w).sum() for y, w in zip(of, weights)), images) for of in (results, alone)
    )
    for a, b in zip(of_list, of_images):
        assert_close(a, b, 1e-4, 1e-4)
    first = images[0].detach().requires_grad_()
    (gradient,) = torch.autograd.grad(sum(y.sum() for y in augment([first, images[2], first], seed=seeds[:3])), first)
    each = [augment(first[None], seed=seeds[b : b + 1]).sum() for b in (0, 2)]
    assert_close(gradient, torch.autograd.grad(sum(each), first)[0], 1e-4, 1e-4)


@pytest.mark.native  # image by image
def test_more_images_than_a_table_has(device):
    images = pictures(device, [(1 + b % 7, 1 + b % 5) for b in range(1100)], torch.uint8)
    augment, seeds = RandAugment(2, 9), seeds_of(images)
    results = augment(images, seed=seeds)
    for b in (0, 511, 512, 1023, 1024, 1099):
        assert torch.equal(results[b], augment(images[b][None], seed=seeds[b : b + 1])[0])


@pytest.mark.parametrize("dtype", [torch.float32, torch.uint8], ids=str)
@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("channels", [3, 1, 4])
def test_each_operation(channels, layout, dtype, device):
    """All on images of each size, by the operator and by its reference."""
    names = ["rotate" if name == "identity" else name for name in OPERATIONS]
    sizes = [size for size in SIZES for _ in names]
    images = [LAYOUTS[layout](x) for x in of_channels(channels, device, dtype, sizes)]
    numbers = torch.tensor([OPERATIONS[name].number for name in names], device=device).repeat(len(SIZES))
    operation = torch.stack([torch.full_like(numbers, -1), numbers], 1)
    value = torch.full(operation.shape, 0.7, device=device)
    results, (matrix,) = table.execute_steps_on_list(images, [("invert",), tuple(OPERATIONS)], operation, value)
    for b, x in enumerate(images):
        y, _ = table.execute_step(x[None], tuple(OPERATIONS), operation[b : b + 1, 1], value[b : b + 1, 1])
        error = (results[b].float() - y[0].float()).abs()
        # Rounding may carry single values across a threshold or a level.
        assert (error > (1 if dtype == torch.uint8 else 2e-5)).sum() <= 0.002 * error.numel() + 1, names[b % len(names)]
    assert matrix.shape == (len(images), 3, 3)


@pytest.mark.native
def test_operators_with_gradients_are_their_references(device):
    images = [x.requires_grad_() for x in pictures(device, SIZES)]
    numbers = torch.tensor([OPERATIONS[name].number for name in ("rotate", "contrast", "sharpness")], device=device)
    operation, value = numbers.expand(len(images), -1), torch.full((len(images), 3), 0.7, device=device)
    weights, results = [torch.rand_like(x) for x in images], []
    for execute in (table._apply_operations_list, table._reference_of_list):
        *y, matrices = execute(images, operation, value)
        gradients = torch.autograd.grad(sum((a * w).sum() for a, w in zip(y, weights)), images)
        results.append([*y, matrices, *gradients])
    for a, b in zip(*results):
        assert_close(a, b, 1e-4, 1e-4)


CONTAINERS = {
    "chain": lambda: (A.RandomHorizontalFlip(), RandAugment(2, 9), A.RandomErasing()),
    "late crop": lambda: (TrivialAugment(), A.RandomResizedCrop((12, 14)), A.Normalize(0.5, 0.2)),
    "choice": lambda: (A.OneOf(RandAugment(2, 9), TrivialAugment()), A.RandomInvert()),
    "chance": lambda: (A.RandomApply(RandAugment(2, 9)), AugMix()),
}


@pytest.mark.parametrize("name", CONTAINERS)
def test_in_containers_with_labels(name, device):
    augment = A.AugmentationSequential(*CONTAINERS[name](), data_keys=["input", "mask", "bbox_xyxy", "keypoints"])
    images = pictures(device, [size for size in SIZES if min(size) > 1])
    seeds, masks = seeds_of(images), [(x[:1] > 0.5).float() for x in images]
    boxes = [torch.tensor([[1.0, 2, 9, 12]], device=device)[: b % 2] for b in range(len(images))]
    points = [torch.tensor([[3.0, 4.0], [5.0, 6.0]], device=device) for _ in images]
    inputs = (images, masks, boxes, points)
    results = augment(*inputs, seed=seeds)
    params, matrices = augment._params, augment.transform_matrix
    for b in range(len(images)):
        own = (images[b][None], [masks[b]], [boxes[b]], [points[b]])
        alone = augment(*own, seed=seeds[b : b + 1])
        assert all(torch.equal(of_list[b], y[0]) for of_list, y in zip(results, alone))
        assert_close(matrices[b].to(device), augment.transform_matrix[0].to(device))
    again = augment(*inputs, params=params)
    assert all(torch.equal(a, b) for of, given in zip(results, again) for a, b in zip(of, given))


def test_a_list_has_a_graph(device):
    augment, images = RandAugment(2, 9), pictures(device, SIZES[:3])
    seeds = seeds_of(images)
    compiled = torch.compile(lambda images: augment(images, seed=seeds), fullgraph=True, backend="eager")
    for a, b in zip(compiled(images), augment(images, seed=seeds)):
        assert_close(a, b, 1e-4, 1e-4)


@pytest.mark.parametrize("dtype", [torch.float32, torch.uint8], ids=str)
@pytest.mark.parametrize("channels", [3, 1])
@policies
@pytest.mark.skipif(not torch.cuda.is_available(), reason="launches are counted on a GPU")
def test_as_many_launches_as_a_batch(name, channels, dtype):
    sizes = [(40 + b, 60 - b) for b in range(40)]
    augment, images = POLICIES_AND_MIXTURES[name](), of_channels(channels, "cuda", dtype, sizes)
    batch, seeds = torch.stack([images[0]] * 40), seeds_of(images)
    of_list, of_batch = (launches(partial(augment, x, seed=seeds)) for x in (images, batch))
    assert of_list <= of_batch


def test_wrong_lists(device):
    augment, images = RandAugment(2, 9), pictures(device)
    with pytest.raises(TypeError, match="RandAugment: expected input of one type"):
        augment([*images, images[0].half()])
    with pytest.raises(ValueError, match="RandAugment: expected input with one number of channels"):
        augment([*images, images[0][:1]])
    with pytest.raises(ValueError, match="seed"):
        augment(images, seed=torch.arange(2))
    params = (augment(images), augment._params)[1]
    with pytest.raises(ValueError, match="RandAugment: expected params"):
        augment(images[:2], params=params)


LABELS_AROUND = {
    "run": lambda policy: (A.RandomHorizontalFlip(), policy, A.RandomErasing()),
    "late crop": lambda policy: (policy, A.RandomResizedCrop((12, 14))),
    "container": lambda policy: (A.ImageSequential(A.RandomVerticalFlip(), policy), A.RandomInvert()),
    "choice": lambda policy: (A.OneOf(policy, A.RandomInvert()), A.RandomHorizontalFlip()),
}


@pytest.mark.parametrize("around", LABELS_AROUND)
@policies
def test_labels_in_containers_follow_together(name, around, device, backend):
    """Masks, boxes and points of each image are those of the image alone, by as many calls for any number of images."""
    policy = POLICIES_AND_MIXTURES[name]()
    keys = ["input", "mask", "bbox_xyxy", "keypoints"]
    augment = A.AugmentationSequential(*LABELS_AROUND[around](policy), data_keys=keys, clip_boxes="each")
    images = pictures(device, [(16 + 3 * b, 40 - 2 * b) for b in range(9)])
    inputs = (
        images,
        [(x[: b % 3] > 0.5).to(torch.uint8) for b, x in enumerate(images)],
        [torch.tensor([[1.0, 2, 9, 12], [3, 3, 8, 9]], device=device)[: b % 3] for b in range(9)],
        [torch.tensor([[3.0, 4], [6, 7]], device=device) for _ in images],
    )
    seeds = seeds_of(images)
    results = augment(*inputs, seed=seeds)
    for b in range(9):
        alone = augment(
            *([value[b]] if i in (1, 2) else value[b][None] for i, value in enumerate(inputs)),
            seed=seeds[b : b + 1],
        )
        assert torch.equal(results[0][b], alone[0][0]) and torch.equal(results[1][b], alone[1][0])
        assert_close(results[2][b], alone[2][0], 1e-4, 1e-4)
        assert_close(results[3][b], alone[3][0], 1e-4, 1e-4)
    if backend != "reference":
        counts = [calls(augment, *(x[:n] for x in inputs), seed=seeds[:n]) for n in (4, 9)]
        assert around == "choice" or counts[0] == counts[1]

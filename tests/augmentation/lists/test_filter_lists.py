"""Filters of lists of images; chains with blurs are among those of test_list_runs.py."""

import pytest
import torch

from augmentation.test_list_runs import is_by_passes
from augmentation.test_lists import SMALL, pictures, seeds_of
from kvision import augmentation as A
from kvision._backend import current_backend
from kvision._modes import BORDER
from kvision.augmentation.lists.filter_lists import gaussian_blur2d_of_sides
from kvision.filters import gaussian_blur2d
from kvision.geometry.transform.lists.remap_list import unpacked
from op_tests import assert_close


@pytest.mark.parametrize("dtype", [torch.float16, torch.float32, torch.float64], ids=str)
def test_motion_over_a_list(dtype, device):
    augment = A.ImageSequential(
        A.RandomMotionBlur(5, 30.0, 0.5, p=0.7), A.RandomMotionBlur(3, 30.0, 0.5, "reflect", p=1.0)
    )
    images = [x.requires_grad_() for x in pictures(device, SMALL, dtype)]
    seeds = seeds_of(images)
    results, weights = augment(images, seed=seeds), [torch.rand_like(x) for x in images]
    assert is_by_passes(augment)
    alone = [augment(x[None], seed=seeds[b : b + 1])[0] for b, x in enumerate(images)]
    assert all(torch.equal(a, b) for a, b in zip(results, alone))
    grads = [torch.autograd.grad(sum((y * w).sum() for y, w in zip(of, weights)), images) for of in (results, alone)]
    for of_list, of_image in zip(*grads):
        assert_close(of_list, of_image, 2e-3, 2e-3)


RANGES = {
    "one": lambda: A.ImageSequential(A.RandomMotionBlur((3, 7), 30.0, 0.5, p=0.7)),
    "two": lambda: A.ImageSequential(
        A.RandomMotionBlur((3, 7), 30.0, 0.5, "reflect", "bilinear", p=1.0),
        A.RandomMotionBlur((5, 9), 30.0, 0.5, p=0.5),
    ),
    "labels": lambda: A.AugmentationSequential(A.RandomMotionBlur((3, 7), 30.0, 0.5, p=0.7), data_keys=["input"]),
}


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float16, torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("name", RANGES)
def test_motion_of_drawn_lengths_over_a_list(name, dtype, device):
    """Images that have seeds have lengths of their own, others that of the batch, which a replay repeats, too."""
    augment, images = RANGES[name](), pictures(device, [*SMALL, (20, 17)], dtype)
    seeds = seeds_of(images)
    results = augment(images, seed=seeds)
    assert is_by_passes(augment)
    again = augment(images, params=augment._params)
    for b, x in enumerate(images):
        alone = augment(x[None], seed=seeds[b : b + 1])[0]
        assert torch.equal(results[b], alone) and torch.equal(again[b], alone)
    results = augment(images)
    params = augment._params
    lengths = {n for own in params for n in own.data["ksize_factor"].tolist()}
    assert len(lengths) <= len(params) and all(
        len(own.data["ksize_factor"]) == len(images) and len(set(own.data["ksize_factor"].tolist())) == 1
        for own in params
    )
    assert all(torch.equal(a, b) for a, b in zip(results, augment(images, params=params)))
    equal = [x[:, :15, :16] for x in images]
    assert all(torch.equal(a, b) for a, b in zip(augment(equal, seed=3), augment(torch.stack(equal), seed=3)))


def test_gradients_of_motion_of_drawn_lengths(device):
    augment, images = A.RandomMotionBlur((3, 7), 30.0, 0.5, p=0.7), pictures(device, SMALL)
    seeds, images = seeds_of(images), [x.requires_grad_() for x in images]
    weights = [torch.rand_like(x) for x in images]
    alone = [augment(x[None], seed=seeds[b : b + 1])[0] for b, x in enumerate(images)]
    for a, b in zip(
        *(
            torch.autograd.grad(sum((y * w).sum() for y, w in zip(of, weights)), images)
            for of in (augment(images, seed=seeds), alone)
        )
    ):
        assert_close(a, b, 1e-5, 1e-5)


def test_only_images_with_a_long_motion_have_to_be_large(device):
    augment, images = A.RandomMotionBlur((3, 9), 30.0, 0.5, "reflect", p=1.0), pictures(device, [(20, 30)] * 8)
    lengths = [
        augment(x[None], seed=b) is not None and int(augment._params["ksize_factor"]) for b, x in enumerate(images)
    ]
    images = [x[:, : n // 2 + 1] for n, x in zip(lengths, images)]
    assert len(augment(images, seed=torch.arange(8, device=device))) == 8
    with pytest.raises(ValueError, match="border of"):
        augment([x[:, :2] for x in images], seed=torch.arange(8, device=device))


def test_a_window_fits_the_smallest_image(device):
    images = pictures(device, [(20, 30), (20, 3)])
    for blur in (
        A.RandomGaussianBlur((7, 7), (0.5, 1.0), p=1.0),
        A.RandomBoxBlur((7, 7), p=1.0),
        A.RandomMedianBlur((7, 7), p=1.0),
    ):
        with pytest.raises(ValueError, match="20, 3"):
            blur(images)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("layout", ["planar", "interleaved"])
def test_windows_that_grow_with_the_image(dtype, layout, device):
    """Each is that of a blur of the image alone, from one pixel to windows that no strip serves, also with gradients."""
    sizes = ((1, 1), (20, 40), (150, 150), (350, 250), (33, 700), (90, 90), (1100, 60))
    images = pictures(device, sizes, dtype)
    if layout == "interleaved":
        images = [x.permute(1, 2, 0).contiguous().permute(2, 0, 1) for x in images]
    images = [x.requires_grad_() for x in images]
    (block,) = gaussian_blur2d_of_sides(images, 0.01, BORDER["reflect"])
    results = unpacked(block, [n for size in sizes for n in size], len(images[0]))
    weights = [torch.rand_like(x) for x in images]
    grads = torch.autograd.grad(sum((y * w).sum() for y, w in zip(results, weights)), images)
    for x, y, w, of_list in zip(images, results, weights, grads):
        sigma = 0.01 * x.shape[1], 0.01 * x.shape[2]
        alone = gaussian_blur2d(x[None], tuple(2 * int(3 * s + 0.5) + 1 for s in sigma), sigma, "reflect")[0]
        same = layout == "planar" and current_backend() != "reference"
        assert torch.equal(y, alone) if same else torch.allclose(y, alone, rtol=0, atol=1e-5)
        (of_image,) = torch.autograd.grad((alone * w).sum(), x)
        assert torch.allclose(of_list, of_image, rtol=0, atol=1e-5)

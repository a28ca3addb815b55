"""Resizing of lists of images: each image as by itself."""

from __future__ import annotations

import pytest
import torch

import kvision as K
from filters.test_column_groups import kernels_of
from geometry.transform.lists.test_warp_list import SIZES, TYPES, pictures
from op_tests import assert_close

MODES = ("bilinear", "nearest", "nearest-exact", "bicubic", "area", "lanczos")


@pytest.mark.parametrize("dtype", TYPES, ids=str)
@pytest.mark.parametrize("mode", MODES)
def test_results_are_those_of_single_images(dtype, mode, device):
    images = pictures(device, dtype)
    for size in ((9, 13), 11):
        for antialias in (False, True) if mode not in ("nearest", "nearest-exact", "area") else (False,):
            options = {"size": size, "interpolation": mode, "antialias": antialias}
            results = K.geometry.resize(images, **options)
            expected = [K.geometry.resize(x, **options) for x in images]
            assert isinstance(results, list) == isinstance(size, int)
            for y, z in zip(results, expected, strict=True):
                if device.type == "cpu":
                    assert torch.equal(y, z)
                else:  # whose kernels of batches add up in another order
                    assert_close(y, z, atol=1 if dtype == torch.uint8 else None)
    with K.backend("reference"):
        for y, z in zip(K.geometry.resize(images, **options), results):
            assert_close(y, z, atol=1 if dtype == torch.uint8 else 2e-2)


@pytest.mark.parametrize(("channels", "height", "size"), [(3, 34000, (17000, 2)), (1, 38400, (128, 2))])
def test_long_images_shrink_as_by_themselves(channels, height, size, device):
    images = pictures(device, sizes=((height, 4), (height + 9, 3)), channels=channels)
    for y, x in zip(K.geometry.resize(images, size, antialias=True), images, strict=True):
        assert_close(y, K.geometry.resize(x, size, antialias=True))


SHRINKING = ((90, 121), (64, 96), (130, 45), (37, 40), (260, 66), (30, 300))


@pytest.mark.parametrize("dtype", TYPES, ids=str)
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_images_that_shrink_more_and_less_are_those_of_single_images(dtype, channels, device):
    images = pictures(device, dtype, SHRINKING, channels)
    for x in images if dtype.is_floating_point else ():
        x[:, 3, 5], x[:, -1, -1] = torch.inf, torch.nan
    for size in ((33, 41), (31, 20), 18):
        for y, x in zip(K.geometry.resize(images, size, antialias=True), images, strict=True):
            single = K.geometry.resize(x, size, antialias=True)
            assert_close(y, single, atol=1 if dtype == torch.uint8 else None)


@pytest.mark.parametrize("dtype", [dtype for dtype in TYPES if dtype != torch.float64], ids=str)
def test_equal_sizes_give_the_bits_of_a_batch(dtype, device):
    for height, width in ((92, 131), (65, 99), (40, 37)):
        images = pictures(device, dtype, [(height, width)] * 3)
        batch = torch.stack([x.contiguous() for x in images])
        for size in ((height * 46 // 100, width * 49 // 100), (height * 3 // 4, width // 3), (height // 5, width // 6)):
            results = K.geometry.resize([x.contiguous() for x in images], size, antialias=True)
            assert torch.equal(results, K.geometry.resize(batch, size, antialias=True)), (height, width, size)


@pytest.mark.native
def test_lists_that_shrink_take_columns_and_strips(device):
    if device.type != "cuda":
        pytest.skip("needs --device cuda")
    for dtype in (torch.uint8, torch.float16, torch.bfloat16, torch.float32):
        for sizes, columns, strips in (
            (((64, 90), (100, 70)), True, False),
            (((400, 300), (330, 500)), False, True),
            (((64, 90), (330, 500)), True, True),
        ):
            images = [torch.ones(3, *size, device=device).to(dtype) for size in sizes]
            names = kernels_of(lambda _, images=images: K.geometry.resize(images, (40, 50), antialias=True), images[0])
            taken = [any(kernel in name for name in names) for kernel in ("resize_list_columns", "resize_list_strips")]
            assert taken == ([columns, strips] if dtype != torch.float32 else [False, True]), (dtype, sizes)
            assert len(names) == sum(taken)


@pytest.mark.derivatives
@pytest.mark.parametrize("size", [(4, 3), 3])
def test_gradients(size, device):
    images = [x.detach().requires_grad_() for x in pictures(device, torch.float64, ((3, 4), (5, 2), (2, 2)), 2)]
    for antialias in (False, True):

        def resized(*tensors, antialias=antialias):
            results = K.geometry.resize(list(tensors), size, "bicubic", antialias=antialias)
            return tuple(results) if isinstance(results, list) else results

        assert torch.autograd.gradcheck(resized, images)
        assert torch.autograd.gradgradcheck(resized, images)


def test_an_image_that_appears_twice_adds_up(device):
    image = pictures(device)[0].requires_grad_()
    results = K.geometry.resize([image, image], (5, 5))
    once = torch.autograd.grad(K.geometry.resize(image, (5, 5)).sum(), image)[0]
    assert_close(torch.autograd.grad(results.sum(), image)[0], 2 * once)


def test_the_type_follows_from_the_size_that_is_asked_for(device):
    equal = pictures(device, sizes=[(8, 8)] * 2)
    assert isinstance(K.geometry.resize(equal, 4), list)
    assert isinstance(K.geometry.resize(equal[:1], 4), list)
    assert K.geometry.resize(pictures(device), (4, 4)).shape == (len(SIZES), 3, 4, 4)
    blurred = K.geometry.resize(pictures(device), 4, antialias="gaussian")
    assert [min(y.shape[1:]) for y in blurred] == [4] * len(SIZES)

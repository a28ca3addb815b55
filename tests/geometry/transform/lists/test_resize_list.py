"""Resizing of lists of images: each image as by itself."""

from __future__ import annotations

import pytest
import torch

import kvision as K
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

"""Antialiased windows of lists: those of each image, their gradients, and equal sizes as a batch."""

from __future__ import annotations

import pytest
import torch

from geometry.transform.lists.test_warp_list import SIZES, TYPES, pictures
from kvision.geometry.transform.lists.resize_windows_list import resize_windows_list
from kvision.geometry.transform.resize_windows import resized_windows
from op_tests import assert_close

BILINEAR, BICUBIC = 3, 4


def windows(sizes, result, device, dtype=torch.float32):
    """Matrices from windows of images to a result; every other one mirrors it."""
    matrices = torch.eye(3).repeat(len(sizes), 1, 1)
    for matrix, (h, w), mirrored in zip(matrices, sizes, [False, True] * len(sizes)):
        for axis, (side, to) in enumerate(((w, result[1]), (h, result[0]))):
            first, size = side // 4, max(1, side // 2)
            scale = to / size
            matrix[axis, axis], matrix[axis, 2] = scale, 0.5 * scale - 0.5 - first * scale
            if mirrored:
                matrix[axis, axis], matrix[axis, 2] = -scale, to - 1 - matrix[axis, 2]
    return matrices.to(device, dtype)


@pytest.mark.parametrize("dtype", TYPES, ids=str)
@pytest.mark.parametrize("filter", [BILINEAR, BICUBIC])
def test_windows_are_those_of_single_images(dtype, filter, device):
    images = pictures(device, dtype)
    matrices = windows(SIZES, (7, 9), device, torch.float64 if dtype == torch.float64 else torch.float32)
    (results,) = resize_windows_list(images, matrices, [7, 9], filter, False)
    for b, x in enumerate(images):
        alone = resized_windows(x[None], matrices[b : b + 1], [7, 9], filter, False)
        assert torch.equal(results[b : b + 1], alone)


@pytest.mark.derivatives
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_gradients(dtype, device):
    images = [x.detach().requires_grad_() for x in pictures(device, dtype)]
    matrices = windows(SIZES, (7, 9), device, dtype)
    (results,) = resize_windows_list(images, matrices, [7, 9], BILINEAR, False)
    weights = torch.rand_like(results)
    gradients = torch.autograd.grad((weights * results).sum(), images)
    for b, x in enumerate(images):
        alone = resized_windows(x[None], matrices[b : b + 1], [7, 9], BILINEAR, False)
        (expected,) = torch.autograd.grad((weights[b : b + 1] * alone).sum(), x)
        assert_close(gradients[b], expected, 1e-5, 1e-5)

"""Sums of moved copies, against SciPy; what they read, and what they do not."""

import numpy as np
import pytest
import torch
from scipy import ndimage
from torch import Tensor

from kvision.augmentation.corruption.moved import sum_of_moved
from op_tests import OpTests, assert_close


def moves(x: Tensor) -> Tensor:
    """Enlarged, and shifted by parts of pixels, also out of the image."""
    some = torch.tensor(
        [
            [0.8043, 0.5317, 0.2719, 0.5],
            [1.0, -2.0731, 1.0317, 0.25],
            [1.0, 0.3113, 0.0613, 0.25],
            [1.3, 99.0, -50.0, 0.125],
        ]
    )
    return some + 0.0107 * torch.arange(x.shape[0])[:, None, None] * torch.tensor([1.0, 1, 1, 0])


class TestSumOfMoved(OpTests):
    operators = ("sum_of_moved", "sum_of_moved_backward")
    bytes = True
    variants = [{"moves": moves}]
    mixed = ("moves",)
    tolerances = {torch.uint8: (0, 1)}  # sums in another order round to the other byte

    @staticmethod
    def function(x: Tensor, moves: Tensor) -> Tensor:
        x = x if x.is_floating_point() or x.dtype == torch.uint8 else x.float()
        return sum_of_moved(x, moves.to(torch.float64 if x.dtype == torch.float64 else torch.float32))

    def test_wrong_kinds(self, variant, device):
        pytest.skip("the classes that call the operator check its input")


def test_copies_are_those_of_scipy(device):
    x = torch.rand(2, 3, 17, 70, dtype=torch.float64)
    rows = torch.tensor([[[0.7, 5.25, 1.5, 0.75], [1.0, -3.0, 20.0, 0.25]], [[1.2, -1.0, 0.5, 1.0], [1, 2, 0.5, -0.5]]])
    expected = np.zeros(x.shape)
    for b, c in np.ndindex(2, 3):
        for scale, right, down, weight in rows[b].tolist():
            at = np.meshgrid(scale * np.arange(17) + down, scale * np.arange(70) + right, indexing="ij")
            expected[b, c] += weight * ndimage.map_coordinates(x[b, c].numpy(), at, order=1, mode="nearest")
    result = sum_of_moved(x.to(device), rows.double().to(device))
    assert_close(result.cpu(), torch.from_numpy(expected), 1e-6, 1e-6)


def test_only_pixels_that_count_are_read(device):
    x = torch.ones(1, 1, 4, 4, device=device)
    x[..., 3] = float("nan")
    rows = torch.tensor([[[1.0, 0.0, 0.0, 1.0], [1.0, 1.0, 0.0, 0.0]]], device=device)
    assert_close(sum_of_moved(x, rows)[..., :3], x[..., :3], 0, 0)

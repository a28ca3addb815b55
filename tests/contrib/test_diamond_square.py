"""A step of the diamond-square algorithm; test_contrib.py has whole maps."""

import pytest
import torch
from torch import Tensor

from kvision.contrib.diamond_square import refine_fractal
from op_tests import OpTests, assert_close


def noise(x: Tensor) -> Tensor:
    *planes, _, h, w = x.shape
    return torch.rand(*planes, 1, 2 * h - 1, 2 * w - 1)


class TestRefineFractal(OpTests):
    operators = ("refine_fractal",)
    channels = 1
    variants = [{"noise": noise, "weights": lambda x: torch.linspace(0.2, 0.9, x.shape[0])}]

    @staticmethod
    def function(x: Tensor, noise: Tensor, weights: Tensor) -> Tensor:
        x = x[:, :1] if x.is_floating_point() else x[:, :1].float()
        weights = weights.to(torch.float64 if x.dtype == torch.float64 else torch.float32)
        return refine_fractal(x, noise.to(x.dtype), weights.reshape(-1, 1, 1, 1))

    def test_wrong_kinds(self, variant, device):
        pytest.skip("diamond_square checks its input")


def test_a_step_by_hand(device):
    """Means of four pixels, then of four neighbors, or three at the border; the noise counts by its weight."""
    x = torch.tensor([[[[0.0, 4.0], [8.0, 12.0]]]], device=device)
    zero = torch.zeros(1, 1, 3, 3, device=device)
    expected = torch.tensor([[0.0, 10 / 3, 4.0], [14 / 3, 6.0, 22 / 3], [8.0, 26 / 3, 12.0]])
    assert_close(refine_fractal(x, zero, zero[..., :1, :1])[0, 0].cpu(), expected)
    mixed = torch.tensor([[0.0, 5.5 / 12, 4.0], [9.5 / 12, 1.5, 17.5 / 12], [8.0, 21.5 / 12, 12.0]])
    assert_close(refine_fractal(x, zero, zero[..., :1, :1] + 0.75)[0, 0].cpu(), mixed)
    assert_close(refine_fractal(x, zero + 9, zero[..., :1, :1] + 1)[0, 0].cpu()[1], torch.full((3,), 9.0))

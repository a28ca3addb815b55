"""A NaN or infinite pixel changes only the results of windows that contain it, in values and in gradients."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

import kvision as K
from benchmarks.sample_calls.windows import WINDOWS, Window
from op_tests import as_tuple, assert_close

F = K.filters
BAD = [float("nan"), float("inf"), float("-inf")]


windows = pytest.mark.parametrize("window", WINDOWS, ids=str)


def call(window: Window, x: Tensor) -> Tensor:
    """The first result, its new axis, where there is one, in front."""
    y = as_tuple(window(x))[0]
    return y.movedim(2, 0) if y.dim() > x.dim() else y


def image_of(window: Window, device: torch.device) -> Tensor:
    size = (19, 40) if len(window.reach) == 2 else (7, 9, 11)
    return torch.rand(2, 3, *size, device=device) + 0.1


def seen_from(window: Window, like: Tensor) -> tuple[tuple[int, ...], Tensor]:
    """A pixel, and where it may be seen."""
    at = tuple(n // 2 for n in like.shape[2:])
    seen = torch.zeros(like.shape, dtype=torch.bool, device=like.device)
    around = tuple(slice(max(p - r, 0), p + r + 1) for p, r in zip(at, window.reach))
    seen[(0, slice(None) if window.channels else 1, *around)] = True
    return (0, 1, *at), seen


def spoilt(x: Tensor, at: tuple[Any, ...], bad: float) -> Tensor:
    x = x.clone()
    x[at] = bad
    return x


@windows
def test_values(window: Window, device: torch.device) -> None:
    x = image_of(window, device)
    at, seen = seen_from(window, x)
    expected = call(window, x)
    unseen = ~seen[:, : expected.shape[-len(window.reach) - 1]].expand_as(expected)
    for bad in BAD:
        assert_close(call(window, spoilt(x, at, bad))[unseen], expected[unseen])


@windows
def test_gradients(window: Window, device: torch.device) -> None:
    """Of a bad pixel, and of a bad gradient that comes back."""
    x = image_of(window, device).requires_grad_()
    at, seen = seen_from(window, x)
    # Windows that hold the pixel reach as far again.
    _, seen_twice = seen_from(replace(window, reach=tuple(2 * r for r in window.reach)), x)
    y = call(window, x)
    (expected,) = torch.autograd.grad(y.sum(), x, retain_graph=True)
    channel = min(at[1], y.shape[-len(window.reach) - 1] - 1)
    for bad in BAD:
        grad = spoilt(torch.ones_like(y), (..., at[0], channel, *at[2:]), bad)
        (actual,) = torch.autograd.grad(y, x, grad, retain_graph=True)
        assert_close(actual[~seen], expected[~seen])
        leaf = spoilt(x.detach(), at, bad).requires_grad_()
        (actual,) = torch.autograd.grad(call(window, leaf).sum(), leaf)
        assert_close(actual[~seen_twice], expected[~seen_twice])


def test_infinite_center_of_a_laplacian(device: torch.device) -> None:
    """inf - inf: the sum of the window is infinite, and so is what the center takes away from it."""
    x = torch.zeros(1, 1, 7, 7, device=device)
    x[..., 3, 3] = float("inf")
    y = F.laplacian(x, 3)
    assert y[0, 0, 3, 3].isnan() and (y[0, 0, 2:5, 2:5].isinf().sum(), y.isfinite().sum()) == (8, 40)

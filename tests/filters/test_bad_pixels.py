"""A NaN or infinite pixel changes only the results of windows that contain it, in values and in gradients."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import pytest
import torch
from torch import Tensor

import kvision as K
from op_tests import assert_close

F = K.filters


class Case(NamedTuple):
    call: Callable[[Tensor], Tensor]
    reach: tuple[int, ...]  # how far a pixel is seen, along the axes of an image or a volume
    channels: bool = False  # whether it is seen by the other channels, too


def kernel(*size: int) -> Callable[[Tensor], Tensor]:
    return lambda x: torch.rand(1, *size, generator=torch.Generator().manual_seed(0)).to(x) + 0.1


CASES = {
    "sobel": Case(F.sobel, (1, 1)),
    "spatial_gradient": Case(lambda x: F.spatial_gradient(x).movedim(2, 0), (1, 1)),
    "spatial_gradient_2": Case(lambda x: F.spatial_gradient(x, order=2).movedim(2, 0), (2, 2)),
    "spatial_gradient_diff": Case(lambda x: F.spatial_gradient(x, "diff").movedim(2, 0), (1, 1)),
    "spatial_gradient3d": Case(lambda x: F.spatial_gradient3d(x, order=2).movedim(2, 0), (1, 1, 1)),
    "laplacian_3": Case(lambda x: F.laplacian(x, 3), (1, 1)),
    "laplacian_5x9": Case(lambda x: F.laplacian(x, (5, 9), "replicate"), (2, 4)),
    "canny": Case(lambda x: F.canny(x, 0.01, 0.02, hysteresis=False)[0], (4, 4), channels=True),
    "box_3": Case(lambda x: F.box_blur(x, 3), (1, 1)),
    "box_5x13": Case(lambda x: F.box_blur(x, (5, 13), "circular"), (2, 6)),
    "box_31": Case(lambda x: F.box_blur(x, 31, "constant"), (15, 15)),
    "gaussian_5": Case(lambda x: F.gaussian_blur2d(x, 5, 1.5), (2, 2)),
    "gaussian_3x11": Case(lambda x: F.gaussian_blur2d(x, (3, 11), (0.8, 3.0), "constant"), (1, 5)),
    "unsharp_mask": Case(lambda x: F.unsharp_mask(x, 5, 1.5), (2, 2)),
    "median_3": Case(lambda x: F.median_blur(x, 3), (1, 1)),
    "median_5": Case(lambda x: F.median_blur(x, 5), (2, 2)),
    "median_3x9": Case(lambda x: F.median_blur(x, (3, 9)), (1, 4)),
    "bilateral": Case(lambda x: F.bilateral_blur(x, 5, 0.2, 1.5), (2, 2), channels=True),
    "joint_bilateral": Case(lambda x: F.joint_bilateral_blur(x, x, 5, 0.2, 1.5, "replicate"), (2, 2), channels=True),
    "guided": Case(lambda x: F.guided_blur(x, x, 3, 0.1), (2, 2), channels=True),
    "motion": Case(lambda x: F.motion_blur(x, 5, 30.0, 0.5), (2, 2)),
    "motion3d": Case(lambda x: F.motion_blur3d(x, 3, (30.0, 10.0, 50.0), 0.5), (1, 1, 1)),
    "filter2d": Case(lambda x: F.filter2d(x, kernel(3, 5)(x)), (1, 2)),
    "filter2d_separable": Case(lambda x: F.filter2d_separable(x, kernel(7)(x), kernel(3)(x)), (1, 3)),
    "filter3d": Case(lambda x: F.filter3d(x, kernel(3, 1, 5)(x)), (1, 0, 2)),
    "blur_pool": Case(lambda x: F.blur_pool2d(x, 3, stride=1), (1, 1)),
    "edge_aware_blur_pool": Case(lambda x: F.edge_aware_blur_pool2d(x, 3, 1.05), (3, 3), channels=True),
}
BAD = [float("nan"), float("inf"), float("-inf")]


@pytest.fixture(params=CASES)
def case(request: pytest.FixtureRequest) -> Case:
    return CASES[request.param]


def image_of(case: Case, device: torch.device) -> Tensor:
    size = (19, 40) if len(case.reach) == 2 else (7, 9, 11)
    return torch.rand(2, 3, *size, device=device) + 0.1


def window(case: Case, like: Tensor) -> tuple[tuple[int, ...], Tensor]:
    """A pixel, and where it may be seen."""
    at = tuple(n // 2 for n in like.shape[2:])
    seen = torch.zeros(like.shape, dtype=torch.bool, device=like.device)
    around = tuple(slice(max(p - r, 0), p + r + 1) for p, r in zip(at, case.reach))
    seen[(0, slice(None) if case.channels else 1, *around)] = True
    return (0, 1, *at), seen


@pytest.mark.parametrize("bad", BAD, ids=str)
def test_values(case: Case, bad: float, device: torch.device) -> None:
    x = image_of(case, device)
    at, seen = window(case, x)
    spoilt = x.clone()
    spoilt[at] = bad
    y, expected = case.call(spoilt), case.call(x)
    unseen = ~seen[:, : y.shape[-len(case.reach) - 1]].expand_as(y)
    assert_close(y[unseen], expected[unseen])


@pytest.mark.parametrize("bad", BAD, ids=str)
def test_gradients(case: Case, bad: float, device: torch.device) -> None:
    """Of a bad pixel, and of a bad gradient that comes back."""
    x = image_of(case, device).requires_grad_()
    at, seen = window(case, x)
    y = case.call(x)
    (expected,) = torch.autograd.grad(y.sum(), x, retain_graph=True)

    grad = torch.ones_like(y)
    grad[(..., at[0], min(at[1], y.shape[-len(case.reach) - 1] - 1), *at[2:])] = bad
    (actual,) = torch.autograd.grad(y, x, grad)
    assert_close(actual[~seen], expected[~seen])

    spoilt = x.detach().clone()
    spoilt[at] = bad
    (actual,) = torch.autograd.grad(case.call(spoilt.requires_grad_()).sum(), spoilt)
    # Windows that hold the pixel reach as far again.
    _, seen = window(case._replace(reach=tuple(2 * r for r in case.reach)), x)
    assert_close(actual[~seen], expected[~seen])


def test_infinite_center_of_a_laplacian(device: torch.device) -> None:
    """inf - inf: the sum of the window is infinite, and so is what the center takes away from it."""
    x = torch.zeros(1, 1, 7, 7, device=device)
    x[..., 3, 3] = float("inf")
    y = F.laplacian(x, 3)
    assert y[0, 0, 3, 3].isnan() and (y[0, 0, 2:5, 2:5].isinf().sum(), y.isfinite().sum()) == (8, 40)

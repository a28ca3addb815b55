"""How many operators calls dispatch that are bound by launches: no more than were needed when the call was made fast."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

import kvision as K
from op_tests import DispatchedOperators

VIEWS = (
    "alias",
    "detach",
    "empty",
    "expand",
    "lift",
    "select",
    "slice",
    "split",
    "squeeze",
    "t",
    "transpose",
    "unbind",
    "view",
)


def work(names: list[str]) -> list[str]:
    """The operators among `names` that are neither views nor allocations."""
    return [n for n in names if not n.startswith(("unsqueeze", "_unsafe_view")) and n not in VIEWS]


def descriptors() -> tuple[Tensor, ...]:
    lafs = torch.rand(1, 9, 2, 3) * 100
    return torch.rand(9, 16), torch.rand(9, 16), lafs, lafs


LIGHT = K.augmentation.RandomLinearIllumination(p=1.0)
CALLS: dict[str, tuple[Callable[[], object], int]] = {
    "rgb_to_rgb255": (lambda: K.color.rgb_to_rgb255(torch.rand(1, 3, 4, 5)), 2),
    "normals_to_rgb255": (lambda: K.color.normals_to_rgb255(torch.rand(1, 3, 4, 5)), 2),
    "worldtocam_to_camtoworld_Rt": (
        lambda: K.geometry.worldtocam_to_camtoworld_Rt(torch.rand(2, 3, 3), torch.rand(2, 3, 1)),
        1,
    ),
    "project_points_orthographic": (lambda: K.geometry.project_points_orthographic(torch.rand(4, 3)), 0),
    "normalize_transformation": (lambda: K.geometry.normalize_transformation(torch.rand(2, 3, 3)), 5),
    "accuracy": (lambda: K.metrics.accuracy(torch.rand(4, 3), torch.ones(4).long()), 6),
    "angle_error_vec": (lambda: K.metrics.angle_error_vec(torch.rand(4, 3), torch.rand(4, 3)), 12),
    "draw_point2d": (lambda: K.image.draw_point2d(torch.zeros(3, 4, 5), torch.ones(2, 2).long(), torch.ones(3)), 3),
    "compute_correspond_epilines": (
        lambda: K.geometry.compute_correspond_epilines(torch.rand(2, 9, 2), torch.rand(2, 3, 3)),
        3,
    ),
    "match_fginn": (lambda: K.feature.match_fginn(*descriptors()), 16),
    "RandomLinearIllumination": (lambda: LIGHT(torch.rand(2, 3, 4, 5)), 26),
}


@pytest.mark.parametrize("name", CALLS)
def test_dispatched_operators(name: str) -> None:
    call, most = CALLS[name]
    with K.backend("native"):
        call()
        with DispatchedOperators() as dispatched:
            call()
    makes_arguments = ("rand", "zeros", "ones")
    names = [n for n in work(dispatched.names) if not n.startswith(makes_arguments)]
    assert len(names) <= most, names


def test_images_of_the_same_size_are_copied() -> None:
    x = torch.rand(1, 3, 4, 5, requires_grad=True)
    with DispatchedOperators() as dispatched:
        y = K.geometry.resize(x, (4, 5))
        (grad,) = torch.autograd.grad(y, x, torch.ones(x.shape))
    assert work(dispatched.names) == ["clone", "ones"] and torch.equal(grad, torch.ones(x.shape))
    assert y.data_ptr() != x.data_ptr()

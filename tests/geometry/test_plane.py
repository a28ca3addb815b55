"""Planes and their fits."""

import pytest
import torch
from torch import Tensor

import kvision as K
from composition_tests import Case, CompositionTests
from kvision.geometry.vector import Vector3
from op_tests import assert_close

G = K.geometry


class TestPlane(CompositionTests):
    cases = {
        "plane": Case(lambda a, b, c, p: G.Hyperplane.through(a, b, c).projection(p).data, ((2, 5, 3),) * 4),
        "fit_plane": Case(lambda p: G.fit_plane(p).signed_distance(p.new_ones(3)).data, ((2, 9, 3),)),
    }
    compiled = ()


def rand(*shape: int, seed: int = 5) -> Tensor:
    return torch.rand(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)) - 0.3


def test_fitted_planes_are_those_of_a_decomposition(device):
    points = rand(7, 20, 3) * torch.tensor([1, 0.5, 0.01], dtype=torch.float64)
    points = points @ G.axis_angle_to_rotation_matrix(rand(7, 3, seed=9)).mT + 100
    result = G.fit_plane(points.to(device))
    _, S, V = torch.linalg.svd(points - points.mean(1, keepdim=True))
    assert_close((result.normal.data.cpu() * V[:, 2]).sum(-1).abs(), torch.ones(7, dtype=torch.float64))
    distances = result.abs_distance(points.to(device).transpose(0, 1)).data
    assert_close(distances.square().sum(0).cpu(), S[:, 2] ** 2, 1e-8, 1e-8)
    single = G.fit_plane(Vector3(points[0].float().to(device)))
    assert_close(single.normal.data.double().cpu().abs(), result.normal.data[0].cpu().abs(), 1e-2, 1e-2)


BAD = [
    (lambda: G.fit_plane(torch.ones(2, 3)), ValueError, r"fit_plane: expected points of shape \(\*, N, 3\)"),
    (lambda: G.Hyperplane(torch.ones(2), torch.ones(())), ValueError, r"Hyperplane: expected n of shape \(\*, 3\)"),
    (lambda: G.Hyperplane.through(torch.ones(3), torch.ones(3)), ValueError, "Hyperplane.through: expected three points"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()

"""Lines, their fits, and where they meet planes."""

import itertools

import pytest
import torch
from torch import Tensor

import kvision as K
from composition_tests import Case, CompositionTests
from kvision.geometry.vector import Scalar
from op_tests import assert_close

G = K.geometry


def line(origin: Tensor, direction: Tensor) -> G.ParametrizedLine:
    return G.ParametrizedLine.through(origin, origin + direction)


class TestLine(CompositionTests):
    cases = {
        "line": Case(lambda o, d, p: line(o, d).distance(p), ((2, 5, 3),) * 3),
        "projection": Case(lambda o, d, p: line(o, d).projection(p), ((2, 5, 2),) * 3),
        "fit_line": Case(lambda p, w: G.fit_line(p, w).point_at(2.0), ((2, 9, 3), (2, 9))),
        "intersect": Case(lambda o, d, n: line(o, d).intersect(G.Hyperplane.from_vector(n, o))[1], ((2, 5, 3),) * 3),
    }
    compiled = ()


def rand(*shape: int, seed: int = 5) -> Tensor:
    return torch.rand(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)) - 0.3


@pytest.mark.parametrize("axes", [2, 3, 5])
@pytest.mark.parametrize("weighted", [False, True])
def test_fitted_lines_are_those_of_a_decomposition(axes, weighted, device):
    points = rand(7, 20, axes) + 3 * rand(7, 20, 1, seed=6) * rand(7, 1, axes, seed=7)
    weights = rand(7, 20, seed=8).abs() if weighted else None
    result = G.fit_line(points.to(device), None if weights is None else weights.to(device))
    w = torch.ones(7, 20, dtype=torch.float64) if weights is None else weights
    mean = (w[..., None] * points).sum(1, keepdim=True) / w.sum(1)[:, None, None]
    _, _, V = torch.linalg.svd((points - mean) * w.sqrt()[..., None])
    assert_close(result.origin.cpu(), mean[:, 0])
    assert_close((result.direction.cpu() * V[:, 0]).sum(-1).abs(), torch.ones(7, dtype=torch.float64))
    assert_close(result.direction.norm(dim=-1).cpu(), torch.ones(7, dtype=torch.float64))


def test_degenerate_fits_have_finite_gradients(device):
    same = torch.ones(1, 5, 3, device=device, requires_grad=True)
    along = torch.arange(15.0, device=device).reshape(1, 5, 3).requires_grad_()
    for points, fit in itertools.product(
        (same, along), (lambda p: G.fit_line(p).direction, lambda p: G.fit_plane(p).n)
    ):
        result = fit(points)
        (grad,) = torch.autograd.grad(result.sum(), points)
        assert result.isfinite().all()
        assert grad.isfinite().all()
    assert_close(G.fit_line(along).direction, torch.full((1, 3), 3**-0.5, device=device))
    assert not G.fit_line(same).direction.any()


def test_lines_and_planes_are_those_of_kornia(device):
    theirs = pytest.importorskip("kornia").geometry
    from kornia.geometry.vector import Vector3 as TheirVector

    a, b, c, p = (rand(4, 3, seed=s) for s in range(4))
    ours, his = G.ParametrizedLine.through(a.to(device), b.to(device)), theirs.ParametrizedLine.through(a, b)
    flat, level = G.Hyperplane.through(*(x.to(device) for x in (a, b, c))), theirs.Hyperplane.through(a, b, c)
    assert_close(ours.projection(p.to(device)).cpu(), his.projection(p))
    assert_close(ours.distance(p.to(device)).cpu(), his.distance(p))
    assert_close(ours.squared_distance(p.to(device)).cpu(), his.squared_distance(p))
    assert_close(ours.point_at(p[:, 0].to(device)).cpu(), his.point_at(p[:, 0]))
    assert_close(ours.point_at(Scalar(torch.tensor(2.0, device=device))).cpu(), his.point_at(2.0))
    assert (ours.dim(), ours[0] is ours.origin, len(list(ours))) == (3, True, 2)
    assert_close(flat.normal.data.cpu(), level.normal.data)
    assert_close(flat.offset.data.cpu(), level.offset.data)
    assert_close(flat.signed_distance(p.to(device)).data.cpu(), level.signed_distance(TheirVector(p)).data)
    assert_close(flat.projection(p.to(device)).data.cpu(), level.projection(TheirVector(p)).data)
    other = G.ParametrizedLine(p.to(device), c.to(device))
    assert_close([x.cpu() for x in other.intersect(flat)], list(theirs.ParametrizedLine(p, c).intersect(level)))
    parallel = G.ParametrizedLine(p.to(device), (b - a).to(device))
    assert_close(parallel.intersect(flat)[1], p.to(device))


def test_lines_learn(device):
    line = G.ParametrizedLine(torch.zeros(2), torch.tensor([1.0, 0])).to(device)
    line.distance(torch.tensor([1.0, 2], device=device)).backward()
    assert_close(line.origin.grad, torch.tensor([0.0, -1], device=device))


BAD = [
    (lambda: G.fit_line(torch.ones(2, 3)), ValueError, r"fit_line: expected points of shape \(B, N, D\)"),
    (lambda: G.fit_line(torch.ones(2, 1, 3)), ValueError, "fit_line: expected points of at least 2 a line"),
    (lambda: G.fit_line(torch.ones(2, 5, 3), torch.ones(2)), ValueError, r"fit_line: expected weights of shape \(2, 5\)"),
    (lambda: G.ParametrizedLine(torch.ones(3), torch.ones(2)), ValueError, r"direction of shape \(\*, 3\)"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()

"""Roots of polynomials."""

import numpy as np
import pytest
import torch

import kvision as K
from composition_tests import Case, on
from kvision.geometry.solvers.roots import first_root
from op_tests import assert_close
from point_op_tests import SINGLE_AND_DOUBLE, Call, PointOpTests
from view_tests import ViewTests, finite_gradients

G = K.geometry
QUARTIC = torch.tensor([0, 0, 2.0, 0, 0])


class TestRoots(ViewTests):
    cases = {
        "quartic": Case(lambda c: G.solve_quartic(c - on(c.device, QUARTIC)), ((2, 5),)),
    }  # fmt: skip
    compiled = ()


@pytest.mark.parametrize("roots", [[1, 1, 1], [-2, 3, 3], [0, 0, 5], [1e-6, 1, 1e6]])
def test_known_roots(roots, device):
    coeffs = torch.ones(1, 1).double()
    for r in roots:
        coeffs = torch.nn.functional.pad(coeffs, (0, 1)) - r * torch.nn.functional.pad(coeffs, (1, 0))
    expected = torch.tensor([roots]).double()
    assert_close(finite_gradients(G.solve_cubic, coeffs.to(device)).cpu(), expected, 1e-6, 1e-9)
    both = torch.nn.functional.pad(coeffs, (1, 0)).to(device)  # a quartic that is a cubic
    assert_close(finite_gradients(G.solve_quartic, both)[:, :3].sort(-1).values.cpu(), expected, 1e-6, 1e-9)


def test_polynomials_without_roots(device):
    coeffs = torch.tensor([[1.0, 0, 1], [0, 0, 1], [0, 0, 0]], device=device)
    assert (finite_gradients(G.solve_quadratic, coeffs) == 0).all()
    assert (finite_gradients(G.solve_quartic, torch.nn.functional.pad(coeffs, (1, 1))[:1]) == 0).all()


BAD = [
    (lambda: G.solve_cubic(torch.rand(3)), ValueError, r"solve_cubic: expected coeffs of shape \(\*, B, 4\)"),
]  # fmt: skip


@pytest.mark.parametrize("solve", [G.solve_quadratic, G.solve_cubic, G.solve_quartic])
def test_leading_axes(solve):
    coeffs = torch.rand(
        2, 3, 4, {G.solve_quadratic: 3, G.solve_cubic: 4, G.solve_quartic: 5}[solve], dtype=torch.float64
    )
    roots = solve(coeffs - 0.5)
    assert roots.shape == (2, 3, 4, coeffs.shape[-1] - 1)
    assert torch.equal(roots.flatten(0, 2), solve(coeffs.flatten(0, 2) - 0.5))


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message) as caught:
        call()
    assert isinstance(caught.value, K.core.exceptions.BaseError)


class TestRootsOperators(PointOpTests):
    calls = {
        "real_roots": [
            Call(
                (lambda: torch.tensor([2.0, -0.3, -3, 0.2, 0.5]) + 0.1 * torch.rand(5),),
                differentiable=False,
                dtypes=SINGLE_AND_DOUBLE,
                tolerance=20,
            )
        ],
        "first_root": [
            Call(
                (lambda: torch.tensor([1.0, -0.3, -0.6, 0.2, -0.5]) + 0.1 * torch.rand(5),),
                differentiable=False,
                dtypes=SINGLE_AND_DOUBLE,
                tolerance=20,
            )
        ],
    }


def test_first_positive_roots(device, backend):
    """The smallest positive one of numpy.roots; inf where there is none."""
    random = np.random.default_rng(5)
    p = np.concatenate([np.ones((400, 1)), random.uniform(-1, 1, (400, 6)) * np.exp(random.normal(size=(400, 6)))], 1)
    p[::5, 4:] = 0
    p[0, 1:] = 0
    expected = []
    for row in p:
        roots = np.roots(np.trim_zeros(row[::-1], "f"))
        real = roots.real[(abs(roots.imag) < 1e-9) & (roots.real > 0)]
        expected.append(real.min() if len(real) else np.inf)
    result = first_root(torch.from_numpy(p).to(device)).cpu()
    # The reference ends where the value is 0 up to rounding, which is earlier at roots that nearly meet.
    assert_close(result, torch.tensor(expected), 1e-5 if backend == "reference" else 1e-7, 0)

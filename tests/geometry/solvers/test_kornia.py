"""Solvers against Kornia 0.9, which defines names and conventions."""

import kornia
import pytest

import kvision as K
from op_tests import assert_close
from view_tests import assert_values_of_kornia, on_planes, rand

POINTS1, POINTS2, _ = on_planes(2, 12, noise=1.0)
WEIGHTS = rand(2, 12, seed=7)

# Home, name, arguments, keyword arguments.
CALLS = [
    ("solvers", "solve_quadratic", (rand(50, 3, low=-1),), {}),
    ("solvers", "multiply_deg_one_poly", (rand(5, 4), rand(5, 4, seed=1)), {}),
    ("solvers", "multiply_deg_two_one_poly", (rand(5, 10), rand(5, 4, seed=1)), {}),
    ("solvers", "determinant_to_polynomial", (rand(5, 3, 13),), {}),
    ("solvers", "null_vector_3x4", (rand(5, 3, 4),), {}),
    ("solvers", "find_affine", (POINTS1, POINTS2, WEIGHTS), {}),
]


@pytest.mark.parametrize("home, name, args, kwargs", CALLS, ids=[f"{c[1]}-{i}" for i, c in enumerate(CALLS)])
def test_values(home, name, args, kwargs, device):
    assert_values_of_kornia(home, name, args, kwargs, device)


@pytest.mark.parametrize("name, count", [("solve_cubic", 4), ("solve_quartic", 5)])
def test_roots(name, count, device):
    coeffs = rand(500, count, low=-1)
    result = getattr(K.geometry, name)(coeffs.to(device)).cpu()
    expected = getattr(kornia.geometry.solvers, name)(coeffs)
    assert_close(result.sort(-1).values, expected.sort(-1).values, 1e-9, 1e-9)

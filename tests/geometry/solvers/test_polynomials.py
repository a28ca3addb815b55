"""Products and determinants of polynomials."""

import numpy as np
import torch

import kvision as K
from composition_tests import Case
from op_tests import assert_close
from point_op_tests import Call, PointOpTests, vector
from view_tests import ViewTests, rand

G = K.geometry


class TestPolynomials(ViewTests):
    cases = {
        "linear": Case(G.multiply_deg_one_poly, ((2, 4), (2, 4))),
        "quadratic": Case(G.multiply_deg_two_one_poly, ((2, 10), (2, 4))),
        "determinant": Case(G.determinant_to_polynomial, ((2, 3, 13),)),
    }
    compiled = ("determinant",)


class TestPolynomialOperators(PointOpTests):
    calls = {
        "product_of_linear": [Call((vector(4), vector(4)))],
        "product_of_quadratic": [Call((vector(10), vector(4)))],
        "determinant_to_polynomial": [Call((vector(3, 13),))],
    }


def test_leading_axes_broadcast(device):
    a, b = rand(3, 1, 10).to(device), rand(2, 4, seed=1).to(device)
    expected = torch.stack([G.multiply_deg_two_one_poly(row.expand(2, 10), b) for row in a])
    assert_close(G.multiply_deg_two_one_poly(a, b), expected)


def test_determinant_polynomial_equals_numpy(device):
    A, z = rand(3, 13, low=-1), 0.7
    entries = A.split([4, 4, 5], -1)
    matrix = np.array([[np.polyval(e[row].numpy(), z) for e in entries] for row in range(3)])
    coefficients = G.determinant_to_polynomial(A.to(device)).cpu().flip(-1).numpy()
    np.testing.assert_allclose(np.polyval(coefficients, z), np.linalg.det(matrix), rtol=1e-12)

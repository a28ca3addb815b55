"""Normalization of points."""

import torch

import kvision as K
from composition_tests import Case
from point_op_tests import SINGLE_AND_DOUBLE, Call, PointOpTests, vector
from view_tests import ViewTests

G = K.geometry


class TestNormalization(ViewTests):
    cases = {
        "normalized": Case(lambda x, w: torch.cat([y[..., -2:] for y in G.normalize_points(x, 1e-3, w)], 1), ((2, 7, 2), (2, 7))),
    }  # fmt: skip
    compiled = ("normalized",)


class TestNormalizationOperators(PointOpTests):
    calls = {
        "normalize_points": [
            Call(
                (vector(7, 2, scale=9), weights),
                (1e-3,),
                broadcasts=False,
                accepted=("another dtype",),
                dtypes=SINGLE_AND_DOUBLE,
            )
            for weights in (vector(7), None)
        ],
    }


def test_matrices_without_a_last_entry_stay(device):
    M = torch.eye(3, dtype=torch.float64, device=device).repeat(3, 1, 1)
    M[:, 2, 2] = torch.tensor([2.0, 0.0, 1e-9])
    M.requires_grad_()
    normalized = G.normalize_transformation(M)
    assert torch.equal(normalized[1:], M[1:]) and torch.equal(normalized[0].diagonal(), M.new_tensor([0.5, 0.5, 1]))
    (grad,) = torch.autograd.grad(normalized[1:].sum(), M)
    assert torch.equal(grad[1:], torch.ones_like(M[1:]))

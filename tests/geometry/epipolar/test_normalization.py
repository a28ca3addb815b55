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

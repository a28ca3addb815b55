"""Normalization of points."""

import torch

import kvision as K
from composition_tests import Case
from view_tests import ViewTests

G = K.geometry


class TestNormalization(ViewTests):
    cases = {
        "normalized": Case(lambda x, w: torch.cat([y[..., -2:] for y in G.normalize_points(x, 1e-3, w)], 1), ((2, 7, 2), (2, 7))),
    }  # fmt: skip
    compiled = ("normalized",)

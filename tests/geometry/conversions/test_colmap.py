"""Poses of ARKit and COLMAP."""

import pytest
import torch

import kvision as K
from composition_tests import Case, CompositionTests

G = K.geometry


class TestColmap(CompositionTests):
    compiled = ()
    cases = {
        "ARKitQTVecs_to_ColmapQTVecs": Case(
            lambda q, t: torch.cat([x.flatten(1) for x in G.ARKitQTVecs_to_ColmapQTVecs(q, t)], 1), ((2, 4), (2, 3, 1))
        ),
    }


BAD = [
    (lambda: G.ARKitQTVecs_to_ColmapQTVecs(torch.ones(1, 4), torch.ones(3, 1)), ValueError, "expected tvec of shape"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()

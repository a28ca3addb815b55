"""Key points of images."""

import pytest
import torch

import kvision as K
from composition_tests import Case, CompositionTests

G = K.geometry


class TestKeypoints(CompositionTests):
    cases = {
        "keypoints": Case(lambda k, M: G.Keypoints(k).transform_keypoints(M).data, ((2, 5, 2), (2, 3, 3))),
        "keypoints3d": Case(lambda k, p: G.Keypoints3D(k).pad(p).data, ((2, 5, 3), (2, 6))),
    }
    compiled = ()


BAD = [
    (lambda: G.Keypoints(torch.ones(3)), ValueError, r"Keypoints: expected keypoints of shape \(\*, 2\)"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()

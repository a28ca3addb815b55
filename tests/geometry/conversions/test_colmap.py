"""Poses of ARKit and COLMAP, and COLMAP's cameras."""

import pytest
import torch

import kvision as K
from composition_tests import Case, CompositionTests
from op_tests import assert_close

G = K.geometry


class TestColmap(CompositionTests):
    compiled = ()
    cases = {
        "ARKitQTVecs_to_ColmapQTVecs": Case(
            lambda q, t: torch.cat([x.flatten(1) for x in G.ARKitQTVecs_to_ColmapQTVecs(q, t)], 1), ((2, 4), (2, 3, 1))
        ),
        "camera_from_colmap": Case(
            lambda x: torch.cat([y.flatten(1) for y in G.camera_from_colmap(x, "FULL_OPENCV")], 1), ((2, 12),)
        ),
        "camera_to_colmap": Case(lambda x, k: G.camera_to_colmap(x, k, "FULL_OPENCV"), ((2, 3, 3), (2, 5))),
    }


BAD = [
    (lambda: G.ARKitQTVecs_to_ColmapQTVecs(torch.ones(1, 4), torch.ones(3, 1)), ValueError, "expected tvec of shape"),
    (lambda: G.camera_from_colmap(torch.ones(5), "FOV"), ValueError, "model must be one of"),
    (lambda: G.camera_from_colmap(torch.ones(5), "OPENCV"), ValueError, r"expected params of shape \(\*, 8\)"),
    (lambda: G.camera_to_colmap(torch.eye(3), torch.ones(5)), ValueError, r"of shape \(n\) with n at most 4"),
    (lambda: G.camera_to_colmap(torch.eye(3), torch.ones(2, 4)), ValueError, r"of shape \(n\) with n at most 4"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()


def test_cameras(device):
    """Focal lengths, half a pixel of the principal point, coefficients filled up with zeros, and the way back."""
    one = torch.tensor([[50.0, 20, 10, 0.1, 0.2]], device=device)
    matrix, coefficients = G.camera_from_colmap(one, "RADIAL")
    assert matrix.tolist() == [[[50, 0, 19.5], [0, 50, 9.5], [0, 0, 1]]]
    assert_close(coefficients, torch.tensor([[0.1, 0.2, 0, 0]], device=device), 0, 0)
    for model, count in (("OPENCV", 8), ("OPENCV_FISHEYE", 8), ("FULL_OPENCV", 12)):
        params = torch.rand(2, 3, count, device=device)
        assert_close(G.camera_to_colmap(*G.camera_from_colmap(params, model), model), params, 0, 1e-6)
    five = G.camera_to_colmap(matrix, torch.ones(1, 5, device=device), "FULL_OPENCV")
    assert five.tolist() == [[50, 50, 20, 10, 1, 1, 1, 1, 1, 0, 0, 0]]

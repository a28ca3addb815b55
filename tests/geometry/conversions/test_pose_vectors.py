"""Poses as vectors of a quaternion and a translation."""

import pytest
import torch

import kvision as K
from composition_tests import Case, CompositionTests
from op_tests import assert_close

G = K.geometry
# A quarter turn about z, and a translation.
HALF = 0.5**0.5
VECTORS = {
    "t_xyzw": [1, 2, 3, 0, 0, HALF, HALF],
    "xyzw_t": [0, 0, HALF, HALF, 1, 2, 3],
    "wxyz_t": [HALF, 0, 0, HALF, 1, 2, 3],
    "t_wxyz": [1, 2, 3, HALF, 0, 0, HALF],
}
MATRIX = torch.tensor([[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]], dtype=torch.float64)


class TestPoseVectors(CompositionTests):
    cases = {
        "pose_vector_to_matrix4x4": Case(lambda x: G.pose_vector_to_matrix4x4(x, "t_xyzw"), ((2, 7),)),
        "matrix4x4_to_pose_vector": Case(
            lambda x: G.matrix4x4_to_pose_vector(G.pose_vector_to_matrix4x4(x, "xyzw_t"), "t_wxyz"), ((2, 7),)
        ),
    }
    compiled = ()


@pytest.mark.parametrize("order", VECTORS)
def test_orders(order, device):
    vectors = torch.tensor([[VECTORS[order]]], dtype=torch.float64, device=device)
    assert_close(G.pose_vector_to_matrix4x4(2 * vectors, order)[0, 0, :3, :3].cpu(), MATRIX[:3, :3], 0, 1e-12)
    matrices = G.pose_vector_to_matrix4x4(vectors, order)
    assert_close(matrices.cpu(), MATRIX[None, None], 0, 1e-12)
    assert_close(G.matrix4x4_to_pose_vector(matrices, order), vectors, 0, 1e-12)


def test_errors():
    with pytest.raises(ValueError, match="order must be one of"):
        G.pose_vector_to_matrix4x4(torch.ones(7), "xyzw")
    with pytest.raises(ValueError, match=r"expected pose of shape \(\*, 7\)"):
        G.pose_vector_to_matrix4x4(torch.ones(6), "t_xyzw")
    with pytest.raises(TypeError, match="expected extrinsics to be floating point"):
        G.matrix4x4_to_pose_vector(torch.eye(4, dtype=torch.int64), "t_xyzw")

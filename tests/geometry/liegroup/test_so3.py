"""The operators of SO(3). What all groups satisfy is in test_group.py."""

from __future__ import annotations

from point_op_tests import Call, PointOpTests, vector


class TestSo3Operators(PointOpTests):
    calls = {
        "so3_left_jacobian": [Call((vector(3),)), Call((vector(3, scale=3),))],
        "so3_left_jacobian_inverse": [Call((vector(3),)), Call((vector(3, scale=3),))],
    }

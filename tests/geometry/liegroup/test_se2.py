"""The operators of SE(2). What all groups satisfy is in test_group.py."""

from __future__ import annotations

from point_op_tests import Call, PointOpTests, vector


class TestSe2Operators(PointOpTests):
    calls = {
        "se2_exp": [Call((vector(3),))],
        "se2_log": [Call((vector(4),))],
    }

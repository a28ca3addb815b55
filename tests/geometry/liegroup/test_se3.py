"""The operators of SE(3). What all groups satisfy is in test_group.py."""

from __future__ import annotations

import torch

from point_op_tests import Call, PointOpTests, vector

MOTION = torch.tensor([0.8, 0.3, -0.4, 0.2, 0.0, 0.0, 0.0], dtype=torch.float64)


class TestSe3Operators(PointOpTests):
    calls = {
        "se3_exp": [Call((vector(6),)), Call((vector(6, scale=3),))],
        "se3_log": [Call((lambda: MOTION + 0.3 * torch.rand(7, dtype=torch.float64),))],
        "se3_left_jacobian": [Call((vector(6),)), Call((vector(6, scale=2),))],
        "se3_left_jacobian_inverse": [Call((vector(6),)), Call((vector(6, scale=2),))],
    }

"""Confusion matrices."""

import torch

from point_op_tests import Call, PointOpTests


def labels() -> torch.Tensor:
    return torch.randint(-1, 5, (30,))


class TestConfusionMatrixOperators(PointOpTests):
    calls = {
        "confusion_matrix": [
            Call(
                (labels, labels),
                (4, statistic, 1e-6),
                broadcasts=False,
                differentiable=False,
                dtypes=(torch.int64, torch.int64),
                accepted=("of torch.int64", "classes"),
            )
            for statistic in range(3)
        ],
    }

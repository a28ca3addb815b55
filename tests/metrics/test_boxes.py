"""Overlaps of boxes."""

from collections.abc import Callable

import torch

from point_op_tests import Call, PointOpTests


def boxes(n: int) -> Callable[[], torch.Tensor]:
    return lambda: torch.rand(n, 4, dtype=torch.float64).cumsum(1)


class TestBoxesOperators(PointOpTests):
    calls = {
        "box_iou": [Call((boxes(5), boxes(3)), (form,), accepted=(" cut along axis -2",)) for form in range(3)],
    }

"""Overlaps of boxes."""

from collections.abc import Callable

import pytest
import torch

import kvision as K
from point_op_tests import Call, PointOpTests


def boxes(n: int) -> Callable[[], torch.Tensor]:
    return lambda: torch.rand(n, 4, dtype=torch.float64).cumsum(1)


class TestBoxesOperators(PointOpTests):
    calls = {
        "box_iou": [Call((boxes(5), boxes(3)), (form,), accepted=(" cut along axis -2",)) for form in range(3)],
    }


@pytest.mark.parametrize("count", [3, 4])
def test_shared_edges_share_the_gradient(count, device):
    """Boxes with common edges, boxes that only touch, and one without an area: as torch differentiates the reference."""
    a = torch.tensor([[0.0, 0, 2, 2], [1, 1, 3, 2], [2, 0, 4, 2], [3, 3, 3, 5]], device=device)[:count]
    b = torch.tensor([[0.0, 0, 2, 2], [1, 0, 2, 2]], device=device)
    grad = torch.rand(count, 2, device=device)

    def gradients():
        leaves = [x.clone().requires_grad_() for x in (a, b)]
        return torch.autograd.grad(K.metrics.mean_iou_bbox(*leaves), leaves, grad)

    with K.backend("reference"):
        expected = gradients()
    assert expected[0].isfinite().all() and expected[1].isnan().all() == (count == 4)
    for result, right in zip(gradients(), expected):
        torch.testing.assert_close(result, right, equal_nan=True)

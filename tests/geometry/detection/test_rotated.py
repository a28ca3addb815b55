"""Suppression of rotated boxes against a greedy loop over exact overlaps."""

import pytest
import torch
from torch import Tensor

import kvision as K

G = K.geometry


def rotated(n: int, seed: int = 3) -> Tensor:
    r = torch.rand(n, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    return torch.cat([20 * r[:, :2], 2 + 8 * r[:, 2:4], 360 * r[:, 4:] - 180], 1)


def greedy(boxes: Tensor, scores: Tensor, threshold: float, classes: Tensor) -> list[int]:
    kept: list[int] = []
    overlaps = K.metrics.box_iou_rotated(boxes, boxes).tolist()
    for i in scores.argsort(descending=True, stable=True).tolist():
        if not any(overlaps[i][j] > threshold and classes[i] == classes[j] for j in kept):
            kept.append(i)
    return kept


@pytest.mark.parametrize("n, threshold", [(0, 0.5), (1, 0.5), (40, 0.05), (200, 0.2), (200, 0.9)])
def test_nms_is_greedy(n, threshold, device):
    boxes, scores = rotated(n), torch.rand(n, generator=torch.Generator().manual_seed(5)).round(decimals=2)
    classes = torch.arange(n) % 3
    for idxs in (None, classes):
        own = None if idxs is None else idxs.to(device)
        result = G.nms_rotated(boxes.to(device), scores.to(device), threshold, own)
        assert result.tolist() == greedy(boxes, scores, threshold, classes * (idxs is not None))
    single = boxes.float()
    expected = greedy(single.double(), scores, threshold, 0 * classes)
    assert G.nms_rotated(single.to(device), scores.to(device), threshold).tolist() == expected


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_what_does_not_overlap_is_not_suppressed_at_zero(dtype, device):
    angle = torch.rand(60, dtype=torch.float64, generator=torch.Generator().manual_seed(2))[:, None] * 360
    column = torch.arange(60, dtype=torch.float64)[:, None]
    boxes = torch.cat([8 * column, 30 * (column % 7), torch.full_like(column, 5), 1 + column / 20, angle], 1)
    overlaps = K.metrics.box_iou_rotated(boxes.to(device, dtype), boxes.to(device, dtype))
    assert torch.equal(overlaps > 0, torch.eye(60, dtype=torch.bool, device=device))
    assert len(G.nms_rotated(boxes.to(device, dtype), torch.rand(60, device=device), 0.0)) == 60
    many = rotated(100).to(device, dtype)
    overlaps = K.metrics.box_iou_rotated(many, many)
    assert overlaps.min() == 0 and overlaps.max() <= 1 and torch.equal(overlaps == 0, overlaps.mT == 0)


def test_upright_boxes_are_those_of_nms(device):
    upright = rotated(100).to(device)
    upright[:, 4] = 0
    scores = torch.rand(100, device=device)
    xyxy = torch.cat([upright[:, :2] - upright[:, 2:4] / 2, upright[:, :2] + upright[:, 2:4] / 2], 1)
    assert torch.equal(G.nms_rotated(upright, scores, 0.3), G.nms(xyxy, scores, 0.3))
    chain = torch.tensor([[5.0 * i, 0, 8, 4, 0] for i in range(200)], device=device)  # each box overlaps the next one
    assert G.nms_rotated(chain, -torch.arange(200.0, device=device), 0.1).tolist() == list(range(0, 200, 2))
    chain[:, 2] = 0  # no area, no overlap
    assert len(G.nms_rotated(chain, scores[:1].expand(200), 0.1)) == 200


BAD = [
    (lambda: G.nms_rotated(torch.ones(3, 4), torch.ones(3), 0.5), ValueError, r"expected boxes of shape \(N, 5\)"),
    (
        lambda: G.nms_rotated(rotated(3), torch.ones(2), 0.5),
        ValueError,
        r"nms_rotated: expected scores of shape \(3,\)",
    ),
    (lambda: G.nms_rotated(rotated(3), torch.ones(3), 0.5, torch.ones(3)), TypeError, "expected idxs of integers"),
]


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()

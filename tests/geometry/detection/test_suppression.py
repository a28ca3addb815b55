"""Suppression of boxes: kernels against their references, greedy loops and values of torchvision."""

import math

import pytest
import torch
from torch import Tensor

import kvision as K
from composition_tests import Case, CompositionTests
from op_tests import assert_close, does_not_wait
from point_op_tests import SINGLE_AND_DOUBLE, Call, PointOpTests

G = K.geometry
COUNT = 9  # below, up to 300 boxes are more than the 64 of a word


def rand(*shape: int, seed: int = 3) -> Tensor:
    return torch.rand(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def xyxy(*shape: int, seed: int = 3) -> Tensor:
    near = 20 * rand(*shape, 2, seed=seed)
    return torch.cat([near, near + 2 + 10 * rand(*shape, 2, seed=seed + 1)], -1)


def edges() -> Tensor:
    near = 20 * torch.rand(2, COUNT, dtype=torch.float64)
    return torch.cat([near, near + 2 + 10 * torch.rand(2, COUNT, dtype=torch.float64)])


def labels() -> Tensor:
    return torch.randint(0, 3, (COUNT,))


def scores() -> Tensor:
    return torch.rand(COUNT, dtype=torch.float64)


# Alone, or beside labels of int64, edges may be of either type.
ACCEPTED = ("labels of torch.int64", "edges of another dtype", "decay 0")
CALL = dict(differentiable=False, dtypes=SINGLE_AND_DOUBLE, accepted=ACCEPTED)


class TestSuppressionOperators(PointOpTests):
    calls = {
        "suppress_boxes": [
            Call((edges, classes), (threshold,), **CALL) for classes in (None, labels) for threshold in (0.3, -1.0)
        ],
        "soft_suppress_boxes": [
            Call((edges, scores, classes), (0.3, 0.5, 0.2, decay), **CALL)
            for classes in (None, labels)
            for decay in range(2)
        ],
    }


class TestMasks(CompositionTests):
    cases = {
        "nms_mask": Case(
            lambda b, s: G.nms_mask(b.cumsum(-1), s, 0.2).to(s.dtype), ((2, 9, 4), (2, 9)), differentiable=False
        ),
    }


def greedy(boxes: Tensor, scores: Tensor, threshold: float, classes: list[int] | None = None) -> list[int]:
    kept: list[int] = []
    overlaps = K.metrics.mean_iou_bbox(boxes, boxes).tolist()
    for i in scores.argsort(descending=True, stable=True).tolist():
        if not any(overlaps[i][j] > threshold and (not classes or classes[i] == classes[j]) for j in kept):
            kept.append(i)
    return kept


@pytest.mark.parametrize("n, threshold", [(0, 0.5), (1, 0.5), (2, 0.0), (64, 0.1), (300, 0.5), (300, 1.0)])
def test_nms_is_greedy(n, threshold, device):
    boxes, best = xyxy(n), (10 * rand(n, seed=6)).round()
    classes = (3 * rand(n, seed=7)).long() * 2**40 - 1
    at = [x.to(device) for x in (boxes, best, classes)]
    expected, by_class = greedy(boxes, best, threshold), greedy(boxes, best, threshold, classes.tolist())
    assert G.nms(*at[:2], threshold).tolist() == expected
    assert G.batched_nms(*at, threshold).tolist() == by_class
    assert G.nms_mask(*at[:2], threshold, at[2]).nonzero()[:, 0].tolist() == sorted(by_class)


def test_nms_of_a_chain(device):
    """Each box excludes the next one alone."""
    x = torch.arange(200.0, device=device)
    boxes = torch.stack([x, 0 * x, x + 1.5, 0 * x + 1], -1)
    assert G.nms(boxes, -x, 0.1).tolist() == list(range(0, 200, 2))
    assert G.nms(0 * boxes, -x, 0.1).tolist() == list(range(200))  # no area, no overlap
    boxes[::2] = torch.nan
    assert G.nms(boxes, -x, 0.1).tolist() == list(range(200))
    assert G.nms(boxes[1:2].expand(5, 4), x[:5], 0.99).tolist() == [4]  # equal boxes overlap by 1 exactly
    assert G.nms(boxes[1:2].expand(5, 4), x[:5], 1.0).tolist() == [4, 3, 2, 1, 0]


def test_padding_and_many_images(device):
    boxes, best = xyxy(3, 150).to(device), rand(3, 150, seed=8).to(device)
    each = torch.stack([G.nms_mask(b, s, 0.3) for b, s in zip(boxes, best)])
    assert torch.equal(G.nms_mask(boxes, best, 0.3), each)
    padded = torch.cat([boxes, torch.zeros(3, 9, 4, device=device)], 1), torch.cat([best, best[:, :9] - 9], 1)
    assert torch.equal(G.nms_mask(*padded, 0.3)[:, :150], each)
    does_not_wait(device, [lambda: G.nms_mask(boxes, best, 0.3)])


# torchvision 0.29.1: nms and batched_nms of these boxes, scores and classes.
BOXES = [
    [0, 0, 10, 10],
    [1, 1, 11, 11],
    [0, 0, 9, 10],
    [20, 20, 30, 30],
    [21, 20, 31, 30],
    [5, 5, 15, 15],
    [0, 0, 0, 0],
]
SCORES, CLASSES = [0.9, 0.8, 0.85, 0.3, 0.95, 0.5, 0.1], [0, 1, 0, 1, 1, 0, 0]
KEPT, BY_CLASS = [4, 0, 5, 6], [4, 0, 1, 5, 6]


def test_values_of_torchvision(device):
    boxes, best = torch.tensor(BOXES, device=device), torch.tensor(SCORES, device=device)
    for dtype in (torch.int64, torch.float32, torch.float16):
        assert G.nms(boxes.to(dtype), best, 0.5).tolist() == KEPT
        assert G.batched_nms(boxes.to(dtype), best, torch.tensor(CLASSES, device=device), 0.5).tolist() == BY_CLASS


def soft(boxes: Tensor, best: Tensor, method: str, lowest: float) -> tuple[list[int], list[float]]:
    """The paper's loop, with Python's numbers."""
    overlaps, left = K.metrics.mean_iou_bbox(boxes, boxes).tolist(), dict(enumerate(best.tolist()))
    order, values = [], []
    while left and max(left.values()) >= lowest:
        i = max(left, key=lambda k: left[k])
        order.append(i)
        values.append(left.pop(i))
        for k in left:
            overlap = overlaps[i][k]
            linear = 1 - overlap if overlap > 0.3 else 1
            left[k] *= linear if method == "linear" else math.exp(-(overlap**2) / 0.5)
    return order, values


@pytest.mark.parametrize("method", ["linear", "gaussian"])
@pytest.mark.parametrize("n", [0, 1, 60])
def test_soft_nms_is_the_papers_loop(n, method, device):
    boxes, best = xyxy(n), rand(n, seed=6)
    order, values = soft(boxes, best, method, 0.1)
    result, decayed = G.soft_nms(boxes.to(device), best.to(device), 0.3, 0.5, 0.1, method)
    assert result.tolist() == order
    assert_close(decayed.cpu(), torch.tensor(values, dtype=torch.float64), 1e-5, 1e-7)
    apart = torch.arange(n, device=device)
    result, decayed = G.soft_nms(boxes.to(device), best.to(device), min_score=0.1, method=method, idxs=apart)
    assert result.tolist() == [i for i in best.argsort(descending=True).tolist() if best[i] >= 0.1]


BOX = xyxy(5)
BAD = [
    (lambda: G.nms(BOX, torch.ones(3), 0.5), ValueError, r"nms: expected scores of shape \(5,\)"),
    (lambda: G.nms(BOX, [1, 2], 0.5), TypeError, "nms: expected scores to be a Tensor"),
    (lambda: G.nms_mask(BOX[None, None], torch.ones(5), 0.5), ValueError, r"of shape \(N, 4\) or \(B, N, 4\)"),
    (lambda: G.batched_nms(BOX, torch.ones(5), torch.ones(5), 0.5), TypeError, "expected idxs of integers"),
    (lambda: G.soft_nms(BOX, torch.ones(5), method="hard"), ValueError, "soft_nms: method must be one of"),
    (lambda: G.soft_nms(BOX, torch.ones(5), sigma=0.0), ValueError, "expected sigma above 0"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()

"""Thresholds, compared with OpenCV's."""

from __future__ import annotations

import cv2
import pytest
import torch

import kvision as K
from op_tests import assert_close

E = K.enhance
TYPES = [t for t in E.ThresholdType if t != E.ThresholdType.THRESH_OTSU]


@pytest.mark.parametrize("kind", TYPES, ids=lambda t: t.name)
def test_opencv(kind):
    levels = torch.arange(256, dtype=torch.uint8).view(16, 16)
    assert int(kind) == getattr(cv2, kind.name)
    for t in (0.0, 100.0, 100.7, 254.0):
        expected = cv2.threshold(levels.numpy(), t, 200.0, int(kind))[1]
        assert torch.equal(E.threshold(levels, t, 200.0, kind), torch.from_numpy(expected))
        expected = cv2.threshold(levels.float().numpy(), t, 200.0, int(kind))[1]
        assert_close(E.threshold(levels.float(), t, 200.0, int(kind)), torch.from_numpy(expected))


@pytest.mark.parametrize("dtype", [torch.bool, torch.int8, torch.int16, torch.int64, torch.float16], ids=str)
def test_type_is_kept(dtype):
    x = torch.tensor([0, 1, 1, 0]).to(dtype)
    for kind in TYPES:
        y = E.threshold(x, 0.5, 1000.0, kind)
        assert y.dtype == dtype and y.shape == x.shape
    top = 1 if dtype == torch.bool else min(1000, torch.iinfo(dtype).max) if not x.is_floating_point() else 1000
    assert E.threshold(x, 0.5, 1000.0)[1] == top


def test_thresholds_that_broadcast(device):
    x = torch.rand(2, 3, 4, 5, device=device)
    t, high = torch.rand(2, 1, 1, 1, device=device), torch.rand(3, 1, 1, device=device)
    assert_close(E.threshold(x, t, high), torch.where(x > t, high, 0.0))
    assert_close(E.threshold(x, t, type=2), torch.minimum(x, t))
    levels = (255 * x).byte()
    assert torch.equal(E.threshold(levels, 255 * t, type=3), torch.where(levels > (255 * t).floor(), levels, 0))


def test_gradients():
    x = torch.tensor([0.2, 0.7], requires_grad=True)
    for kind, slope in ((0, [0.0, 0.0]), (2, [1.0, 0.0]), (3, [0.0, 1.0]), (4, [1.0, 0.0])):
        y = E.threshold(x, 0.5, 1.0, kind)
        assert y.requires_grad == (kind != 0)
        if y.requires_grad:
            assert_close(torch.autograd.grad(y.sum(), x)[0], torch.tensor(slope))
        t = torch.tensor(0.5, requires_grad=True)
        assert E.threshold(x.detach(), t, 1.0, kind).requires_grad == (kind == 2)

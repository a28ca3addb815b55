"""Levels of 255, and unit normals kept in them."""

from __future__ import annotations

import torch

import kvision as K
from op_tests import assert_close

C = K.color


def test_bytes_become_colors(device):
    levels = torch.arange(256, dtype=torch.uint8, device=device).view(1, 1, 256).expand(3, -1, -1)
    assert_close(C.rgb255_to_rgb(levels), levels.float() / 255)
    assert_close(C.rgb_to_rgb255(C.rgb255_to_rgb(levels)).round().to(torch.uint8), levels)


def test_clamped_at_both_ends(device):
    x = torch.tensor([-0.5, 0.5, 1.5], device=device).view(3, 1, 1)
    assert C.rgb_to_rgb255(x).flatten().tolist() == [0, 127.5, 255]
    assert C.normals_to_rgb255(2 * x - 1).flatten().tolist() == [0, 127.5, 255]


def test_half_types_are_rounded_once(device):
    x = torch.linspace(-1.2, 1.2, 3003, device=device).view(1, 3, 7, 143)
    for dtype in (torch.float16, torch.bfloat16):
        half = x.to(dtype)
        assert torch.equal(C.rgb_to_rgb255(half), C.rgb_to_rgb255(half.float()).to(dtype))
        assert torch.equal(C.normals_to_rgb255(half), C.normals_to_rgb255(half.float()).to(dtype))


def test_normals(device):
    n = torch.nn.functional.normalize(torch.randn(2, 3, 5, 6, dtype=torch.float64, device=device), dim=1)
    result = C.rgb255_to_normals(C.normals_to_rgb255(n))
    assert_close(result, n)
    unequal = C.rgb255_to_normals(torch.rand(2, 3, 5, 6, dtype=torch.float64, device=device) * 255)
    assert_close(unequal.norm(dim=1), torch.ones_like(unequal[:, 0]))


def test_normals_of_length_zero(device):
    x = torch.full((3, 1, 1), 127.5, device=device, requires_grad=True)
    y = C.rgb255_to_normals(x)
    (gradient,) = torch.autograd.grad(y.sum(), x)
    assert not y.any() and gradient.isfinite().all()

"""Levels to [0, 1] and back."""

from __future__ import annotations

import pytest
import torch

from kvision.core.pixels import to_uint8, to_unit


@pytest.mark.parametrize("dtype", [torch.uint8, torch.uint16, torch.int16, torch.bool])
def test_ends_of_the_range(dtype, device):
    top = 1 if dtype == torch.bool else torch.iinfo(dtype).max
    x = torch.tensor([0, top], device=device).to(dtype)
    assert to_unit(x).tolist() == pytest.approx([0, 1]) and to_uint8(x).tolist() == [0, 255]


@pytest.mark.parametrize("dtype", [torch.float16, torch.float32, torch.float64])
def test_every_level_survives(dtype, device):
    levels = torch.arange(256, dtype=torch.uint8, device=device)
    assert torch.equal(to_uint8(to_unit(levels).to(dtype)), levels)
    assert torch.equal(to_uint8(levels), levels)

"""Alpha as a number or an image, and backgrounds of every shape."""

from __future__ import annotations

import pytest
import torch

import kvision as K
from kvision.core.exceptions import DeviceError
from op_tests import assert_close

C = K.color


@pytest.mark.parametrize("append, module", [(C.rgb_to_rgba, C.RgbToRgba), (C.bgr_to_rgba, C.BgrToRgba)])
def test_alpha(append, module, device):
    x = torch.rand(2, 3, 4, 5, device=device)
    rgb = x if append is C.rgb_to_rgba else x.flip(1)
    alpha = torch.rand(2, 1, 4, 5, dtype=torch.float64, device=device, requires_grad=True)
    y = append(x, alpha)
    assert y.dtype == x.dtype
    assert_close(y, torch.cat([rgb, alpha.float()], 1))
    assert_close(append(x, 0.5)[:, 3], torch.full((2, 4, 5), 0.5, device=device))
    y.sum().backward()
    assert torch.equal(alpha.grad, torch.ones_like(alpha))
    fixed = module(alpha.detach())
    assert_close(fixed(x), y.detach())
    assert not fixed.state_dict()
    bytes_ = append(torch.zeros(3, 2, 2, dtype=torch.uint8, device=device), 255.0)
    assert bytes_.dtype == torch.uint8 and bytes_[3].min() == 255


@pytest.mark.parametrize(
    "shape", [(3, 1, 1), (1, 3, 1, 1), (2, 3, 1, 1), (3, 4, 5), (2, 3, 4, 5), (1, 3, 4, 1)], ids=str
)
def test_backgrounds(shape, device):
    kornia = pytest.importorskip("kornia")
    x = torch.rand(2, 4, 4, 5, dtype=torch.float64, device=device, requires_grad=True)
    background = torch.rand(shape, dtype=torch.float64, device=device, requires_grad=True)
    assert_close(C.rgba_to_rgb(x, background), kornia.color.rgba_to_rgb(x, background))
    assert torch.autograd.gradcheck(C.rgba_to_rgb, (x, background))
    several = torch.rand(3, 2, 4, 4, 5, device=device)
    assert_close(C.rgba_to_rgb(several, background.float())[1], C.rgba_to_rgb(several[1], background.float()))


def test_background_numbers(device):
    x = torch.rand(4, 4, 5, device=device)
    color = torch.tensor([0.1, 0.2, 0.3], device=device)[:, None, None]
    for background in ((0.1, 0.2, 0.3), [0.1, 0.2, 0.3]):
        assert_close(C.rgba_to_rgb(x, background), C.rgba_to_rgb(x, color))
    assert_close(C.rgba_to_bgr(x), C.rgba_to_rgb(x, (1, 1, 1)).flip(0))


def test_alpha_of_zero_and_one(device):
    x = torch.rand(1, 4, 4, 5, device=device)
    x[:, 3, :2], x[:, 3, 2:] = 0, 1
    y = C.rgba_to_rgb(x, (0.1, 0.2, 0.3))
    assert torch.equal(y[:, :, 2:], x[:, :3, 2:])
    assert_close(y[0, :, 0, 0], torch.tensor([0.1, 0.2, 0.3], device=device))


def test_tensors_on_another_device(device):
    x = torch.rand(2, 3, 4, 5, device=device)
    with pytest.raises(DeviceError, match="^rgb_to_rgba: "):
        C.rgb_to_rgba(x, torch.ones(2, 1, 4, 5, device="meta"))
    with pytest.raises(DeviceError, match="^rgba_to_rgb: "):
        C.rgba_to_rgb(C.rgb_to_rgba(x, 1.0), torch.ones(3, 1, 1, device="meta"))

"""Gradients of color functions where channels are equal, 0 or 1, and where they are nearly: docs/conventions.md."""

from __future__ import annotations

import itertools
import math

import pytest
import torch
from torch import Tensor

import kvision as K
from op_tests import assert_close

C, E = K.color, K.enhance
COLORS = torch.tensor(list(itertools.product([0, 0.25, 0.5, 1], repeat=3)))
IS_GRAY = COLORS.std(1) == 0

IDENTITIES = {
    "hue": lambda x: E.adjust_hue(x, 0.0),
    "saturation": lambda x: E.adjust_saturation(x, 1.0),
    "saturation from gray": lambda x: E.adjust_saturation_with_gray_subtraction(x, 1.0),
    "gamma": lambda x: E.adjust_gamma(x, 1.0),
    "brightness": lambda x: E.adjust_brightness(x, 0.0),
    "contrast": lambda x: E.adjust_contrast(x, 1.0),
}
CURVES = {
    "hue": lambda x: E.adjust_hue(x, 1.0),
    "desaturated": lambda x: E.adjust_saturation(x, 0.5),
    "saturated": lambda x: E.adjust_saturation(x, 2.0),
    "rgb_to_hsv": C.rgb_to_hsv,
    "hsv_to_rgb": C.hsv_to_rgb,
    "rgb_to_hls": C.rgb_to_hls,
    "hls_to_rgb": C.hls_to_rgb,
    "gamma": lambda x: E.adjust_gamma(x, 0.7),
    "solarize": lambda x: E.solarize(x, 0.5),
    "ycbcr_to_rgb": C.ycbcr_to_rgb,
}


def jacobians(f, colors: Tensor, device: torch.device) -> Tensor:
    """(N, 3, 3) of the colors (N, 3)."""
    x = colors.T.reshape(1, 3, 1, -1).contiguous().to(device).requires_grad_()
    y = f(x)
    rows = [torch.autograd.grad(y[:, i].sum(), x, retain_graph=True)[0] for i in range(3)]
    return torch.stack([row[0, :, 0].T for row in rows], 1).cpu()


@pytest.mark.parametrize("name", IDENTITIES)
def test_identities_have_the_gradient_of_the_identity(name, device):
    """Also on faces, edges and corners of the cube; grays, which have no hue, share it among their channels."""
    identity = torch.eye(3).expand(len(COLORS), 3, 3)
    if name == "hue":
        identity = torch.where(IS_GRAY[:, None, None], 1 / 3, identity)
    assert_close(jacobians(IDENTITIES[name], COLORS, device), identity, 0, 1e-5)


@pytest.mark.parametrize("name", CURVES)
def test_kernels_and_references_agree_at_corners(name, device):
    actual = jacobians(CURVES[name], COLORS, device)
    with K.backend("reference"):
        assert_close(actual, jacobians(CURVES[name], COLORS, device), 1e-4, 1e-5)


def test_hue_is_smooth_where_two_channels_tie_for_the_highest(device):
    yellow = torch.tensor([[0.5, 0.5, 0.25]])
    slope = math.pi / 3 / 0.25
    for f in (C.rgb_to_hsv, C.rgb_to_hls):
        assert_close(jacobians(f, yellow, device)[0, 0], torch.tensor([-slope, slope, 0.0]), 1e-5, 1e-5)


@pytest.mark.parametrize("name", ["rgb_to_hsv", "rgb_to_hls", "hue", "saturated", "gamma"])
def test_denormal_colors(name, device, backend):
    """The color that 2^-128 times an ordinary one is has its hue; hue and saturation are adjusted by the same factors."""
    color = torch.tensor([[0.75, 0.25, 0.5]])
    dark = color * 2.0**-128
    actual, ordinary = (CURVES[name](c.view(1, 3, 1, 1).to(device)).flatten().cpu() for c in (dark, color))
    if name == "rgb_to_hsv":  # the eps of HLS is far larger
        assert_close(actual[0], ordinary[0])
    jacobian = jacobians(CURVES[name], dark, device)
    assert actual.isfinite().all() and jacobian.isfinite().all()
    if (
        name in ("hue", "saturated") and backend != "reference"
    ):  # homogeneous; torch's products of denormals lose digits
        assert_close(jacobian, jacobians(CURVES[name], color, device), 1e-4, 1e-4)
    if name == "gamma":
        assert_close(jacobian[0].diagonal(), 0.7 * dark[0].double().pow(-0.3).float(), 1e-4, 0)


def test_one_dark_pixel_in_color_jitter(device):
    x = torch.rand(2, 3, 8, 8, device=device)
    x[0, :, 0, 0] = torch.tensor([3e-39, 1e-39, 2e-39], device=device)
    assert K.augmentation.ColorJitter(0.2, 0.2, 0.2, 0.2, p=1.0)(x).isfinite().all()

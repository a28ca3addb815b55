"""Structural similarity: the kernel's tests."""

from __future__ import annotations

import pytest
import torch

import kvision as K
from op_tests import OpTests


def other(x: torch.Tensor) -> torch.Tensor:
    """Another image, partly equal."""
    noise = torch.rand(x.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(1)).to(x.device)
    return (x.double() * 0.6 + 0.4 * noise).to(torch.float64 if x.dtype == torch.float64 else torch.float32)


class TestSSIM(OpTests):
    function = staticmethod(K.metrics.ssim)
    module = K.metrics.SSIM
    operators = ("ssim", "ssim_backward", "ssim_backward_both")
    variants = [
        {"img2": other, "window_size": 5},
        {"img2": other, "window_size": 7, "padding": "valid", "max_val": 2.0},
    ]
    errors = [
        ({"window_size": 4}, ValueError, "expected window_size to be odd"),
        ({"padding": "full"}, ValueError, "padding must be one of"),
        ({"eps": -1.0}, ValueError, "expected eps to be"),
        ({"img2": None}, TypeError, "expected img2 to be a Tensor"),
    ]
    forward_arguments = ("img2",)
    shape = (2, 3, 13, 18)
    small = (1, 1, 8, 9)
    max_size = 17
    # Variances are differences of means of squares, and the similarity divides by them.
    tolerances = {torch.float32: (2e-4, 2e-5)}

    def test_opcheck(self, variant, device, backend):
        if device.type == "cuda" and torch.__version__.startswith("2.11"):
            pytest.skip("torch 2.11: the second derivative of a convolution on CUDA takes no symbolic sizes")
        super().test_opcheck(variant, device, backend)

"""Contrast of channels around their means, which the corruption `contrast` is."""

import pytest
import torch

from kvision.enhance.channels.channel_contrast import channel_contrast
from op_tests import OpTests


class TestChannelContrast(OpTests):
    operators = ("channel_contrast", "channel_contrast_backward")
    bytes = True
    variants = [{"factor": factor} for factor in (0.3, 2.5)]
    tolerances = {torch.uint8: (0, 1)}  # means are summed in another order

    @staticmethod
    def function(x, factor):
        return channel_contrast(x if x.is_floating_point() or x.dtype == torch.uint8 else x.float(), factor)

    def test_wrong_kinds(self, variant, device):
        pytest.skip("the class that calls the operator checks its input")


@pytest.mark.parametrize("pixels", [1, 8191, 8192, 8193, 40000])
def test_planes_of_several_chunks(pixels, device):
    x = torch.rand(2, 3, 1, pixels, device=device)
    mean = x.double().mean((2, 3), keepdim=True)
    assert torch.allclose(channel_contrast(x, 0.4).double(), mean + 0.4 * (x - mean), atol=1e-5)
    skewed = torch.cat([torch.zeros(2, 3, 1, 1, device=device), x], 3)[..., 1:]
    assert torch.equal(channel_contrast(skewed, 0.4), channel_contrast(x, 0.4))

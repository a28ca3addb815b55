"""Tests of the filters that are composed of other operators."""

from __future__ import annotations

import pytest
import torch

import kvision as K
from composition_tests import Case, CompositionTests
from op_tests import assert_close

F = K.filters
IMAGE, VOLUME = (2, 2, 6, 5), (1, 2, 3, 4, 3)


class TestCompositions(CompositionTests):
    cases = {
        "fft_conv": Case(lambda x, k: F.fft_conv(x, k, normalized=True), (IMAGE, (1, 3, 2)), shared=(1,)),
        "fft_conv_each": Case(lambda x, k: F.fft_conv(x, k, "circular", behaviour="conv"), (IMAGE, (2, 3, 3))),
        "guided_blur": Case(lambda g, x: F.guided_blur(g, x, 3, 0.1), (IMAGE, (2, 1, 6, 5))),
        "guided_blur_fast": Case(lambda g, x, eps: F.guided_blur(g, x, 3, eps, "replicate", 2), (IMAGE, IMAGE, (2,))),
        "motion_blur": Case(lambda x, d: F.motion_blur(x, 3, 33.0, d), (IMAGE, (1,)), shared=(1,)),
        "motion_blur_each": Case(
            lambda x, a, d: F.motion_blur(x, 3, 100 * a, d, "replicate", "bilinear"), (IMAGE, (2,), (2,))
        ),
        "motion_blur3d": Case(
            lambda x, a, d: F.motion_blur3d(x, 3, 100 * a, d, mode="bilinear"), (VOLUME, (1, 3), (1,))
        ),
        "blur_pool2d": Case(lambda x: F.blur_pool2d(x, 3), (IMAGE,)),
        "max_blur_pool2d": Case(lambda x: F.max_blur_pool2d(x, 3), (IMAGE,)),
        "edge_aware_blur_pool2d": Case(lambda x: F.edge_aware_blur_pool2d(x, 3, 3.0), (IMAGE,)),
        "in_range": Case(lambda x: F.in_range(x, (0.2, 0.3), (0.8, 0.9)), (IMAGE,)),
    }

    def test_number_types(self, name, case, device):
        exact = self.values(case, device)
        single = [v.float() for v in exact]
        assert_close(case.call(*single), case.call(*exact).float())
        for dtype in (torch.float16, torch.bfloat16):
            images = [v.to(dtype) if v.dim() > 3 else v for v in single]
            assert case.call(*images).dtype == dtype
            if name != "in_range":  # a bound in a coarse type is another bound
                assert_close(case.call(*images), case.call(*[v.float() for v in images]).to(dtype))

    def test_no_channels(self, name, case, device):
        if name == "in_range":
            pytest.skip("its bounds count the channels")
        values = [v[:, :0] if v.dim() > 3 else v for v in self.values(case, device)]
        values = [v.requires_grad_() for v in values]
        y = case.call(*values)
        assert y.numel() == 0 and y.dim() == values[0].dim()
        y.sum().backward()
        assert values[0].grad.shape == values[0].shape

"""Patches: the kernels' tests."""

from __future__ import annotations

import pytest
import torch

import kvision as K
from op_tests import OpTests, assert_close


class TestExtract(OpTests):
    function = staticmethod(K.contrib.extract_tensor_patches)
    module = K.contrib.ExtractTensorPatches
    operators = ("extract_patches", "combine_patches")
    variants = [
        {"window_size": (4, 8), "stride": (2, 4), "padding": (1, 0, 4, 0)},
        {"window_size": 3, "stride": 5, "allow_auto_padding": True},
    ]
    errors = [
        ({"window_size": 0}, ValueError, "expected window_size"),
        ({"stride": "1"}, TypeError, "expected stride"),
        ({"padding": (1, 2, 3)}, TypeError, "expected padding"),
    ]
    bytes = True
    shape = (2, 3, 12, 20)
    max_size = 9

    def test_other_integers_become_float32(self, variant, device):
        """They do not: patches have the type of their image."""
        x, kwargs = self.setup(variant, device, torch.uint8)
        assert_close(self.call(x.int(), kwargs), self.call(x, kwargs).int())


@pytest.mark.parametrize("size", [(1, 1), (9, 14), (40, 64)], ids=str)
@pytest.mark.parametrize("stride", [(1, 1), (3, 4), (4, 8)], ids=str)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.int64], ids=str)
def test_patches_put_together(size, stride, dtype, device):
    """The image again, whatever overlaps."""
    x = torch.rand(2, 3, *size).mul(100).to(dtype).to(device)
    more = {"allow_auto_padding": True}
    patches = K.contrib.extract_tensor_patches(x, (4, 8), stride, **more)
    again = K.contrib.combine_tensor_patches(patches, size, (4, 8), stride, allow_auto_unpadding=True)
    assert_close(again, x)

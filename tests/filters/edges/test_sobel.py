import pytest
import torch

import kvision as K
from benchmarks.sample_calls.windows import variants
from op_tests import OpTests, assert_close


class TestSobel(OpTests):
    function = staticmethod(K.filters.sobel)
    module = K.filters.Sobel
    operators = ("sobel", "sobel_backward")
    compiler = "inductor"
    variants = variants("sobel")
    # Where both gradients nearly vanish, rounding decides their direction, and the gradient follows it.
    tolerances = {torch.float32: (5e-4, 5e-6)}

    def test_flat_image_gives_the_root_of_eps(self, device):
        assert_close(
            K.filters.sobel(torch.full((1, 1, 4, 4), 0.3, device=device)), torch.full((1, 1, 4, 4), 1e-3, device=device)
        )

    def test_flat_image_without_eps_has_gradient_zero(self, device):
        x = torch.full((1, 1, 4, 4), 0.3, device=device, requires_grad=True)
        K.filters.sobel(x, eps=0.0).sum().backward()
        assert torch.equal(x.grad, torch.zeros_like(x))

    def test_index_arithmetic_beyond_31_bits(self, device):
        if device.type != "cuda":
            pytest.skip("8 GB of pixels: on the GPU only")
        x = torch.zeros(1, 1, 2**16 + 2, 2**15 + 8, device=device, dtype=torch.float16)
        x[0, 0, -5:, -5:] = torch.rand(5, 5, device=device)
        y = K.filters.sobel(x)
        assert torch.equal(y[..., -8:, -8:], K.filters.sobel(x[..., -10:, -10:].contiguous())[..., 2:, 2:])

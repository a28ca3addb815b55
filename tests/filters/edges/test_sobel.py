import cv2
import kornia
import numpy as np
import pytest
import scipy.ndimage
import skimage.filters
import torch

import kvision as K
from benchmarks.sample_calls.windows import variants
from op_tests import OpTests, assert_close


class TestSobel(OpTests):
    function = staticmethod(K.filters.sobel)
    module = K.filters.Sobel
    operators = ("sobel", "sobel_backward")
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

    def test_against_kornia(self, device):
        x = torch.rand(2, 3, 31, 40, device=device)
        assert_close(K.filters.sobel(x), kornia.filters.sobel(x))

    def test_against_opencv_scipy_and_skimage(self, device):
        image = np.random.default_rng(0).random((37, 41), dtype=np.float32)
        ours = K.filters.sobel(torch.from_numpy(image)[None, None].to(device), eps=0.0)[0, 0].cpu()

        def magnitude(dx, dy):
            return torch.from_numpy(np.hypot(dx, dy))

        replicate = cv2.BORDER_REPLICATE
        by_opencv = [
            cv2.Sobel(image, cv2.CV_32F, *d, ksize=3, scale=1 / 8, borderType=replicate) for d in [(1, 0), (0, 1)]
        ]
        assert_close(ours, magnitude(*by_opencv))
        assert_close(ours, magnitude(*(scipy.ndimage.sobel(image, axis, mode="nearest") / 8 for axis in (0, 1))))
        # scikit-image divides by 4 and averages the two squares
        assert_close(ours, torch.from_numpy(skimage.filters.sobel(image, mode="nearest")) / np.sqrt(2))

    def test_index_arithmetic_beyond_31_bits(self, device):
        if device.type != "cuda":
            pytest.skip("8 GB of pixels: on the GPU only")
        x = torch.zeros(1, 1, 2**16 + 2, 2**15 + 8, device=device, dtype=torch.float16)
        x[0, 0, -5:, -5:] = torch.rand(5, 5, device=device)
        y = K.filters.sobel(x)
        assert torch.equal(y[..., -8:, -8:], K.filters.sobel(x[..., -10:, -10:].contiguous())[..., 2:, 2:])

import cv2
import kornia
import numpy as np
import pytest
import scipy.ndimage
import torch

import kvision as K
from benchmarks.sample_calls.windows import variants
from kvision.filters.smoothing.gaussian import gaussian_levels
from op_tests import OpTests, assert_close


class TestGaussianLevels(OpTests):
    """The operator of ScalePyramid, which checks its arguments."""

    function = staticmethod(gaussian_levels)
    operators = ("gaussian_levels", "gaussian_blur2d_backward")
    small = (1, 2, 5, 6)
    variants = [
        {"sizes": [3, 5], "sigmas": [0.8, 1.5]},
        {"sizes": [5], "sigmas": [2.0], "border_type": "replicate"},
    ]

    def test_levels_are_blurred_one_after_the_other(self, device):
        x = torch.rand(2, 3, 21, 18, device=device)
        levels = gaussian_levels(x, [5, 9], [1.0, 1.5])
        first = K.filters.gaussian_blur2d(x, 5, (1.0, 1.0))
        assert torch.equal(levels[:, :, 0], x) and torch.equal(levels[:, :, 1], first)
        assert torch.equal(levels[:, :, 2], K.filters.gaussian_blur2d(first, 9, (1.5, 1.5)))


class TestGaussianBlur2d(OpTests):
    function = staticmethod(K.filters.gaussian_blur2d)
    module = K.filters.GaussianBlur2d
    operators = ("gaussian_blur2d", "gaussian_blur2d_backward", "filter2d_separable_weights_backward")
    bytes = True
    small = (1, 2, 5, 6)
    tolerances = {torch.uint8: (0, 1)}  # a sum in another order may fall on the other side of a half
    variants = variants("gaussian_blur2d")
    errors = [
        ({"kernel_size": 4}, ValueError, "expected kernel_size to be odd"),
        ({"kernel_size": 0}, ValueError, "ints of at least 1"),
        ({"kernel_size": 3.0}, TypeError, "expected kernel_size"),
        ({"sigma": (1.0, 0.0)}, ValueError, "positive"),
        ({"sigma": (1.0, float("nan"))}, ValueError, "positive"),
        ({"sigma": "1"}, TypeError, "expected sigma"),
        ({"sigma": lambda x: torch.ones(3, 2)}, ValueError, "a batch size of 1 or 2"),
        ({"sigma": lambda x: torch.ones(2)}, ValueError, "expected sigma of shape"),
        ({"border_type": "mirror"}, ValueError, "border_type must be one of"),
        ({"kernel_size": 31}, ValueError, "border of 15 pixels"),
    ]

    @pytest.mark.parametrize("size, sigma", [(3, 0.8), (5, 1.0), (11, 2.0), (31, 5.0), (35, 6.0)])
    @pytest.mark.parametrize("border", ["reflect", "replicate", "constant"])
    def test_against_opencv(self, size, sigma, border, device):
        image = np.random.default_rng(0).random((61, 150), dtype=np.float32)
        rule = {"reflect": cv2.BORDER_REFLECT_101, "replicate": cv2.BORDER_REPLICATE, "constant": cv2.BORDER_CONSTANT}
        expected = cv2.GaussianBlur(image, (size, size), sigma, sigmaY=sigma, borderType=rule[border])
        x = torch.from_numpy(image)[None, None].to(device)
        ours = K.filters.gaussian_blur2d(x, (size, size), (sigma, sigma), border)
        assert_close(ours[0, 0].cpu(), torch.from_numpy(expected))

    @pytest.mark.parametrize("size, sigma", [(5, 1.0), (11, 2.0), (31, 5.0)])
    def test_bytes_against_opencv(self, size, sigma, device):
        """OpenCV blurs bytes in fixed point: within one level."""
        image = np.random.default_rng(0).integers(0, 256, (61, 150), dtype=np.uint8)
        expected = cv2.GaussianBlur(image, (size, size), sigma, borderType=cv2.BORDER_REFLECT_101)
        ours = K.filters.gaussian_blur2d(torch.from_numpy(image)[None, None].to(device), size, sigma)
        assert_close(ours[0, 0].cpu(), torch.from_numpy(expected), 0, 1)

    def test_against_scipy_and_kornia(self, device):
        x = torch.rand(2, 3, 40, 50, dtype=torch.float64, device=device)
        ours = K.filters.gaussian_blur2d(x, (9, 13), (1.2, 2.0))
        expected = scipy.ndimage.gaussian_filter(x.cpu().numpy(), (0, 0, 1.2, 2.0), radius=(0, 0, 4, 6), mode="mirror")
        assert_close(ours.cpu(), torch.from_numpy(expected))
        assert_close(ours, kornia.filters.gaussian_blur2d(x, (9, 13), (1.2, 2.0)))

    def test_numbers_and_tensor_are_one(self, device):
        x = torch.rand(2, 3, 40, 50, device=device)
        sigma = torch.tensor([[1.2, 2.0]], device=device)
        for size in (3, (3, 5), 31, 33):
            assert_close(
                K.filters.gaussian_blur2d(x, size, (1.2, 2.0)), K.filters.gaussian_blur2d(x, size, sigma), 1e-6, 1e-7
            )

    def test_bad_sigma_of_a_tensor_spoils_its_image_only(self, device):
        x = torch.rand(4, 1, 9, 9, device=device)
        sigma = torch.tensor([[1.0, 1.0], [0.0, 1.0], [1.0, -1.0], [float("nan"), 1.0]], device=device)
        spoilt = K.filters.gaussian_blur2d(x, 3, sigma).isnan()
        assert not spoilt[0].any() and spoilt[1:].all()

    def test_tiny_sigma_is_the_identity(self, device):
        x = torch.rand(1, 1, 9, 9, device=device)
        assert torch.equal(K.filters.gaussian_blur2d(x, 5, 1e-30), x)

    def test_learned_sigma(self, device):
        module = K.filters.GaussianBlur2d(7, torch.nn.Parameter(torch.tensor([[1.0, 2.0]]))).to(device)
        module(torch.rand(2, 1, 9, 9, device=device)).square().sum().backward()
        (sigma,) = module.parameters()
        assert sigma.grad.shape == (1, 2) and sigma.grad.abs().min() > 0

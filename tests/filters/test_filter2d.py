import cv2
import hypothesis.strategies as st
import kornia
import numpy as np
import pytest
import scipy.ndimage
import torch

import kvision as K
from kvision.filters.filter2d import filter2d_clamped, filter_arguments
from op_tests import OpTests, assert_close

BORDERS = ("constant", "reflect", "replicate", "circular")


def kernel(*sizes, shared=True):
    """A kernel whose weights are multiples of 1/64: sums of bytes are exact in float32."""
    return lambda x: torch.randint(-32, 33, (1 if shared else x.shape[0], *sizes)) / 64.0


class TestFilter2d(OpTests):
    function = staticmethod(K.filters.filter2d)
    operators = ("filter2d", "filter2d_backward", "filter2d_kernel_backward")
    bytes = True
    variants = [
        {"kernel": kernel(3, 3)},
        {"kernel": kernel(5, 5, shared=False), "border_type": "replicate"},
        {"kernel": kernel(7, 7), "border_type": "circular"},
        {"kernel": kernel(5, 5), "border_type": "constant", "behaviour": "conv"},
        {"kernel": kernel(3, 3, shared=False), "padding": "valid"},
        {"kernel": kernel(4, 6), "border_type": "reflect"},
        {"kernel": kernel(2, 9, shared=False), "border_type": "replicate"},
        {"kernel": kernel(11, 1), "border_type": "circular"},
        {"kernel": kernel(9, 13), "border_type": "constant"},
        {"kernel": kernel(8, 5), "padding": "valid"},
    ]
    errors = [
        ({"kernel": lambda x: torch.ones(3, 3)}, ValueError, r"expected kernel of shape \(B or 1, kH, kW\)"),
        ({"kernel": kernel(3, 3), "border_type": "mirror"}, ValueError, "border_type must be one of"),
        ({"kernel": kernel(3, 3), "padding": "full"}, ValueError, "padding must be one of"),
        ({"kernel": kernel(3, 3), "behaviour": "convolve"}, ValueError, "behaviour must be one of"),
        ({"kernel": lambda x: torch.ones(5, 3, 3)}, ValueError, "expected a kernel batch of 1 or the 2"),
        ({"kernel": lambda x: torch.ones(1, 3, 0)}, ValueError, "at least one tap"),
        ({"kernel": kernel(14, 3), "padding": "valid"}, ValueError, "'valid' kernel no larger than the input"),
        ({"kernel": kernel(27, 3)}, ValueError, "'reflect' border of 13"),
    ]
    small = (1, 2, 8, 7)
    # Sums of up to 117 products.
    tolerances = {torch.float32: (2e-5, 2e-5)}

    def fuzz_arguments(self):
        sizes = st.tuples(st.integers(1, 12), st.integers(1, 12))
        return st.fixed_dictionaries(
            {
                "kernel": st.builds(lambda s, shared: kernel(*s, shared=shared), sizes, st.booleans()),
                "border_type": st.sampled_from(BORDERS),
                "padding": st.sampled_from(("same", "valid")),
                "behaviour": st.sampled_from(("corr", "conv")),
            }
        )

    @pytest.mark.parametrize("padding", ["same", "valid"])
    @pytest.mark.parametrize("border", BORDERS)
    @pytest.mark.parametrize("size", [(1, 1), (3, 3), (5, 5), (6, 3), (7, 7), (15, 8), (31, 31)])
    def test_values_and_gradients(self, size, border, padding, device):
        """Large and small kernels on images that take the fast paths of the GPU, those of one block and larger ones."""
        for shape in [(2, 2, 40, 36), (1, 1, 33, 41), *[(1, 2, 70, 264)] * (device.type == "cuda")]:
            x = torch.rand(shape, device=device)
            weights = torch.rand(shape[0], *size, device=device) - 0.5
            kwargs = {"kernel": weights, "border_type": border, "padding": padding}
            assert_close(K.filters.filter2d(x, **kwargs), self.expected(x, kwargs), atol=5e-5)
            self.check_gradients(x, kwargs)

    @pytest.mark.parametrize("border", BORDERS)
    def test_against_kornia(self, border, device):
        x, weights = torch.rand(2, 3, 31, 40, device=device), torch.rand(2, 5, 4, device=device)
        for kwargs in [{}, {"normalized": True}, {"padding": "valid"}, {"behaviour": "conv"}]:
            expected = kornia.filters.filter2d(x, weights, border, **kwargs)
            assert_close(K.filters.filter2d(x, weights, border, **kwargs), expected)

    def test_against_opencv_and_scipy(self, device):
        image = np.random.default_rng(0).random((37, 41), dtype=np.float32)
        weights = np.random.default_rng(1).random((5, 7), dtype=np.float32)
        x, w = torch.from_numpy(image)[None, None].to(device), torch.from_numpy(weights)[None].to(device)
        for ours, theirs, name in [
            ("reflect", cv2.BORDER_REFLECT_101, "mirror"),
            ("replicate", cv2.BORDER_REPLICATE, "nearest"),
            ("constant", cv2.BORDER_CONSTANT, "constant"),
        ]:
            y = K.filters.filter2d(x, w, ours)[0, 0].cpu()
            assert_close(y, torch.from_numpy(cv2.filter2D(image, cv2.CV_32F, weights, borderType=theirs)))
            assert_close(y, torch.from_numpy(scipy.ndimage.correlate(image, weights, mode=name)))

    def test_bytes_against_opencv(self, device):
        image = np.random.default_rng(0).integers(0, 256, (64, 48), dtype=np.uint8)
        for size in (3, 5, 9):
            weights = (np.random.default_rng(size).integers(-8, 12, (size, size)) / 64).astype(np.float32)
            expected = cv2.filter2D(image, -1, weights, borderType=cv2.BORDER_REPLICATE)
            x, w = torch.from_numpy(image)[None, None].to(device), torch.from_numpy(weights)[None].to(device)
            assert torch.equal(K.filters.filter2d(x, w, "replicate")[0, 0].cpu(), torch.from_numpy(expected))

    def test_correlate_and_convolve(self, device):
        x, w = torch.rand(1, 2, 9, 11, device=device), torch.rand(1, 3, 5, device=device)
        assert_close(K.filters.correlate2d(x, w), K.filters.filter2d(x, w))
        assert_close(K.filters.convolve2d(x, w), K.filters.filter2d(x, w.flip(1, 2)))

    def test_kernel_gradient_of_a_large_half_image_does_not_overflow(self, device):
        x = torch.full((1, 1, 300, 300), 2.0, dtype=torch.float16, device=device)
        w = torch.ones(1, 3, 3, device=device, requires_grad=True)
        K.filters.filter2d(x, w, "replicate").sum().backward()
        assert_close(w.grad, torch.full((1, 3, 3), 180000.0, device=device))

    def test_nan_outside_the_window_leaves_the_kernel_gradient(self, device):
        """Taps that never lie on the last column have a finite gradient."""
        x = torch.rand(1, 1, 9, 35, device=device)
        x[..., -1] = float("nan")
        w = torch.rand(1, 3, 3, device=device, requires_grad=True)
        K.filters.filter2d(x, w, "constant").sum().backward()
        assert w.grad[..., 0].isfinite().all() and w.grad[..., 1:].isnan().all()


class TestClamped(OpTests):
    """Results clamped to [0, 1] where they are stored."""

    operators = ("filter2d_clamped", "filter2d", "filter2d_backward", "filter2d_kernel_backward")
    bytes = True
    variants = [
        {"kernel": kernel(3, 3), "border_type": "reflect"},
        {"kernel": kernel(5, 5, shared=False), "border_type": "replicate"},
        {"kernel": kernel(7, 7), "border_type": "circular"},
        {"kernel": kernel(9, 13, shared=False), "border_type": "constant"},
    ]
    small = (1, 2, 8, 7)
    tolerances = {torch.float32: (2e-5, 2e-5), torch.uint8: (0, 1)}  # the definition has no bytes

    @staticmethod
    def function(x, kernel, border_type):
        x, weights, border, _ = filter_arguments("filter2d", x, kernel, border_type)
        return filter2d_clamped(x, weights, border)

    def test_wrong_kinds(self, variant, device):
        pytest.skip("the class that calls the operator checks its input")

    @pytest.mark.parametrize("dtype", [torch.float16, torch.float32, torch.float64, torch.uint8], ids=str)
    @pytest.mark.parametrize("size", [3, 7, 9])
    def test_values_are_those_of_the_filter(self, size, dtype, device):
        most = 255 if dtype == torch.uint8 else 1
        x = (torch.rand(2, 3, 40, 131, device=device) * (200 if most > 1 else 1)).to(dtype)
        x, weights, border, _ = filter_arguments("filter2d", x, torch.randn(1, size, size, device=device))
        y = K.filters.filter2d(x, weights).clamp(0, most)
        assert_close(
            filter2d_clamped(x, weights, border), y, 0, int(dtype == torch.uint8)
        )  # the definition has no bytes
